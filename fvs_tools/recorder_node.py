"""``fvs_recorder_node``: writes every topic that it finds into a bag, as it comes."""

from __future__ import annotations

from fvs_ros import stop

stop.listen()

import importlib
import shutil
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from fvs_ros import ros, topics
from fvs_ros.topics import INTERFACES, Qos, resolve
from fvs_ros.version import version
from fvs_tools import recording, transforms
from fvs_tools.recording import Doubles, Message, Request, SimulatedTime

_LOOK_S = 0.2
#: Messages wait in their queues, with the time at which they came, and are fetched this often:
#: far cheaper than to be woken by each.
_FETCH_S = 0.05
_STATUS_S = 0.5
#: So long it goes on when it is stopped: a controller that is stopped together with it still sends
#: its last zeros.
_LAST_WORDS_S = 0.5
_MB = 1e6


class RecorderNode(ros.FvsNode):
    """Looks for topics, fetches their messages, writes them."""

    def __init__(self) -> None:
        super().__init__(recording.NODE, recording.PARAMETERS)
        self._folder = Path(self.values["output_dir"]).expanduser()
        recording.check_folder(self._folder)
        recording.check_installed()
        from fvs_tools.bag import ERRORS, Bag, knows
        from fvs_tools.viewing import Viewing

        self._known, self._bag_errors = knows, ERRORS
        self._viewing = Viewing(
            self.resolve_topic_name(topics.ROBOT_DESCRIPTION.name),
            self.resolve_topic_name(topics.JOINT_STATES.name),
            self.resolve_topic_name(topics.TRUE_CAMERA_POSE.name),
            self.values["feature_frame"],
        )
        self._group = ros.NeverReady()
        self._heard: dict[str, dict[Request, Subscription]] = {}
        self._types: dict[str, str] = {}
        self._publishers_known: dict[str, int] = {}
        self._doubles: dict[str, Doubles] = {}
        self._left_out: set[str] = set()
        simulated = self.get_parameter("use_sim_time").value
        self._simulated_time = SimulatedTime() if simulated else None
        self._broken = self._warned = False
        names = self._expect()
        # The last thing: a folder that is there tells who waits that everything is heard.
        self._bag = Bag(self._folder, recording.notes(self.values["scenario"], version(), names))
        self.create_timer(_LOOK_S, self._look, clock=self.steady_clock)
        self.create_timer(_FETCH_S, self._fetch, clock=self.steady_clock)
        self.create_timer(_STATUS_S, self._publish_state, clock=self.steady_clock)
        self.tell(ros.OK, f"recording into {self._folder}")

    # --- which topics ---

    def _expect(self) -> dict[str, str]:
        """Subscribe to this package's topics before anybody publishes: no first message is lost.

        Returns
        -------
        dict of str to str
            Their full names as declared, and as they are here.
        """
        names = {}
        for node, interface in INTERFACES.items():
            for end in interface.publishes:
                topic = self.resolve_topic_name(end.topic.of(node).name)
                names[resolve(end.topic.name, node, self.get_namespace())] = topic
                if recording.is_recorded(topic, end.topic.type, self.values["images"]):
                    offers = [
                        Request(qos is not Qos.NEWEST, latched=qos is Qos.LATCHED)
                        for qos in end.qos
                    ]
                    self._hear(topic, end.topic.type, offers)
        return names

    def _look(self) -> None:
        """Subscribe to what is new on the graph."""
        for topic, types in self.get_topic_names_and_types():
            publishers = self.count_publishers(topic)
            if publishers == self._publishers_known.get(topic, 0) or topic in self._left_out:
                continue
            self._publishers_known[topic] = publishers
            if len(types) > 1:
                self._leave_out(topic, f"it has several types ({', '.join(types)})")
            elif not recording.is_recorded(topic, types[0], self.values["images"]):
                self._left_out.add(topic)
            elif not self._hear(topic, types[0], map(_request, self._profiles(topic))):
                made = types[0] == transforms.TYPE
                self._leave_out(
                    topic,
                    f"its type {types[0]} is not known here"
                    + ("; the robot's links are computed from joint_states instead" * made),
                )

    def _profiles(self, topic: str) -> list[QoSProfile]:
        """What the topic's publishers offer."""
        return [info.qos_profile for info in self.get_publishers_info_by_topic(topic)]

    def _hear(self, topic: str, message_type: str, offers: Iterable[Request]) -> bool:
        """Subscribe to a topic; False where its type is not known."""
        kind = _message_class(message_type)
        if kind is None or not self._known(message_type):
            return False
        self._types[topic] = message_type
        heard = self._heard.setdefault(topic, {})
        for request in recording.missing_requests(offers, heard):
            heard[request] = self.create_subscription(
                kind,
                topic,
                lambda _message: None,  # fetched, never called
                _qos(request, recording.queue_depth(message_type)),
                callback_group=self._group,
                raw=True,
            )
        if len(heard) > 1:
            self._doubles.setdefault(topic, Doubles())
        return True

    def _leave_out(self, topic: str, why: str) -> None:
        self._left_out.add(topic)
        self.tell(ros.WARN, f"{topic} is not recorded: {why}")

    # --- their messages ---

    def _fetch(self) -> None:
        """Write all that has come, in the order in which it came."""
        if self.exit_code is not None:
            return
        came = sorted(self._waiting(), key=lambda message: message.received_ns)
        try:
            free_mb = shutil.disk_usage(self._folder).free / _MB
            for message in came:
                self._write(message)
        except self._bag_errors as error:
            self._break_off(error)
            return
        least_mb = self.values["smallest_free_mb"]
        if free_mb < least_mb:
            self._give_up(
                f"only {free_mb:.0f} MB are left on the disk (smallest_free_mb is "
                f"{least_mb:.0f}); what was recorded until now is complete"
            )

    def _waiting(self) -> Iterator[Message]:
        for topic, subscriptions in self._heard.items():
            doubles = self._doubles.get(topic)
            for subscription in subscriptions.values():
                while True:
                    with subscription.handle:
                        taken = subscription.handle.take_message(subscription.msg_type, True)
                    if taken is None:
                        break
                    data, info = taken
                    if doubles is not None and doubles.again(info["source_timestamp"], data):
                        continue
                    yield Message(topic, self._types[topic], info["received_timestamp"], data)

    def _write(self, message: Message) -> None:
        if self._simulated_time is None:
            self._append(message.received_ns, message)
            return
        for stamp_ns, one in self._simulated_time.stamped(message):
            self._append(stamp_ns, one)
        self._warn_without_clock()

    def _append(self, stamp_ns: int, message: Message) -> None:
        topic = message.topic
        profiles = () if topic in self._bag.counts else self._profiles(topic)
        self._bag.write(topic, message.message_type, profiles, stamp_ns, message.data)
        told = self._viewing.of(
            topic, stamp_ns, message.data, robot=transforms.TOPIC not in self._heard
        )
        if told is not None:
            offers = ros.QOS_RELIABLE if told[0] == transforms.TOPIC else ros.QOS_LATCHED
            self._bag.write(told[0], transforms.TYPE, [offers], stamp_ns, told[1])
        elif self._viewing.wrong:
            self.tell(ros.WARN, f"no transforms of the robot: {self._viewing.wrong}")
            self._viewing.wrong = ""

    def _warn_without_clock(self) -> None:
        if self._simulated_time is not None and self._simulated_time.without_clock:
            if not self._warned:
                self.tell(ros.WARN, "no /clock came (use_sim_time): times are the system's")
            self._warned = True

    # --- state and end ---

    def _break_off(self, error: Exception) -> None:
        self._broken = True
        self._bag.abandon()
        why = getattr(error, "strerror", None) or error
        self._give_up(f"{why}; what was written has no index")

    def _give_up(self, why: str) -> None:
        self.tell(ros.ERROR, f"recording into {self._folder} has ended: {why}")
        self.exit_code = stop.EXIT_FAILURE

    def _publish_state(self) -> None:
        counts = self._bag.counts
        self.publish_status(
            ros.OK,
            "RECORDING",
            f"recording into {self._folder}",
            {"topics": len(counts), "messages": sum(counts.values())},
        )

    def finish(self) -> None:
        """Write what still comes, and finish the bag."""
        try:
            end_s = self.steady_s() + _LAST_WORDS_S
            while self.exit_code is None and self.steady_s() < end_s:
                self._fetch()
                time.sleep(_FETCH_S)
        finally:
            if not self._broken:
                self._close()

    def _close(self) -> None:
        try:
            if self._simulated_time is not None:
                for stamp_ns, message in self._simulated_time.rest():
                    self._append(stamp_ns, message)
                self._warn_without_clock()
            self._bag.close()
        except self._bag_errors as error:
            self._break_off(error)
            return
        counts = self._bag.counts
        self.tell(ros.OK, f"{sum(counts.values())} messages of {len(counts)} topics recorded")


def _request(profile: QoSProfile) -> Request:
    return Request(
        reliable=profile.reliability == ReliabilityPolicy.RELIABLE,
        latched=profile.durability == DurabilityPolicy.TRANSIENT_LOCAL,
    )


def _qos(request: Request, depth: int) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=(
            ReliabilityPolicy.RELIABLE if request.reliable else ReliabilityPolicy.BEST_EFFORT
        ),
        durability=(
            DurabilityPolicy.TRANSIENT_LOCAL if request.latched else DurabilityPolicy.VOLATILE
        ),
    )


def _message_class(message_type: str) -> Any:
    """The class of a message type, or None where its package is not installed."""
    package, kind, name = message_type.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name, None)
    except ImportError:
        return None


def main() -> int:
    """Run ``fvs_recorder_node``."""
    return ros.run(RecorderNode, __doc__, recording.PARAMETERS)


if __name__ == "__main__":
    sys.exit(main())
