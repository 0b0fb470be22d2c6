"""A bag as arrays: which of its topics are this project's, and what they said when.

Arrivals are the bag's times of reception; stamps are those in the messages' headers, computed as
the nodes compute them, so that a number made of them is the nodes' own.
"""

from __future__ import annotations

import struct
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.rosbag2 import ReaderError

from fvs_lab.replay import files
from fvs_lab.replay.data import Flow, Recording, Said, Series
from fvs_lab.replay.files import BagError
from fvs_ros import topics
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.joints import JOINT_PARAMETERS, N_JOINTS, JointMap, JointStateError
from fvs_tools import yaml_text

#: What is looked at, by the name under which its messages are kept here.
TOPICS = {
    "joints": topics.JOINT_STATES.name,
    "ball": topics.BALL_POSITION.name,
    "true_ball": topics.TRUE_BALL_POSITION.name,
    "target": topics.TARGET_POSITION.name,
    "commands": topics.COMMANDS.name,
    "jacobian": topics.JACOBIAN.name,
    "controller": topics.CONTROLLER_STATUS.name,
    "estimator": topics.ESTIMATOR_STATUS.name,
}
_POINTS = ("ball", "true_ball", "target")
_STATUSES = ("controller", "estimator")
_LOG, _PARAMETER_EVENTS = topics.EVERY_NODE_PUBLISHES
#: From this level on a line of the log is kept: rcl's WARN.
_WARN = 30
#: Stamps and arrivals that lie further apart are not of one clock, s.
_SAME_CLOCK_S = 1e4
_WIDTHS = {"commands": N_JOINTS, "jacobian": 3 * N_JOINTS}


def read(path: Path, namespace: str | None = None) -> Recording:
    """Read a bag.

    Parameters
    ----------
    path : Path
        Folder of a rosbag2 (MCAP or SQLite), or its one file; of one that was cut off, what is
        whole is read.
    namespace : str, optional
        Of the nodes; only needed where the bag holds several.

    Raises
    ------
    BagError
        If it is none, is damaged, or holds nothing of this project.
    """
    paths, cut_off = files.storages(path)
    try:
        with files.bounded_memory(), files.opened(path, paths) as reader:
            if cut_off and not reader.message_count:
                raise BagError(f"{path} was cut off before any message was written into it")
            return _Reading(reader, path, namespace, files.notes(paths)).recording(cut_off)
    except (AnyReaderError, ReaderError) as error:
        raise BagError(f"cannot read {path}: {_one_line(error)}; is it a whole bag?") from error
    except BagError:
        raise
    except Exception as error:  # a damaged file is found out anywhere in the reader
        raise BagError(
            f"cannot read {path}: it is damaged or no bag ({type(error).__name__}: "
            f"{_one_line(error)})"
        ) from error


