"""What a viewer of a bag needs beside its messages: transforms, made of what is recorded."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from rosbags.serde import SerdeError

from fvs_tools.bag import TYPES
from fvs_tools.transforms import STATIC_TOPIC, TOPIC, TYPE, Links, Transform

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
        self._links = Links(TYPES.deserialize_cdr(data, _STRING).data)  # type: ignore[attr-defined]

    def _place_camera(self, data: bytes) -> None:
        message: Any = TYPES.deserialize_cdr(data, _POSE)
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
        message: Any = TYPES.deserialize_cdr(data, _JOINTS)
        moved = self._links.moved(dict(zip(message.name, message.position, strict=False)))
        stamp = message.header.stamp
        if not moved:
            return None
        return TOPIC, _transforms(stamp.sec * 10**9 + stamp.nanosec, moved)


def _transforms(stamp_ns: int, transforms: Iterable[Transform]) -> bytes:
    """A ``TFMessage``, serialised."""
    kinds: Any = TYPES.types
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
    return bytes(TYPES.serialize_cdr(kinds[TYPE](told), TYPE))
