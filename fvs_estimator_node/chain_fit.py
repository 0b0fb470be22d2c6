"""Fits a serial chain of revolute joints to a minute of ordinary motion.

The camera sees the ball at ``x(r(t - tau)) + noise`` of an image stamped t: 4 n + 3 numbers of a
:class:`~fvs_ros.chain.SerialChain` of n joints (two for each axis' direction, two for its place,
three for the ball) and the time ``tau`` that the images are stamped late. They are found by robust
non-linear least squares with the exact derivatives.

The start comes from a cubic regression of the positions about the mean joints: there
``dx/dr_i = J_i`` and ``d2x/dr_i dr_j = w_i x J_j`` for j >= i, which is linear in the axes; and of
several times ``tau`` one fits best. Joints that hardly move the ball say little about their axes;
those are tried in several ways until the images fit as well as they fit each other, and the weakest
once more on the ball's other side when all is fitted.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from fvs_estimator_node.chain_chart import OFFSET, Chart, each_coordinate, residuals_and_slopes
from fvs_estimator_node.chain_path import MAX_OFFSET_S, ChainPath
from fvs_estimator_node.chain_start import Regression, first_guess, regress, turned_about
from fvs_estimator_node.dataset import DataSet
from fvs_ros.chain import SerialChain

#: Fewest images that a chain is fitted to.
MIN_SAMPLES = 200
#: No depth camera sees further, m.
_FARTHEST_M = 50.0
#: An offset this near to the longest that is looked for would go on beyond it, s.
_AT_LIMIT_S = 1e-3
#: Images of the search for the right start, and starts that are tried at most.
_SEARCH_SAMPLES, _STARTS = 400, 12
#: Offsets of the stamps that are tried before, s, and passes of a robust median.
_SEARCH_OFFSETS_S, _PASSES = np.linspace(-0.18, 0.18, 13), 6
#: Above both, the second in m, something else than a chain of revolute joints moves the ball; a
#: camera's own systematic errors stay below.
_MISFIT_LIMIT, _UNEXPLAINED_LIMIT_M = 1.3, 0.001
#: Neighbours are images no further apart, s, and so many pairs of them make a median; an image that
#: is unlike both its neighbours by so many times what is usual is an outlier.
_NEAR_S, _LEAST_PAIRS, _UNLIKE = 0.25, 50, 6.0
#: Images further than so many standard deviations from the chain are left out.
_OUTLIER = 6.0
#: A start is right if its residual is below so many times that of the images themselves.
_GOOD_SHARE = 1.5
#: So many of the weakest joints are turned about once more when all is fitted, and the evaluations
#: that each is given: the right side needs six or so, a wrong one has no end.
_TURNED, _TURNED_EVALUATIONS = 2, 10
#: How far off the coordinates may be where the data do not tell, standard deviations: rad, m, m, s.
_PRIOR = (1.0, 1.0, 1.0, 0.1)
#: The same for a slope of the residuals by the joints, m/rad: more than any joint moves the ball.
_SLOPE_PRIOR = 1.0
#: Typical steps of the coordinates: rad, m, m, s.
_TYPICAL = (0.3, 0.1, 0.1, 0.05)
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
    time_offset_s : float
        How late the images are stamped, s: one stamped t shows the joints at t - offset.
    time_offset_deviation_s : float
        Its standard deviation, s.
    residual_m : float
        Median distance of images from the chain, m, without those that are far from both their
        neighbours.
    noise_m : float
        The part of it that is noise: what changes from one image to the next, m; NaN if the images
        are too far apart to tell.
    ray_noise_m, lateral_noise_m : float
        Standard deviation of a position along the line of sight, and across it (each of two), m.
    outliers : int
        Images further than six standard deviations from the chain.
    samples : int
        Images used.
    covariance : ndarray, shape (4 n + 4, 4 n + 4)
        Of the coordinates of :class:`~fvs_estimator_node.chain_chart.Chart` at the chain, by the
        noise; rad, m and s.
    unfitted : ndarray, shape (7 n + 4, 7 n + 4)
        What a constant Jacobian beside the chain would change, squared and less what noise makes
        of it: the coordinates, and that Jacobian row by row, m/rad.
    """

    chain: SerialChain
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
        """Residual over noise: 1 for a serial chain, more where something else moves the ball.

        NaN if the images are too far apart to tell.
        """
        return self.residual_m / self.noise_m

    @property
    def unexplained_m(self) -> float:
        """The part of the residual that neither the chain nor noise explains, m.

        All of it if the images are too far apart to tell.
        """
        if math.isnan(self.noise_m):
            return self.residual_m
        return math.sqrt(max(self.residual_m**2 - self.noise_m**2, 0.0))

    @property
    def is_chain(self) -> bool:
        """Whether the ball moves as one on a serial chain, as far as the noise lets one see.

        Not if the images are too far apart to tell, unless all of the residual is small.
        """
        return self.misfit <= _MISFIT_LIMIT or self.unexplained_m <= _UNEXPLAINED_LIMIT_M

    @property
    def offset_at_limit(self) -> bool:
        """Whether the images may be stamped later, or earlier, than is looked for."""
        return abs(self.time_offset_s) > MAX_OFFSET_S - _AT_LIMIT_S

    def jacobian_deviation(self, joints_rad: np.ndarray) -> np.ndarray:
        """Relative standard deviation of the Jacobian at joints where data are.

        Of the noise and, in the mean over the data, of what no chain explains: a camera whose
        focal length is told wrongly makes the ball's path another one than a chain's. A wrong
        scale of the camera makes all of a chain larger, and is not seen.

        Parameters
        ----------
        joints_rad : ndarray, shape (k, n)
            Joints, rad.

        Returns
        -------
        ndarray, shape (k,)
            Frobenius norm of the deviation over that of the Jacobian.
        """
        chart = Chart(self.chain)
        jacobian = self.chain.jacobian(joints_rad)
        numbers = jacobian[0].size
        changes = np.zeros((len(joints_rad), numbers, len(self.unfitted)))
        for place, step in enumerate(_STEP * np.eye(chart.size - 1)):
            change = (chart.chain(step).jacobian(joints_rad) - jacobian) / _STEP
            changes[..., place] = change.reshape(len(joints_rad), -1)
        changes[..., chart.size :] = np.eye(numbers)

        def squares(moments: np.ndarray) -> np.ndarray:
            some = changes[..., : len(moments)]
            return np.sum(some @ moments * some, axis=(1, 2))

        square = squares(self.covariance) + np.maximum(squares(self.unfitted), 0.0)
        return np.sqrt(square) / np.linalg.norm(jacobian, axis=(1, 2))


