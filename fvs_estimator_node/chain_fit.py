"""Fits a serial chain to a minute of ordinary motion.

The model of an image stamped t is ``x(r(t - tau)) + noise``. Its unknowns are the 4 n + m numbers
of a :class:`~fvs_ros.chain.SerialChain` of n joints (two for each axis' direction, two for its
place, m for the feature) and the stamp offset ``tau``. They are found by robust non-linear least
squares with exact derivatives.

An error of the lens bends the motion as no chain does. The chain remains that of what is measured.

The starts are random chains, of which the best of a part of the images goes on. Each joint may be
prismatic, too: then it turns the motion of no joint behind it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from fvs_estimator_node.chain_chart import OFFSET, Chart, residuals_and_slopes
from fvs_estimator_node.files import DataSet
from fvs_estimator_node.joint_path import MAX_OFFSET_S, Path, behind_play
from fvs_ros.chain import MOST_LENS, MOST_PLAY_RAD, SerialChain, cross_matrix
from fvs_ros.filter import OUTLIER
from fvs_ros.timeline import MAX_GAP_S, too_slow
from fvs_ros.vectors import LARGEST, largest, plausible

#: Applies a function to all items, like the built-in ``map``: here or by other processes.
Workers = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]

#: Fewest images that a chain is fitted to.
_MIN_SAMPLES = 200
#: Images of the search for the right start.
_SEARCH_SAMPLES = 400
#: Random starts, at least and at most; each is solved in so many charts of so many evaluations.
#: Seven of ten reach the best optimum.
_LEAST_STARTS, _MOST_STARTS, _CHARTS, _IN_A_CHART = 8, 30, 8, 15
#: First guess of their residuals, over the spread of the feature; costs of the same optimum differ
#: by less than this share, or this much, which is 0.4 % of the spread.
_ROUGH, _SAME, _SAME_COST = 0.1, 0.02, 1e-3
#: Above both limits, the second in m, a chain does not explain the motion. A camera's
#: own systematic errors stay below.
_MISFIT_LIMIT, _UNEXPLAINED_LIMIT_M = 1.3, 0.001
#: Least count of pairs of neighbouring images for a median.
LEAST_PAIRS = 50
#: Prior standard deviations, which hold coordinates that the data do not determine: rad, m, m/rad
#: for turns, shifts and slopes of the residuals by the joints; s for the offset.
_PRIOR, _OFFSET_PRIOR_S = 1.0, 0.1
#: The same of a lens' focal length and k1.
_LENS_PRIOR = np.array([0.1, 0.2])
#: Shifts by the lens count above this many deviations, and above what a detector's own errors look
#: like, as shares of the distance from the picture's middle (rms).
_LENS_DEVIATIONS, _LEAST_LENS = 3.0, 0.002
#: Fits behind the lens that was found last: of an error of 5 %, 0.01 % remain.
_LENS_ROUNDS = 2
#: Play: least that counts, beside as many deviations, and prior deviation, rad; fits behind it.
_LEAST_PLAY_RAD, _PLAY_PRIOR_RAD, _PLAY_ROUNDS = 2e-3, 0.02, 8
#: Step of the derivatives of the Jacobian by the coordinates, rad and m.
_STEP = 1e-4


class ChainFitError(ValueError):
    """Data that no chain can be fitted to; the text says why."""


@dataclass(frozen=True, kw_only=True)
class Fit:
    """What every fit of a chain tells, and how far it can be trusted."""

    #: Lengths, m, (m,), of the numbers that it carries: residuals are of the weighted numbers.
    weights: np.ndarray
    #: How late the images are stamped, s: one stamped t shows the joints at t - offset.
    time_offset_s: float
    time_offset_deviation_s: float
    residual_m: float  #: median distance of images from the chain, m
    #: Its noise part, which changes from one image to the next, m; NaN if they are too far apart.
    noise_m: float
    outliers: int  #: images further than six standard deviations from the chain
    samples: int  #: images used

    @property
    def misfit(self) -> float:
        """Residual over noise: 1 for a serial chain; NaN if the images are too far apart."""
        return self.residual_m / self.noise_m

    @property
    def is_chain(self) -> bool:
        """Whether the feature moves as on a serial chain, to within the noise."""
        noise_m = 0.0 if math.isnan(self.noise_m) else self.noise_m
        unexplained_m2 = self.residual_m**2 - noise_m**2
        return self.misfit <= _MISFIT_LIMIT or unexplained_m2 <= _UNEXPLAINED_LIMIT_M**2

    @property
    def offset_at_limit(self) -> bool:
        """Whether the stamp offset is at the limit of the search."""
        return abs(self.time_offset_s) > 0.99 * MAX_OFFSET_S

    def figures(self) -> dict[str, float]:
        """Key figures by name; NaN where unknown."""
        names = ("misfit", "residual_m", "noise_m", "time_offset_s", "time_offset_deviation_s")
        return {name: getattr(self, name) for name in (*names, "outliers", "samples")}


@dataclass(frozen=True, kw_only=True)
class ChainFit(Fit):
    """A fitted chain of a rigid body."""

    chain: SerialChain
    ray_noise_m: float  #: standard deviation of a position along the line of sight, m
    lateral_noise_m: float  #: across it, of each of two coordinates, m
    #: Error of the lens, (2,), as of :meth:`~fvs_ros.kinds.Kind.through_lens`. If notable, the
    #: chain has it as well, and the figures above are those without it.
    lens: np.ndarray
    lens_covariance: np.ndarray  #: of the lens, by the noise, (2, 2)
    #: Play, rad, (n,), as far as it is notable; that of the chain, once a fit behind it adds none.
    play_rad: np.ndarray
    #: Of the c = 4 n + m + 1 coordinates of :class:`~fvs_estimator_node.chain_chart.Chart` at the
    #: chain, by the noise, (c, c); rad, m and s.
    covariance: np.ndarray
    #: Squared changes by an additional constant Jacobian in the fit, less those by noise: of the
    #: coordinates, and of that Jacobian row by row, m/rad; (c + m n, c + m n).
    unfitted: np.ndarray

    def figures(self) -> dict[str, float]:
        """Key figures by name; NaN where unknown."""
        focal, radial = self.lens.tolist()
        focal_deviation, radial_deviation = np.sqrt(np.diag(self.lens_covariance)).tolist()
        return {
            **super().figures(),
            "ray_noise_m": self.ray_noise_m,
            "lateral_noise_m": self.lateral_noise_m,
            "focal_error": focal,
            "radial_error": radial,
            "focal_deviation": focal_deviation,
            "radial_deviation": radial_deviation,
        }

    def inliers(self, data: DataSet) -> np.ndarray:
        """Which images are within the noise, bool (k,)."""
        z = self.weights * data.z
        return inliers(self.weights * self.chain.position(data.joints_rad) - z, z)

    def jacobian_deviation(self, joints_rad: np.ndarray) -> np.ndarray:
        """Relative standard deviation of the Jacobian, (k,), at joints where data are, rad, (k, n).

        It is a ratio of Frobenius norms. It covers the noise and the systematic error that no chain
        explains (mean over the data): a wrong focal length distorts the ball's path. A wrong scale
        of the camera is invisible, because it only scales the chain.
        """
        chain = self.chain.weighted(self.weights)
        chart = Chart(chain)
        jacobian = chain.jacobian(joints_rad)
        numbers = jacobian[0].size
        changes = np.zeros((len(joints_rad), numbers, len(self.unfitted)))
        for column, step in enumerate(_STEP * np.eye(chart.size - 1)):
            change = (chart.chain(step).jacobian(joints_rad) - jacobian) / _STEP
            changes[..., column] = change.reshape(len(joints_rad), -1)
        changes[..., chart.size :] = np.eye(numbers)
        of_chain = changes[..., : chart.size]
        noise = np.sum(of_chain @ self.covariance * of_chain, axis=(1, 2))
        square = noise + np.maximum(np.sum(changes @ self.unfitted * changes, axis=(1, 2)), 0.0)
        return np.sqrt(square) / np.linalg.norm(jacobian, axis=(1, 2))


def fit_chain(
    data: DataSet, progress: Callable[[str], None] | None = None, workers: Workers = map
) -> ChainFit:
    """Fit a chain to a minute of motion of all joints, or more; ``progress`` gets words on it.

    The workers try the starts; the result does not depend on them. A ``ChainFitError`` says that
    there is too little data, or that nothing fits.
    """
    if not data.kind.rigid:
        raise ChainFitError(f"a {data.kind.what} is no rigid body, so there is no chain to find")
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
            f"{2 * MAX_OFFSET_S:g} s, the data set has {len(path.indices)}; "
            + (
                too_slow(data.stamps_s)
                or f"still poses have joints at rest for {MAX_OFFSET_S:g} s before each image, or "
                "no stamp_s in a table"
            )
        )
    if not plausible(data.z):
        raise ChainFitError(f"the {data.kind.what} has a place above {LARGEST:g} m: metres?")
    if np.linalg.norm(data.z.std(axis=0)) < 1e-3:
        raise ChainFitError(
            f"the {data.kind.what} does not move in the data set, so there is no chain to find"
        )
    fitting = _Fitting(data, np.zeros(data.joints_rad.shape[1]))
    # Matrices of few columns: on a busy machine more threads took twenty times as long.
    with threadpool_limits(1):
        say("looking for the axes")
        start = fitting.start(workers)
        say("fitting")
        fit = fitting.finish(start)
        for _ in range(_PLAY_ROUNDS):
            if largest(fit.play_rad - fit.chain.play_rad) < 0.1 * _LEAST_PLAY_RAD:
                break
            start = _Optimum(fit.chain.weighted(data.kind.weights), fit.time_offset_s, 0.0)
            fit = _Fitting(data, fit.play_rad).finish(start)
        return _behind_lens(fit, path, data)


def _behind_lens(fit: ChainFit, path: Path, data: DataSet) -> ChainFit:
    """The same fit, and that of the lens if it is notable."""
    z, kind, lens, behind = data.z[path.indices], data.kind, fit.lens, fit
    shifts = np.stack([np.ones(len(z)), np.sum((z[:, :2] / z[:, 2:3]) ** 2, axis=1)], axis=1)
    deviation = math.sqrt(np.mean(np.sum(shifts @ fit.lens_covariance * shifts, axis=1)))
    least = max(_LENS_DEVIATIONS * deviation, _LEAST_LENS)
    for _ in range(_LENS_ROUNDS):
        notable = math.sqrt(np.mean((shifts @ lens) ** 2)) >= least
        if not notable or not np.abs(lens).max() <= MOST_LENS:
            # Perhaps only now: what a fit behind it takes back was no error of the lens.
            return replace(fit, lens=lens, lens_covariance=behind.lens_covariance)
        fitting = _Fitting(data, fit.chain.play_rad, lens)
        start = _Optimum(behind.chain.weighted(kind.weights), behind.time_offset_s, 0.0)
        behind = fitting.finish(start)
        lens = np.clip(lens + behind.lens, -MOST_LENS, MOST_LENS)
    chain = replace(fit.chain, lens=lens)
    return replace(behind, chain=chain, lens=lens, covariance=fit.covariance, unfitted=fit.unfitted)


class _Optimum(NamedTuple):
    """An optimum: chain, offset of the stamps, s, and cost for an image."""

    chain: SerialChain
    offset_s: float
    cost: float


_cost = attrgetter("cost")


class _Fitting:
    """One fit: the joints at any time, and the feature in k images, (k, m), with its weights."""

    def __init__(self, data: DataSet, play_rad: np.ndarray, lens: np.ndarray | None = None) -> None:
        self._kind, self._weights, self._play_rad = data.kind, data.kind.weights, play_rad
        plays_rad = play_rad, play_rad + _LEAST_PLAY_RAD
        self._paths = [Path(behind_play(data, play_rad)) for play_rad in plays_rad]
        self._path = self._paths[0]
        z = data.z[self._path.indices]
        self._z = self._weights * (z if lens is None else self._kind.without_lens(z, *lens))
        self._spread_m = float(np.linalg.norm(self._z[:, :3].std(axis=0)))

    def start(self, workers: Workers) -> _Optimum:
        """The best of some random chains; an optimum that is found twice is taken for it."""
        rng, joints = np.random.default_rng(0), self._path.joints_and_velocities(0.0)[0]
        middle, reference = self._z.mean(axis=0), joints.mean(axis=0)
        drawn = (rng.normal(size=(2, len(reference), 3)) for _ in range(_MOST_STARTS))
        chains = (
            SerialChain(
                axes,
                middle[:3] + self._spread_m * points,
                middle,
                reference,
                on_arm=self._kind.on_arm,
            )
            for axes, points in drawn
        )
        optima: list[_Optimum] = []
        for optimum in workers(self._from_afar, chains):
            optima.append(optimum)
            best, *others = sorted(optimum.cost for optimum in optima)
            if len(optima) >= _LEAST_STARTS and others[0] < (1.0 + _SAME) * best + _SAME_COST:
                break
        optimum = min(optima, key=_cost)
        for joint in range(len(reference)):
            shifting = self._from_afar(with_slide(optimum.chain, joint))
            optimum = min(optimum, shifting, key=_cost)
        return optimum

    @threadpool_limits.wrap(limits=1)  # of a worker, too
    def _from_afar(self, chain: SerialChain) -> _Optimum:
        """The optimum from a start that may be far from it, by a new chart after some steps."""
        images, size = self._z.shape
        unit = np.broadcast_to(np.eye(size) / (_ROUGH * self._spread_m), (images, size, size))
        spread = np.linspace(0, images - 1, min(_SEARCH_SAMPLES, images)).astype(int)
        optimum = _Optimum(chain, 0.0, math.inf)
        for _ in range(_CHARTS):
            last = optimum
            optimum = self._solve(last, unit, spread, evaluations=_IN_A_CHART)
            if optimum.cost > (1.0 - _SAME) * last.cost:
                break
        return optimum

    def finish(self, optimum: _Optimum) -> ChainFit:
        """Fit all images, each weighed by its noise along and across the line of sight."""
        images = np.arange(len(self._z))
        weights = whitening(self._residuals(optimum), self._z)
        optimum = self._solve(optimum, weights, images)
        # Outliers had a small weight so far, but a long run of them would still bias the fit.
        inlier = inliers(self._residuals(optimum), self._z)
        if not inlier.all():
            optimum = self._solve(optimum, weights, images[inlier])
        joints, velocity = self._path.joints_and_velocities(optimum.offset_s)
        chart = Chart(optimum.chain)
        residual, slopes = residuals_and_slopes(
            chart, np.zeros(chart.size), joints, velocity, self._z
        )
        residual_m, noise_m = self._distances_m(residual)
        ray_m, lateral_m = noise_by_direction(residual[:, :3], self._z)
        inlier = inliers(residual, self._z)
        missed = (weights @ residual[..., None])[inlier].ravel()

        def beside(more: np.ndarray, prior: np.ndarray | float) -> tuple[np.ndarray, ...]:
            """Changes with p more unknowns of slopes (k, m, p), their covariance, that without."""
            columns = np.concatenate([slopes, more], axis=2)
            rows = (weights @ columns)[inlier].reshape(-1, columns.shape[2])
            deviation = np.full(columns.shape[2], _PRIOR)
            deviation[chart.size + OFFSET] = _OFFSET_PRIOR_S
            deviation[chart.size :] = prior
            known = rows.T @ rows + np.diag(deviation**-2)
            wider, own = np.linalg.inv(known), known[: chart.size, : chart.size]
            return -wider @ (rows.T @ missed), wider, np.linalg.inv(own)

        # A constant Jacobian beside the chain: noise alone makes a difference of the two fits as
        # large as that of their covariances.
        constant = np.kron(np.eye(self._z.shape[1]), (joints - joints.mean(axis=0))[:, None])
        change, wider, covariance = beside(constant, _PRIOR)
        unfitted = np.outer(change, change) - wider
        unfitted[: chart.size, : chart.size] += covariance
        # An error of the lens that is removed.
        z = self._z / self._weights
        without = [self._kind.without_lens(z, *error) for error in _STEP * np.eye(2)]
        by_lens = self._weights[:, None] * (z[..., None] - np.stack(without, axis=-1)) / _STEP
        change, wider, _ = beside(by_lens, _LENS_PRIOR)
        later = self._paths[1].joints_and_velocities(optimum.offset_s)[0]
        by_play = optimum.chain.jacobian(joints) * ((later - joints) / _LEAST_PLAY_RAD)[:, None]
        more_rad, doubt, _ = beside(by_play, _PLAY_PRIOR_RAD)
        n, deviation = len(self._play_rad), np.sqrt(np.diag(doubt))
        play_rad = np.clip(self._play_rad + more_rad[-n:], 0.0, MOST_PLAY_RAD)
        play_rad *= play_rad > np.maximum(_LENS_DEVIATIONS * deviation[-n:], _LEAST_PLAY_RAD)
        chain = optimum.chain.weighted(1.0 / self._weights)
        return ChainFit(
            chain=replace(chain, play_rad=self._play_rad),
            weights=self._weights,
            time_offset_s=optimum.offset_s,
            time_offset_deviation_s=float(np.sqrt(covariance[OFFSET, OFFSET])),
            residual_m=residual_m,
            noise_m=noise_m,
            ray_noise_m=ray_m,
            lateral_noise_m=lateral_m,
            outliers=int(np.count_nonzero(~inlier)),
            samples=len(residual),
            lens=change[-2:],
            lens_covariance=wider[-2:, -2:],
            play_rad=play_rad,
            covariance=covariance,
            unfitted=unfitted,
        )

    def _residuals(self, optimum: _Optimum) -> np.ndarray:
        joints = self._path.joints_and_velocities(optimum.offset_s)[0]
        return optimum.chain.position(joints) - self._z

    def _solve(
        self,
        begin: _Optimum,
        whitening: np.ndarray,
        images: np.ndarray,
        evaluations: int = 100,
    ) -> _Optimum:
        """The robust optimum for some images.

        The prior holds coordinates that the data do not determine. Residuals above two standard
        deviations have a decreasing weight.
        """
        chart = Chart(begin.chain)
        deviation = np.full(chart.size, _PRIOR)
        deviation[OFFSET] = _OFFSET_PRIOR_S
        first, limit = np.zeros(chart.size), np.full(chart.size, np.inf)
        limit[OFFSET] = MAX_OFFSET_S
        first[OFFSET] = np.clip(begin.offset_s, -0.99 * MAX_OFFSET_S, 0.99 * MAX_OFFSET_S)
        numbers = self._z[images].size + chart.size

        @lru_cache(maxsize=1)
        def white(content: bytes) -> tuple[np.ndarray, np.ndarray]:
            values = np.frombuffer(content)
            joints, velocity = self._path.joints_and_velocities(float(values[OFFSET]))
            try:
                residual, slopes = residuals_and_slopes(
                    chart, values, joints[images], velocity[images], self._z[images]
                )
            except ValueError:  # after a step too far, which is then made shorter
                return np.full(numbers, np.inf), np.empty(0)
            residual = np.append(whitening[images] @ residual[..., None], values / deviation)
            slopes = np.append(whitening[images] @ slopes, np.diag(1.0 / deviation))
            return residual, slopes.reshape(numbers, -1)

        solution = least_squares(
            lambda values: white(values.tobytes())[0],
            first,
            lambda values: white(values.tobytes())[1],
            bounds=(-limit, limit),
            loss="soft_l1",
            f_scale=2.0,
            max_nfev=evaluations,
            ftol=1e-6,
            xtol=1e-7,
            gtol=1e-10,
            x_scale=deviation,
        )
        offset_s, cost = float(solution.x[OFFSET]), float(solution.cost) / len(images)
        return _Optimum(chart.chain(solution.x), offset_s, cost)

    def _distances_m(self, residual: np.ndarray) -> tuple[float, float]:
        """Median length of the residuals, and of their noise part, m.

        The noise is estimated from differences of neighbours; NaN if there are too few of them.
        """
        passed_s = np.diff(self._path.stamps_s)
        apart_m = np.linalg.norm(np.diff(residual, axis=0), axis=1)
        apart_m = apart_m[(passed_s > 0.0) & (passed_s < MAX_GAP_S)]
        noise_m = math.nan
        if len(apart_m) >= LEAST_PAIRS:
            noise_m = float(np.median(apart_m)) / math.sqrt(2.0)
        return float(np.median(np.linalg.norm(residual, axis=1))), noise_m


def with_slide(chain: SerialChain, joint: int) -> SerialChain:
    """The chain with a prismatic joint that moves the point as before, at the reference joints."""
    axes, prismatic = chain.axes.copy(), chain.prismatic.copy()
    slope = chain.jacobian(chain.reference_rad)[:3, joint]
    axes[joint], prismatic[joint] = -slope if chain.on_arm else slope, 1.0
    return replace(chain, axes=axes, prismatic=prismatic)


def noise_by_direction(residual_m: np.ndarray, feature_m: np.ndarray) -> tuple[float, float]:
    """Deviations along the sight and across, by medians, m; of residuals, (k, 3), at (k, m)."""
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
        rotations = -cross_matrix(axes).reshape(images, size - 3, 3)
        rotations /= np.linalg.norm(rotations, axis=1, keepdims=True)
        back = np.swapaxes(rotations, 1, 2)
        of_rotation, lateral_m = by_noise((back @ residual_m[:, 3:, None])[..., 0])
        whole[:, 3:, 3:] = (np.eye(size - 3) - rotations @ back) / lateral_m
        whole[:, 3:, 3:] += rotations @ of_rotation @ back
    return whole


def inliers(residual_m: np.ndarray, feature_m: np.ndarray) -> np.ndarray:
    """Which images are within the noise, bool (k,)."""
    white = (whitening(residual_m, feature_m) @ residual_m[..., None])[..., 0]
    return np.asarray(np.abs(white).max(axis=1) <= OUTLIER)
