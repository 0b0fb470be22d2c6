"""``fvs_recorder_node``: records every topic that it finds into a bag, unchanged."""

from __future__ import annotations

from fvs_ros import stop

stop.listen()

import shutil
import sys
import time
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from fvs_ros import ros, topics
from fvs_ros.kinds import KINDS
from fvs_ros.paths import version
from fvs_tools.recording import (
    LARGE,
    PARAMETERS,
    RecorderConfig,
    check_recording,
    is_recorded,
)

try:
    from fvs_tools import bag
except ImportError:  # without rosbags: check_recording refuses
    bag = None  # type: ignore[assignment]

#: Polling period of the message queues, s: polling costs far less than a callback per message.
_FETCH_S = 0.05
#: Free disk space below which the recording ends cleanly, MB.
_LEAST_FREE_MB = 200


@dataclass
class _Topic:
    """A topic that is recorded.

    Each QoS of a publisher (reliable, latched) has its own subscription: one that requests less
    than is offered loses messages, and one that requests more receives none.
    """

    type: str
    subscriptions: dict[tuple[Any, Any], Subscription] = field(default_factory=dict)
    #: Newest messages, to detect duplicates from two subscriptions.
    recent: deque[tuple[int, int]] = field(default_factory=lambda: deque(maxlen=1000))

    def came_before(self, sent_ns: int, data: bytes) -> bool:
        if len(self.subscriptions) < 2:
            return False
        key = (sent_ns, hash(data))
        known = key in self.recent
        self.recent.append(key)
        return known


