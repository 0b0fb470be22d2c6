"""Fits a serial chain to a minute of ordinary motion.

The model of an image stamped t is ``x(r(t - tau)) + noise``. Its unknowns are the 4 n + m numbers
of a :class:`~fvs_ros.chain.SerialChain` of n joints (two for each axis' direction, two for its
place, m for the feature) and the stamp offset ``tau``. They are found by robust non-linear least
squares with exact derivatives.

The start comes from a cubic regression of the positions (:mod:`fvs_estimator_node.chain_start`) at
the best of several ``tau``. A joint that hardly moves the ball determines its axis poorly: the axis
may be found on the wrong side of the ball. So the other side is tried, until the residual is near
the images' noise, and once more for the weakest joint after the full fit. A joint that moves the
ball by its own travel may be prismatic: then it turns the motion of no joint behind it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from fvs_estimator_node.chain_chart import OFFSET, Chart, residuals_and_slopes
from fvs_estimator_node.chain_start import (
    MAX_OFFSET_S,
    Path,
    first_guess,
    other_starts,
    regress,
)
from fvs_estimator_node.files import DataSet
from fvs_ros.chain import SerialChain, cross_matrix
from fvs_ros.filter import OUTLIER
from fvs_ros.timeline import MAX_GAP_S
from fvs_ros.vectors import LARGEST, plausible

#: Fewest images that a chain is fitted to.
_MIN_SAMPLES = 200
#: Images, and offsets of the stamps, of the search for the right start.
_SEARCH_SAMPLES, _SEARCH_OFFSETS = 400, 13
#: Random starts for still poses, at least and at most; each is solved in so many charts of so many
#: evaluations. Seven of ten reach the best optimum.
_LEAST_STARTS, _MOST_STARTS, _CHARTS, _IN_A_CHART = 8, 30, 8, 15
#: First guess of their residuals, over the spread of the feature; costs of the same optimum differ
#: by less than this share, or this much, which is 0.4 % of the spread.
_ROUGH, _SAME, _SAME_COST = 0.1, 0.02, 1e-3
#: Above both limits, the second in m, a chain does not explain the motion. A camera's
#: own systematic errors stay below.
_MISFIT_LIMIT, _UNEXPLAINED_LIMIT_M = 1.3, 0.001
#: Least count of pairs of neighbouring images for a median.
_LEAST_PAIRS = 50
#: A start is right if its residual is below this multiple of the images' own.
_GOOD_SHARE = 1.2
#: Another start is better if it costs this share or less.
_BETTER = 0.9
#: Prior standard deviations, which hold coordinates that the data do not determine: rad, m, m/rad
#: for turns, shifts and slopes of the residuals by the joints; s for the offset.
_PRIOR, _OFFSET_PRIOR_S = 1.0, 0.1
#: Step of the derivatives of the Jacobian by the coordinates, rad and m.
_STEP = 1e-4


class ChainFitError(ValueError):
    """Data that no chain can be fitted to; the text says why."""


@dataclass(frozen=True)
class ChainFit:
    """A fitted chain, and how far it can be trusted.

    Parameters
    ----------
    chain : SerialChain
        The chain.
    weights : ndarray, shape (m,)
        Lengths, m, of the numbers that it carries: residuals are of the weighted numbers.
    time_offset_s, time_offset_deviation_s : float
        How late the images are stamped, s: one stamped t shows the joints at t - offset; and its
        standard deviation, s.
    residual_m : float
        Median distance of images from the chain, m.
    noise_m : float
        Its noise part, which changes from one image to the next, m; NaN if the images are too far
        apart.
    ray_noise_m, lateral_noise_m : float
        Standard deviation of a position along the line of sight, and across it (each of two), m.
    outliers : int
        Images further than six standard deviations from the chain.
    samples : int
        Images used.
    covariance : ndarray, shape (4 n + m + 1, 4 n + m + 1)
        Of the coordinates of :class:`~fvs_estimator_node.chain_chart.Chart` at the chain, by the
        noise; rad, m and s.
    unfitted : ndarray, shape (4 n + m + 1 + m n, 4 n + m + 1 + m n)
        Squared changes by an additional constant Jacobian in the fit, less those by noise: of the
        coordinates, and of that Jacobian row by row, m/rad.
    """

    chain: SerialChain
    weights: np.ndarray
    time_offset_s: float
    time_offset_deviation_s: float
    residual_m: float
    noise_m: float
    ray_noise_m: float
    lateral_noise_m: float
    outliers: int
    samples: int
    covariance: np.ndarray
    unfitted: np.ndarray

    @property
    def misfit(self) -> float:
        """Residual over noise: 1 for a serial chain; NaN if the images are too far apart."""
        return self.residual_m / self.noise_m

    @property
    def is_chain(self) -> bool:
        """Whether the ball moves as on a serial chain, to within the noise."""
        noise_m = 0.0 if math.isnan(self.noise_m) else self.noise_m
        unexplained_m2 = self.residual_m**2 - noise_m**2
        return self.misfit <= _MISFIT_LIMIT or unexplained_m2 <= _UNEXPLAINED_LIMIT_M**2

    @property
    def offset_at_limit(self) -> bool:
        """Whether the stamp offset is at the limit of the search."""
        return abs(self.time_offset_s) > 0.99 * MAX_OFFSET_S

    def jacobian_deviation(self, joints_rad: np.ndarray) -> np.ndarray:
        """Relative standard deviation of the Jacobian at joints where data are.

        It covers the noise and the systematic error that no chain explains (mean over the data): a
        wrong focal length distorts the ball's path. A wrong scale of the camera is invisible,
        because it only scales the chain.

        Parameters
        ----------
        joints_rad : ndarray, shape (k, n)
            Joints, rad.

        Returns
        -------
        ndarray, shape (k,)
            Frobenius norm of the deviation over that of the Jacobian.
        """
        chain = self.chain.weighted(self.weights)
        chart = Chart(chain)
        jacobian = chain.jacobian(joints_rad)
        numbers = jacobian[0].size
        changes = np.zeros((len(joints_rad), numbers, len(self.unfitted)))
        for place, step in enumerate(_STEP * np.eye(chart.size - 1)):
            change = (chart.chain(step).jacobian(joints_rad) - jacobian) / _STEP
            changes[..., place] = change.reshape(len(joints_rad), -1)
        changes[..., chart.size :] = np.eye(numbers)
        some = changes[..., : chart.size]
        noise = np.sum(some @ self.covariance * some, axis=(1, 2))
        square = noise + np.maximum(np.sum(changes @ self.unfitted * changes, axis=(1, 2)), 0.0)
        return np.sqrt(square) / np.linalg.norm(jacobian, axis=(1, 2))


def fit_chain(data: DataSet, progress: Callable[[str], None] | None = None) -> ChainFit:
    """Fit a chain to ball positions and joints.

    Parameters
    ----------
    data : DataSet
        A minute of motion of all joints, or more.
    progress : callable, optional
        Called with a text at each stage.

    Raises
    ------
    ChainFitError
        If there is too little data, or nothing fits.
    """
    say = progress or (lambda words: None)
    path = Path(data)
    unknown = 4 * data.joints_rad.shape[1] + data.z.shape[1]
    if data.still and len(data) < unknown:
        raise ChainFitError(
            f"a chain of {data.joints_rad.shape[1]} joints needs at least {unknown} still poses, "
            f"the data set has {len(data)}"
        )
    if not data.still and len(path.indices) < _MIN_SAMPLES:
        raise ChainFitError(
            f"a chain needs at least {_MIN_SAMPLES} images in continuous runs of more than "
            f"{2 * MAX_OFFSET_S:g} s, the data set has {len(path.indices)}; still poses have "
            f"joints at rest for {MAX_OFFSET_S:g} s before each image, or no stamp_s in a table"
        )
    if not plausible(data.z):
        raise ChainFitError(f"the {data.kind.what} has a place above {LARGEST:g} m: metres?")
    if np.linalg.norm(data.z.std(axis=0)) < 1e-3:
        raise ChainFitError(
            f"the {data.kind.what} does not move in the data set, so there is no chain to find"
        )
    fitting = _Fitting(path, data.z[path.indices], data.kind.weights)
    # Matrices of few columns: on a busy machine more threads took twenty times as long.
    with threadpool_limits(1):
        say("looking for the axes")
        found = fitting.start_at_random() if data.still else fitting.start()
        say("fitting")
        return fitting.finish(found)


class _Found(NamedTuple):
    """An optimum: chain, offset of the stamps, s, and cost for an image."""

    chain: SerialChain
    offset_s: float
    cost: float


class _Fitting:
    """One fit: the joints at any time, and the feature in k images, (k, m), with its weights."""

    def __init__(self, path: Path, features: np.ndarray, weights: np.ndarray) -> None:
        self._path, self._weights = path, weights
        self._z = weights * features

    def start(self) -> _Found:
        """The best of some starts, each fitted to a part of the images."""
        reference = self._path.joints_and_velocities(0.0)[0].mean(axis=0)
        regression = min(
            (
                regress(offset_s, self._path.joints_and_velocities(offset_s)[0], reference, self._z)
                for offset_s in np.linspace(-MAX_OFFSET_S, MAX_OFFSET_S, _SEARCH_OFFSETS)
            ),
            key=lambda one: one.distance_m,
        )
        count = min(_SEARCH_SAMPLES, len(self._z))
        some = np.linspace(0, len(self._z) - 1, count).astype(int)

        def fitted(chain: SerialChain) -> _Found:
            begin = _Found(chain, regression.offset_s, math.inf)
            images, size = self._z.shape
            unit = np.broadcast_to(np.eye(size) / regression.distance_m, (images, size, size))
            return self._solve(begin, unit, some, 3.0, 60)

        best, rank, better = fitted(first_guess(regression, reference)), 0, 0
        while rank < better + len(reference):  # all joints since the last that was better
            residual_m, noise_m = self._distances_m(self._residuals(best))
            if residual_m < _GOOD_SHARE * noise_m:
                break
            for other in map(fitted, other_starts(best.chain, rank)):
                if other.cost < _BETTER * best.cost:
                    best, better = other, rank + 1
            rank += 1
        return best

    def start_at_random(self) -> _Found:
        """The best of some random chains; an optimum that is found twice is taken for it.

        Still poses are too few for a regression, but far apart, so that few wrong optima are left.
        """
        rng, joints = np.random.default_rng(0), self._path.joints_and_velocities(0.0)[0]
        middle, reference = self._z.mean(axis=0), joints.mean(axis=0)
        spread_m = float(np.linalg.norm(self._z[:, :3].std(axis=0)))
        tried: list[_Found] = []
        while len(tried) < _MOST_STARTS:
            axes, places = rng.normal(size=(2, len(reference), 3))
            chain = SerialChain(axes, middle[:3] + spread_m * places, middle, reference)
            one = self._from_afar(chain, spread_m)
            tried = sorted([*tried, one], key=lambda each: each.cost)
            best, *others = (each.cost for each in tried)
            if len(tried) >= _LEAST_STARTS and others[0] < (1.0 + _SAME) * best + _SAME_COST:
                break
        found = tried[0]
        for joint in range(len(reference)):
            slopes = found.chain.jacobian(reference)[:3]
            is_joint = np.arange(len(reference)) == joint
            shifting = replace(
                found.chain,
                axes=np.where(is_joint[:, None], slopes.T, found.chain.axes),
                prismatic=np.where(is_joint, 1.0, found.chain.prismatic),
            )
            found = min(found, self._from_afar(shifting, spread_m), key=lambda each: each.cost)
        return found

    def _from_afar(self, chain: SerialChain, spread_m: float) -> _Found:
        """The optimum from a start that may be far from it, by a new chart after some steps."""
        images, size = self._z.shape
        unit = np.broadcast_to(np.eye(size) / (_ROUGH * spread_m), (images, size, size))
        found = _Found(chain, 0.0, math.inf)
        for _ in range(_CHARTS):
            last = found
            found = self._solve(last, unit, np.arange(images), evaluations=_IN_A_CHART)
            if found.cost > (1.0 - _SAME) * last.cost:
                break
        return found

    def finish(self, found: _Found) -> ChainFit:
        """Fit all images, each weighed by its noise along and across the line of sight."""
        images = np.arange(len(self._z))
        weights = whitening(self._residuals(found), self._z)
        found = self._solve(found, weights, images)
        # A wrong optimum can fit almost as well, since noise hides the curvature of a weak joint.
        # The right side converges in about six evaluations, a wrong one does not.
        for other in other_starts(found.chain, 0):
            about = found._replace(chain=other)
            turned = self._solve(about, weights, images, evaluations=10)
            if turned.cost < found.cost:
                weights = whitening(self._residuals(turned), self._z)
                found = self._solve(turned, weights, images)
        # Outliers had a small weight so far, but a long run of them would still bias the fit.
        inlier = inliers(self._residuals(found), self._z)
        if not inlier.all():
            found = self._solve(found, weights, images[inlier])
        residual = self._residuals(found)
        residual_m, noise_m = self._distances_m(residual)
        ray_m, lateral_m = noise_by_direction(residual[:, :3], self._z)
        inlier = inliers(residual, self._z)
        covariance, unfitted = self._moments(found, weights, inlier)
        return ChainFit(
            chain=found.chain.weighted(1.0 / self._weights),
            weights=self._weights,
            time_offset_s=found.offset_s,
            time_offset_deviation_s=float(np.sqrt(covariance[OFFSET, OFFSET])),
            residual_m=residual_m,
            noise_m=noise_m,
            ray_noise_m=ray_m,
            lateral_noise_m=lateral_m,
            outliers=int(np.count_nonzero(~inlier)),
            samples=len(residual),
            covariance=covariance,
            unfitted=unfitted,
        )

    def _residuals(self, found: _Found) -> np.ndarray:
        joints = self._path.joints_and_velocities(found.offset_s)[0]
        return found.chain.position(joints) - self._z

    def _solve(
        self,
        begin: _Found,
        whitening: np.ndarray,
        images: np.ndarray,
        scale: float = 2.0,
        evaluations: int = 100,
    ) -> _Found:
        """The robust optimum for some images.

        The prior holds coordinates that the data do not determine. Residuals above ``scale``
        standard deviations have a decreasing weight.
        """
        chart = Chart(begin.chain)
        deviation = np.full(chart.size, _PRIOR)
        deviation[OFFSET] = _OFFSET_PRIOR_S

        def white(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            joints, velocity = self._path.joints_and_velocities(float(values[OFFSET]))
            residual, slope = residuals_and_slopes(
                chart, values, joints[images], velocity[images], self._z[images]
            )
            return whitening[images] @ residual[..., None], whitening[images] @ slope

        first = np.zeros(chart.size)
        first[OFFSET] = begin.offset_s
        limit = np.full(chart.size, np.inf)
        limit[OFFSET] = MAX_OFFSET_S
        found, cost = robust_optimum(white, first, deviation, scale, evaluations, limit)
        return _Found(chart.chain(found), float(found[OFFSET]), cost / len(images))

    def _distances_m(self, residual: np.ndarray) -> tuple[float, float]:
        """Median length of the residuals, and of their noise part, m.

        The noise is estimated from differences of neighbours; NaN if there are too few of them.
        """
        passed_s = np.diff(self._path.stamps_s)
        apart_m = np.linalg.norm(np.diff(residual, axis=0), axis=1)
        apart_m = apart_m[(passed_s > 0.0) & (passed_s < MAX_GAP_S)]
        noise_m = math.nan
        if len(apart_m) >= _LEAST_PAIRS:
            noise_m = float(np.median(apart_m)) / math.sqrt(2.0)
        return float(np.median(np.linalg.norm(residual, axis=1))), noise_m

    def _moments(
        self, found: _Found, whitening: np.ndarray, inlier: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Covariance by the noise, and what a constant Jacobian beside the chain would change."""
        joints, velocity = self._path.joints_and_velocities(found.offset_s)
        chart = Chart(found.chain)
        residual, slope = residuals_and_slopes(
            chart, np.zeros(chart.size), joints, velocity, self._z
        )
        beside = np.kron(np.eye(self._z.shape[1]), (joints - joints.mean(axis=0))[:, None])
        columns = np.concatenate([slope, beside], axis=2)
        rows = (whitening @ columns)[inlier].reshape(-1, columns.shape[2])
        wanted = (whitening @ residual[..., None])[inlier].ravel()
        prior = np.full(columns.shape[2], _PRIOR)
        prior[chart.size + OFFSET] = _OFFSET_PRIOR_S
        known = rows.T @ rows + np.diag(prior**-2)
        covariance = np.linalg.inv(known[: chart.size, : chart.size])
        wider = np.linalg.inv(known)
        change = wider @ (rows.T @ wanted)
        # Noise alone makes a difference of the two fits as large as that of their covariances.
        unfitted = np.outer(change, change) - wider
        unfitted[: chart.size, : chart.size] += covariance
        return covariance, unfitted


