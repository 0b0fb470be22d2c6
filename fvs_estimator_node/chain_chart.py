"""Local coordinates of serial chains, and what the ball's position does when they change.

Two for each of n axes turn it, two shift it, three move the ball; the last is how late the images
are stamped. Only what changes an axis counts: neither its length nor a shift along itself.
"""

from __future__ import annotations

import numpy as np

from fvs_ros.chain import SerialChain, cross_matrix

#: Directions in which an axis is turned and shifted.
_ACROSS = 2
#: Place of the offset of the stamps among the coordinates: the last.
OFFSET = -1


def each_coordinate(joints: int, axis: float, point: float, ball: float, offset: float):
    """A number for each coordinate of a chain, shape (4 joints + 4,), by what it changes."""
    return np.repeat([axis, point, ball, offset], [_ACROSS * joints, _ACROSS * joints, 3, 1])


class Chart:
    """Coordinates about a chain, which lies at zero.

    Parameters
    ----------
    chain : SerialChain
        The chain.

    Attributes
    ----------
    size : int
        Number of coordinates.
    basis : ndarray, shape (n, 2, 3)
        Two directions across each axis, in which it is turned and shifted.
    expected : ndarray, shape (size,)
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
        count = _ACROSS * len(axes)
        self.turns, self.shifts = slice(count), slice(count, 2 * count)
        self.of_ball = slice(2 * count, 2 * count + 3)
        self.size = 2 * count + 4
        self.expected = np.zeros(self.size)
        self.expected[self.shifts] = np.einsum(
            "ijk,ik->ij", self.basis, self.ball - self.points
        ).ravel()

    def directions(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unit axes (n, 3) and their lengths before (n,)."""
        axes = self.axes + np.einsum(
            "ij,ijk->ik", values[self.turns].reshape(-1, _ACROSS), self.basis
        )
        lengths = np.linalg.norm(axes, axis=1)
        return axes / lengths[:, None], lengths

    def chain(self, values: np.ndarray) -> SerialChain:
        """The chain at coordinates, shape (size - 1,) or more.

        Raises
        ------
        ValueError
            If they lead beyond all reason.
        """
        shifts = values[self.shifts].reshape(-1, _ACROSS)
        points = self.points + np.einsum("ij,ijk->ik", shifts, self.basis)
        return SerialChain(
            self.directions(values)[0], points, self.ball + values[self.of_ball], self.reference
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
    values : ndarray, shape (size,)
        Coordinates.
    joints_rad, velocity_rad_s : ndarray, shape (k, n)
        Joints when the images were taken, rad, and their velocities, rad/s.
    ball_m : ndarray, shape (k, 3)
        The ball in the images, m.

    Returns
    -------
    residuals_m : ndarray, shape (k, 3)
        m.
    slopes : ndarray, shape (k, 3, size)
        m over rad, m and s.

    Raises
    ------
    ValueError
        If the coordinates lead beyond all reason.
    """
    chain = chart.chain(values)
    axes, lengths = chart.directions(values)
    images, joints = joints_rad.shape
    angles = joints_rad - chain.reference_rad
    sine, cosine = np.sin(angles), np.cos(angles)
    k = cross_matrix(axes)
    turns = np.eye(3) + sine[..., None, None] * k + (1.0 - cosine)[..., None, None] * (k @ k)
    slope = np.empty((images, 3, chart.size))
    point = np.broadcast_to(chain.ball_m, (images, 3))
    moved = np.empty((joints, images, 3))  # ball before axis i turns, from the axis' point
    for i in reversed(range(joints)):
        moved[i] = point - chain.points_m[i]
        point = chain.points_m[i] + (turns[:, i] @ moved[i][..., None])[..., 0]
    before = np.broadcast_to(np.eye(3), (images, 3, 3))
    velocity = np.zeros((images, 3))
    for i in range(joints):
        axis, u = axes[i], moved[i]
        basis = chart.basis[i]
        local = np.empty((images, 3, 2 * _ACROSS + 1))
        for b in range(_ACROSS):
            tilt = basis[b] - axis * (axis @ basis[b])
            local[:, :, b] = sine[:, i, None] * _cross(tilt, u) + (1.0 - cosine[:, i, None]) * (
                tilt * (u @ axis)[:, None] + axis * (u @ tilt)[:, None]
            )
            local[:, :, _ACROSS + b] = basis[b] - turns[:, i] @ basis[b]
        local[:, :, :_ACROSS] /= lengths[i]
        # the column of the Jacobian, of the ball after this axis has turned
        local[:, :, -1] = _cross(axis, (turns[:, i] @ u[..., None])[..., 0])
        seen = before @ local
        at = slice(_ACROSS * i, _ACROSS * (i + 1))
        slope[:, :, chart.turns][:, :, at] = seen[:, :, :_ACROSS]
        slope[:, :, chart.shifts][:, :, at] = seen[:, :, _ACROSS:-1]
        velocity += seen[:, :, -1] * velocity_rad_s[:, i, None]
        before = before @ turns[:, i]
    slope[:, :, chart.of_ball] = before
    slope[:, :, OFFSET] = -velocity
    return point - ball_m, slope


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products along the last axis, at a third of ``np.cross``'s cost for few vectors."""
    return a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]
