"""What a viewer of a bag needs beside its messages: transforms, made of what is recorded.

RViz and Foxglove draw a thing where ``/tf`` and ``/tf_static`` say that its frame is. Here they
are computed from what a recording has anyway: the robot's URDF and its joint states.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any
from xml.etree import ElementTree

import numpy as np
from rosbags.serde import SerdeError
from scipy.spatial.transform import Rotation

from fvs_tools.bag import TYPES, Message

TOPIC, STATIC_TOPIC = "/tf", "/tf_static"
TYPE = "tf2_msgs/msg/TFMessage"
#: Joints that follow another one, or float, belong to no arm.
_MOVING = ("revolute", "continuous", "prismatic")
#: The arm's transforms are written no more often: a viewer needs no more.
_PERIOD_NS = 10**9 // 30


@dataclass(frozen=True)
class Joint:
    """A joint of a URDF, or a camera's mount: where one frame stands in another.

    Parameters
    ----------
    parent, child : str
        Names of the frames.
    translation_m : ndarray, shape (3,)
        The child's origin in the parent at position zero, m.
    rotation : Rotation
        Its orientation there.
    kind : str
        Such as ``revolute``.
    axis : ndarray, shape (3,)
        Unit axis in the child.
    """

    parent: str
    child: str
    translation_m: np.ndarray
    rotation: Rotation
    kind: str = "fixed"
    axis: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def at(self, position: float) -> Joint:
        """The same with the child where a position, rad or m, puts it."""
        step = position * self.axis
        if self.kind == "prismatic":
            return replace(self, translation_m=self.translation_m + self.rotation.apply(step))
        return replace(self, rotation=self.rotation * Rotation.from_rotvec(step))


def read_joints(urdf: str) -> dict[str, Joint]:
    """The joints of a robot by name, of its URDF.

    Raises
    ------
    ValueError
        If it is no URDF, or has a joint that cannot be understood.
    """
    try:
        found = ElementTree.fromstring(urdf).findall("joint")
        return {one.get("name", ""): _joint(one) for one in found}
    except (ElementTree.ParseError, ValueError) as error:
        raise ValueError(f"robot_description cannot be read: {error}") from error


def _joint(element: ElementTree.Element) -> Joint:
    def attribute(tag: str, name: str, default: str) -> str:
        child = element.find(tag)
        return default if child is None else child.get(name, default)

    def numbers(tag: str, name: str, default: str) -> np.ndarray:
        text = attribute(tag, name, default)
        values = np.array([float(word) for word in text.split()])
        if values.shape != (3,) or not np.isfinite(values).all():
            raise ValueError(f"joint {element.get('name')} has {tag} {name} '{text}'")
        return values

    parent, child = attribute("parent", "link", ""), attribute("child", "link", "")
    if not parent or not child:
        raise ValueError(f"joint {element.get('name')} has no parent or no child")
    axis = numbers("axis", "xyz", "1 0 0")
    rotation = Rotation.from_euler("xyz", numbers("origin", "rpy", "0 0 0"))
    translation_m = numbers("origin", "xyz", "0 0 0")
    axis /= np.linalg.norm(axis) or 1.0
    return Joint(parent, child, translation_m, rotation, element.get("type", ""), axis)


class Viewing:
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
        self._joints: dict[str, Joint] = {}
        self._camera: list[Joint] = []
        self._newest_ns = 0

    def of(self, message: Message, robot: bool = True) -> Message | None:
        """The transforms that follow from a message of the bag, if any do.

        Parameters
        ----------
        message : Message
            Of any topic.
        robot : bool
            Whether the robot's links are wanted, too; those that move, at most 30 times a second.

        Raises
        ------
        ValueError
            If the message is malformed, or describes no robot.
        """
        try:
            if message.topic == self._joint_states:
                return self._moved(message) if robot else None
            if message.topic == self._description:
                self._joints = {}
                self._joints = read_joints(_read(message, "std_msgs/msg/String").data)
            elif message.topic == self._camera_pose:
                stamped = _read(message, "geometry_msgs/msg/PoseStamped")
                at, turn = stamped.pose.position, stamped.pose.orientation
                rotation = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])
                place = stamped.header.frame_id, self._camera_frame, np.array([at.x, at.y, at.z])
                self._camera = [Joint(*place, rotation)]
            else:
                return None
        except SerdeError as error:
            raise ValueError(f"{message.topic} is malformed: {error}") from error
        # All that is known each time: a latched topic keeps its last message only.
        links = [one for one in self._joints.values() if robot and one.kind == "fixed"]
        return _message(STATIC_TOPIC, message, message.stamp_ns, [*links, *self._camera])

    def _moved(self, message: Message) -> Message | None:
        if not self._joints or 0 <= message.stamp_ns - self._newest_ns < _PERIOD_NS:
            return None
        self._newest_ns = message.stamp_ns
        states = _read(message, "sensor_msgs/msg/JointState")
        links = [
            self._joints[name].at(position)
            for name, position in zip(states.name, states.position, strict=False)
            if name in self._joints and self._joints[name].kind in _MOVING and np.isfinite(position)
        ]
        stamp = states.header.stamp
        return _message(TOPIC, message, stamp.sec * 10**9 + stamp.nanosec, links)


def _read(message: Message, kind: str) -> Any:
    return TYPES.deserialize_cdr(message.data, kind)


def _message(
    topic: str, cause: Message, stamp_ns: int, transforms: Iterable[Joint]
) -> Message | None:
    """A ``TFMessage`` of the transforms, written at the time of its cause; None without any."""
    kinds: Any = TYPES.types
    stamp = kinds["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
    stamped = [
        kinds["geometry_msgs/msg/TransformStamped"](
            kinds["std_msgs/msg/Header"](stamp, one.parent),
            one.child,
            kinds["geometry_msgs/msg/Transform"](
                kinds["geometry_msgs/msg/Vector3"](*map(float, one.translation_m)),
                kinds["geometry_msgs/msg/Quaternion"](*map(float, one.rotation.as_quat())),
            ),
        )
        for one in transforms
    ]
    data = bytes(TYPES.serialize_cdr(kinds[TYPE](stamped), TYPE))
    return Message(topic, TYPE, cause.stamp_ns, data) if stamped else None
