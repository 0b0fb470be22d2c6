"""Where the fit of a chain begins: the joints at any time, and axes from a cubic regression.

About the mean joints ``dx/dr_i = J_i`` and ``d2x/dr_i dr_j = w_i x J_j`` for j >= i, which is
linear in the axes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from fvs_estimator_node.files import DataSet
from fvs_ros.chain import SerialChain, cross_matrix

#: Largest stamp offset in the search, late or early, s; the ends of each run are cut by it.
MAX_OFFSET_S = 0.2
#: Fewest images of a run.
LEAST_RUN = 5
#: A joint with a smaller standard deviation, rad, is at rest: its axis is unknown.
STILL_RAD = 1e-3
#: A prismatic joint moves the ball by its own travel, within this share, and turns the slopes of
#: the joints from it on by less than this per unit of travel, rad.
_SHIFTS, _TURNS = 0.1, 0.3
#: Prior deviation of a derivative of the position, of any order, m.
_REACH_M = 1.0
#: Passes of the robust regression.
_PASSES = 6
#: Largest number of images in a fit, and size of the blocks they are taken in: more images change
#: the Jacobian by less than its deviation.
_MOST_SAMPLES, _BLOCK = 6000, 50


class Path:
    """Joints at any time of each continuous run, from those at the exposures.

    ``indices`` are the images that are fitted, in blocks where there are too many, ``stamps_s``
    their stamps, s, both of shape (k,). Of still poses every image counts, whenever it was exposed.
    """

    def __init__(self, data: DataSet) -> None:
        stamps = data.stamps_s
        inside, splines = [np.arange(len(data) if data.still else 0)], []
        for run in () if data.still else data.runs():
            time_s = stamps[run]
            early, late = time_s[0] + MAX_OFFSET_S, time_s[-1] - MAX_OFFSET_S
            fitted = run.start + np.flatnonzero((time_s >= early) & (time_s <= late))
            if len(time_s) >= LEAST_RUN and len(fitted):
                inside.append(fitted)
                splines.append((run, CubicSpline(time_s, data.joints_rad[run])))
        self.indices = _thinned(np.concatenate(inside))
        self.stamps_s, self._joints = stamps[self.indices], data.joints_rad[self.indices]
        self._splines: list[tuple[slice, Any]] = [
            (slice(*np.searchsorted(self.indices, [run.start, run.stop])), spline)
            for run, spline in splines
        ]

    def joints_and_velocities(self, offset_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Joints and their velocities at the stamps minus an offset, (k, n) each."""
        joints, velocity = self._joints.copy(), np.zeros_like(self._joints)
        for places, spline in self._splines:
            time_s = self.stamps_s[places] - offset_s
            joints[places], velocity[places] = spline(time_s), spline(time_s, 1)
        return joints, velocity