class _Reading:
    """One pass through a bag."""

    def __init__(
        self, reader: AnyReader, path: Path, namespace: str | None, notes: Mapping[str, str]
    ) -> None:
        self._reader = reader
        self._path = path
        names = {connection.topic for connection in reader.connections if connection.msgcount}
        self._notes = notes
        self._remaps = _remaps(self._notes.get("remaps", ""))
        # A remapped topic speaks for the namespace in which it was declared.
        declared_names = {declared for declared, name in self._remaps.items() if name in names}
        own_names = names - set(self._remaps.values()) | declared_names
        self._namespace = _namespace(own_names, namespace, path)
        self._keys = {self._full(key): key for key in TOPICS}
        self._scenario = _scenario(self._notes.get("scenario", ""))
        declared = {one.name: one.default for one in JOINT_PARAMETERS}
        given = {**declared, **self._scenario.get("fvs_controller_node", {})}
        self._joint_map = JointMap(given["joint_names"], given["tf_prefix"])
        self._rows: dict[str, list[tuple[float, float, np.ndarray]]] = defaultdict(list)
        self._frames: dict[str, list[str]] = defaultdict(list)  # of each row of a point's topic
        self._said: dict[str, list[Said]] = defaultdict(list)

    def _full(self, key: str) -> str:
        name = topics.resolve(TOPICS[key], "", self._namespace)
        return self._remaps.get(name, name)

    def recording(self, cut_off: bool) -> Recording:
        flows: dict[str, tuple[str, list[float], list[float]]] = {}
        stamped = {
            kind: self._has_header(kind)
            for kind in {connection.msgtype for connection in self._reader.connections}
        }
        for connection, time_ns, raw in self._reader.messages():
            arrival_s = time_ns * 1e-9
            stamp_s = _stamp_s(raw) if stamped[connection.msgtype] else np.nan
            _, arrivals, stamps = flows.setdefault(connection.topic, (connection.msgtype, [], []))
            arrivals.append(arrival_s)
            stamps.append(stamp_s)
            self._take(connection.topic, connection.msgtype, arrival_s, stamp_s, raw)
        every = [time_s for _, arrivals, _ in flows.values() for time_s in arrivals]
        if not every:
            raise BagError(f"{self._path} holds no messages")
        if len(every) != self._reader.message_count:
            raise BagError(
                f"cannot read {self._path}: of the {self._reader.message_count} messages that it "
                f"lists, {len(every)} are in it; the file is damaged"
            )
        return Recording(
            path=self._path,
            namespace=self._namespace,
            version=self._notes.get("fvs_ros_version", ""),
            scenario=self._scenario,
            cut_off=cut_off,
            start_s=min(every),
            end_s=max(every),
            series={key: self._series(key, rows) for key, rows in self._usable().items()},
            said=self._said,
            flows={
                topic: Flow(kind, np.array(arrivals), _of_one_clock(arrivals, stamps))
                for topic, (kind, arrivals, stamps) in sorted(flows.items())
            },
        )

    def _has_header(self, message_type: str) -> bool:
        _, fields = self._reader.typestore.fielddefs.get(message_type, ([], []))
        return bool(fields) and fields[0][0] == "header"

    def _take(
        self, topic: str, message_type: str, arrival_s: float, stamp_s: float, raw: bytes
    ) -> None:
        key = self._keys.get(topic)
        if key is None and topic not in (_LOG, _PARAMETER_EVENTS):
            return
        message: Any = self._reader.deserialize(raw, message_type)
        if key in _STATUSES:
            values = {pair.key: pair.value for pair in message.values}
            self._said[key].append(Said(arrival_s, message.name, message.message, values))
        elif key is not None:
            numbers = self._numbers(key, message)
            if numbers is not None:
                self._rows[key].append((arrival_s, stamp_s, numbers))
                if key in _POINTS:
                    self._frames[key].append(message.header.frame_id)
        elif topic == _LOG and message.level >= _WARN:
            self._said["log"].append(Said(arrival_s, message.name, message.msg))
        elif topic == _PARAMETER_EVENTS:
            changed = {one.name: _parameter(one.value) for one in message.changed_parameters}
            if changed:
                text = ", ".join(f"{name} is now {value}" for name, value in changed.items())
                self._said["parameters"].append(Said(arrival_s, message.node.lstrip("/"), text))

    def _numbers(self, key: str, message: Any) -> np.ndarray | None:
        """The numbers of a message; None for one that its reader would have refused."""
        if key in _POINTS:
            point = message.point
            values = np.array([point.x, point.y, point.z])
            return values if np.isfinite(values).all() else None
        if key == "joints":
            try:
                positions = self._joint_map.positions(message.name, message.position)
            except JointStateError:
                return None
            return np.concatenate([positions, self._velocities(message)])
        values = np.array(message.data, dtype=float)
        usable = values.shape == (_WIDTHS[key],) and np.isfinite(values).all()
        return values if usable else None

    def _velocities(self, message: Any) -> np.ndarray:
        """A joint state's velocities, rad/s; not numbers where it has none, as it may."""
        try:
            return self._joint_map.positions(message.name, message.velocity)
        except JointStateError:
            return np.full(N_JOINTS, np.nan)

    def _usable(self) -> dict[str, list[tuple[float, float, np.ndarray]]]:
        """All rows but points in another frame than the loop's."""
        wanted = self._frame()
        kept = {}
        for key, rows in self._rows.items():
            frames = self._frames.get(key) or [wanted] * len(rows)
            kept[key] = [row for row, frame in zip(rows, frames, strict=True) if frame == wanted]
        return {key: rows for key, rows in kept.items() if rows}

    def _frame(self) -> str:
        """The frame in which the loop worked: as started, or else the measured ball's."""
        started = self._scenario.get("fvs_controller_node")
        if started is not None:
            return str(started.get("feature_frame", CAMERA_FRAME))
        frames = self._frames.get("ball") or self._frames.get("true_ball") or [CAMERA_FRAME]
        return Counter(frames).most_common(1)[0][0]

    def _series(self, key: str, rows: list[tuple[float, float, np.ndarray]]) -> Series:
        arrivals, stamps, values = zip(*rows, strict=True)
        return Series(
            self._full(key),
            np.array(arrivals),
            np.array(stamps),
            np.array(values),
        )


