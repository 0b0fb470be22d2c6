"""Reading a bag: which of its topics are this package's, and what was on them.

Arrivals are the bag's times of reception. Stamps are those of the messages' headers, computed as
the nodes compute them, so that a number made of them is the nodes' own.
"""

from __future__ import annotations

import re
import struct
from array import array
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader

from fvs_controller_node.config import PARAMETERS
from fvs_lab.replay import files
from fvs_lab.replay.files import BagError
from fvs_lab.replay.recording import (
    CONTROLLER,
    TOPICS,
    Event,
    Recording,
    Series,
    Status,
    as_started,
)
from fvs_ros import topics
from fvs_ros.joints import JointMap, JointStateError
from fvs_ros.status import vector
from fvs_tools.scenario import read_yaml

_LOG, _PARAMETER_EVENTS = topics.EVERY_NODE_PUBLISHES
#: From this level on a line of the log is kept: rcl's WARN.
_WARN = 30


def read(path: Path, namespace: str | None = None) -> Recording:
    """Read a bag.

    Parameters
    ----------
    path : Path
        Folder of a rosbag2 (MCAP or SQLite), or its one file; one that was cut off is read up to
        there.
    namespace : str, optional
        Of the nodes; needed where the bag holds several.

    Raises
    ------
    BagError
        If there is no bag, it is damaged, or it holds no topic of this package.
    """
    try:
        bag = files.find(path)
        with files.opened(bag) as reader:
            return _Reading(reader, bag, path, namespace).recording()
    except (BagError, OSError):
        raise
    except Exception as error:  # a damaged file shows anywhere in the reader
        words = " ".join(str(error).split())[:200]
        raise BagError(
            f"cannot read {path}: it is damaged or no bag ({type(error).__name__}: {words})"
        ) from error


class _Columns:
    """Times and numbers of one topic, growing as plain bytes: no object is kept for a message."""

    def __init__(self) -> None:
        self.times_s, self.values, self.width = array("d"), bytearray(), 0

    def add(self, arrival_s: float, stamp_s: float, values: np.ndarray) -> None:
        if not self.times_s:
            self.width = values.size
        if values.size == self.width:
            self.times_s.append(arrival_s)
            self.times_s.append(stamp_s)
            self.values += values.tobytes()

    def series(self, topic: str) -> Series:
        times = np.frombuffer(self.times_s).reshape(-1, 2)
        values = np.frombuffer(self.values).reshape(len(times), self.width)
        found = Series(topic, times[:, 0], times[:, 1], values)
        # What lies in disorder in the file, or in several, is put in order.
        disordered = bool((np.diff(found.arrival_s) < 0.0).any())
        return found.taking(np.argsort(found.arrival_s, kind="stable")) if disordered else found


