"""Unit quaternions x, y, z, w, as ROS messages hold rotations."""

from __future__ import annotations

import numpy as np


def about(axis: np.ndarray, angle_rad: float) -> np.ndarray:
    """The rotation about a unit axis, shape (3,), by an angle, rad; shape (4,)."""
    return np.append(np.sin(0.5 * angle_rad) * axis, np.cos(0.5 * angle_rad))


def quaternion_of(rotation: np.ndarray) -> np.ndarray:
    """The quaternion, shape (4,), w not negative, of a rotation matrix, shape (3, 3).

    As an eigenvector (Bar-Itzhack, 2000), which loses no digits at any angle.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation
    symmetric = np.array(
        [
            [xx - yy - zz, xy + yx, xz + zx, zy - yz],
            [xy + yx, yy - xx - zz, yz + zy, xz - zx],
            [xz + zx, yz + zy, zz - xx - yy, yx - xy],
            [zy - yz, xz - zx, yx - xy, xx + yy + zz],
        ]
    )
    quaternion = np.linalg.eigh(symmetric)[1][:, -1]
    return quaternion if quaternion[3] >= 0.0 else -quaternion


def rotation_of(quaternion_xyzw: np.ndarray) -> np.ndarray:
    """The rotation matrix, shape (3, 3), of a unit quaternion, shape (4,)."""
    x, y, z, w = quaternion_xyzw
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def product(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """First the right rotation, then the left one; shape (4,) each."""
    (ax, ay, az, aw), (bx, by, bz, bw) = left, right
    return np.array(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ]
    )
