"""Local coordinates of serial chains, and the derivatives of the feature by them.

Each of the n axes has two coordinates that turn it and two that shift it; the latter do not move a
prismatic joint. The m numbers of the feature follow, and the last is the stamp offset of the
images. An axis' length and a shift along itself have no coordinate, because they do not change the
chain.
"""

from __future__ import annotations

import numpy as np

from fvs_ros.chain import SerialChain, cross_matrix

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
        self._axes, self._feature, self._reference = axes, chain.feature_m, chain.reference_rad
        self._prismatic = chain.prismatic
        count = self.basis.size // 3
        self.turns, self.shifts = slice(count), slice(count, 2 * count)
        self.size = 2 * count + chain.feature_m.size + 1
        self.of_feature = slice(2 * count, self.size - 1)

    def _along(self, values: np.ndarray) -> np.ndarray:
        return np.einsum("ij,ijk->ik", values.reshape(self.basis.shape[:2]), self.basis)

    def directions(self, values: np.ndarray) -> np.ndarray:
        """The axes before they are normalised, (n, 3)."""
        return self._axes + self._along(values[self.turns])

    def chain(self, values: np.ndarray) -> SerialChain:
        """The chain at coordinates; ValueError if it would not be a valid chain."""
        points = self._points + self._along(values[self.shifts])
        feature = self._feature + values[self.of_feature]
        axes = self.directions(values)
        return SerialChain(axes, points, feature, self._reference, self._prismatic)


def residuals_and_slopes(
    chart: Chart,
    values: np.ndarray,
    joints_rad: np.ndarray,
    velocity_rad_s: np.ndarray,
    feature_m: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Chain minus images, m, (k, m), and the derivatives by the coordinates, (k, m, size).

    Of k images: joints, rad, and their velocities, rad/s, (k, n), and the feature, m, (k, m).
    Turning an axis about w_b through its point q takes ``E u`` to ``w_b x E u - E (w_b x u)``, u
    from q; a shift of it along w takes ``u + a w`` to ``a w_b x w``. Directions are not shifted.
    """
    chain, lengths = chart.chain(values), np.linalg.norm(chart.directions(values), axis=1)
    axes, (images, joints) = chain.axes, joints_rad.shape
    travel = joints_rad - chain.reference_rad
    angles = np.where(chain.prismatic, 0.0, travel)[..., None, None]
    shifts = np.where(chain.prismatic, travel, 0.0)[..., None] * axes
    k = cross_matrix(axes)
    turns = np.eye(3) + np.sin(angles) * k + (1.0 - np.cos(angles)) * (k @ k)
    carried = chain.feature_m.reshape(-1, 3)
    rows = len(carried)
    is_point = np.eye(rows)[:1].T  # the first row is the point
    now = np.broadcast_to(carried, (images, rows, 3))
    before_turn, after_turn = (np.empty((joints, images, rows, 3)) for _ in range(2))
    for i in reversed(range(joints)):
        before_turn[i] = now - is_point * chain.points_m[i]
        after_turn[i] = before_turn[i] @ np.swapaxes(turns[:, i], 1, 2)
        after_turn[i] += is_point * shifts[:, None, i]
        now = is_point * chain.points_m[i] + after_turn[i]
    slope = np.zeros((images, rows, 3, chart.size))
    frame = np.broadcast_to(np.eye(3), (images, 3, 3))
    velocity = np.zeros((images, rows, 3))
    for i in range(joints):
        basis, turn = chart.basis[i], turns[:, i]
        at = slice(len(basis) * i, len(basis) * (i + 1))
        about = np.swapaxes(cross_matrix(np.cross(axes[i], basis) / lengths[i]), 1, 2)
        back = np.swapaxes(frame, 1, 2)
        turned = [
            (after_turn[i] @ one - before_turn[i] @ one @ np.swapaxes(turn, 1, 2)) @ back
            for one in about
        ]
        slope[..., chart.turns][..., at] = np.stack(turned, axis=-1)
        slope[:, 0, :, chart.shifts][..., at] = frame @ (basis.T - turn @ basis.T)
        moves = is_point * axes[i] if chain.prismatic[i] else after_turn[i] @ k[i].T
        velocity += (velocity_rad_s[:, i, None, None] * moves) @ back
        frame = frame @ turn
    for row in range(rows):
        slope[:, row, :, chart.of_feature][..., 3 * row : 3 * row + 3] = frame
    slope[..., OFFSET] = -velocity
    residual = now.reshape(images, -1) - feature_m
    return residual, slope.reshape(*residual.shape, chart.size)