def fit_chain(
    data: DataSet,
    rng: np.random.Generator | None = None,
    progress: Callable[[str], None] | None = None,
) -> ChainFit:
    """Fit a chain to ball positions and joints.

    Parameters
    ----------
    data : DataSet
        A minute of motion of all joints, or more.
    rng : numpy Generator, optional
        Decides what is tried where the regression leaves an axis open; default seed 0.
    progress : callable, optional
        Told what is being done, in words.

    Raises
    ------
    ChainFitError
        If there is too little data, or nothing fits.
    """
    rng = rng if rng is not None else np.random.default_rng(0)
    say = progress or (lambda words: None)
    path = ChainPath(data)
    if len(path.indices) < MIN_SAMPLES:
        raise ChainFitError(
            f"a chain needs at least {MIN_SAMPLES} images in continuous runs of more than "
            f"{2 * MAX_OFFSET_S:g} s, the data set has {len(path.indices)}"
        )
    if np.abs(data.ball_m).max() > _FARTHEST_M:
        raise ChainFitError(
            f"the ball is up to {np.abs(data.ball_m).max():.0f} m away in the data set; positions "
            "must be in metres"
        )
    if np.linalg.norm(data.ball_m.std(axis=0)) < 1e-3:
        raise ChainFitError("the ball does not move in the data set, so there is no chain to find")
    fitting = _Fitting(path, data.ball_m[path.indices])
    # Matrices of few columns: on a busy machine more threads took twenty times as long.
    with threadpool_limits(1):
        say("looking for the axes")
        chain, offset_s = fitting.start(rng)
        say("fitting")
        return fitting.finish(chain, offset_s)


