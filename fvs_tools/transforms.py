"""Where the links of a robot stand, as a viewer wants to know it: a tree of transforms.

RViz and Foxglove draw a thing where ``/tf`` and ``/tf_static`` say that its frame is. Here they
are computed from what a recording has anyway: the robot's URDF and its joint states.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from fvs_ros.quaternions import about, product, rotation_of

TOPIC, STATIC_TOPIC = "/tf", "/tf_static"
TYPE = "tf2_msgs/msg/TFMessage"


@dataclass(frozen=True)
class Transform:
    """Where one frame stands in another.

    Parameters
    ----------
    parent, child : str
        Names of the frames.
    translation_m : ndarray, shape (3,)
        The child's origin in the parent, m.
    quaternion_xyzw : ndarray, shape (4,)
        Its orientation there, a unit quaternion.
    """

    parent: str
    child: str
    translation_m: np.ndarray
    quaternion_xyzw: np.ndarray


@dataclass(frozen=True)
class _Joint:
    """A joint that moves: its child in its parent at zero, and its unit axis in the child."""

    zero: Transform
    axis: np.ndarray
    turns: bool


class Links:
    """The links of a robot, of its URDF.

    Parameters
    ----------
    urdf : str
        The text.

    Attributes
    ----------
    fixed : tuple of Transform
        Those that never move.

    Raises
    ------
    ValueError
        If it is no URDF, or has a joint that cannot be understood.
    """

    def __init__(self, urdf: str) -> None:
        try:
            found = ElementTree.fromstring(urdf).findall("joint")
            joints = {one.get("name", ""): (one.get("type", ""), _read(one)) for one in found}
        except (ElementTree.ParseError, ValueError) as error:
            raise ValueError(f"robot_description cannot be read: {error}") from error
        self.fixed = tuple(one.zero for kind, one in joints.values() if kind == "fixed")
        # What floats, or follows another joint, is no arm's, and left out.
        self._moving = {
            name: one
            for name, (kind, one) in joints.items()
            if kind in ("revolute", "continuous", "prismatic")
        }

    def moved(self, positions: Mapping[str, float]) -> list[Transform]:
        """The links that move, where these joint positions (rad or m, by name) put them."""
        return [
            _moved(self._moving[name], position)
            for name, position in positions.items()
            if name in self._moving and np.isfinite(position)
        ]


def _read(joint: ElementTree.Element) -> _Joint:
    parent, child = (_attribute(joint, tag, "link", "") for tag in ("parent", "child"))
    if not parent or not child:
        raise ValueError(f"joint {joint.get('name')} has no parent or no child")
    axis = _numbers(joint, "axis", "xyz", "1 0 0")
    length = float(np.linalg.norm(axis))
    turned = np.array([0.0, 0.0, 0.0, 1.0])
    for unit, angle_rad in zip(np.eye(3), _numbers(joint, "origin", "rpy", "0 0 0"), strict=True):
        turned = product(about(unit, angle_rad), turned)
    zero = Transform(parent, child, _numbers(joint, "origin", "xyz", "0 0 0"), turned)
    return _Joint(zero, axis / length if length else axis, turns=joint.get("type") != "prismatic")


def _attribute(joint: ElementTree.Element, tag: str, name: str, otherwise: str) -> str:
    element = joint.find(tag)
    return otherwise if element is None else element.get(name, otherwise)


def _numbers(joint: ElementTree.Element, tag: str, name: str, otherwise: str) -> np.ndarray:
    text = _attribute(joint, tag, name, otherwise)
    numbers = np.array([float(word) for word in text.split()])
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        raise ValueError(f"joint {joint.get('name')} has {tag} {name} '{text}'")
    return numbers


def _moved(joint: _Joint, position: float) -> Transform:
    zero = joint.zero
    if joint.turns:
        turned = product(zero.quaternion_xyzw, about(joint.axis, position))
        return Transform(zero.parent, zero.child, zero.translation_m, turned)
    slid = rotation_of(zero.quaternion_xyzw) @ (position * joint.axis)
    return Transform(zero.parent, zero.child, zero.translation_m + slid, zero.quaternion_xyzw)
