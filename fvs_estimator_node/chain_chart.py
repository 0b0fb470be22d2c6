"""Local coordinates of serial chains, and what the ball's position does when they change.

Twelve turn the axes, twelve shift them, three move the ball; the 28th is how late the images are
stamped. Only what changes an axis counts: neither its length nor a shift along itself.
"""

from __future__ import annotations

import numpy as np

from fvs_ros.chain import SerialChain, cross_matrix
from fvs_ros.joints import N_JOINTS

#: Where the coordinates stand: axes, places, ball, and the offset of the stamps.
AXES, POINTS, BALL, OFFSET = slice(0, 12), slice(12, 24), slice(24, 27), 27
N_COORDINATES = 28


class Chart:
    """Coordinates about a chain, which lies at zero.

    Parameters
    ----------
    chain : SerialChain
        The chain.

    Attributes
    ----------
    basis : ndarray, shape (6, 2, 3)
        Two directions across each axis, in which it is turned and shifted.
    expected : ndarray, shape (28,)
        What the coordinates are for all one knows without data: axes next to the ball.
    """

    def __init__(self, chain: SerialChain) -> None:
        axes = chain.axes
        helper = np.eye(3)[np.abs(axes).argmin(axis=1)]
        first = np.cross(axes, helper)
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        self.basis = np.stack([first, np.cross(axes, first)], axis=1)
        # Of all points of an axis the one next to the ball: the chart's numbers stay small.
        out = chain.points_m - chain.ball_m
        self.points = chain.points_m - axes * np.sum(out * axes, axis=1, keepdims=True)
        self.axes, self.ball, self.reference = axes, chain.ball_m, chain.reference_rad
        self.expected = np.zeros(N_COORDINATES)
        self.expected[POINTS] = np.einsum("ijk,ik->ij", self.basis, self.ball - self.points).ravel()

    def directions(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unit axes (6, 3) and their lengths before (6,)."""
        axes = self.axes + np.einsum("ij,ijk->ik", values[AXES].reshape(6, 2), self.basis)
        lengths = np.linalg.norm(axes, axis=1)
        return axes / lengths[:, None], lengths

    def chain(self, values: np.ndarray) -> SerialChain:
        """The chain at coordinates, shape (27,) or more.

        Raises
        ------
        ValueError
            If they lead beyond all reason.
        """
        points = self.points + np.einsum("ij,ijk->ik", values[POINTS].reshape(6, 2), self.basis)
        return SerialChain(
            self.directions(values)[0], points, self.ball + values[BALL], self.reference
        )


def residuals_and_slopes(
    chart: Chart,
    values: np.ndarray,
    joints_rad: np.ndarray,
    velocity_rad_s: np.ndarray,
    ball_m: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Chain minus images, and the derivatives by the coordinates.

    Parameters
    ----------
    chart : Chart
        What the coordinates are of.
    values : ndarray, shape (28,)
        Coordinates.
    joints_rad, velocity_rad_s : ndarray, shape (n, 6)
        Joints when the images were taken, rad, and their velocities, rad/s.
    ball_m : ndarray, shape (n, 3)
        The ball in the images, m.

    Returns
    -------
    residuals_m : ndarray, shape (n, 3)
        m.
    slopes : ndarray, shape (n, 3, 28)
        m over rad, m and s.

    Raises
    ------
    ValueError
        If the coordinates lead beyond all reason.
    """
    chain = chart.chain(values)
    axes, lengths = chart.directions(values)
    n = len(joints_rad)
    angles = joints_rad - chain.reference_rad
    sine, cosine = np.sin(angles), np.cos(angles)
    k = cross_matrix(axes)
    turns = np.eye(3) + sine[..., None, None] * k + (1.0 - cosine)[..., None, None] * (k @ k)
    slope = np.empty((n, 3, N_COORDINATES))
    point = np.broadcast_to(chain.ball_m, (n, 3))
    moved = np.empty((N_JOINTS, n, 3))  # ball before axis i turns, from the axis' point
    for i in range(N_JOINTS - 1, -1, -1):
        moved[i] = point - chain.points_m[i]
        point = chain.points_m[i] + (turns[:, i] @ moved[i][..., None])[..., 0]
    before = np.broadcast_to(np.eye(3), (n, 3, 3))
    velocity = np.zeros((n, 3))
    for i in range(N_JOINTS):
        axis, u = axes[i], moved[i]
        basis = chart.basis[i]
        local = np.empty((n, 3, 5))
        for b in range(2):
            tilt = basis[b] - axis * (axis @ basis[b])
            local[:, :, b] = sine[:, i, None] * _cross(tilt, u) + (1.0 - cosine[:, i, None]) * (
                tilt * (u @ axis)[:, None] + axis * (u @ tilt)[:, None]
            )
            local[:, :, 2 + b] = basis[b] - turns[:, i] @ basis[b]
        local[:, :, :2] /= lengths[i]
        # the column of the Jacobian, of the ball after this axis has turned
        local[:, :, 4] = _cross(axis, (turns[:, i] @ u[..., None])[..., 0])
        seen = before @ local
        slope[:, :, AXES.start + 2 * i : AXES.start + 2 * i + 2] = seen[:, :, :2]
        slope[:, :, POINTS.start + 2 * i : POINTS.start + 2 * i + 2] = seen[:, :, 2:4]
        velocity += seen[:, :, 4] * velocity_rad_s[:, i, None]
        before = before @ turns[:, i]
    slope[:, :, BALL] = before
    slope[:, :, OFFSET] = -velocity
    return point - ball_m, slope


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products along the last axis, at a third of ``np.cross``'s cost for few vectors."""
    return a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]
