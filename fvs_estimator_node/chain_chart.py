"""Local coordinates of serial chains, and the derivatives of the ball's position by them.

Each of the n axes has two coordinates that turn it and two that shift it; the latter do not move a
prismatic joint. Three more move the ball, and the last is the stamp offset of the images. An axis'
length and a shift along itself have no coordinate, because they do not change the chain.
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
        # The point of each axis that is closest to the ball keeps the coordinates small.
        out = chain.points_m - chain.ball_m
        self._points = chain.points_m - axes * np.sum(out * axes, axis=1, keepdims=True)
        self._axes, self._ball, self._reference = axes, chain.ball_m, chain.reference_rad
        self._prismatic = chain.prismatic
        count = self.basis.size // 3
        self.turns, self.shifts = slice(count), slice(count, 2 * count)
        self.of_ball = slice(2 * count, 2 * count + 3)
        self.size = 2 * count + 4

    def _along(self, values: np.ndarray) -> np.ndarray:
        return np.einsum("ij,ijk->ik", values.reshape(self.basis.shape[:2]), self.basis)

    def directions(self, values: np.ndarray) -> np.ndarray:
        """The axes before they are normalised, (n, 3)."""
        return self._axes + self._along(values[self.turns])

    def chain(self, values: np.ndarray) -> SerialChain:
        """The chain at coordinates; ValueError if it would not be a valid chain."""
        points = self._points + self._along(values[self.shifts])
        ball = self._ball + values[self.of_ball]
        return SerialChain(self.directions(values), points, ball, self._reference, self._prismatic)


def residuals_and_slopes(
    chart: Chart,
    values: np.ndarray,
    joints_rad: np.ndarray,
    velocity_rad_s: np.ndarray,
    ball_m: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Chain minus images, m, (k, 3), and the derivatives by the coordinates, (k, 3, size).

    Of k images: joints, rad, and their velocities, rad/s, (k, n), and the ball, m, (k, 3). Turning
    an axis about w_b through its point q takes ``E u`` to ``w_b x E u - E (w_b x u)``, u from q; a
    shift of it along w takes ``u + a w`` to ``a w_b x w``.
    """
    chain, lengths = chart.chain(values), np.linalg.norm(chart.directions(values), axis=1)
    axes, joints = chain.axes, joints_rad.shape[1]
    travel = joints_rad - chain.reference_rad
    angles = np.where(chain.prismatic, 0.0, travel)[..., None, None]
    shifts = np.where(chain.prismatic, travel, 0.0)[..., None] * axes
    k = cross_matrix(axes)
    turns = np.eye(3) + np.sin(angles) * k + (1.0 - np.cos(angles)) * (k @ k)
    point = np.broadcast_to(chain.ball_m, ball_m.shape)
    before_turn, after_turn = (np.empty((joints, *ball_m.shape)) for _ in range(2))
    for i in reversed(range(joints)):
        before_turn[i] = point - chain.points_m[i]
        after_turn[i] = _turned(turns[:, i], before_turn[i]) + shifts[:, i]
        point = chain.points_m[i] + after_turn[i]
    slope = np.empty((*ball_m.shape, chart.size))
    frame = np.broadcast_to(np.eye(3), (len(ball_m), 3, 3))
    velocity = np.zeros(ball_m.shape)
    for i in range(joints):
        basis, turn = chart.basis[i], turns[:, i]
        about = np.swapaxes(cross_matrix(np.cross(axes[i], basis) / lengths[i]), 1, 2)
        turned = np.stack(
            [after_turn[i] @ one - _turned(turn, before_turn[i] @ one) for one in about], axis=-1
        )
        at = slice(len(basis) * i, len(basis) * (i + 1))
        slope[:, :, chart.turns][:, :, at] = frame @ turned
        slope[:, :, chart.shifts][:, :, at] = frame @ (basis.T - turn @ basis.T)
        moves = axes[i] if chain.prismatic[i] else after_turn[i] @ k[i].T
        moves = velocity_rad_s[:, i, None] * moves
        velocity += _turned(frame, moves)
        frame = frame @ turn
    slope[:, :, chart.of_ball] = frame
    slope[:, :, OFFSET] = -velocity
    return point - ball_m, slope


def _turned(turns: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors, (k, 3), each turned by its own matrix, (k, 3, 3)."""
    return (turns @ vectors[..., None])[..., 0]
