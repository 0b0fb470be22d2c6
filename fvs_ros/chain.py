"""A serial chain of revolute and prismatic joints that carries a ball or tag, seen by the camera.

Product of exponentials: with axis i a line through ``q_i`` along the unit vector ``w_i``,

    x(r) = E_1(r_1 - r0_1) E_2(r_2 - r0_2) ... E_n(r_n - r0_n) x0,

where ``E_i(angle)`` turns space about axis i, or shifts it along axis i if joint i is prismatic and
r_i a length. Axes and x0 are those of the reference joints ``r0``, in the camera's frame: no other
frame, and no length or angle of the robot, is needed. With ``T_i``, the derivative of ``E_i`` at 0,
column i of the Jacobian is the twist of axis i, as it stands now, applied to x. A tag's pose is a
point and three directions (:mod:`fvs_ros.kinds.pose`); a direction is turned, but not shifted.

From a camera on the arm the room moves the other way, the joint next to the camera last:

    x(r) = E_n(r0_n - r_n) ... E_2(r0_2 - r_2) E_1(r0_1 - r_1) x0.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from fvs_ros.vectors import LARGEST, check_arrays, plausible

_UNIT = np.eye(4)
#: The cross matrices of the three unit vectors, row by row.
_CROSS = np.array(
    [
        [0, 0, 0, 0, 0, -1, 0, 1, 0],
        [0, 0, 1, 0, 0, 0, -1, 0, 0],
        [0, -1, 0, 1, 0, 0, 0, 0, 0],
    ],
    dtype=float,
)
#: Images whose slopes are computed together: what a core's cache holds. Twice as fast as all.
_PART = 200
#: What a chain of n joints is made of, and the shapes.
CHAIN_SHAPES: dict[str, tuple[int | str, ...]] = {
    "axes": ("n", 3),
    "points_m": ("n", 3),
    "feature_m": ("m",),
    "reference_rad": ("n",),
    "prismatic": ("n",),
    "lens": (2,),
    "play_rad": ("n",),
}
#: Largest error of a lens that is believed, of either number, and largest play, rad.
MOST_LENS, MOST_PLAY_RAD = 0.5, 0.2


def cross_matrix(vectors: np.ndarray) -> np.ndarray:
    """Matrices K with ``K u = v x u``, shape (..., 3, 3), of vectors v, shape (..., 3)."""
    return (vectors @ _CROSS).reshape(*vectors.shape, 3)


class Slopes(NamedTuple):
    """The feature at k joint vectors, m, (k, m), and its derivatives.

    ``by_joint``, (k, m, n), is the Jacobian, and ``by_twist``, (k, m, p), by p motions of parts of
    the chain; ``rotation``, (k, 3, 3), has turned what is carried since the reference joints.
    """

    feature_m: np.ndarray
    by_joint: np.ndarray
    by_twist: np.ndarray
    rotation: np.ndarray


@dataclass(frozen=True)
class SerialChain:
    """The axes of n joints and what they carry, in the camera's frame.

    A ``ValueError`` says that a shape is wrong, a number not finite or too large, or that an axis
    has no direction.
    """

    axes: np.ndarray  #: directions w of the axes at the reference joints, (n, 3); normalised here
    points_m: np.ndarray  #: a point q of each axis, m, (n, 3)
    #: The feature x0 at the reference joints, m, (m,): a point, then any directions.
    feature_m: np.ndarray
    reference_rad: np.ndarray  #: the reference joints r0, rad, of prismatic ones m, (n,)
    #: 1 for each prismatic joint, 0 for the others, (n,); by default all are revolute.
    prismatic: np.ndarray = None  # type: ignore[assignment]
    #: Error of the lens through which all of this was measured, (2,), as of
    #: :meth:`~fvs_ros.kinds.Kind.through_lens`; by default it is as good as declared.
    lens: np.ndarray = None  # type: ignore[assignment]
    on_arm: bool = False  #: whether the camera is on the arm, and x stands in the room
    #: Play between each motor, whose angle is reported, and its joint, rad (m), (n,).
    play_rad: np.ndarray = None  # type: ignore[assignment]
    #: The joint of each stage, from the camera on.
    order: np.ndarray = field(init=False, repr=False)
    #: Axes by which x moves: the other way round from a camera on the arm.
    _signed: np.ndarray = field(init=False, repr=False)
    #: T_i and T_i^2, with ``E_i(a) = 1 + sin(a) T_i + (1 - cos(a)) T_i^2``, or ``1 + a T_i`` of a
    #: prismatic joint, whose T_i^2 is zero; all transposed, for points in rows, by stages.
    _twists: np.ndarray = field(init=False, repr=False)
    _squares: np.ndarray = field(init=False, repr=False)
    #: Axes and points in homogeneous coordinates, (n, 2, 4), by stages.
    _lines: np.ndarray = field(init=False, repr=False)
    #: Point and directions in homogeneous coordinates, (m / 3, 4).
    _carried: np.ndarray = field(init=False, repr=False)
    _shifts: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        joints = len(self.reference_rad)
        for name, size in (("prismatic", joints), ("lens", 2), ("play_rad", joints)):
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.zeros(size))
        check_arrays(self, CHAIN_SHAPES)
        for name in CHAIN_SHAPES:
            if not plausible(getattr(self, name)):
                raise ValueError(f"{name} of a chain holds a number above {LARGEST:g} m")
        if np.abs(self.lens).max() > MOST_LENS:
            raise ValueError(f"a chain's lens errs by {self.lens.tolist()}")
        if (np.clip(self.play_rad, 0.0, MOST_PLAY_RAD) != self.play_rad).any():
            raise ValueError(f"a chain's joints have a play of {self.play_rad.tolist()} rad")
        if self.feature_m.size == 0 or self.feature_m.size % 3:
            raise ValueError(f"a chain carries {self.feature_m.size} numbers, expected 3, 6, ...")
        lengths = np.linalg.norm(self.axes, axis=1, keepdims=True)
        if lengths.min() < 1e-6:
            raise ValueError("an axis of a chain has no direction")
        self._keep("axes", self.axes / lengths)
        self._keep("order", np.arange(len(self.axes))[:: -1 if self.on_arm else 1])
        self._keep("_signed", -self.axes if self.on_arm else self.axes)
        axes, points_m = self._signed[self.order], self.points_m[self.order]
        twists = np.zeros((len(axes), 4, 4))
        self._keep("_shifts", np.flatnonzero(self.prismatic[self.order]))
        twists[:, :3, :3] = cross_matrix(axes)
        twists[:, :3, 3] = -(twists[:, :3, :3] @ points_m[:, :, None])[..., 0]
        twists[self._shifts, :3, :3], twists[self._shifts, :3, 3] = 0.0, axes[self._shifts]
        twists = np.ascontiguousarray(np.swapaxes(twists, 1, 2))
        self._keep("_twists", twists)
        self._keep("_squares", twists @ twists)
        lines = np.stack([axes, points_m], axis=1)
        self._keep("_lines", np.insert(lines, 3, [0.0, 1.0], axis=2))
        carried = np.insert(self.feature_m.reshape(-1, 3), 3, 0.0, axis=1)
        carried[0, 3] = 1.0
        self._keep("_carried", carried)

    def _keep(self, name: str, value: np.ndarray) -> None:
        value.setflags(write=False)
        object.__setattr__(self, name, value)

    @property
    def joints(self) -> int:
        """Count of joints, n."""
        return len(self.axes)

    @property
    def numbers(self) -> int:
        """Count of numbers of the feature, m."""
        return len(self.feature_m)

    def _transforms(self, joints_rad: np.ndarray) -> np.ndarray:
        """The motions E_i, transposed, shape (..., n, 4, 4), at joints, rad, shape (..., n)."""
        angle = (np.asarray(joints_rad, dtype=float) - self.reference_rad)[..., None, None]
        if self.on_arm:
            angle = angle[..., ::-1, :, :]
        sine = np.sin(angle)
        if self._shifts.size:
            sine[..., self._shifts, :, :] = angle[..., self._shifts, :, :]
        transforms = sine * self._twists
        transforms += (1.0 - np.cos(angle)) * self._squares
        transforms += _UNIT
        return transforms

    def position(self, joints_rad: np.ndarray) -> np.ndarray:
        """The feature, camera frame, m, shape (..., m), at joints, rad, shape (..., n)."""
        transforms = self._transforms(joints_rad)
        carried = self._carried
        for i in reversed(range(len(self._twists))):
            carried = carried @ transforms[..., i, :, :]
        return carried[..., :3].reshape(*carried.shape[:-2], -1)

    def motion(self, joints_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The feature, (..., m), and the twist of space by each joint, at joints, rad, (..., n).

        Angular velocities w per joint velocity, rad/rad, (..., n, 3), and velocities v of what is
        at the camera's origin, m/rad, (..., n, 3): a point p moves by ``v + w x p``.
        """
        stages = self._stages(self._transforms(joints_rad))
        lines = (self._lines @ stages[..., :-1, :, :])[..., :3]
        axes, points_m = lines[..., 0, :], lines[..., 1, :]
        linear_m = (cross_matrix(points_m) @ axes[..., None])[..., 0]
        if self._shifts.size:
            linear_m[..., self._shifts, :] = axes[..., self._shifts, :]
            axes[..., self._shifts, :] = 0.0
        if self.on_arm:
            axes, linear_m = axes[..., ::-1, :], linear_m[..., ::-1, :]
        feature = (self._carried @ stages[..., -1, :, :])[..., :3]
        return feature.reshape(*feature.shape[:-2], -1), axes, linear_m

    def _stages(self, transforms: np.ndarray) -> np.ndarray:
        """Motion of what is behind the first 0, 1, ... joints, transposed, (..., n + 1, 4, 4)."""
        joints = transforms.shape[-3]
        stages = np.empty((*transforms.shape[:-3], joints + 1, 4, 4))
        stages[..., 0, :, :] = _UNIT
        multiply = np.dot if transforms.ndim == 3 else np.matmul  # of one matrix: in half the time
        for i in range(joints):
            multiply(transforms[..., i, :, :], stages[..., i, :, :], out=stages[..., i + 1, :, :])
        return stages

    def position_and_jacobian(self, joints_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The feature, (..., m), and its Jacobian, (..., m, n), at joints, rad, (..., n)."""
        feature, angular, linear_m = self.motion(joints_rad)
        parts = feature.reshape(*feature.shape[:-1], -1, 3)
        is_point = self._carried[:, 3, None, None]
        moved = (
            angular[..., None, :, :] @ cross_matrix(parts) + is_point * linear_m[..., None, :, :]
        )
        jacobian = np.swapaxes(moved, -1, -2)
        return feature, jacobian.reshape(*feature.shape, len(self.axes))

    def jacobian(self, joints_rad: np.ndarray) -> np.ndarray:
        """The Jacobian, m/rad, shape (..., m, n), at joints, rad, shape (..., n)."""
        return self.position_and_jacobian(joints_rad)[1]

    def slopes(self, joints_rad: np.ndarray, twists: np.ndarray) -> Slopes:
        """The feature at joints, rad, (k, n), and its derivatives by all that a chain can change.

        By ``twists``, (n + 1, 6, p), of what is behind the first 0, 1, ..., n joints, as it stands
        at the reference joints: turns about the camera's origin, rad, and shifts, m.
        """
        images, joints = joints_rad.shape
        axes = np.zeros((joints + 1, 6, joints))
        at, shifts = np.arange(joints), self.prismatic[:, None] > 0.0
        axes[self.order, :3, at] = np.where(shifts, 0.0, self._signed)
        axes[self.order, 3:, at] = np.where(
            shifts, self._signed, np.cross(self.points_m, self._signed)
        )
        columns = np.concatenate([axes, twists], axis=2).reshape(6 * len(axes), -1)
        size = self.feature_m.size
        feature, slopes = np.empty((images, size)), np.empty((images, size, columns.shape[1]))
        rotation = np.empty((images, 3, 3))
        for first in range(0, images, _PART):
            part = slice(first, first + _PART)
            feature[part], by_twist, rotation[part] = self._slopes(joints_rad[part])
            np.matmul(by_twist, columns, out=slopes[part])
        return Slopes(feature, slopes[..., :joints], slopes[..., joints:], rotation)

    def _slopes(self, joints_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Feature, its derivatives by all twists, (k, m, 6 n + 6), and how it has been turned."""
        transforms, rows = self._transforms(joints_rad), len(self._carried)
        stages = self._stages(transforms)
        feature = (self._carried @ stages[:, -1])[..., :3]
        is_point, unit = self._carried[:, 3:], stages[:, :, None, :3, :3]
        # A turn about a unit vector f, a row of a stage, moves a point at a by f x a.
        arms = feature[:, None] - is_point * stages[:, :, 3:, :3]
        by_twist = np.empty((len(transforms), rows, 3, len(self.axes) + 1, 6))
        by_twist[..., :3] = np.transpose(unit @ cross_matrix(arms), (0, 2, 4, 1, 3))
        by_twist[..., 3:] = np.transpose(is_point[..., None] * unit, (0, 2, 4, 1, 3))
        size = len(transforms), 3 * rows
        return (
            feature.reshape(size),
            by_twist.reshape(*size, -1),
            np.swapaxes(stages[:, -1, :3, :3], 1, 2),
        )

    def weighted(self, weights: np.ndarray) -> SerialChain:
        """The chain that carries the numbers of this one times weights, (m,)."""
        return replace(self, feature_m=weights * self.feature_m)

    def anchored(self, joints_rad: np.ndarray, feature_m: np.ndarray) -> SerialChain:
        """The chain with another feature, (m,), m: one that is seen at joints, rad, (n,)."""
        seen = np.insert(feature_m.reshape(-1, 3), 3, self._carried[:, 3], axis=1)
        carried = np.linalg.solve(self.transform(joints_rad).T, seen.T).T
        return replace(self, feature_m=carried[:, :3].ravel())

    def transform(self, joints_rad: np.ndarray) -> np.ndarray:
        """Motion since the reference joints, transposed, (4, 4), at joints, rad, (n,)."""
        return self._stages(self._transforms(joints_rad))[-1]

    def moved(self, rotation: np.ndarray, translation_m: np.ndarray) -> SerialChain:
        """The chain as seen after ``x -> R x + t``: another camera pose, all else the same."""
        carried = self.feature_m.reshape(-1, 3) @ rotation.T
        carried[0] += translation_m
        axes, points_m = self.axes @ rotation.T, self.points_m @ rotation.T + translation_m
        return replace(self, axes=axes, points_m=points_m, feature_m=carried.ravel())
