"""A rosbag2 that is being written: messages as they were on the wire, in an MCAP file.

Any ROS 2 from Jazzy on reads it (``ros2 bag info``, ``ros2 bag play``), and so do Foxglove,
PlotJuggler and ``fvs_experiments replay``. RViz and Foxglove draw a thing where ``/tf`` and
``/tf_static`` place its frame; :class:`Transforms` computes these from what a recording has anyway.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple
from xml.etree import ElementTree

import numpy as np
import yaml
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import (
    CompressionFormat,
    CompressionMode,
    StoragePlugin,
    Writer,
    WriterError,
)
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

#: Of rosbag2's format, as ROS 2 Jazzy writes it.
_VERSION: Final = 9
#: The types of messages that a bag of Jazzy may hold.
TYPES = get_typestore(Stores.ROS2_JAZZY)
#: Holds the notes until ``metadata.yaml`` does: a recorder that is killed leaves it.
NOTES: Final = "notes.yaml"
#: A recorder that is killed loses this much of the recording's own time, ns.
_CHUNK_NS: Final = 10**9
#: Messages that wait for a first /clock take this much memory at most, bytes.
_HELD_BYTES: Final = 64 * 2**20
#: What writing into a bag may raise.
ERRORS: Final = (OSError, WriterError)

_CLOCK, _TRANSFORMS = "rosgraph_msgs/msg/Clock", "tf2_msgs/msg/TFMessage"
TF, TF_STATIC = "/tf", "/tf_static"
#: The arm's transforms are written no more often: a viewer needs no more.
_TF_PERIOD_NS = 10**9 // 30


class Message(NamedTuple):
    """One message as it came: its topic's full name, type, arrival, and bytes on the wire (CDR)."""

    topic: str
    message_type: str
    stamp_ns: int
    data: bytes


def knows(message_type: str) -> bool:
    """Whether messages of a type can be described in a bag."""
    return message_type in TYPES.fielddefs


class SimulatedTime:
    """Gives messages the simulated time of their arrival, by the ``/clock`` messages among them.

    Messages from before the first ``/clock`` wait for it and get its time. Where none comes, all
    keep the system's time.
    """

    def __init__(self) -> None:
        self._now_ns: int | None = None
        self._held: list[Message] = []
        self._held_bytes = 0

    def stamped(self, message: Message) -> list[Message]:
        """Messages whose time is known now; to be called in the order of arrival."""
        if message.message_type == _CLOCK:
            self._now_ns = _stamp_ns(_read(message).clock)
        self._held.append(message)
        self._held_bytes += len(message.data)
        waits = self._now_ns is None and self._held_bytes <= _HELD_BYTES
        return [] if waits else self.rest()

    def rest(self) -> list[Message]:
        """What still waits, at the end, or because too much does."""
        released, self._held = self._held, []
        if self._now_ns is None:
            return released
        return [one._replace(stamp_ns=self._now_ns) for one in released]


