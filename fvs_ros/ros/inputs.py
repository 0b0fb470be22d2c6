"""Messages of other nodes: bounded in size, read on demand, counted."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
import rclpy
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Image
from std_msgs.msg import String

from fvs_ros.ros.messages import MOST_TEXT, MessageError
from fvs_ros.ros.qos import QOS_NEWEST

#: Largest message or request of others, bytes; a robot's description (URDF) may be larger. Most
#: items that a request names.
_MOST_BYTES, _MOST_BYTES_OF, MOST_ITEMS = 2**14, {String: 2**20}, 250


def unpacked(message_type: type, data: Any) -> Any:
    """The message in received bytes, or the image; a ``MessageError`` if it is none."""
    # Images are as large as their pixels, which their decoding bounds.
    if message_type is Image:
        size, most, what = len(data.header.frame_id), MOST_TEXT, "its frame_id"
    else:
        size, most, what = len(data), _MOST_BYTES_OF.get(message_type, _MOST_BYTES), "it"
    if size > most:
        raise MessageError(f"{what} has {size} bytes, expected at most {most}")
    try:
        return data if message_type is Image else deserialize_message(data, message_type)
    except RuntimeError as error:
        raise MessageError(str(error)) from error


def check_request(request: Any) -> None:
    """A ``ValueError`` if a service's request is too large or malformed."""
    size = len(serialize_message(request))
    fields = [getattr(request, name) for name in request.get_fields_and_field_types()]
    items = max([len(field) for field in fields if isinstance(field, list)], default=0)
    if size > _MOST_BYTES or items > MOST_ITEMS:
        raise MessageError(
            f"a request of {items} items and {size} bytes is too large, "
            f"expected at most {MOST_ITEMS} and {_MOST_BYTES}"
        )
    for parameter in getattr(request, "parameters", ()):
        rclpy.Parameter.from_parameter_msg(parameter)  # raises if its type is unknown


class NeverReady(CallbackGroup):
    """Subscriptions that the executor ignores: their messages are read on demand."""

    def can_execute(self, entity: Any) -> bool:
        """Never."""
        return False


def take(subscription: Any) -> Any:
    """The next waiting message of a subscription, and its information; None if there is none."""
    with subscription.handle:
        return subscription.handle.take_message(subscription.msg_type, subscription.raw)


class Sampled:
    """A topic that is read on demand: its messages do not wake the process.

    Hundreds of wake-ups per second cost a good part of a core.
    """

    def __init__(
        self, node: Node, message_type: type, topic: str, callback: Callable[[Any], None]
    ) -> None:
        self._node = node
        self._subscription = node.create_subscription(
            message_type, topic, callback, QOS_NEWEST, callback_group=NeverReady()
        )

    def look(self) -> None:
        """Take the newest message, if one has arrived since the last look."""
        taken = take(self._subscription)
        if taken is not None:
            self._subscription.callback(taken[0])

    def close(self) -> None:
        """Unsubscribe."""
        self._node.destroy_subscription(self._subscription)


class ArrivalMonitor:
    """Statistics of one input's last arrivals on a steady clock."""

    def __init__(self) -> None:
        self._arrivals_s: deque[float] = deque(maxlen=100)
        self.count = 0

    def arrived(self, now_s: float) -> None:
        """Count an arrival, s on the steady clock."""
        self._arrivals_s.append(now_s)
        self.count += 1

    def age_s(self, now_s: float) -> float:
        """Seconds since the newest arrival; infinite before the first."""
        return now_s - self._arrivals_s[-1] if self._arrivals_s else math.inf

    def report(self, now_s: float) -> dict[str, float | int]:
        """Age (s), rate (Hz), jitter (ms, standard deviation of the intervals) and count."""
        intervals_s = np.diff(self._arrivals_s)
        mean_s = float(np.mean(intervals_s)) if intervals_s.size else 0.0
        return {
            "age_s": self.age_s(now_s),
            "rate_hz": 1.0 / mean_s if mean_s > 0.0 else math.nan,
            "jitter_ms": 1e3 * float(np.std(intervals_s)) if intervals_s.size else math.nan,
            "count": self.count,
        }
