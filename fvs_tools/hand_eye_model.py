"""What a camera sees of a target that an arm moves, by the URDF and by what may be off.

Link i is turned and shifted before joint i. The camera reports a point (x, y, z) as ``s (f (1 + k
r^2) x, f (1 + k r^2) y, z)`` with ``r^2 = (x^2 + y^2) / z^2``: s and f are scales of lengths and of
the focal length, k is the first coefficient of distortion.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fvs_estimator_node.files import DataSet
from fvs_estimator_node.joint_path import Path
from fvs_ros.chain import SerialChain, cross_matrix
from fvs_ros.kinds import Kind
from fvs_ros.rotations import nearest_rotation
from fvs_tools.kinematics import Kinematics

#: Step of the derivatives of what a lens shows, m; the others are exact.
_STEP = 1e-6


class Unknowns(NamedTuple):
    """What is estimated, or its standard deviations; all are 0 at the start, without errors."""

    camera: np.ndarray  # shift, m, and rotation, rad, in the base's frame, from the start, (6,)
    target: np.ndarray  # motion of what the tip carries, m and rad, from the start, (d,)
    delay_s: np.ndarray  # how late the images are stamped, (1,)
    scale: np.ndarray  # lengths that the camera reports over true ones, less 1, (1,)
    focal: np.ndarray  # true focal length over that of camera_info, less 1, (1,)
    radial: np.ndarray  # distortion k1 that camera_info lacks, (1,)
    zeros: np.ndarray  # to be added to each joint, rad (m), (n,)
    encoders: np.ndarray  # true motion of each joint over the reported one, less 1, (n,)
    links: np.ndarray  # of each joint but the first: shift, m, and rotation times 0.5 m, (6 n - 6,)


#: Lever arm of a link's rotation, m.
_LINK_M = 0.5


@dataclass(frozen=True)
class HandEyeModel:
    """Images as functions of the unknowns."""

    data: DataSet  #: with the joints of the arm, in its order
    path: Path  #: its joints at any time, and the images that count
    arm: Kinematics  #: from the URDF
    base_from_camera: np.ndarray  #: where the unknown pose of the camera begins, (4, 4)
    #: Where the target begins: as measured in the base's frame, all joints at zero, (m,).
    target: np.ndarray

    @cached_property
    def kind(self) -> Kind:
        """What the camera sees."""
        return self.data.kind

    @cached_property
    def measured(self) -> np.ndarray:
        """What the images show, (k, m)."""
        return self.data.z[self.path.indices]

    @cached_property
    def sizes(self) -> tuple[int, ...]:
        """Of the parts of the unknowns."""
        n = len(self.arm.names)
        return 6, self.kind.size, 1, 1, 1, 1, n, n, 6 * (n - 1)

    def unknowns(self, values: np.ndarray) -> Unknowns:
        """The parts of a vector, (p,)."""
        return Unknowns(*np.split(values, np.cumsum(self.sizes)[:-1]))

    def poses(self, unknowns: Unknowns) -> tuple[np.ndarray, np.ndarray]:
        """``base_from_camera``, (4, 4), and the target in the base's frame, (m,)."""
        moved = self.base_from_camera.copy()
        moved[:3, 3] += unknowns.camera[:3]
        moved[:3, :3] = Rotation.from_rotvec(unknowns.camera[3:]).as_matrix() @ moved[:3, :3]
        return moved, self.kind.retract(self.target, self.kind.unit * unknowns.target)

    def features(self, values: np.ndarray, images: np.ndarray | slice = slice(None)) -> np.ndarray:
        """What images show, (k, m), at a vector of unknowns, (p,)."""
        unknowns = self.unknowns(values)
        reported = self.path.joints_and_velocities(unknowns.delay_s.item())[0][images]
        joints = (1.0 + unknowns.encoders) * reported + unknowns.zeros
        return self._shown(self._chain(unknowns)[0].position(joints), unknowns)

    def _shown(
        self, features: np.ndarray, unknowns: Unknowns, more: np.ndarray | float = 0.0
    ) -> np.ndarray:
        """What the camera reports of features, (k, m); with more of scale, focal and radial."""
        scale, focal, radial = np.concatenate(unknowns[3:6]) + more
        shown = self.kind.through_lens(features, focal, radial)
        shown[:, :3] *= 1.0 + scale
        return shown

    def _chain(self, unknowns: Unknowns) -> tuple[SerialChain, np.ndarray]:
        """Arm and target in the camera's frame, all joints at zero.

        And the axes, in columns, along which camera, links and target are moved, (n + 1, 3, 3).
        """
        base_from_camera, target = self.poses(unknowns)
        arm, links = self.arm, unknowns.links.reshape(-1, 6)
        rotations = Rotation.from_rotvec(links[:, 3:] / _LINK_M).as_matrix()
        first = base_from_camera[:3, :3].T
        behind = np.array([*accumulate(rotations, np.matmul, initial=first)])  # each joint, (n,)
        before = np.insert(behind, 0, first, axis=0)  # each joint, and the target
        steps_m = np.diff(np.vstack([base_from_camera[:3, 3], arm.points_m, target[:3]]), axis=0)
        steps_m[1:-1] += links[:, :3]
        points_m = np.cumsum((before @ steps_m[..., None])[..., 0], axis=0)
        axes, zero = (behind @ arm.axes[..., None])[..., 0], np.zeros(len(arm.names))
        carried = np.append(points_m[-1], target[3:].reshape(-1, 3) @ behind[-1].T)
        return SerialChain(axes, points_m[:-1], carried, zero, arm.prismatic), before

    def slopes(self, values: np.ndarray, images: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Derivatives of the features by the unknowns, (k, m, p).

        Camera, links and target move what is behind them by twists.
        """
        unknowns = self.unknowns(values)
        (chain, frames), gears = self._chain(unknowns), 1.0 + unknowns.encoders
        motion = self.path.joints_and_velocities(unknowns.delay_s.item())
        reported, velocity = (part[images] for part in motion)
        stages = np.arange(len(frames))
        links_rad = unknowns.links.reshape(-1, 6)[:, 3:] / _LINK_M
        target_rad = np.append(unknowns.target, np.zeros(3))[3:6]
        turns = frames @ _left_jacobian(np.vstack([unknowns.camera[3:], links_rad, target_rad]))
        about_m = np.vstack([np.zeros(3), chain.points_m[1:], chain.feature_m[:3]])
        twists = np.zeros((len(frames), 6, len(frames), 6))
        twists[stages, 3:, stages, :3] = frames
        twists[stages, :3, stages, 3:] = turns
        twists[stages, 3:, stages, 3:] = cross_matrix(about_m) @ turns
        twists[0] *= -1.0  # what is seen moves against the camera
        twists[1:-1, ..., 3:] /= _LINK_M
        joints = gears * reported + unknowns.zeros
        parts = chain.slopes(joints, twists.reshape(len(frames), 6, -1))
        camera, links, target = np.split(parts.by_twist, [6, 6 * len(stages) - 6], axis=2)
        delay_s = -parts.by_joint @ (gears * velocity)[..., None]
        encoders = parts.by_joint * reported[:, None]

        shown = self._shown(parts.feature_m, unknowns)
        by_feature = [
            (self._shown(parts.feature_m + step, unknowns) - shown) / _STEP
            for step in _STEP * np.eye(shown.shape[1])
        ]
        # What is shown is linear in each of scale, focal length and distortion.
        lens = [self._shown(parts.feature_m, unknowns, more) - shown for more in np.eye(3)]
        moving = [camera, target[..., : self.kind.size], delay_s, parts.by_joint, encoders, links]
        slopes = np.stack(by_feature, axis=-1) @ np.concatenate(moving, axis=2)
        return np.insert(slopes, [7 + self.kind.size] * 3, np.stack(lens, axis=2), axis=2)


def _left_jacobian(vectors_rad: np.ndarray) -> np.ndarray:
    """How rotations turn further, rad, by their rotation vectors, (k, 3): (k, 3, 3)."""
    angles = np.maximum(np.linalg.norm(vectors_rad, axis=1), 1e-9)[:, None, None]
    k = cross_matrix(vectors_rad) / angles
    return np.eye(3) + (1.0 - np.cos(angles)) / angles * k + (1.0 - np.sin(angles) / angles) * k @ k


def registration(
    arm: Kinematics, joints_rad: np.ndarray, features: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """``base_from_camera`` and the target in the base's frame, by linear least squares.

    With vectors as rows, what is seen at x and carried at c of the tip is at ``x R + s = f + c T``
    of the base, linear in R, s and c; the nearest rotation of R fixes the others. No start is
    needed, and errors of the URDF move the optimum but make no second one.
    """
    rotations, points_m = arm.tip_at(joints_rad)  # T and f
    vectors = features.reshape(len(features), -1, 3)  # a point, and directions, without s and f
    slopes = np.zeros((*vectors.shape, 12 + vectors[0].size))
    slopes[..., :9] = np.einsum("kjm,de->kjdme", vectors, np.eye(3)).reshape(*vectors.shape, 9)
    slopes[:, 0, :, 9:12] = np.eye(3)
    for j in range(vectors.shape[1]):
        slopes[:, j, :, 12 + 3 * j : 15 + 3 * j] = -np.swapaxes(rotations, 1, 2)
    shifts_m = np.zeros(vectors.shape)
    shifts_m[:, 0] = points_m
    rows, wanted = slopes.reshape(features.size, -1), shifts_m.ravel()
    rotation = nearest_rotation(np.linalg.lstsq(rows, wanted, rcond=None)[0][:9].reshape(3, 3))
    rest = np.linalg.lstsq(rows[:, 9:], wanted - rows[:, :9] @ rotation.ravel(), rcond=None)[0]
    base_from_camera = np.eye(4)
    base_from_camera[:3] = np.column_stack([rotation.T, rest[:3]])
    target = rest[3:].reshape(-1, 3) @ arm.tip_rotation.T
    target[0] += arm.tip_m
    return base_from_camera, target.ravel()