class RecorderNode(ros.FvsNode):
    """Looks for topics, fetches their messages, writes them."""

    def __init__(self) -> None:
        super().__init__("fvs_recorder_node", PARAMETERS)
        self._config = RecorderConfig.from_values(self.values)
        self._folder = Path(self._config.bag_dir).expanduser()
        check_recording(self._folder)
        self._group = ros.NeverReady()
        self._topics: dict[str, _Topic] = {}
        self._publisher_counts: dict[str, int] = {}
        simulated = self.get_parameter("use_sim_time").value
        self._simulated_time = bag.SimulatedTime() if simulated else None
        self._expect()
        notes = {"fvs_ros_version": version(), "scenario": self._config.scenario}
        # Created last: the launcher waits for the folder as a sign that all topics are subscribed.
        self._bag = bag.Bag(self._folder, notes)
        self.create_timer(0.2, self._look, clock=self.steady_clock)
        self.create_timer(_FETCH_S, self._fetch, clock=self.steady_clock)
        self.create_timer(ros.STATUS_PERIOD_S, self._publish_state, clock=self.steady_clock)
        self.tell(ros.OK, f"recording into {self._folder}")

    # --- which topics ---

    def _expect(self) -> None:
        """Subscribe to this package's topics before a node publishes: no first message is lost.

        Not to one whose type depends on the kind of feature: its publisher tells.
        """
        every = [*topics.COMMON, *(topic for kind in KINDS.values() for topic in kind.topics)]
        types = Counter(topic.name for topic in every)
        for topic in every:
            for node in topic.publishers:
                name = self.resolve_topic_name(topic.name.replace("~", node, 1))
                if types[topic.name] == 1 and is_recorded(name, topic.type, self._config.images):
                    self._add(name, topic.type, ros.PROFILES[topic.offers])

    def _look(self) -> None:
        """Subscribe to new topics and publishers on the graph."""
        for topic, _ in self.get_topic_names_and_types():
            publishers = self.count_publishers(topic)
            if publishers == self._publisher_counts.get(topic, 0):
                continue
            self._publisher_counts[topic] = publishers
            types = sorted({end.topic_type for end in self.get_publishers_info_by_topic(topic)})
            if not types or not is_recorded(topic, types[0], self._config.images):
                continue
            if len(types) > 1:
                self.tell(ros.WARN, f"{topic} is not recorded: it has several types {types}")
            elif not all([self._add(topic, types[0], qos) for qos in self._offers(topic)]):
                self.tell(ros.WARN, f"{topic} is not recorded: its type {types[0]} is not known")

    def _offers(self, topic: str) -> list[QoSProfile]:
        """What the topic's publishers offer."""
        return [info.qos_profile for info in self.get_publishers_info_by_topic(topic)]

    def _add(self, topic: str, message_type: str, offer: QoSProfile) -> bool:
        """Subscribe to a kind of publisher; False where the type of message is not known."""
        try:
            kind = ros.message_class(message_type)
        except (ImportError, AttributeError):  # its package is not installed
            return False
        if message_type not in bag.TYPES.fielddefs:
            return False
        subscriptions = self._topics.setdefault(topic, _Topic(message_type)).subscriptions
        reliable = offer.reliability == ReliabilityPolicy.RELIABLE
        latched = offer.durability == DurabilityPolicy.TRANSIENT_LOCAL
        if (reliable, latched) not in subscriptions:
            subscriptions[reliable, latched] = self.create_subscription(
                kind,
                topic,
                lambda _message: None,  # fetched, never called
                QoSProfile(
                    history=HistoryPolicy.KEEP_LAST,
                    depth=60 if message_type in LARGE else 4000,
                    reliability=offer.reliability,
                    durability=offer.durability,
                ),
                callback_group=self._group,
                raw=True,
            )
        return True

    # --- their messages ---

    def _fetch(self) -> None:
        """Write all that has come, in the order in which it came."""
        if self.exit_code is not None:
            return
        try:
            for message in sorted(self._waiting(), key=lambda message: message.stamp_ns):
                simulated = self._simulated_time
                for stamped in [message] if simulated is None else simulated.stamped(message):
                    self._write(stamped)
            free_mb = shutil.disk_usage(self._folder).free / 1e6
        except bag.ERRORS as error:
            self._give_up(str(getattr(error, "strerror", None) or error))
            return
        if free_mb < _LEAST_FREE_MB:
            self._give_up(f"only {free_mb:.0f} MB are left on the disk")

    def _waiting(self) -> Iterator[bag.Message]:
        for name, topic in self._topics.items():
            for subscription in topic.subscriptions.values():
                while (taken := ros.take(subscription)) is not None:
                    data, info = taken
                    if not topic.came_before(info["source_timestamp"], data):
                        yield bag.Message(name, topic.type, info["received_timestamp"], data)

    def _write(self, message: bag.Message) -> None:
        is_new = message.topic not in self._bag.counts
        self._bag.write(message, self._offers(message.topic) if is_new else ())

    # --- state and end ---

    def _give_up(self, why: str) -> None:
        self.tell(ros.ERROR, f"recording into {self._folder} has ended: {why}")
        self.exit_code = stop.EXIT_FAILURE

    def _publish_state(self) -> None:
        counts = self._bag.counts
        values = {"topics": len(counts), "messages": sum(counts.values())}
        self.publish_status(ros.OK, "RECORDING", f"recording into {self._folder}", values)

    def finish(self) -> None:
        """Record the last messages, and finish the bag."""
        # A controller that is stopped at the same time still sends zeros.
        end_s = self.steady_s() + 0.5
        while self.exit_code is None and self.steady_s() < end_s:
            self._fetch()
            time.sleep(_FETCH_S)
        try:
            for message in self._simulated_time.rest() if self._simulated_time else ():
                self._write(message)
            self._bag.close()
        except bag.ERRORS as error:
            if self.exit_code is None:
                self._give_up(str(error))
            return
        counts = self._bag.counts
        self.tell(ros.OK, f"{sum(counts.values())} messages of {len(counts)} topics recorded")


def main() -> int:
    """Run ``fvs_recorder_node``."""
    return ros.run(RecorderNode, __doc__, PARAMETERS)


if __name__ == "__main__":
    sys.exit(main())