def robust_optimum(
    white: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    start: np.ndarray,
    deviation: np.ndarray,
    scale: float,
    evaluations: int,
    limit: np.ndarray | float = np.inf,
) -> tuple[np.ndarray, float]:
    """The optimum of residuals and of a prior about zero, and its cost.

    Parameters
    ----------
    white : callable
        Residuals in standard deviations, k of them in all, and their slopes, (..., p), at unknowns,
        (p,); a ValueError after a step too far, which is then made shorter.
    start, deviation, limit : ndarray, shape (p,)
        Of the unknowns: where to begin, prior deviation, and largest size.
    scale : float
        Residuals above it have a decreasing weight.
    evaluations : int
        At most.
    """
    numbers = 0

    @lru_cache(maxsize=1)
    def both(content: bytes) -> tuple[np.ndarray, np.ndarray]:
        nonlocal numbers
        values = np.frombuffer(content)
        try:
            residual, slopes = white(values)
        except ValueError:
            return np.full(numbers, np.inf), np.empty(0)
        residual = np.append(residual, values / deviation)
        numbers = len(residual)
        return residual, np.append(slopes, np.diag(1.0 / deviation)).reshape(numbers, -1)

    solution = least_squares(
        lambda values: both(values.tobytes())[0],
        np.clip(start, -0.99 * limit, 0.99 * limit),
        lambda values: both(values.tobytes())[1],
        bounds=(-np.broadcast_to(limit, start.shape), np.broadcast_to(limit, start.shape)),
        loss="soft_l1",
        f_scale=scale,
        max_nfev=evaluations,
        ftol=1e-6,
        xtol=1e-7,
        gtol=1e-10,
        x_scale=deviation,
    )
    return solution.x, float(solution.cost)