class _Reading:
    """One pass through a bag."""

    def __init__(
        self, reader: AnyReader, bag: files.Bag, path: Path, namespace: str | None
    ) -> None:
        self._reader, self._bag, self._path = reader, bag, path
        names = {connection.topic for connection in reader.connections}
        if not names and bag.cut_off:
            raise BagError(f"{path} was cut off before any message was written into it")
        self._remaps = _mapping(bag.notes.get("remaps", ""))
        # A remapped topic belongs to the namespace in which it was declared.
        declared = {name for name, other in self._remaps.items() if other in names}
        own = names - set(self._remaps.values()) | declared
        self._namespace = _namespace(own, namespace, path)
        self._names = {key: self._full(name) for key, name in TOPICS.items()}
        self._keys = {name: key for key, name in self._names.items()}
        self._scenario = _scenario(bag.notes.get("scenario", ""))
        started = as_started(self._scenario, CONTROLLER, PARAMETERS)
        self._frame = started["feature_frame"] if CONTROLLER in self._scenario else None
        self._joint_map = JointMap(started["joint_names"], started["tf_prefix"])
        self._joint_order: tuple[list[str], np.ndarray] | None = None
        self._columns: dict[str, _Columns] = {}
        self._statuses: list[Status] = []
        self._events: list[Event] = []

    def _full(self, name: str) -> str:
        name = topics.resolve(name, "", self._namespace)
        return str(self._remaps.get(name, name))

    def recording(self) -> Recording:
        all_columns: dict[str, _Columns] = {}
        stamped = {one.msgtype: self._has_header(one.msgtype) for one in self._reader.connections}
        nothing = np.empty(0)
        for connection, time_ns, raw in self._reader.messages():
            topic, kind = connection.topic, connection.msgtype
            arrival_s = time_ns * 1e-9
            stamp_s = _stamp_s(raw) if stamped[kind] else np.nan
            if topic not in all_columns:
                all_columns[topic] = _Columns()
            all_columns[topic].add(arrival_s, stamp_s, nothing)
            if topic in self._keys or topic in (_LOG, _PARAMETER_EVENTS):
                self._take(topic, arrival_s, stamp_s, self._reader.deserialize(raw, kind))
        every = {topic: one.series(topic) for topic, one in sorted(all_columns.items())}
        if not every:
            raise BagError(f"{self._path} holds no messages")
        count = sum(map(len, every.values()))
        if count != self._reader.message_count and not self._bag.cut_off:
            raise BagError(
                f"cannot read {self._path}: it lists {self._reader.message_count} messages and "
                f"holds {count}; the file is damaged"
            )
        return Recording(
            namespace=self._namespace,
            version=self._bag.notes.get("fvs_ros_version", ""),
            scenario=self._scenario,
            cut_off=self._bag.cut_off,
            start_s=min(float(one.arrival_s[0]) for one in every.values()),
            end_s=max(float(one.arrival_s[-1]) for one in every.values()),
            topics=every,
            series=self._series(),
            statuses=sorted(self._statuses, key=lambda one: one.arrival_s),
            events=self._events,
        )

    def _has_header(self, message_type: str) -> bool:
        _, fields = self._reader.typestore.fielddefs.get(message_type, ([], []))
        return bool(fields) and fields[0][0] == "header"

    def _take(self, topic: str, arrival_s: float, stamp_s: float, message: Any) -> None:
        key = self._keys.get(topic)
        if key == "controller":
            self._statuses.append(_status(arrival_s, message))
        elif key is not None:
            numbers = self._numbers(key, message)
            if numbers is not None:
                if key not in self._columns:
                    self._columns[key] = _Columns()
                self._columns[key].add(arrival_s, stamp_s, numbers)
        elif topic == _LOG and message.level >= _WARN:
            self._events.append(Event(arrival_s, message.name, message.msg))
        elif topic == _PARAMETER_EVENTS:
            node = message.node.lstrip("/")
            for one in message.changed_parameters:
                text = f"{one.name} is now {_parameter(one.value)}"
                self._events.append(Event(arrival_s, node, text))

    def _numbers(self, key: str, message: Any) -> np.ndarray | None:
        """The numbers of a message; None for one of another frame, size or robot."""
        if key == "joints":
            return self._joint_numbers(message)
        if key in ("commands", "jacobian"):
            return message.data if message.data.size % len(self._joint_map.names) == 0 else None
        if self._frame not in (None, message.header.frame_id):
            return None
        return np.array([message.point.x, message.point.y, message.point.z])

    def _joint_numbers(self, message: Any) -> np.ndarray | None:
        """Positions, rad, and velocities, rad/s, NaN where there are none; kinematic order."""
        if self._joint_order is None or self._joint_order[0] != message.name:
            try:
                places = self._joint_map.positions(message.name, range(len(message.name)))
            except JointStateError:  # another device's
                return None
            self._joint_order = message.name, places.astype(int)
        names, order = self._joint_order
        if len(message.position) != len(names):
            return None
        known = len(message.velocity) == len(names)
        velocities = message.velocity[order] if known else np.full(len(order), np.nan)
        return np.concatenate([message.position[order], velocities])

    def _series(self) -> dict[str, Series]:
        """What was read of each topic, without messages that are not finite."""
        found = {key: one.series(self._names[key]) for key, one in self._columns.items()}
        for key, one in found.items():
            needed = len(self._joint_map.names) if key == "joints" else None  # not the velocities
            finite = np.isfinite(one.values[:, :needed]).all(axis=1)
            found[key] = one if finite.all() else one.taking(finite)
        return {key: one for key, one in found.items() if len(one)}


def _namespace(names: set[str], wanted: str | None, path: Path) -> str:
    """The namespace of the nodes in a bag."""
    found = {
        name.removesuffix(own).strip("/")
        for name in names
        for own in TOPICS.values()
        if name.endswith(f"/{own}")
    }
    listed = ", ".join(f"'/{one}'" for one in sorted(found)) or "none of this project"
    if wanted is not None:
        if wanted.strip("/") not in found:
            raise BagError(f"{path} holds nothing in namespace '{wanted}'; it has {listed}")
        return wanted.strip("/")
    if not found:
        raise BagError(
            f"{path} holds none of the topics {', '.join(TOPICS.values())}; it has "
            f"{', '.join(sorted(names)) or 'no messages'}"
        )
    if len(found) > 1:
        raise BagError(f"{path} holds several robots, name one by --namespace: {listed}")
    return found.pop()


def _mapping(text: str) -> dict[str, Any]:
    """The mapping in a note; empty for another tool's."""
    try:
        content = read_yaml(text)
    except ValueError:
        return {}
    return content if isinstance(content, dict) else {}


def _scenario(text: str) -> dict[str, dict[str, Any]]:
    """Node -> parameters, of a note in the form of a ROS parameter file."""
    sections = {key.rpartition("/")[2]: one for key, one in _mapping(text).items()}
    return {
        node: one["ros__parameters"]
        for node, one in sections.items()
        if isinstance(one, dict) and isinstance(one.get("ros__parameters"), dict)
    }


def _stamp_s(raw: bytes) -> float:
    """Stamp of a message that begins with a header, s."""
    order = "<" if raw[1] & 1 else ">"
    seconds, nanoseconds = struct.unpack_from(f"{order}iI", raw, 4)
    return seconds + nanoseconds * 1e-9 if seconds or nanoseconds else np.nan


def _status(arrival_s: float, message: Any) -> Status:
    values = {pair.key: pair.value for pair in message.values}
    # "near singular (0.071 m/rad)" without the number, which differs each time.
    limit = re.sub(r" \([^)]*\)", "", values.get("active_limit", ""))
    state, reason = values.get("state", "unknown"), values.get("reason", "")
    target_m = vector(values, "target_{}_m")
    return Status(arrival_s, state, reason, limit, message.message, target_m)


def _parameter(value: Any) -> Any:
    """A ``ParameterValue``'s value; its fields are in the order of its types."""
    names = [name for name in value.__dataclass_fields__ if name.endswith("_value")]
    found = getattr(value, names[value.type - 1]) if 0 < value.type <= len(names) else None
    return found.tolist() if isinstance(found, np.ndarray) else found
