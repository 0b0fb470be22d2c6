"""A rosbag2 that is being written: messages as they were on the wire, in an MCAP file.

Any ROS 2 from Jazzy on reads it (``ros2 bag info``, ``ros2 bag play``), and so do Foxglove,
PlotJuggler and ``fvs_experiments replay``.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
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

from fvs_ros.apps.transforms import STATIC_TOPIC, TOPIC, TYPE, Links, Transform

#: Of rosbag2's format, as ROS 2 Jazzy writes it.
_VERSION: Final = 9
_TYPES = get_typestore(Stores.ROS2_JAZZY)
_STRING, _POSE, _JOINTS = (
    f"{package}/msg/{name}"
    for package, name in (
        ("std_msgs", "String"),
        ("geometry_msgs", "PoseStamped"),
        ("sensor_msgs", "JointState"),
    )
)
#: The arm's transforms are written no more often: a viewer needs no more.
_PERIOD_NS = 10**9 // 30
#: What writing into a bag may raise.
ERRORS: Final = (OSError, WriterError)


def knows(message_type: str) -> bool:
    """Whether messages of a type can be described in a bag."""
    return message_type in _TYPES.fielddefs


def to_bag_qos(profile: Any) -> Qos:
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


class Viewing:
    """Makes the transforms that a viewer of a bag needs, of what is recorded into it.

    Parameters
    ----------
    description, joint_states, camera_pose : str
        Full names of the topics that they are made of.
    camera_frame : str
        The frame whose pose the last one tells.

    Attributes
    ----------
    wrong : str
        What was wrong with the robot's description, empty if nothing was.
    """

    def __init__(
        self, description: str, joint_states: str, camera_pose: str, camera_frame: str
    ) -> None:
        self._topics = {description: self._describe, camera_pose: self._place_camera}
        self._joint_states = joint_states
        self._camera_frame = camera_frame
        self._links: Links | None = None
        self._camera: tuple[Transform, ...] = ()
        self._newest_ns = 0
        self.wrong = ""

    def of(
        self, topic: str, stamp_ns: int, data: bytes, robot: bool = True
    ) -> tuple[str, bytes] | None:
        """Topic and message, serialised, that follow from a message of the bag, if any do.

        Parameters
        ----------
        topic, stamp_ns, data
            Of the message: topic, time of its arrival (ns), and as it was on the wire.
        robot : bool
            Whether the robot's links are wanted, too; those that move, at most 30 times a second.
        """
        try:
            if topic == self._joint_states:
                return self._move(stamp_ns, data) if robot else None
            if topic not in self._topics:
                return None
            self._topics[topic](data)
        except (ValueError, SerdeError) as error:
            self.wrong = str(error)
            return None
        # All that is known each time: of a latched topic, who comes late hears the last only.
        links = self._links.fixed if robot and self._links is not None else ()
        both = (*links, *self._camera)
        return (STATIC_TOPIC, _transforms(stamp_ns, both)) if both else None

    def _describe(self, data: bytes) -> None:
        self._links = None
        self._links = Links(_TYPES.deserialize_cdr(data, _STRING).data)  # type: ignore[attr-defined]

    def _place_camera(self, data: bytes) -> None:
        message: Any = _TYPES.deserialize_cdr(data, _POSE)
        at, turn = message.pose.position, message.pose.orientation
        self._camera = (
            Transform(
                message.header.frame_id,
                self._camera_frame,
                np.array([at.x, at.y, at.z]),
                np.array([turn.x, turn.y, turn.z, turn.w]),
            ),
        )

    def _move(self, stamp_ns: int, data: bytes) -> tuple[str, bytes] | None:
        if self._links is None or 0 <= stamp_ns - self._newest_ns < _PERIOD_NS:
            return None
        self._newest_ns = stamp_ns
        message: Any = _TYPES.deserialize_cdr(data, _JOINTS)
        moved = self._links.moved(dict(zip(message.name, message.position, strict=False)))
        stamp = message.header.stamp
        if not moved:
            return None
        return TOPIC, _transforms(stamp.sec * 10**9 + stamp.nanosec, moved)


def _transforms(stamp_ns: int, transforms: Iterable[Transform]) -> bytes:
    """A ``TFMessage``, serialised."""
    kinds: Any = _TYPES.types
    stamp = kinds["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
    told = [
        kinds["geometry_msgs/msg/TransformStamped"](
            kinds["std_msgs/msg/Header"](stamp, one.parent),
            one.child,
            kinds["geometry_msgs/msg/Transform"](
                kinds["geometry_msgs/msg/Vector3"](*map(float, one.translation_m)),
                kinds["geometry_msgs/msg/Quaternion"](*map(float, one.quaternion_xyzw)),
            ),
        )
        for one in transforms
    ]
    return bytes(_TYPES.serialize_cdr(kinds[TYPE](told), TYPE))


class Bag:
    """Writes one bag; a topic is in it from its first message on.

    Parameters
    ----------
    folder : Path
        Made here.
    notes : mapping of str to str
        What travels beside the messages.

    Raises
    ------
    OSError
        If the folder cannot be made.
    """

    def __init__(self, folder: Path, notes: Mapping[str, str]) -> None:
        self._writer = Writer(folder, version=_VERSION, storage_plugin=StoragePlugin.MCAP)
        # Whole chunks of the file, as every reader of MCAP knows it: 1 MB at a time.
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        for key, value in notes.items():
            self._writer.set_custom_data(key, value)
        self._writer.open()
        self._connections: dict[str, Any] = {}
        #: Messages by topic.
        self.counts: dict[str, int] = {}

    def write(
        self, topic: str, message_type: str, profiles: Iterable[Any], stamp_ns: int, data: bytes
    ) -> None:
        """Append a message.

        Parameters
        ----------
        topic, message_type : str
            Its topic and type.
        profiles : iterable of QoSProfile
            What the topic's publishers offer; looked at with the first message.
        stamp_ns : int
            Time of its arrival, ns.
        data : bytes
            The message, serialised (CDR).

        Raises
        ------
        OSError or WriterError
            If it cannot be written.
        """
        connection = self._connections.get(topic)
        if connection is None:
            offered = dict.fromkeys(map(to_bag_qos, profiles))  # each kind once
            connection = self._writer.add_connection(
                topic, message_type, typestore=_TYPES, offered_qos_profiles=list(offered)
            )
            self._connections[topic] = connection
            self.counts[topic] = 0
        self._writer.write(connection, stamp_ns, data)
        self.counts[topic] += 1

    def close(self) -> None:
        """Finish the file and write ``metadata.yaml``; one of ``ERRORS`` if that fails."""
        self._writer.close()

    def abandon(self) -> None:
        """Close after an error; what was written stays, without an index."""
        with contextlib.suppress(*ERRORS):
            self._writer.abort()