def noise_by_direction(residual_m: np.ndarray, feature_m: np.ndarray) -> tuple[float, float]:
    """Standard deviations along the line of sight and across it, by medians, m.

    Takes residuals, (k, 3), and features, (k, m), of k images, m.
    """
    sight = _sight(feature_m)
    along = np.sum(residual_m * sight, axis=1)
    across = np.linalg.norm(residual_m - along[:, None] * sight, axis=1)
    # medians of a normal and of a Rayleigh distribution
    ray_m = float(np.median(np.abs(along))) / 0.6745
    lateral_m = float(np.median(across)) / 1.1774
    return max(ray_m, 1e-6), max(lateral_m, 1e-6)


def _sight(feature_m: np.ndarray) -> np.ndarray:
    point_m = feature_m[:, :3]
    return np.asarray(point_m / np.maximum(np.linalg.norm(point_m, axis=1, keepdims=True), 1e-9))


def whitening(residual_m: np.ndarray, feature_m: np.ndarray) -> np.ndarray:
    """Matrices (k, m, m) that turn residuals into standard deviations.

    Shifts and turns have another noise along the line of sight than across it.
    """
    sight = _sight(feature_m)
    along = sight[:, :, None] * sight[:, None, :]

    def by_noise(residual_m: np.ndarray) -> tuple[np.ndarray, float]:
        ray_m, lateral_m = noise_by_direction(residual_m, feature_m)
        return along / ray_m + (np.eye(3) - along) / lateral_m, lateral_m

    images, size = residual_m.shape
    whole = np.zeros((images, size, size))
    whole[:, :3, :3] = by_noise(residual_m[:, :3])[0]
    if size > 3:
        # Motions of the axes by turns, (k, 9, 3): orthonormal columns.
        axes = feature_m[:, 3:].reshape(images, -1, 3)
        turns = -cross_matrix(axes).reshape(images, size - 3, 3)
        turns /= np.linalg.norm(turns, axis=1, keepdims=True)
        back = np.swapaxes(turns, 1, 2)
        of_turn, lateral_m = by_noise((back @ residual_m[:, 3:, None])[..., 0])
        whole[:, 3:, 3:] = (np.eye(size - 3) - turns @ back) / lateral_m + turns @ of_turn @ back
    return whole


def inliers(residual_m: np.ndarray, feature_m: np.ndarray) -> np.ndarray:
    """Which images are within the noise, bool (k,)."""
    white = (whitening(residual_m, feature_m) @ residual_m[..., None])[..., 0]
    return np.asarray(np.abs(white).max(axis=1) <= OUTLIER)
