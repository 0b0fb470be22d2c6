"""Reading a bag: which of its topics are this package's, and what was on them, as arrays.

Arrivals are the bag's times of reception. Stamps are those of the messages' headers, computed as
the nodes compute them, so that a number made of them is the nodes' own.
"""

from __future__ import annotations

import contextlib
import re
import resource
import struct
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.storage_mcap import McapReader

from fvs_controller_node.config import PARAMETERS
from fvs_ros import topics
from fvs_ros.joints import JointMap, JointStateError
from fvs_ros.params import Parameter, ParameterError, ParameterSet
from fvs_ros.status import vector
from fvs_tools.bag import NOTES, TYPES
from fvs_tools.scenario import read_yaml, read_yaml_file

CONTROLLER = "fvs_controller_node"
#: The topics that are read, by the name under which their messages are kept here.
TOPICS = {
    "joints": topics.JOINT_STATES.name,
    "ball": topics.BALL_POSITION.name,
    "true_ball": topics.TRUE_BALL_POSITION.name,
    "target": topics.TARGET_POSITION.name,
    "commands": topics.COMMANDS.name,
    "jacobian": topics.JACOBIAN.name,
    "controller": topics.CONTROLLER_STATUS.name,
}


@dataclass(frozen=True)
class Series:
    """Messages of one topic, n in order of arrival."""

    #: Full name.
    topic: str
    #: Times of arrival, and of the headers, s, shape (n,); not a number where there is none.
    arrival_s: np.ndarray
    stamp_s: np.ndarray
    #: Numbers of each message, shape (n, k); k is 0 where only the times are read.
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

    def by_time(self) -> Series:
        """The messages in the order of ``time_s``."""
        in_order = bool((np.diff(self.time_s) >= 0.0).all())
        return self if in_order else self.taking(np.argsort(self.time_s, kind="stable"))


class Status(NamedTuple):
    """One status of the controller: arrival, s, its words, and its target, m, if it has one."""

    arrival_s: float
    state: str
    reason: str
    limit: str
    text: str
    target_m: np.ndarray | None


class Event(NamedTuple):
    """A warning, a changed parameter or a silence: first time, s, node or topic, and how often."""

    time_s: float
    who: str
    text: str
    times: int = 1


@dataclass(frozen=True)
class Recording:
    """What a bag holds."""

    #: Of the nodes, without slashes.
    namespace: str
    #: Of this package when it was recorded, and node -> parameter -> value, as started; both empty
    #: where the bag has no notes.
    version: str
    scenario: Mapping[str, Mapping[str, Any]]
    #: Whether the recorder never finished it.
    cut_off: bool
    #: First and last arrival, s.
    start_s: float
    end_s: float
    #: All messages of each topic, by its full name, without values.
    topics: Mapping[str, Series]
    #: By the names of ``TOPICS``; only messages that the nodes would accept.
    series: Mapping[str, Series]
    #: The controller's.
    statuses: Sequence[Status]
    #: Warnings of the log and changes of parameters.
    events: Sequence[Event]

    def started(
        self, node: str = CONTROLLER, parameters: Sequence[Parameter] = PARAMETERS
    ) -> dict[str, Any]:
        """A node's parameters as started; the defaults where the bag does not say."""
        return as_started(self.scenario, node, parameters)


def as_started(
    scenario: Mapping[str, Mapping[str, Any]], node: str, parameters: Sequence[Parameter]
) -> dict[str, Any]:
    """A node's parameters as a scenario has them; the defaults where it does not say."""
    declared = ParameterSet(parameters)
    given = {key: one for key, one in scenario.get(node, {}).items() if key != "use_sim_time"}
    try:
        return declared.values(given)
    except ParameterError:  # another version's
        return declared.values()


# ---- opening a bag --------------------------------------------------------------------------

_METADATA, _MCAP, _SQLITE = "metadata.yaml", ".mcap", ".db3"
#: An MCAP file begins and ends with it.
_MAGIC = b"\x89MCAP0\r\n"
#: A small file may unpack to any size: reading takes no more memory than this, bytes.
_MOST_MEMORY = 2**32


class BagError(ValueError):
    """A bag that cannot be read; the text says why."""


@dataclass(frozen=True)
class Bag:
    """Where a bag's messages and notes are."""

    #: Its folder, or its files where the folder is incomplete.
    paths: Sequence[Path]
    #: Whether the recorder never finished it.
    cut_off: bool
    #: What the recorder noted beside the messages (``custom_data``).
    notes: Mapping[str, str]