class _Fitting:
    """One fit: the joints at any time, and the ball in the images, m, (n, 3)."""

    def __init__(self, path: ChainPath, ball_m: np.ndarray) -> None:
        self._path = path
        self._ball = ball_m
        self._reference = path.joints_and_velocities(0.0)[0].mean(axis=0)

    # ---- start ----------------------------------------------------------------------------

    def start(self, rng: np.random.Generator) -> tuple[SerialChain, float]:
        """The best of some starts, each fitted to a part of the images."""
        some = np.sort(rng.permutation(len(self._ball))[:_SEARCH_SAMPLES])
        regression = min(
            (self._regress(offset_s) for offset_s in _SEARCH_OFFSETS_S),
            key=lambda one: one.distance_m,
        )
        best: tuple[float, SerialChain, float] | None = None
        for attempt in range(_STARTS):
            if best is None or attempt % 2 == 0:
                chain = first_guess(regression, self._reference, rng, attempt)
            else:
                chain = turned_about(best[1], attempt // 2)
            values, cost = self._solve(
                Chart(chain), regression.offset_s, some, np.eye(3), regression.distance_m, 3.0, 60
            )
            if best is None or cost < best[0]:
                best = (cost, Chart(chain).chain(values), float(values[OFFSET]))
            residual_m, noise_m = self._distances_m(self._residuals(best[1], best[2]))
            if residual_m < _GOOD_SHARE * noise_m:
                break
        assert best is not None
        return best[1], best[2]

    def _regress(self, offset_s: float) -> Regression:
        joints = self._path.joints_and_velocities(offset_s)[0]
        return regress(offset_s, joints, self._reference, self._ball)

    # ---- least squares --------------------------------------------------------------------

    def _residuals(self, chain: SerialChain, offset_s: float) -> np.ndarray:
        return chain.position(self._path.joints_and_velocities(offset_s)[0]) - self._ball

    def _solve(
        self,
        chart: Chart,
        offset_s: float,
        images: np.ndarray,
        whitening: np.ndarray,
        unit: float,
        scale: float,
        evaluations: int,
    ) -> tuple[np.ndarray, float]:
        """Local coordinates and offset of the robust optimum, and its cost for an image.

        ``unit`` is what one standard deviation of an image is after the whitening: what the data
        do not tell is held by the prior, not by chance. Residuals above ``scale`` of them count
        less and less.
        """
        from scipy.optimize import least_squares

        pull = unit / each_coordinate(len(chart.axes), *_PRIOR)

        def values_of(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            joints, velocity = self._path.joints_and_velocities(float(values[OFFSET]))
            try:
                residual, slope = residuals_and_slopes(
                    chart, values, joints[images], velocity[images], self._ball[images]
                )
            except ValueError:  # no chain: a step too far, which is then made shorter
                return np.full(3 * len(images) + chart.size, np.inf), np.empty(0)
            white = whitening if whitening.ndim == 2 else whitening[images]
            residual = (white @ residual[..., None]).ravel()
            slope = (white @ slope).reshape(-1, chart.size)
            return (
                np.concatenate([residual, pull * (values - chart.expected)]),
                np.concatenate([slope, np.diag(pull)]),
            )

        cache: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

        def cached(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            key = values.tobytes()
            if key not in cache:
                cache.clear()
                cache[key] = values_of(values)
            return cache[key]

        begin = np.zeros(chart.size)
        begin[OFFSET] = offset_s
        limit = np.full(chart.size, np.inf)
        limit[OFFSET] = MAX_OFFSET_S
        solution = least_squares(
            lambda values: cached(values)[0],
            begin,
            lambda values: cached(values)[1],
            bounds=(-limit, limit),
            loss="soft_l1",
            f_scale=scale * unit,
            max_nfev=evaluations,
            ftol=1e-6,
            xtol=1e-7,
            gtol=1e-10,
            x_scale=each_coordinate(len(chart.axes), *_TYPICAL),
        )
        return solution.x, float(solution.cost) / len(images)

    def finish(self, chain: SerialChain, offset_s: float) -> ChainFit:
        """Fit all images, each weighed by its noise along and across the line of sight."""
        for _ in range(2):
            whitening = self._weighing(self._residuals(chain, offset_s))
            chain, offset_s, cost = self._refined(chain, offset_s, whitening)
        # A wrong optimum can fit nearly as well as the right one: noise hides a weak joint's bend.
        for rank in range(_TURNED):
            turned = self._refined(
                turned_about(chain, rank), offset_s, whitening, _TURNED_EVALUATIONS
            )
            if turned[2] < cost:
                chain, offset_s, cost = turned
                whitening = self._weighing(self._residuals(chain, offset_s))
                chain, offset_s, cost = self._refined(chain, offset_s, whitening)
        # What is far off had a small say so far; in a long stretch, all of it pulls one way.
        inlier = self._inliers(self._residuals(chain, offset_s))
        if not inlier.all():
            chain, offset_s, _ = self._refined(chain, offset_s, whitening, images=inlier)
        residual = self._residuals(chain, offset_s)
        residual_m, noise_m = self._distances_m(residual)
        ray_m, lateral_m = _noise_by_direction(residual, self._ball)
        inlier = self._inliers(residual)
        covariance, unfitted = self._moments(chain, offset_s, whitening, inlier)
        return ChainFit(
            chain=chain,
            time_offset_s=offset_s,
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

    def _weighing(self, residual: np.ndarray) -> np.ndarray:
        """Matrices (n, 3, 3) that weigh each image by the noise about a chain."""
        return _whitening(self._ball, *_noise_by_direction(residual, self._ball))

    def _inliers(self, residual: np.ndarray) -> np.ndarray:
        """Which images are no further off than noise brings them, bool (n,)."""
        white = (self._weighing(residual) @ residual[..., None])[..., 0]
        return np.abs(white).max(axis=1) <= _OUTLIER

    def _refined(
        self,
        chain: SerialChain,
        offset_s: float,
        whitening: np.ndarray,
        evaluations: int = 100,
        images: np.ndarray | slice = slice(None),
    ) -> tuple[SerialChain, float, float]:
        """Chain and offset at the optimum of some images, or all, and its cost for an image."""
        chart, some = Chart(chain), np.arange(len(self._ball))[images]
        values, cost = self._solve(chart, offset_s, some, whitening, 1.0, 2.0, evaluations)
        return chart.chain(values), float(values[OFFSET]), cost

    def _distances_m(self, residual: np.ndarray) -> tuple[float, float]:
        """Median length of the residuals, and what it were if all were as unlike as neighbours, m.

        Both of the same images: outliers, which are unlike both their neighbours, count for
        neither. The second is NaN where there are too few neighbours.
        """
        passed_s = np.diff(self._path.stamps_s)
        first = np.flatnonzero((passed_s > 0.0) & (passed_s < _NEAR_S))
        apart_m = np.linalg.norm(residual[first + 1] - residual[first], axis=1)
        nearest_m = np.full(len(residual), np.inf)
        np.minimum.at(nearest_m, first, apart_m)
        np.minimum.at(nearest_m, first + 1, apart_m)
        alike = np.isfinite(nearest_m)
        for _ in range(_PASSES if alike.any() else 0):
            alike &= nearest_m <= _UNLIKE * np.median(nearest_m[alike])
        both = alike[first] & alike[first + 1]
        if np.count_nonzero(both) < _LEAST_PAIRS:
            return _median_length(residual), math.nan
        return _median_length(residual[alike]), float(np.median(apart_m[both])) / math.sqrt(2.0)

    def _moments(
        self, chain: SerialChain, offset_s: float, whitening: np.ndarray, inlier: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Covariance by the noise, and what a constant Jacobian beside the chain would change."""
        joints, velocity = self._path.joints_and_velocities(offset_s)
        chart = Chart(chain)
        residual, slope = residuals_and_slopes(
            chart, np.zeros(chart.size), joints, velocity, self._ball
        )
        beside = np.kron(np.eye(3), (joints - joints.mean(axis=0))[:, None])
        columns = np.concatenate([slope, beside], axis=2)
        rows = (whitening @ columns)[inlier].reshape(-1, columns.shape[2])
        wanted = (whitening @ residual[..., None])[inlier].ravel()
        prior = np.full(columns.shape[2], _SLOPE_PRIOR)
        prior[: chart.size] = each_coordinate(len(chart.axes), *_PRIOR)
        known = rows.T @ rows + np.diag(prior**-2)
        covariance = np.linalg.inv(known[: chart.size, : chart.size])
        wider = np.linalg.inv(known)
        found = wider @ (rows.T @ wanted)
        # Noise alone makes a difference of the two fits as large as that of their covariances.
        unfitted = np.outer(found, found) - wider
        unfitted[: chart.size, : chart.size] += covariance
        return covariance, unfitted


def _median_length(vectors: np.ndarray) -> float:
    return float(np.median(np.linalg.norm(vectors, axis=1)))


def _sight(ball_m: np.ndarray) -> np.ndarray:
    return ball_m / np.maximum(np.linalg.norm(ball_m, axis=1, keepdims=True), 1e-9)


def _noise_by_direction(residual: np.ndarray, ball_m: np.ndarray) -> tuple[float, float]:
    """Standard deviations along the line of sight and across it, by medians, m."""
    sight = _sight(ball_m)
    along = np.sum(residual * sight, axis=1)
    across = np.linalg.norm(residual - along[:, None] * sight, axis=1)
    # medians of a normal and of a Rayleigh distribution
    ray_m = float(np.median(np.abs(along))) / 0.6745
    lateral_m = float(np.median(across)) / 1.1774
    return max(ray_m, 1e-6), max(lateral_m, 1e-6)


def _whitening(ball_m: np.ndarray, ray_m: float, lateral_m: float) -> np.ndarray:
    """Matrices (n, 3, 3) that turn a residual into standard deviations."""
    sight = _sight(ball_m)
    along = sight[:, :, None] * sight[:, None, :]
    return along / ray_m + (np.eye(3) - along) / lateral_m
