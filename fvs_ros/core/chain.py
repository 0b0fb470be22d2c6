"""A serial chain of revolute joints that carries the ball, seen from the camera.

Product of exponentials: with axis i a line through ``q_i`` along the unit vector ``w_i``,

    x(r) = E_1(r_1 - r0_1) E_2(r_2 - r0_2) ... E_6(r_6 - r0_6) x0,

where ``E_i(angle)`` turns space about axis i. Axes and ball are those of the reference joints
``r0``, in the camera's frame: no other frame, and no length or angle of the robot, is needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fvs_ros.core.joints import N_JOINTS

_IDENTITY = np.eye(4)
_LARGEST_M = 100.0


def cross_matrix(vectors: np.ndarray) -> np.ndarray:
    """Matrices K with ``K u = v x u``, shape (..., 3, 3), of vectors v, shape (..., 3)."""
    vectors = np.asarray(vectors, dtype=float)
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


@dataclass(frozen=True)
class SerialChain:
    """Six axes and a ball.

    Parameters
    ----------
    axes : ndarray, shape (6, 3)
        Directions w of the axes at the reference joints, camera frame; normalised here.
    points_m : ndarray, shape (6, 3)
        A point q of each axis, camera frame, m.
    ball_m : ndarray, shape (3,)
        The ball x0 at the reference joints, camera frame, m.
    reference_rad : ndarray, shape (6,)
        The reference joints r0, rad.

    Raises
    ------
    ValueError
        If a shape is wrong, a number is not finite or beyond all reason, or an axis has no
        direction.
    """

    axes: np.ndarray
    points_m: np.ndarray
    ball_m: np.ndarray
    reference_rad: np.ndarray

    def __post_init__(self) -> None:
        wanted = {
            "axes": (N_JOINTS, 3),
            "points_m": (N_JOINTS, 3),
            "ball_m": (3,),
            "reference_rad": (N_JOINTS,),
        }
        for name, shape in wanted.items():
            value = np.array(getattr(self, name), dtype=float)
            if value.shape != shape:
                raise ValueError(f"{name} of a chain has shape {value.shape}, expected {shape}")
            if not float(np.abs(value).max()) <= _LARGEST_M:  # false for NaN, too
                raise ValueError(f"{name} of a chain must be finite and below {_LARGEST_M:g}")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        lengths = np.linalg.norm(self.axes, axis=1, keepdims=True)
        if lengths.min() < 1e-6:
            raise ValueError("an axis of a chain has no direction")
        axes = self.axes / lengths
        turn = cross_matrix(axes)
        turns = np.zeros((2, N_JOINTS, 4, 4))
        turns[0, :, :3, :3], turns[1, :, :3, :3] = turn, turn @ turn
        turns[:, :, :3, 3] = -(turns[:, :, :3, :3] @ self.points_m[:, :, None])[..., 0]
        tips = np.zeros((N_JOINTS, 4, 2))
        tips[:, :3, 0], tips[:, :3, 1], tips[:, 3, 1] = axes, self.points_m, 1.0
        for name, value in (("axes", axes), ("_turns", turns), ("_tips", tips)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def turned(self, joints_rad: np.ndarray) -> np.ndarray:
        """The turns E_i, shape (..., 6, 4, 4), at joints, rad, shape (..., 6)."""
        angle = (np.asarray(joints_rad, dtype=float) - self.reference_rad)[..., None, None]
        first, second = self._turns  # type: ignore[attr-defined]
        return _IDENTITY + np.sin(angle) * first + (1.0 - np.cos(angle)) * second

    def position(self, joints_rad: np.ndarray) -> np.ndarray:
        """The ball's position, camera frame, m, shape (..., 3), at joints, rad, shape (..., 6)."""
        turns = self.turned(joints_rad)
        point = np.append(self.ball_m, 1.0)[:, None]
        for i in range(N_JOINTS - 1, -1, -1):
            point = turns[..., i, :, :] @ point
        return point[..., :3, 0]

    def position_and_jacobian(self, joints_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The ball's position and its Jacobian ``w_i x (x - q_i)``, column i for joint i.

        Parameters
        ----------
        joints_rad : ndarray, shape (..., 6)
            Joint positions, rad.

        Returns
        -------
        position_m : ndarray, shape (..., 3)
            m.
        jacobian : ndarray, shape (..., 3, 6)
            m/rad.
        """
        turns = self.turned(joints_rad)
        before = turns[..., 0, :, :]
        tips = np.empty((*before.shape[:-2], N_JOINTS, 4, 2))
        tips[..., 0, :, :] = self._tips[0]  # type: ignore[attr-defined]
        for i in range(1, N_JOINTS):
            tips[..., i, :, :] = before @ self._tips[i]  # type: ignore[attr-defined]
            before = before @ turns[..., i, :, :]
        position = (before @ np.append(self.ball_m, 1.0))[..., :3]
        axes, points = tips[..., :3, 0], tips[..., :3, 1]
        columns = cross(axes, position[..., None, :] - points)
        return position, np.swapaxes(columns, -1, -2)

    def jacobian(self, joints_rad: np.ndarray) -> np.ndarray:
        """The Jacobian, m/rad, shape (..., 3, 6), at joints, rad, shape (..., 6)."""
        return self.position_and_jacobian(joints_rad)[1]

    def moved(self, rotation: np.ndarray, translation_m: np.ndarray) -> SerialChain:
        """The chain as seen after ``x -> R x + t``: another camera pose, all else the same.

        Parameters
        ----------
        rotation : ndarray, shape (3, 3)
            R.
        translation_m : ndarray, shape (3,)
            t, m.
        """
        return SerialChain(
            self.axes @ rotation.T,
            self.points_m @ rotation.T + translation_m,
            rotation @ self.ball_m + translation_m,
            self.reference_rad,
        )


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products along the last axis, at a third of ``np.cross``'s cost for few vectors."""
    return a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]