class Bag:
    """Writes one bag; a topic is in it from its first message on.

    Parameters
    ----------
    folder : Path
        Made here; an ``OSError`` if it cannot be.
    notes : mapping of str to str
        What travels beside the messages, as ``custom_data``.
    """

    def __init__(self, folder: Path, notes: Mapping[str, str]) -> None:
        self._writer = Writer(folder, version=_VERSION, storage_plugin=StoragePlugin.MCAP)
        # Whole chunks of the file, as every reader of MCAP knows it: 1 MB at a time, or less.
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        for key, value in notes.items():
            self._writer.set_custom_data(key, value)
        self._writer.open()
        self._notes = folder / NOTES
        self._notes.write_text(yaml.safe_dump(dict(notes)), encoding="utf-8")
        self._connections: dict[str, Any] = {}
        self._chunk_ns: int | None = None
        #: Messages by topic.
        self.counts: dict[str, int] = {}

    def write(self, message: Message, profiles: Iterable[Any] = ()) -> None:
        """Append a message; with a topic's first, the ``QoSProfile`` of each of its publishers."""
        topic, stamp_ns = message.topic, message.stamp_ns
        if topic not in self._connections:
            offered = dict.fromkeys(map(_bag_qos, profiles))  # each kind once
            self._connections[topic] = self._writer.add_connection(
                topic, message.message_type, typestore=TYPES, offered_qos_profiles=list(offered)
            )
            self.counts[topic] = 0
        self._writer.write(self._connections[topic], stamp_ns, message.data)
        self.counts[topic] += 1
        if self._chunk_ns is None:
            self._chunk_ns = stamp_ns
        elif abs(stamp_ns - self._chunk_ns) > _CHUNK_NS:
            self._chunk_ns = stamp_ns
            storage: Any = self._writer.storage
            if storage.chunk.msgs:
                storage.close_chunk()
            storage.bio.flush()

    def close(self) -> None:
        """Finish the file and write ``metadata.yaml``; where that fails, the messages stay."""
        try:
            self._writer.close()
        except ERRORS:
            with contextlib.suppress(*ERRORS):
                self._writer.abort()
            raise
        self._notes.unlink(missing_ok=True)


def _bag_qos(profile: Any) -> Qos:
    """What a publisher offers, as a bag holds it; of a ``QoSProfile``, read by its names."""

    def time(duration: Any) -> QosTime:
        return QosTime(*divmod(duration.nanoseconds, 10**9))

    return Qos(
        history=QosHistory[profile.history.name],
        depth=profile.depth,
        reliability=QosReliability[profile.reliability.name],
        durability=QosDurability[profile.durability.name],
        deadline=time(profile.deadline),
        lifespan=time(profile.lifespan),
        liveliness=QosLiveliness[profile.liveliness.name],
        liveliness_lease_duration=time(profile.liveliness_lease_duration),
        avoid_ros_namespace_conventions=bool(profile.avoid_ros_namespace_conventions),
    )


# --- transforms ---


class _Joint(NamedTuple):
    """A joint of a URDF, or a camera's mount: the child's pose (4, 4) in its parent, m."""

    parent: str
    child: str
    pose: np.ndarray
    kind: str = "fixed"
    axis: np.ndarray = np.zeros(3)

    def at(self, position: float) -> _Joint:
        """The same with the child where a position, rad or m, puts it."""
        step, none = position * self.axis, np.zeros(3)
        moved = _pose(step, none) if self.kind == "prismatic" else _pose(none, step)
        return self._replace(pose=self.pose @ moved)


def _pose(translation_m: np.ndarray, rotation_vector: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(rotation_vector).as_matrix()
    pose[:3, 3] = translation_m
    return pose


class Transforms:
    """Makes the transforms that a viewer of a bag needs, of what is recorded into it.

    Parameters
    ----------
    description, joint_states, camera_pose : str
        Full names of the topics that they are made of.
    camera_frame : str
        The frame whose pose the last one holds.
    """

    def __init__(
        self, description: str, joint_states: str, camera_pose: str, camera_frame: str
    ) -> None:
        self._description, self._joint_states = description, joint_states
        self._camera_pose, self._camera_frame = camera_pose, camera_frame
        self._joints: dict[str, _Joint] = {}
        self._camera: list[_Joint] = []
        self._newest_ns = 0

    def of(self, message: Message, robot: bool = True) -> Message | None:
        """The transforms that follow from a message of the bag, if any do.

        Without ``robot``, those of its links are left out. A ``ValueError`` says what is wrong with
        the message.
        """
        try:
            if message.topic == self._joint_states:
                return self._moved(message) if robot else None
            if message.topic == self._description:
                self._joints = {}
                self._joints = _read_joints(_read(message).data)
            elif message.topic == self._camera_pose:
                self._camera = [self._mount(_read(message))]
            else:
                return None
        except SerdeError as error:
            raise ValueError(f"{message.topic} is malformed: {error}") from error
        # All that is known each time: a latched topic keeps its last message only.
        links = [one for one in self._joints.values() if robot and one.kind == "fixed"]
        return _message(TF_STATIC, message, message.stamp_ns, [*links, *self._camera])

    def _mount(self, stamped: Any) -> _Joint:
        at, turn = stamped.pose.position, stamped.pose.orientation
        rotation = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])
        pose = _pose(np.array([at.x, at.y, at.z]), rotation.as_rotvec())
        return _Joint(stamped.header.frame_id, self._camera_frame, pose)

    def _moved(self, message: Message) -> Message | None:
        if not self._joints or 0 <= message.stamp_ns - self._newest_ns < _TF_PERIOD_NS:
            return None
        self._newest_ns = message.stamp_ns
        states = _read(message)
        links = [
            self._joints[name].at(position)
            for name, position in zip(states.name, states.position, strict=False)
            if name in self._joints
            and self._joints[name].kind in ("revolute", "continuous", "prismatic")
            and np.isfinite(position)
        ]
        return _message(TF, message, _stamp_ns(states.header.stamp), links)