# --- what a bag says of itself ---


def _namespace(names: set[str], wanted: str | None, path: Path) -> str:
    """The namespace of the nodes in a bag."""
    found = set()
    for name in names:
        for own in TOPICS.values():
            if name.endswith(f"/{own}"):
                found.add(name.removesuffix(own).strip("/"))
    if wanted is not None:
        if wanted.strip("/") not in found:
            raise BagError(f"{path} holds nothing in namespace '{wanted}'; it has {_list(found)}")
        return wanted.strip("/")
    if not found:
        raise BagError(
            f"{path} holds none of the topics {', '.join(TOPICS.values())}; it has "
            f"{', '.join(sorted(names)) or 'no messages'}"
        )
    if len(found) > 1:
        raise BagError(f"{path} holds several robots, name one by --namespace: {_list(found)}")
    return found.pop()


def _list(namespaces: set[str]) -> str:
    return ", ".join(f"'/{one}'" for one in sorted(namespaces)) or "none of this project"


def _remaps(text: str) -> dict[str, str]:
    """Full names as declared, and as they were in the bag."""
    try:
        return {str(declared): str(name) for declared, name in (yaml_text.read(text) or {}).items()}
    except (ValueError, AttributeError):
        return {}  # another tool's note


def _scenario(text: str) -> dict[str, dict[str, Any]]:
    try:
        content = yaml_text.read(text) or {}
        return {
            key.rpartition("/")[2]: dict(section["ros__parameters"])
            for key, section in content.items()
        }
    except (ValueError, AttributeError, TypeError, KeyError):
        return {}  # another tool's note


# --- messages ---


def _stamp_s(raw: bytes) -> float:
    """Stamp of a message that begins with a header, s."""
    order = "<" if raw[1] & 1 else ">"
    seconds, nanoseconds = struct.unpack_from(f"{order}iI", raw, 4)
    return seconds + nanoseconds * 1e-9 if seconds or nanoseconds else np.nan


def _of_one_clock(arrivals_s: Sequence[float], stamps_s: Sequence[float]) -> np.ndarray:
    """The stamps, if they are of the clock by which the bag was recorded."""
    stamps = np.array(stamps_s)
    known = np.isfinite(stamps)
    if known.any() and abs(np.median(np.array(arrivals_s)[known] - stamps[known])) > _SAME_CLOCK_S:
        return np.full(stamps.shape, np.nan)
    return stamps


def _parameter(value: Any) -> Any:
    """A ``ParameterValue``'s value."""
    names = ("", "bool", "integer", "double", "string")
    arrays = ("byte_array", "bool_array", "integer_array", "double_array", "string_array")
    if 0 < value.type < len(names):
        return getattr(value, f"{names[value.type]}_value")
    at = value.type - len(names)
    if at < 0:
        return None
    return np.asarray(getattr(value, f"{arrays[at]}_value")).tolist() if at < len(arrays) else None


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
