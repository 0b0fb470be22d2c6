"""Local coordinates of serial chains, and the derivatives of the feature by them.

Each of the n axes has two coordinates that turn it and two that shift it; the latter do not move a
prismatic joint. The m numbers of the feature follow, and the last is the stamp offset of the
images. An axis' length and a shift along itself have no coordinate, because they do not change the
chain.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fvs_ros.chain import SerialChain

#: Place of the offset of the stamps among the coordinates: the last.
OFFSET = -1


class Chart:
    """Coordinates about a chain, which lies at zero.

    ``basis`` holds two directions across each axis, (n, 2, 3), in which it is turned and shifted.
    """

    def __init__(self, chain: SerialChain) -> None:
        axes = chain.axes
        helper = np.eye(3)[np.abs(axes).argmin(axis=1)]
        first = np.cross(axes, helper)
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        self.basis = np.stack([first, np.cross(axes, first)], axis=1)
        # The point of each axis that is closest to the feature keeps the coordinates small.
        out = chain.points_m - chain.feature_m[:3]
        self._points = chain.points_m - axes * np.sum(out * axes, axis=1, keepdims=True)
        self._chain, count = chain, self.basis.size // 3
        self.turns, self.shifts = slice(count), slice(count, 2 * count)
        self.size = 2 * count + chain.feature_m.size + 1
        self.of_feature = slice(2 * count, self.size - 1)

    def _along(self, values: np.ndarray) -> np.ndarray:
        return np.einsum("ij,ijk->ik", values.reshape(self.basis.shape[:2]), self.basis)

    def directions(self, values: np.ndarray) -> np.ndarray:
        """The axes before they are normalised, (n, 3)."""
        return self._chain.axes + self._along(values[self.turns])

    def chain(self, values: np.ndarray) -> SerialChain:
        """The chain at coordinates; ValueError if it would not be a valid chain."""
        axes, points_m = self.directions(values), self._points + self._along(values[self.shifts])
        feature_m = self._chain.feature_m + values[self.of_feature]
        return replace(self._chain, axes=axes, points_m=points_m, feature_m=feature_m)


def residuals_and_slopes(
    chart: Chart,
    values: np.ndarray,
    joints_rad: np.ndarray,
    velocity_rad_s: np.ndarray,
    feature_m: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Chain minus images, m, (k, m), and the derivatives by the coordinates, (k, m, size).

    Of k images: joints, rad, and their velocities, rad/s, (k, n), and the feature, m, (k, m).
    An axis that is turned or shifted moves what is behind its joint, and what is behind the next
    by the opposite.
    """
    chain, lengths = chart.chain(values), np.linalg.norm(chart.directions(values), axis=1)
    basis, joints = chart.basis, np.arange(len(lengths))
    turns = np.cross(chain.axes[:, None], basis) / lengths[:, None, None]
    twists = np.zeros((len(joints) + 1, 2, *basis.shape[:2], 6))  # of the turns, then the shifts
    twists[chain.order, 0, joints, :, :3] = turns
    twists[chain.order, 0, joints, :, 3:] = np.cross(chain.points_m[:, None], turns)
    twists[chain.order, 1, joints, :, 3:] = basis
    twists[1:] -= twists[:-1].copy()
    parts = chain.slopes(joints_rad, np.moveaxis(twists, -1, 1).reshape(len(twists), 6, -1))
    slope = np.zeros((*feature_m.shape, chart.size))
    slope[..., : parts.by_twist.shape[2]] = parts.by_twist
    for first in range(0, feature_m.shape[1], 3):
        row = slice(first, first + 3)
        slope[:, row, chart.of_feature][..., row] = parts.rotation
    slope[..., OFFSET] = -np.einsum("kmi,ki->km", parts.by_joint, velocity_rad_s)
    return parts.feature_m - feature_m, slope