def _read_joints(urdf: str) -> dict[str, _Joint]:
    """The joints of a robot by name; a ``ValueError`` says what is wrong with its URDF."""
    try:
        found = ElementTree.fromstring(urdf).findall("joint")
        return {one.get("name", ""): _joint(one) for one in found}
    except (ElementTree.ParseError, ValueError) as error:
        raise ValueError(f"robot_description cannot be read: {error}") from error


def _joint(element: ElementTree.Element) -> _Joint:
    def attribute(tag: str, name: str, default: str = "") -> str:
        child = element.find(tag)
        return default if child is None else child.get(name, default)

    def numbers(tag: str, name: str, default: str) -> np.ndarray:
        values = np.array(attribute(tag, name, default).split(), dtype=float)
        if values.shape != (3,) or not np.isfinite(values).all():
            raise ValueError(f"joint {element.get('name')} has no three numbers as {tag} {name}")
        return values

    parent, child = attribute("parent", "link"), attribute("child", "link")
    if not parent or not child:
        raise ValueError(f"joint {element.get('name')} has no parent or no child")
    turn = Rotation.from_euler("xyz", numbers("origin", "rpy", "0 0 0")).as_rotvec()
    pose = _pose(numbers("origin", "xyz", "0 0 0"), turn)
    axis = numbers("axis", "xyz", "1 0 0")
    return _Joint(parent, child, pose, element.get("type", ""), axis / (np.linalg.norm(axis) or 1))


def _read(message: Message) -> Any:
    return TYPES.deserialize_cdr(message.data, message.message_type)


def _stamp_ns(stamp: Any) -> int:
    return stamp.sec * 10**9 + stamp.nanosec


def _message(
    topic: str, cause: Message, stamp_ns: int, transforms: Iterable[_Joint]
) -> Message | None:
    """A ``TFMessage`` of the transforms, written at the time of its cause; None without any."""
    kinds: Any = TYPES.types
    stamp = kinds["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
    stamped = []
    for one in transforms:
        turn = Rotation.from_matrix(one.pose[:3, :3]).as_quat()
        place = kinds["geometry_msgs/msg/Transform"](
            kinds["geometry_msgs/msg/Vector3"](*one.pose[:3, 3].tolist()),
            kinds["geometry_msgs/msg/Quaternion"](*turn.tolist()),
        )
        header = kinds["std_msgs/msg/Header"](stamp, one.parent)
        stamped.append(kinds["geometry_msgs/msg/TransformStamped"](header, one.child, place))
    data = bytes(TYPES.serialize_cdr(kinds[_TRANSFORMS](stamped), _TRANSFORMS))
    return Message(topic, _TRANSFORMS, cause.stamp_ns, data) if stamped else None