def _thinned(indices: np.ndarray) -> np.ndarray:
    """Blocks of neighbours, evenly spread over all, no more than are worth their time."""
    if len(indices) <= _MOST_SAMPLES:
        return indices
    starts = np.linspace(0, len(indices) - _BLOCK, _MOST_SAMPLES // _BLOCK).astype(int)
    return indices[(starts[:, None] + np.arange(_BLOCK)).ravel()]


@dataclass(frozen=True)
class Regression:
    """A polynomial of n joints through the positions, about some joints.

    With images stamped late by an offset, s: value, first and second derivatives, m and rad,
    shapes (m,), (m, n) and (m, n, n), and the distance of a typical image, m.
    """

    offset_s: float
    position_m: np.ndarray
    slopes: np.ndarray
    bends: np.ndarray
    distance_m: float


def regress(
    offset_s: float, joints_rad: np.ndarray, reference_rad: np.ndarray, feature_m: np.ndarray
) -> Regression:
    """The feature, m, (k, m), as a cubic function of the joints, rad, (k, n), robustly."""
    d = joints_rad - reference_rad
    n = d.shape[1]
    moving = np.flatnonzero(d.std(axis=0) > STILL_RAD)
    terms = [term for degree in range(4) for term in combinations_with_replacement(moving, degree)]
    design = np.stack([np.prod(d[:, list(term)], axis=1) for term in terms], axis=1)
    scale = np.sqrt(np.mean(design**2, axis=0))
    design /= scale
    weight, typical_m = np.ones(len(d)), _REACH_M * float(np.median(scale[1:]))
    for _ in range(_PASSES):
        rows = design * weight[:, None]
        # No derivative is above the arm's reach: where joints moved alike, others would fit, too.
        gram = rows.T @ rows + np.diag((typical_m / (_REACH_M * scale)) ** 2)
        solution = np.linalg.solve(gram, rows.T @ (feature_m * weight[:, None]))
        distance = np.linalg.norm(feature_m - design @ solution, axis=1)
        typical_m = max(float(np.median(distance)), 1e-6)
        weight = np.minimum(1.0, 2.0 * typical_m / np.maximum(distance, 1e-12)) ** 0.5
    solution = solution / scale[:, None]
    m = feature_m.shape[1]
    slopes, bends = np.zeros((m, n)), np.zeros((m, n, n))
    for term, value in zip(terms, solution, strict=True):
        if len(term) == 1:
            slopes[:, term[0]] = value
        elif len(term) == 2:
            i, j = term
            bends[:, i, j] = bends[:, j, i] = value * (2.0 if i == j else 1.0)
    return Regression(offset_s, solution[0], slopes, bends, typical_m)


def first_guess(regression: Regression, reference_rad: np.ndarray) -> SerialChain:
    """Axes from slopes J_i and bends ``w_i x J_j``, and from slopes ``w_i x d`` of directions d.

    A prismatic joint has a slope of length 1 and no bends.
    """
    slopes, bends, point_m = regression.slopes[:3], regression.bends[:3], regression.position_m[:3]
    directions = -cross_matrix(regression.position_m[3:].reshape(-1, 3)).reshape(-1, 3)
    axes, prismatic = np.empty_like(slopes.T), np.zeros(slopes.shape[1])
    for i in range(len(axes)):
        # w x J_j = bend  <=>  -[J_j]x w = bend, for all joints from i on
        rows = np.vstack([-cross_matrix(slopes[:, i:].T).reshape(-1, 3), directions])
        wanted = np.append(bends[:, i, i:].T.reshape(-1), regression.slopes[3:, i])
        axis = np.linalg.lstsq(rows, wanted, rcond=1e-3)[0]
        length = float(np.linalg.norm(axis))
        axes[i] = axis / length if length > 1e-6 else np.eye(3)[0]  # unknown: any
        shift = float(np.linalg.norm(slopes[:, i]))
        if length < _TURNS and abs(shift - 1.0) < _SHIFTS:
            axes[i], prismatic[i] = slopes[:, i], 1.0
    points = point_m - np.cross(slopes.T, axes)
    return SerialChain(axes, points, regression.position_m, reference_rad, prismatic)


def other_starts(chain: SerialChain, rank: int) -> Iterator[SerialChain]:
    """The chain with one axis mistaken in the likely ways; ``rank`` counts from weak joints.

    The axis lies on the ball's other side: the same slope, the opposite bend. Or the joint is
    prismatic: the same slope, no bend. The directions of a pose leave no doubt.
    """
    if chain.feature_m.size > 3:
        return
    slopes = chain.jacobian(chain.reference_rad)
    moves_m = np.linalg.norm(slopes, axis=0)
    joint = np.argsort(moves_m)[rank % len(moves_m)]
    if chain.prismatic[joint]:
        return
    axes, points = chain.axes.copy(), chain.points_m.copy()
    axes[joint] *= -1.0
    points[joint] = 2.0 * chain.feature_m - points[joint]
    yield replace(chain, axes=axes, points_m=points)
    if abs(moves_m[joint] - 1.0) < _SHIFTS:
        axes, prismatic = chain.axes.copy(), chain.prismatic.copy()
        axes[joint], prismatic[joint] = slopes[:, joint], 1.0
        yield replace(chain, axes=axes, prismatic=prismatic)
