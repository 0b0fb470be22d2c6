"""Rotations: matrices, rotation vectors (axis times angle) and quaternions x, y, z, w."""

from __future__ import annotations

from math import acos, atan2, cos, sin

import numpy as np

from fvs_ros.chain import cross_matrix
from fvs_ros.vectors import length

_UNIT = np.eye(3)
#: Slack of a unit quaternion.
_QUATERNION_SLACK = 0.01


def nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """The rotation R of the largest ``tr(R' M)``, shape (3, 3)."""
    left, _, right = np.linalg.svd(matrix)
    left[:, 2] *= np.linalg.det(left @ right)  # -1 of a reflection
    return np.asarray(left @ right)


def rotation_angle_rad(rotation: np.ndarray) -> float:
    """Angle of a rotation matrix, rad."""
    return acos(min(1.0, max(-1.0, 0.5 * (float(np.trace(rotation)) - 1.0))))


def vector_from_rotation_rad(rotation: np.ndarray) -> np.ndarray:
    """Axis times angle, rad, shape (3,), of a rotation matrix; the angle is at most pi."""
    (_, a, b), (c, _, d), (e, f, _) = rotation.tolist()
    twice = np.array([f - d, b - e, c - a])  # 2 sin(angle) times the axis
    sine, cosine = 0.5 * length(twice), 0.5 * (float(np.trace(rotation)) - 1.0)
    angle_rad = atan2(sine, cosine)
    if cosine > -0.9:
        return twice * (0.5 * angle_rad / sine if sine > 1e-9 else 0.5)
    # Near half a turn the sine tells only the sign: R + R' = 2 cos + 2 (1 - cos) w w'.
    products = 0.5 * (rotation + rotation.T) - cosine * _UNIT
    axis = products[int(np.diagonal(products).argmax())]
    axis = axis / length(axis)
    return (angle_rad if axis.dot(twice) >= 0.0 else -angle_rad) * axis


def rotation_from_vector(vector_rad: np.ndarray) -> np.ndarray:
    """Rotation matrix, (3, 3), of axis times angle, rad, (3,): Rodrigues' formula."""
    angle_rad = length(vector_rad)
    k = cross_matrix(vector_rad / max(angle_rad, 1e-12))
    return np.asarray(_UNIT + sin(angle_rad) * k + (1.0 - cos(angle_rad)) * (k @ k))


def rotation_from_quaternion(quaternion_xyzw: np.ndarray) -> np.ndarray:
    """Rotation matrix, (3, 3), of a unit quaternion, (4,); a ``ValueError`` if it is none."""
    size = length(quaternion_xyzw)
    if not abs(size - 1.0) < _QUATERNION_SLACK:
        raise ValueError(f"is no pose, its quaternion no unit one: {quaternion_xyzw.tolist()}")
    quaternion_xyzw = quaternion_xyzw / size
    vector, w = quaternion_xyzw[:3], float(quaternion_xyzw[3])
    k = cross_matrix(vector)
    return np.asarray(_UNIT + 2.0 * w * k + 2.0 * (k @ k))


def quaternion_from_rotation(rotation: np.ndarray) -> np.ndarray:
    """Unit quaternion x, y, z, w, (4,), of a rotation matrix, (3, 3)."""
    vector_rad = vector_from_rotation_rad(rotation)
    half_rad = 0.5 * length(vector_rad)
    share = 0.5 if half_rad < 1e-9 else sin(half_rad) / (2.0 * half_rad)
    return np.append(share * vector_rad, cos(half_rad))
