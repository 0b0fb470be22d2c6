"""Reading a bag: which of its topics are this package's, and what was on them, as arrays.

Arrivals are the bag's times of reception. Stamps are those of the messages' headers, computed as
the nodes compute them, so that a number made of them is the nodes' own.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fvs_controller_node.config import PARAMETERS
from fvs_ros import topics
from fvs_ros.feature import Feature, PoseFeature, ServoedConfig
from fvs_ros.joints import JointMap, JointStateError
from fvs_ros.rotations import rotation_from_quaternion
from fvs_ros.status import vector
from fvs_tools.bag_reader import BagError, BagReader, RecordedJoints, open_bag
from fvs_tools.scenario import read_yaml

CONTROLLER = topics.CONTROLLER
#: The topics that are read: of balls and tags, velocities and positions.
_COMMANDS = (topics.COMMANDS, topics.POSITION_COMMANDS)
_FEATURES = [Feature(), PoseFeature(ServoedConfig.lever_arm_m)]
TOPICS = (
    topics.JOINT_STATES,
    *(one for kind in _FEATURES for one in (kind.seen, kind.truth, kind.target)),
    *_COMMANDS,
    topics.JACOBIAN,
    topics.CONTROLLER_STATUS,
)
#: Position commands further apart than this are of two sessions, s.
_SESSION_S = 0.1
_LOG, _PARAMETER_EVENTS = topics.EVERY_NODE_PUBLISHES


@dataclass(frozen=True)
class Series:
    """Messages of one topic, n of them."""

    #: Full name.
    topic: str
    #: Times of arrival, and of the headers, s, shape (n,); not a number where there is none.
    arrival_s: np.ndarray
    stamp_s: np.ndarray
    #: Numbers of each message, shape (n, k), NaN for one that cannot be used; k is 0 where only the
    #: times are read.
    values: np.ndarray

    def __len__(self) -> int:
        return len(self.arrival_s)

    @cached_property
    def time_s(self) -> np.ndarray:
        """Stamps, and arrivals where there is none, s, shape (n,)."""
        return np.where(np.isfinite(self.stamp_s), self.stamp_s, self.arrival_s)

    def taking(self, rows: Any) -> Series:
        """Some of the messages, by anything that indexes an array."""
        values = self.values[rows]
        return replace(
            self, arrival_s=self.arrival_s[rows], stamp_s=self.stamp_s[rows], values=values
        )


class Status(NamedTuple):
    """A status of the controller: since when, s, its words, its target, m, and how long, s."""

    start_s: float
    state: str
    reason: str
    limit: str
    text: str
    target_m: np.ndarray | None = None
    length_s: float = 0.0


class Event(NamedTuple):
    """A warning, a changed parameter or a silence: first time, s, node or topic, and how often."""

    time_s: float
    who: str
    text: str
    times: int = 1


@dataclass(frozen=True)
class Recording:
    """What a bag holds."""

    #: What was servoed.
    feature: Feature
    #: Of this package when it was recorded, and node -> parameter -> value, as started; both empty
    #: where the bag has no notes.
    version: str
    scenario: Mapping[str, Mapping[str, Any]]
    #: The controller's parameters as started; the defaults where the bag does not say.
    started: Mapping[str, Any]
    #: Whether the recorder never finished it.
    cut_off: bool
    #: First and last arrival, s.
    start_s: float
    end_s: float
    #: All messages of each topic, by its full name, in order of arrival.
    topics: Mapping[str, Series]
    #: By the names of ``TOPICS``, in order of ``time_s``; only messages with finite numbers of the
    #: expected size.
    series: Mapping[str, Series]
    #: The controller's.
    statuses: Sequence[Status]
    #: Warnings of the log and changes of parameters.
    events: Sequence[Event]


def read(path: Path, namespace: str | None = None) -> Recording:
    """Read a bag: a folder of a rosbag2 (MCAP or SQLite), or its one file.

    One that was cut off is read up to there. The namespace is that of the nodes; it is needed
    where the bag holds several. A ``BagError`` says that there is no bag, that it is damaged, or
    that it holds no topic of this package.
    """
    with open_bag(path) as reader:
        return _Reading(reader, namespace).recording()


def _mapping(content: Any) -> dict[str, Any]:
    """Some content if it is a mapping; empty for another tool's."""
    return content if isinstance(content, dict) else {}


