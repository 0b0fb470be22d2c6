"""What a URDF says of an arm's joints: their order, their limits, and where their axes are."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, isfinite

import numpy as np

from fvs_ros.chain import SerialChain
from fvs_ros.feature import rotation_matrix
from fvs_ros.vectors import LARGEST

_MOVING = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True)
class UrdfJoint:
    """A joint; its limits in rad and rad/s, of a prismatic one in m and m/s, infinite for none."""

    name: str
    kind: str
    parent: str
    child: str
    lower: float
    upper: float
    velocity: float
    #: Of the joint in its parent's frame, m and rad (roll, pitch, yaw), and its axis in its own.
    xyz_m: tuple[float, ...] = (0.0, 0.0, 0.0)
    rpy_rad: tuple[float, ...] = (0.0, 0.0, 0.0)
    axis: tuple[float, ...] = (1.0, 0.0, 0.0)

    @property
    def moves(self) -> bool:
        """Whether it is no fixed joint, and not one that mimics another."""
        return self.kind in _MOVING


def read_joints(text: str) -> dict[str, UrdfJoint]:
    """All joints of a URDF, by name; a ``ValueError`` if it is none."""
    if "<!DOCTYPE" in text:  # a few lines of one can expand beyond any memory
        raise ValueError("the URDF has a DOCTYPE, which is not taken")
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise ValueError(f"the URDF is no XML: {error}") from None
    if root.tag != "robot":
        raise ValueError(f"a URDF has one <robot>, got <{root.tag[:40]}>")
    return {one.name: one for one in map(_joint, root.findall("joint"))}


def _joint(element: ET.Element) -> UrdfJoint:
    name, kind = element.get("name", ""), element.get("type", "")
    limit = element.find("limit")
    given: Mapping[str, str] = {} if limit is None else limit.attrib
    try:
        lower, upper = (float(given.get(end, "0")) for end in ("lower", "upper"))
        velocity = float(given.get("velocity", "0"))
        ends = {one.tag: one.attrib["link"] for one in element if one.tag in ("parent", "child")}
        parent, child = ends["parent"], ends["child"]
        xyz_m, rpy_rad = (_triple(element, "origin", which) for which in ("xyz", "rpy"))
        axis = _triple(element, "axis", "xyz", "1 0 0")
    except (ValueError, KeyError):
        words = f"joint {name[:60]!r} of the URDF lacks a link or has a bad number"
        raise ValueError(words) from None
    if lower > upper:
        raise ValueError(f"joint {name[:60]!r} of the URDF has limits {lower:g} to {upper:g}")
    if kind == "continuous" or lower == upper:
        lower, upper = -inf, inf
    if element.find("mimic") is not None:
        kind = "mimic"
    velocity = velocity if isfinite(velocity) and velocity > 0.0 else inf
    return UrdfJoint(name, kind, parent, child, lower, upper, velocity, xyz_m, rpy_rad, axis)


def _triple(element: ET.Element, tag: str, which: str, usual: str = "0 0 0") -> tuple[float, ...]:
    """Three numbers of a child element; a ``ValueError`` if they are others."""
    found = element.find(tag)
    words = usual if found is None else found.get(which, usual)
    x, y, z = (float(word) for word in words.split())
    if not max(abs(x), abs(y), abs(z)) <= LARGEST:
        raise ValueError
    return x, y, z


def _path(joints: Mapping[str, UrdfJoint], end: str) -> list[UrdfJoint]:
    """All joints from the root to a link."""
    above = {one.child: one for one in joints.values()}
    found: list[UrdfJoint] = []
    while end in above and len(found) < len(above):  # a loop of joints has no root
        found.insert(0, above[end])
        end = above[end].parent
    return found


def moving_chain(joints: Mapping[str, UrdfJoint], link: str = "") -> tuple[str, list[UrdfJoint]]:
    """A link, and the moving joints from the root to it.

    Without one it is ``tool0``, or else the link with most moving joints before it.
    """
    above = {one.child: one for one in joints.values()}
    if not above:
        raise ValueError("the URDF has no joints: is it a xacro that was not expanded?")

    def chain(end: str) -> list[UrdfJoint]:
        return [one for one in _path(joints, end) if one.moves]

    end = link or ("tool0" if "tool0" in above else "")
    end = end or max(above, key=lambda one: len(chain(one)), default="")
    if end not in above:
        known = ", ".join(sorted(above))[:400]
        raise ValueError(f"no joint of the URDF has the link {end!r} after it; there are {known}")
    moving = chain(end)
    if not moving:
        raise ValueError(f"no moving joint of the URDF carries {end}")
    return end, moving


@dataclass(frozen=True)
class Kinematics:
    """The moving joints from a root link to a tip, with all joints at zero, in the root's frame."""

    root: str
    tip: str
    names: tuple[str, ...]
    axes: np.ndarray  # (n, 3)
    points_m: np.ndarray  # (n, 3)
    prismatic: np.ndarray  # 1 for a prismatic joint, (n,)
    tip_rotation: np.ndarray  # (3, 3)
    tip_m: np.ndarray  # (3,)

    def chain(self, feature_m: np.ndarray) -> SerialChain:
        """The arm with what it carries, given at zero in the root's frame, m, (m,)."""
        zero = np.zeros(len(self.names))
        return SerialChain(self.axes, self.points_m, feature_m, zero, self.prismatic)

    def at(self, joints_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points of the axes, m, and their directions, (n, 3) each, at joints, rad (m), (n,)."""
        place = np.arange(len(self.names))
        moved = [
            self.chain(np.append(self.points_m[i], self.axes[i])).position(
                np.where(place < i, joints_rad, 0.0)
            )
            for i in place
        ]
        points_m, axes = np.hsplit(np.array(moved), 2)
        return points_m, axes

    def tip_at(self, joints_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Axes of the tip, in rows, (..., 3, 3), and its place, m, (..., 3), at joints, rad."""
        tip = np.concatenate([self.tip_m, self.tip_rotation.T.ravel()])
        moved = self.chain(tip).position(joints_rad)
        return moved[..., 3:].reshape(*moved.shape[:-1], 3, 3), moved[..., :3]

    def reversed(self) -> Kinematics:
        """The same arm as its tip sees it: the last joint first, and each turning the root."""
        back = self.tip_rotation.T
        return Kinematics(
            self.tip,
            self.root,
            self.names[::-1],
            -(self.axes @ back.T)[::-1],
            ((self.points_m - self.tip_m) @ back.T)[::-1],
            self.prismatic[::-1],
            back,
            -back @ self.tip_m,
        )


def kinematics(joints: Mapping[str, UrdfJoint], link: str = "") -> Kinematics:
    """Where the axes of the joints are that carry a link; see :func:`moving_chain`."""
    tip, moving = moving_chain(joints, link)
    path = _path(joints, tip)
    rotation, place_m = np.eye(3), np.zeros(3)
    axes, points_m = [], []
    for one in path:
        place_m = place_m + rotation @ np.array(one.xyz_m)
        for angle, about in zip(one.rpy_rad[::-1], np.eye(3)[::-1], strict=True):
            rotation = rotation @ rotation_matrix(angle * about)
        if one.moves:
            axis = np.array(one.axis)
            if not np.linalg.norm(axis) > 1e-6:
                raise ValueError(f"joint {one.name[:60]!r} of the URDF has no axis")
            axes.append(rotation @ axis / np.linalg.norm(axis))
            points_m.append(place_m)
    prismatic = np.array([one.kind == "prismatic" for one in moving], dtype=float)
    names = tuple(one.name for one in moving)
    return Kinematics(
        path[0].parent, tip, names, np.array(axes), np.array(points_m), prismatic, rotation, place_m
    )
