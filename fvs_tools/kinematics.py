"""Where the axes of an arm are, by its URDF."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fvs_ros.chain import SerialChain
from fvs_ros.urdf import UrdfJoint, moving_chain, path_to


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
    #: Whether zeros and links are exact: of a hand whose pose is measured.
    exact: bool = False

    def chain(self, feature_m: np.ndarray) -> SerialChain:
        """The arm with what it carries, given at zero in the root's frame, m, (m,)."""
        zero = np.zeros(len(self.names))
        return SerialChain(self.axes, self.points_m, feature_m, zero, self.prismatic)

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
            self.exact,
        )


def kinematics(
    joints: Mapping[str, UrdfJoint], link: str = "", known: Collection[str] = ()
) -> Kinematics:
    """Where the axes of the joints are that carry a link; see :func:`moving_chain`."""
    tip, moving = moving_chain(joints, link, known)
    path = path_to({joint.child: joint for joint in joints.values()}, tip)
    rotation, point_m = np.eye(3), np.zeros(3)
    axes, points_m = [], []
    for joint in path:
        point_m = point_m + rotation @ np.array(joint.xyz_m)
        rotation = rotation @ Rotation.from_euler("xyz", joint.rpy_rad).as_matrix()
        if joint.moves:
            axis = np.array(joint.axis)
            if not np.linalg.norm(axis) > 1e-6:
                raise ValueError(f"joint {joint.name[:60]!r} of the URDF has no axis")
            axes.append(rotation @ axis / np.linalg.norm(axis))
            points_m.append(point_m)
    prismatic = np.array([joint.kind == "prismatic" for joint in moving], dtype=float)
    names = tuple(joint.name for joint in moving)
    return Kinematics(
        path[0].parent,
        tip,
        names,
        np.array(axes),
        np.array(points_m),
        prismatic,
        rotation,
        point_m,
    )
