"""Where the fit of a chain begins: axes from a cubic regression of the positions.

About the mean joints ``dx/dr_i = J_i`` and ``d2x/dr_i dr_j = w_i x J_j`` for j >= i, which is
linear in the axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from fvs_ros.chain import SerialChain, cross_matrix

#: A joint that moves less, a standard deviation, rad, stands still: nothing is known of it.
STILL_RAD = 1e-3
#: Passes of a robust regression.
_PASSES = 6
#: A joint that moves the ball less says little about its axis, m/rad.
_WEAK_M_RAD = 0.03


@dataclass(frozen=True)
class Regression:
    """A polynomial of the joints through the positions, about the mean joints.

    Parameters
    ----------
    offset_s : float
        How late images are stamped by assumption, s.
    position_m, slopes, bends : ndarray, shapes (3,), (3, n) and (3, n, n)
        Value, first and second derivatives, m and rad.
    distance_m : float
        Distance of a typical image from it, m.
    """

    offset_s: float
    position_m: np.ndarray
    slopes: np.ndarray
    bends: np.ndarray
    distance_m: float


def regress(
    offset_s: float, joints_rad: np.ndarray, reference_rad: np.ndarray, ball_m: np.ndarray
) -> Regression:
    """Positions, m, (k, 3), as a cubic function of the joints, rad, (k, n), robustly."""
    d = joints_rad - reference_rad
    n = d.shape[1]
    moving = np.flatnonzero(d.std(axis=0) > STILL_RAD)
    terms = [term for degree in range(4) for term in combinations_with_replacement(moving, degree)]
    design = np.stack([np.prod(d[:, list(term)], axis=1) for term in terms], axis=1)
    scale = np.sqrt(np.mean(design**2, axis=0))
    design /= scale
    weight = np.ones(len(d))
    for _ in range(_PASSES):
        rows = design * weight[:, None]
        gram = rows.T @ rows + 1e-6 * len(d) * np.eye(len(terms))
        solution = np.linalg.solve(gram, rows.T @ (ball_m * weight[:, None]))
        distance = np.linalg.norm(ball_m - design @ solution, axis=1)
        typical_m = max(float(np.median(distance)), 1e-6)
        weight = np.minimum(1.0, 2.0 * typical_m / np.maximum(distance, 1e-12)) ** 0.5
    solution = solution / scale[:, None]
    slopes, bends = np.zeros((3, n)), np.zeros((3, n, n))
    for term, value in zip(terms, solution, strict=True):
        if len(term) == 1:
            slopes[:, term[0]] = value
        elif len(term) == 2:
            i, j = term
            bends[:, i, j] = bends[:, j, i] = value * (2.0 if i == j else 1.0)
    return Regression(offset_s, solution[0], slopes, bends, typical_m)


def first_guess(
    regression: Regression,
    reference_rad: np.ndarray,
    rng: np.random.Generator,
    attempt: int,
) -> SerialChain:
    """Axes from slopes J_i and bends ``w_i x J_j``; after the first attempt with some chance."""
    position_m, slopes, bends = regression.position_m, regression.slopes, regression.bends
    n = slopes.shape[1]
    axes, points = np.empty((n, 3)), np.empty((n, 3))
    lever = np.linalg.norm(slopes, axis=0)
    for i in range(n):
        column = slopes[:, i]
        # w x J_j = bend  <=>  -[J_j]x w = bend, for all joints from i on
        rows = -cross_matrix(slopes[:, i:].T).reshape(-1, 3)
        wanted = bends[:, i, i:].T.reshape(-1)
        axis = np.linalg.lstsq(rows, wanted, rcond=1e-3)[0]
        if lever[i] > _WEAK_M_RAD:
            axis -= column * (axis @ column) / lever[i] ** 2
        spread = 0.0 if attempt == 0 else (0.3 if lever[i] > _WEAK_M_RAD else 3.0)
        length = float(np.linalg.norm(axis))
        axis = axis / length if length > 1e-6 else rng.normal(size=3)
        axis = axis + spread * rng.normal(size=3)
        axes[i] = axis / np.linalg.norm(axis)
        points[i] = position_m - np.cross(column, axes[i])
    return SerialChain(axes, points, position_m, reference_rad)


def turned_about(chain: SerialChain, rank: int) -> SerialChain:
    """The chain with one axis on the ball's other side: the same slope, the opposite bend.

    That is the error easily made, first with the joints that move the ball least.
    """
    lever_m = np.linalg.norm(chain.jacobian(chain.reference_rad), axis=0)
    joint = np.argsort(lever_m)[rank % len(lever_m)]
    axes, points = chain.axes.copy(), chain.points_m.copy()
    axes[joint] *= -1.0
    points[joint] = 2.0 * chain.ball_m - points[joint]
    return SerialChain(axes, points, chain.ball_m, chain.reference_rad)
