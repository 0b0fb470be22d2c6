"""A bad network between two nodes: a relay that loses, delays, repeats and spoils messages."""

import random
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy

from fvs_ros import ros

#: What goes through a relay is published on this prefix and the topic.
PREFIX = "wire/"


class Wire:
    """Relays one topic, and does to each message what its attributes say.

    ``loss``, ``repeat`` and ``swap`` are probabilities: a message is lost, is said twice, is said
    after its follower. ``shift_s`` is added to the stamps: the sender's clock jumped. ``freeze``
    sends new contents with the last ``stamp``, or the last ``message`` again. With a ``delay_s``,
    somebody has to call :meth:`deliver` now and then.
    """

    def __init__(self, node: Any, message_type: type, topic: str) -> None:
        self._publisher = node.create_publisher(message_type, PREFIX + topic, ros.QOS_RELIABLE)
        # Deeper than the nodes' own: what the wire loses, it is to lose on purpose.
        qos = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
        node.create_subscription(message_type, topic, self._on_message, qos)
        #: Called with every message heard, before anything is done to it.
        self.listeners: list[Callable[[Any], None]] = []
        self.calm()

    def calm(self) -> None:
        """Be a good wire again; what is under way is lost."""
        self.silent, self.freeze = False, ""
        self.loss = self.repeat = self.swap = self.shift_s = self.delay_s = 0.0
        self.spoil: Callable[[Any], None] | None = None
        self._random = random.Random(1)
        self._last: Any = None
        self._held_back: Any = None
        self._under_way: deque[tuple[float, Any]] = deque()

    def send(self, message: Any) -> None:
        """Say something of one's own at the far end."""
        self._publisher.publish(message)

    def _on_message(self, message: Any) -> None:
        for listener in self.listeners:
            listener(message)
        if self.silent or self._random.random() < self.loss:
            return
        message = self._disturbed(message)
        if self._held_back is None and self._random.random() < self.swap:
            self._held_back = message
            return
        twice = self._random.random() < self.repeat
        late, self._held_back = self._held_back, None
        for one in (message, message if twice else None, late):
            if one is not None:
                self._under_way.append((time.monotonic() + self.delay_s, one))
        self.deliver()

    def _disturbed(self, message: Any) -> Any:
        if self.freeze and self._last is not None:
            if self.freeze == "message":
                return self._last
            message.header.stamp = self._last.header.stamp
            return message
        if self.shift_s:
            stamp_s = ros.from_stamp(message.header.stamp) + self.shift_s
            message.header.stamp = ros.to_stamp(stamp_s)
        if self.spoil is not None:
            self.spoil(message)
        self._last = message
        return message

    def deliver(self) -> None:
        """Say what has been under way for long enough."""
        while self._under_way and self._under_way[0][0] <= time.monotonic():
            self.send(self._under_way.popleft()[1])