def find(path: Path) -> Bag:
    """The bag in a folder, or of one file; a ``BagError`` if there is none, or more than one."""
    if not path.exists():
        raise BagError(f"there is no {path}")
    folder = path if path.is_dir() else path.parent
    metadata: Mapping[str, Any] = {}
    with contextlib.nullcontext() if path.is_dir() else contextlib.suppress(BagError):
        metadata = _yaml(folder / _METADATA).get("rosbag2_bagfile_information", {})
    listed = [folder / Path(name).name for name in metadata.get("relative_file_paths", [])]
    if not path.is_dir():
        metadata = metadata if path in listed else {}
        listed = [path]
    files = listed or [_only_file(folder)]
    cut_off = any(map(is_cut_off, files))
    notes = metadata.get("custom_data") or (_yaml(folder / NOTES) if not metadata else {})
    if path.is_dir() and metadata and not cut_off:
        files = [path]
    elif path.is_dir() and files[0].suffix == _SQLITE:
        cut_off = True  # without metadata it lacks what was still in the recorder's memory
    return Bag(files, cut_off, {str(key): str(value) for key, value in notes.items()})


def _only_file(folder: Path) -> Path:
    """The file of a folder without metadata."""
    files = sorted(one for one in folder.iterdir() if one.suffix in (_MCAP, _SQLITE))
    if not files:
        raise BagError(f"{folder} is no bag: it holds neither {_METADATA} nor an {_MCAP} file")
    if len(files) > 1:
        names = ", ".join(one.name for one in files)
        raise BagError(f"{folder} holds several files without {_METADATA}, name one: {names}")
    return files[0]


def _yaml(path: Path) -> dict[str, Any]:
    """The mapping in a YAML file; empty where there is no such file."""
    if not path.is_file():
        return {}
    try:
        content = read_yaml_file(path)
    except ValueError as error:
        raise BagError(f"cannot read {path}: {' '.join(str(error).split())}") from None
    return content if isinstance(content, dict) else {}


def is_cut_off(path: Path) -> bool:
    """Whether this is an MCAP file without its end."""
    if path.suffix != _MCAP or not path.is_file():
        return False
    with path.open("rb") as file:
        begins_well = _MAGIC.startswith(file.read(len(_MAGIC)))
        file.seek(max(len(_MAGIC), path.stat().st_size - len(_MAGIC)))
        return begins_well and file.read() != _MAGIC


class _CutOffReader(McapReader):
    """Reads an MCAP file without its end, and so without an index, from its beginning."""

    def open(self) -> None:
        """Find the topics in what is readable."""
        self.bio = self.path.open("rb")
        self.data_start, self.data_end = len(_MAGIC), self.path.stat().st_size
        with contextlib.suppress(Exception):  # at the first broken record, of any kind
            self.meta_scan()

    def messages(self, connections: Any, start: Any = None, stop: Any = None) -> Any:
        """All messages before the first broken record, as they lie in the file."""
        with contextlib.suppress(Exception):
            yield from self.messages_scan(connections, start, stop)


@contextlib.contextmanager
def opened(bag: Bag) -> Iterator[AnyReader]:
    """A reader of all files, which raises a ``MemoryError`` above 4 GB (on Linux)."""
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = _MOST_MEMORY if soft == resource.RLIM_INFINITY else min(soft, _MOST_MEMORY)
    resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
    try:
        reader = AnyReader(bag.paths, default_typestore=TYPES)
        for path, one in zip(bag.paths, reader.readers, strict=True):
            if isinstance(one, Reader) and is_cut_off(path):
                one.storage = _CutOffReader(path)
        with reader:
            yield reader
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


# ---- reading it -----------------------------------------------------------------------------

_LOG, _PARAMETER_EVENTS = topics.EVERY_NODE_PUBLISHES


def read(path: Path, namespace: str | None = None) -> Recording:
    """Read a bag: a folder of a rosbag2 (MCAP or SQLite), or its one file.

    One that was cut off is read up to there. The namespace is that of the nodes; it is needed
    where the bag holds several. A ``BagError`` says that there is no bag, that it is damaged, or
    that it holds no topic of this package.
    """
    try:
        bag = find(path)
        with opened(bag) as reader:
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

    def __init__(self, reader: AnyReader, bag: Bag, path: Path, namespace: str | None) -> None:
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
        elif topic == _LOG and message.level >= 30:  # rcl's WARN
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