class _Columns:
    """Times and numbers of one topic, as plain bytes: no object is kept for a message."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._times_s, self._taken, self._values = array("d"), array("b"), array("d")
        self._width = 0

    def add(self, arrival_s: float, stamp_s: float, values: np.ndarray | None) -> None:
        """Append a message; None for one that has no numbers, or that the nodes would refuse."""
        self._times_s.extend((arrival_s, stamp_s))
        if values is not None and not self._values:
            self._width = values.size
        taken = values is not None and values.size == self._width
        self._taken.append(taken)
        if values is not None and taken:
            self._values.frombytes(values.tobytes())

    def series(self) -> Series:
        """All messages; NaN instead of the numbers of those that were not taken."""
        times_s = np.frombuffer(self._times_s).reshape(-1, 2)
        values = np.full((len(times_s), self._width), np.nan)
        taken = np.frombuffer(self._taken, dtype=bool)
        values[taken] = np.frombuffer(self._values).reshape(-1, self._width) if self._width else 0.0
        found = Series(self._topic, times_s[:, 0], times_s[:, 1], values)
        return found.taking(np.argsort(found.arrival_s, kind="stable"))


class _Reading:
    """One pass through a bag."""

    def __init__(self, reader: BagReader, namespace: str | None) -> None:
        self._reader, notes = reader, reader.notes
        self._version = str(notes.get("fvs_ros_version", ""))
        self._scenario = {
            node.rpartition("/")[2]: _mapping(_mapping(one).get("ros__parameters"))
            for node, one in _mapping(read_yaml(str(notes.get("scenario", "")))).items()
        }
        given = self._scenario.get(CONTROLLER, {})
        self._started = {one.name: given.get(one.name, one.default) for one in PARAMETERS}
        self._joint_map = JointMap(self._started["joint_names"], self._started["tf_prefix"])
        self._joints = RecordedJoints(self._joint_map)
        remaps = _mapping(read_yaml(str(notes.get("remaps", ""))))
        names = {connection.topic for connection in reader.connections}
        # A remapped topic belongs to the namespace in which it was declared.
        declared = {name for name, other in remaps.items() if other in names}
        robot = _namespace(names - set(remaps.values()) | declared, namespace)
        full = {one.name: topics.resolve(one.name, "", robot) for one in TOPICS}
        own = {one.name: (remaps.get(full[one.name], full[one.name]), one.type) for one in TOPICS}
        every = {(connection.topic, connection.msgtype) for connection in reader.connections}
        started, seen = self._started, {name for name, one in own.items() if one in every}
        balls, poses = ({kind.seen.name, kind.truth.name} & seen for kind in _FEATURES)
        if poses and not (balls or self._scenario):
            started["feature"] = topics.POSE
        config = {name: started[name] for name in ("feature", "lever_arm_m")}
        self._feature = ServoedConfig(**config).servoed
        self._positions = topics.POSITION_COMMANDS.name in seen
        #: What is read, by the full names of the topics, and their types.
        self._keys = {
            own[topics.JOINT_STATES.name]: "joints",
            own[self._feature.seen.name]: "ball",
            own[self._feature.truth.name]: "true_ball",
            own[self._feature.target.name]: "target",
            own[_COMMANDS[self._positions].name]: "commands",
            own[topics.JACOBIAN.name]: "jacobian",
            own[topics.CONTROLLER_STATUS.name]: "controller",
        }
        self._columns: dict[str, _Columns] = {}
        self._statuses: list[Status] = []
        self._events: list[Event] = []

    def recording(self) -> Recording:
        """Read all messages."""
        fields = self._reader.typestore.fielddefs
        stamped = {
            kind: kind in fields and fields[kind][1][0][0] == "header"
            for kind in {connection.msgtype for connection in self._reader.connections}
        }
        for connection, time_ns, raw in self._reader.messages():
            topic, kind = connection.topic, connection.msgtype
            arrival_s = time_ns * 1e-9
            numbers, key = None, self._keys.get((topic, kind), topic)
            if key != topic or topic in (_LOG, _PARAMETER_EVENTS):
                numbers = self._take(key, arrival_s, self._reader.deserialize(raw, kind))
            stamp_s = self._reader.stamp_s(raw) if stamped[kind] else np.nan
            if topic not in self._columns:
                self._columns[topic] = _Columns(topic)
            self._columns[topic].add(arrival_s, stamp_s, numbers)
        every = {topic: one.series() for topic, one in sorted(self._columns.items())}
        if not every:
            raise BagError("it holds no messages")
        start_s = min(one.arrival_s[0] for one in every.values())
        series = {}
        for (topic, _), key in self._keys.items():
            if topic in every:
                usable = every[topic].taking(np.isfinite(every[topic].values).any(axis=1))
                series[key] = usable.taking(np.argsort(usable.time_s, kind="stable"))
        if self._positions and "commands" in series:
            series["commands"] = _velocities(series["commands"])
        judged = self._joints
        if judged.foreign and "joints" not in series:
            judged.problems[""] = (start_s, judged.foreign, 1)
        for first_s, words, times in judged.problems.values():
            self._events.append(Event(first_s, topics.JOINT_STATES.name, words, times))
        return Recording(
            version=self._version,
            feature=self._feature,
            scenario=self._scenario,
            started=self._started,
            cut_off=self._reader.cut_off,
            start_s=start_s,
            end_s=max(one.arrival_s[-1] for one in every.values()),
            topics=every,
            series={key: one for key, one in series.items() if len(one)},
            statuses=self._statuses,
            events=self._events,
        )

    def _take(self, key: str, arrival_s: float, message: Any) -> np.ndarray | None:
        """Keep a status or an event; the numbers of any other message if they can be used."""
        if key == "controller":
            self._statuses.append(_status(arrival_s, message))
        elif key == _LOG:
            if message.level >= 30:  # rcl's WARN
                self._events.append(Event(arrival_s, message.name, message.msg))
        elif key == _PARAMETER_EVENTS:
            for one in message.changed_parameters:
                text = f"{one.name} is now {_parameter(one.value)}"
                self._events.append(Event(arrival_s, message.node.lstrip("/"), text))
        elif key == "joints":
            return self._joint_numbers(message, arrival_s)
        elif hasattr(message, "data"):
            return message.data if np.isfinite(message.data).all() else None
        else:
            return self._place(message)
        return None

    def _place(self, message: Any) -> np.ndarray | None:
        """The feature, m, (m,), of a position or pose; None if it is none."""
        at = message.point if hasattr(message, "point") else message.pose.position
        position_m = np.array([at.x, at.y, at.z])
        if not np.isfinite(position_m).all():
            return None
        if not isinstance(self._feature, PoseFeature):
            return position_m
        turn = message.pose.orientation
        with suppress(ValueError):
            rotation = rotation_from_quaternion(np.array([turn.x, turn.y, turn.z, turn.w]))
            return self._feature.of(position_m, rotation)
        return None

    def _joint_numbers(self, message: Any, arrival_s: float) -> np.ndarray | None:
        """Positions, rad, and velocities, rad/s, NaN where there are none; kinematic order."""
        angles_rad = self._joints.take(message, arrival_s)
        if angles_rad is None:
            return None
        speeds_rad_s = np.full(len(angles_rad), np.nan)
        with suppress(JointStateError):
            speeds_rad_s = self._joint_map.positions(message.name, message.velocity)
        return np.concatenate([angles_rad, speeds_rad_s])


def _velocities(positions: Series) -> Series:
    """Position commands as the velocities, rad/s, that they follow, one after each period."""
    steps, gaps_s = np.diff(positions.values, axis=0), np.diff(positions.arrival_s)
    within = gaps_s < _SESSION_S
    period_s = np.median(gaps_s[within]) if within.any() else np.inf
    velocities = np.where(within[:, None], steps, 0.0) / period_s
    return replace(positions, values=np.vstack([np.zeros_like(positions.values[:1]), velocities]))


def _namespace(names: set[str], wanted: str | None) -> str:
    """The namespace of the nodes in a bag."""
    found = {
        name.removesuffix(own.name).strip("/")
        for name in names
        for own in TOPICS
        if name.endswith(f"/{own.name}")
    }
    if wanted is not None:
        found &= {wanted.strip("/")}
    if not found:
        where = f" in namespace {wanted}" if wanted else ""
        topics_found = ", ".join(sorted(names)) or "no messages"
        ours = ", ".join(one.name for one in TOPICS)
        raise BagError(f"it holds none of the topics {ours}{where}; it has {topics_found}")
    if len(found) > 1:
        listed = ", ".join(f"'/{one}'" for one in sorted(found))
        raise BagError(f"it holds several robots, name one by --namespace: {listed}")
    return found.pop()


def _status(arrival_s: float, message: Any) -> Status:
    values = {pair.key: pair.value for pair in message.values}
    # "near singular (0.071 m/rad)" without the number, which differs each time.
    limit = re.sub(r" \([^)]*\)", "", values.get("active_limit", ""))
    state, reason = values.get("state", "unknown"), values.get("reason", "")
    return Status(arrival_s, state, reason, limit, message.message, vector(values, "target_{}_m"))


def _parameter(value: Any) -> Any:
    """A ``ParameterValue``'s value; its fields are in the order of its types."""
    names = [name for name in value.__dataclass_fields__ if name.endswith("_value")]
    found = getattr(value, names[value.type - 1]) if 0 < value.type <= len(names) else None
    return found.tolist() if isinstance(found, np.ndarray) else found
