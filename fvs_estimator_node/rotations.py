"""Rotation matrices: the nearest one to a matrix, and how far one turns."""

from __future__ import annotations

import math

import numpy as np


def nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """The rotation R of the largest ``tr(R' M)``, shape (3, 3)."""
    left, _, right = np.linalg.svd(matrix)
    rotation = left @ right
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    if a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) < 0.0:  # a reflection
        left[:, 2] *= -1.0
        rotation = left @ right
    return rotation


def rotation_angle_rad(rotation: np.ndarray) -> float:
    """Angle of a rotation matrix, rad."""
    return math.acos(min(1.0, max(-1.0, 0.5 * (float(np.trace(rotation)) - 1.0))))
