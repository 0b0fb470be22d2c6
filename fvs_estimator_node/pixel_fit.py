"""Fits a chain and the lens before it to the pixels of points, from no guess of either.

The unknowns are the 4 n + 3 K numbers of a chain of n joints that carries K points, the lens' focal
length, centre and k1, and how late a picture and each of its rows are exposed. They are found by
robust non-linear least squares with exact derivatives, from random starts on some points of some
images; the best go on to all.

The scale stays free: a pixel, and so the Jacobian, does not depend on it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from operator import attrgetter, itemgetter
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from fvs_estimator_node.chain_chart import Chart, residuals_and_slopes
from fvs_estimator_node.chain_fit import LEAST_PAIRS, ChainFitError, Fit, Workers, with_slide
from fvs_estimator_node.files import DataSet
from fvs_estimator_node.joint_path import MAX_OFFSET_S, Path
from fvs_ros.chain import SerialChain
from fvs_ros.filter import OUTLIER
from fvs_ros.pixel_chain import PixelChain, Webcam, points_of, slopes_of_points
from fvs_ros.timeline import MAX_GAP_S, too_slow

#: Fewest images of a motion that are fitted, and images of the search for the right start.
_LEAST_IMAGES, _SEARCH_IMAGES = 100, 200
#: Points of the search, and most pixels that are fitted: a minute of so many points determines the
#: Jacobian to 0.06 % or better, and more would only take longer.
_SEARCH_POINTS, _MOST_PIXELS = 4, 8000
#: Joints at which the fit's Jacobian is judged.
_JUDGED = 50
#: Random starts: at least, where the noise is unknown, and at most; and steps of each. One of four
#: reaches the best optimum, and some another whose residuals are larger by 2 %: the best few go on.
_LEAST_STARTS, _MOST_STARTS, _STEPS, _FEW = 30, 80, 60, 3
#: Of the starts: distances of the axes from the first point, which is at 1; the spread of the log
#: focal length; the least distance of a point from the camera.
_NEAR, _FOCAL, _CLOSEST = 0.4, 0.2, 0.3
#: First guess of a start's residuals, over the spread of the pixels. What is further off than this
#: after the fit is no chain's.
_ROUGH = 0.05
#: Residuals of the same optimum differ by less than this factor; and residual over noise above
#: which an optimum is not the best.
_SAME, _MISFIT_LIMIT = 1.02, 1.15
#: Least gain of a step, as a share of the cost: of the rough and the fine search, and of the fit.
_ENOUGH, _CONVERGED = (1e-3, 1e-4), 1e-7
#: Prior standard deviations of log f, k1, and c as a share of the longest side of the picture; of
#: the delays of a picture and of a row, s; of the chain's coordinates, in distances of the first
#: point and rad.
_LENS_PRIOR, _TIME_PRIOR_S, _PRIOR = (0.5, 0.2, 0.2), (0.1, 1e-4), 1.0
#: Relative deviation of the Jacobian, median over the data, above which there is no model: fits of
#: some seconds are often further off than they say.
_UNKNOWN = 0.02
#: Share of images left out above which there is none, either: what is left may be chosen to fit.
_MOST_LEFT_OUT = 0.3
#: Names of the webcam's numbers that are told.
WEBCAM_FIGURES = ("focal_px", "centre_u_px", "centre_v_px", "k1")
#: Step of the derivatives of the Jacobian by the coordinates.
_STEP = 1e-5


@dataclass(frozen=True, kw_only=True)
class PixelFit(Fit):
    """A fitted chain with its lens; residual and noise are standard deviations of a coordinate."""

    chain: PixelChain
    #: By the noise, (4 n + 3 K + 6, 4 n + 3 K + 6), of the coordinates of a
    #: :class:`~fvs_estimator_node.chain_chart.Chart` at the chain, then of log f, c, px, and k1;
    #: last ``late_s`` and ``line_s``.
    covariance: np.ndarray

    @property
    def webcam_deviation(self) -> np.ndarray:
        """Standard deviations of the webcam's ``numbers``, (6,)."""
        deviation: np.ndarray = np.sqrt(np.diag(self.covariance)[-6:])
        return np.append(self.chain.webcam.focal_px * deviation[0], deviation[1:])

    def figures(self) -> dict[str, float]:
        """Key figures by name; NaN where unknown."""
        found = zip(self.chain.webcam.numbers, self.webcam_deviation, strict=True)
        figures = super().figures()
        for name, (number, deviation) in zip(WEBCAM_FIGURES, found, strict=False):
            figures |= {name: float(number), f"{name}_deviation": float(deviation)}
        return figures

    def inliers(self, data: DataSet) -> np.ndarray:
        """Which images are within the noise, bool (k,)."""
        off_px = (self.chain.position(data.joints_rad) - data.z).reshape(len(data), -1, 2)
        return np.asarray(np.abs(off_px).max(axis=(1, 2)) <= OUTLIER * _deviation_px(off_px))

    def jacobian_deviation(self, joints_rad: np.ndarray) -> np.ndarray:
        """Relative deviation of the Jacobian by the noise, (k,), at joints, rad, (k, n)."""
        jacobian = self.chain.jacobian(joints_rad)
        steps = _STEP * np.eye(len(self.covariance))
        changes = [changed(self.chain, step).jacobian(joints_rad) - jacobian for step in steps]
        slopes = np.stack(changes, axis=-1).reshape(len(joints_rad), -1, len(steps)) / _STEP
        variance = np.sum(slopes @ self.covariance * slopes, axis=(1, 2))
        return np.asarray(np.sqrt(variance) / np.linalg.norm(jacobian, axis=(1, 2)))


def fit_pixels(
    data: DataSet, progress: Callable[[str], None] | None = None, workers: Workers = map
) -> PixelFit:
    """Fit a chain and its lens to pixels and joints.

    Parameters
    ----------
    data : DataSet
        Of the kind ``points``: a minute of motion of all joints, or still poses.
    progress : callable, optional
        Called with a text at each stage.
    workers : callable, optional
        Try the starts; the result does not depend on them.

    Raises
    ------
    ChainFitError
        If there is too little data, nothing fits, or the Jacobian is not known after the fit.
    """
    say, path = progress or (lambda words: None), Path(data)
    images, least = len(path.indices), _LEAST_IMAGES
    if data.still:
        least = math.ceil((4 * data.joints_rad.shape[1] + 6) / data.z.shape[1]) + 3
    if images < least:
        raise ChainFitError(
            f"a chain before a webcam needs at least {least} images in continuous runs, the data "
            f"set has {images}: "
            + (too_slow(data.stamps_s) or "collect longer, with all points in the picture")
        )
    fitting = _Fitting(path, data)
    if fitting.spread_px < 1.0:
        raise ChainFitError("the points do not move in the data set, so there is no chain to find")
    outer = _outer(fitting.pixels[0])
    columns = np.arange(data.z.shape[1]).reshape(-1, 2)[outer].ravel()
    search = _Fitting(path, replace(data, z=data.z[:, columns]))
    with threadpool_limits(1):  # matrices of few columns
        say("looking for the axes")
        start = search.start(workers)
        say("fitting")
        fit = search.finish(start)
        if len(columns) < data.z.shape[1]:
            fit = fitting.finish([fitting.with_all_points(fit.chain, outer)])
    if fit.residual_m > _ROUGH * fitting.spread_px * fitting.unit_m:
        raise ChainFitError(
            "no arm with these joints explains the pixels, which are "
            f"{data.kind.length_text(fit.residual_m, 1)} off it; check joint names and units, and "
            "that camera and points stayed fixed"
        )
    if fit.outliers > _MOST_LEFT_OUT * fit.samples:
        raise ChainFitError(
            f"{fit.outliers} of {fit.samples} images fit no chain; are the points always the same, "
            "in the same order?"
        )
    judged_rad = _spread(data.joints_rad, _JUDGED)
    deviation = float(np.median(fit.jacobian_deviation(judged_rad)))
    if not deviation <= _UNKNOWN:
        raise ChainFitError(
            f"the Jacobian is known to {100.0 * deviation:.1f} % only, at most "
            f"{100.0 * _UNKNOWN:g} % is needed; collect longer or in a wider box, with all joints"
        )
    return fit


def changed(model: PixelChain, values: np.ndarray) -> PixelChain:
    """The model at coordinates, those of the covariance; zeros are the model itself."""
    chain, numbers = np.append(values[:-6], 0.0), model.webcam.numbers
    numbers[0] *= math.exp(values[-6])
    numbers[1:] += values[-5:]
    return PixelChain(Chart(model.chain).chain(chain), Webcam.of_numbers(numbers))


def residuals(
    model: PixelChain, path: Path, pixels: np.ndarray, images: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Model minus pixels, px, (k, K, 2), of some images, and the derivatives, (k, K, 2, p).

    The latter are by the coordinates of :func:`changed`.
    """
    chart = Chart(model.chain)
    joints, velocity = (
        of_all[images] for of_all in path.joints_and_velocities(model.webcam.late_s)
    )
    nothing = np.zeros((len(joints), model.chain.feature_m.size))
    carried, slopes = residuals_and_slopes(chart, np.zeros(chart.size), joints, velocity, nothing)
    seen, by_point, by_lens = model.webcam.project(points_of(carried))
    slopes = by_point @ slopes_of_points(slopes)
    # Points below the middle of those seen are exposed later, and have moved further. How little
    # this changes the other derivatives does not count.
    below_px = pixels[images, :, 1:] - pixels[..., 1].mean()
    by_line = -slopes[..., -1] * below_px
    columns = [slopes[..., :-1], by_lens, slopes[..., -1:], by_line[..., None]]
    off_px = seen + model.webcam.line_s * by_line - pixels[images]
    return off_px, np.concatenate(columns, axis=-1)


class _Optimum(NamedTuple):
    """A model, its cost, gradient and, by Gauss and Newton, Hessian."""

    model: PixelChain
    cost: float
    gradient: np.ndarray
    hessian: np.ndarray


class _Fitting:
    """One fit to the pixels, (k, K, 2), of k images."""

    def __init__(self, path: Path, data: DataSet) -> None:
        self._path, self._weights = path, data.kind.weights
        #: Length that a pixel counts as, m.
        self.unit_m = float(self._weights[0])
        self.pixels = data.z[self._path.indices].reshape(len(self._path.indices), -1, 2)
        self.spread_px = float(np.linalg.norm(data.z[:, :2].std(axis=0)))
        self._middle, self._side = self.pixels.mean(axis=(0, 1)), float(np.abs(data.z).max())
        self._few = _spread(np.arange(len(self.pixels)), _SEARCH_IMAGES)

    def start(self, workers: Workers) -> list[PixelChain]:
        """The best few of some random chains, each joint of which may be prismatic, too."""
        rng = np.random.default_rng(0)
        optima: list[tuple[float, PixelChain]] = []

        def enough(improved: tuple[float, float, PixelChain]) -> bool:
            """Whether a few optima are as good as the best one, and that as the noise allows."""
            scale_px, noise_px, model = improved
            optima.append((scale_px, model))
            optima.sort(key=itemgetter(0))
            if len(optima) < (_LEAST_STARTS if math.isnan(noise_px) else _FEW):
                return False
            best_px, worst_px = optima[0][0], optima[_FEW - 1][0]
            return worst_px <= _SAME * best_px and not best_px > _MISFIT_LIMIT * noise_px

        starts = (self._random(rng) for _ in range(_MOST_STARTS))
        if not any(map(enough, workers(self._improved, starts))):
            for joint in range(len(optima[0][1].chain.axes)):
                best = optima[0][1]
                enough(self._improved(replace(best, chain=with_slide(best.chain, joint))))
        return [model for _, model in optima[:_FEW]]

    @threadpool_limits.wrap(limits=1)  # of a worker, too
    def _improved(self, model: PixelChain) -> tuple[float, float, PixelChain]:
        """The optimum from a start, after deviations of its residuals and of their noise, px."""
        scale_px, noise_px = _ROUGH * self.spread_px, math.nan
        for least_gain in _ENOUGH:  # beside a rough scale, the lens remains as guessed
            model = self._descend(model, self._few, scale_px, least_gain).model
            scale_px, noise_px = self._deviations_px(model)
        return scale_px, noise_px, model

    def _random(self, rng: np.random.Generator) -> PixelChain:
        """A chain anywhere about the points, which stay before a usual lens."""
        joints = self._path.joints_and_velocities(0.0)[0]
        central = _nearest(joints, joints.mean(axis=0))
        focal_px = self._side * math.exp(_FOCAL * rng.normal())
        rays = np.insert((self.pixels[central] - self._middle) / focal_px, 2, 1.0, axis=1)
        axes, near = rng.normal(size=(2, joints.shape[1], 3))
        near, carried = _NEAR * near, _carried(rays)
        while True:
            chain = SerialChain(axes, rays[0] + near, carried, joints[central])
            if points_of(chain.position(joints))[..., 2].min() > _CLOSEST:
                return PixelChain(chain, Webcam(focal_px, tuple(self._middle.tolist())))
            near, carried[3:] = 0.8 * near, 0.8 * carried[3:]

    def with_all_points(self, model: PixelChain, known: list[int]) -> PixelChain:
        """The model of some of the points with the others as far away as those."""
        joints, lens = self._path.joints_and_velocities(0.0)[0], model.webcam
        pixels = self.pixels[_nearest(joints, model.chain.reference_rad)]
        rays = np.insert((pixels - lens.centre_px) / lens.focal_px, 2, 1.0, axis=1)
        of_known = points_of(model.chain.feature_m)
        points = of_known[:, 2].mean() * rays
        points[known] = of_known
        return replace(model, chain=replace(model.chain, feature_m=_carried(points)))

    def finish(self, models: list[PixelChain]) -> PixelFit:
        """Fit all images, then without outliers, by the best of some models."""
        inliers, scale_px = np.arange(len(self.pixels)), self._deviations_px(models[0])[0]
        for _ in range(2):
            images = _spread(inliers, _MOST_PIXELS // self.pixels.shape[1])
            optima = [self._descend(model, images, scale_px, _CONVERGED) for model in models]
            optimum = min(optima, key=attrgetter("cost"))
            models = [optimum.model]
            scale_px, noise_px = self._deviations_px(optimum.model)
            off_px = np.abs(self._off_px(optimum.model)).max(axis=(1, 2))
            inliers = np.flatnonzero(off_px <= OUTLIER * scale_px)
        model, covariance = optimum.model, np.linalg.inv(optimum.hessian)
        return PixelFit(
            chain=model,
            weights=self._weights,
            time_offset_s=model.webcam.late_s,
            time_offset_deviation_s=float(covariance[-2, -2] ** 0.5),
            residual_m=self.unit_m * scale_px,
            noise_m=self.unit_m * noise_px,
            outliers=len(off_px) - len(inliers),
            samples=len(off_px),
            covariance=covariance,
        )

    def _off_px(self, model: PixelChain) -> np.ndarray:
        """Model minus pixels, px, (k, K, 2)."""
        joints, velocity = self._path.joints_and_velocities(model.webcam.late_s)
        seen, jacobian = model.position_and_jacobian(joints)
        below_px = self.pixels[..., 1:] - self.pixels[..., 1].mean()
        moved = (jacobian @ velocity[..., None]).reshape(self.pixels.shape)
        off_px = seen.reshape(self.pixels.shape) - self.pixels
        return np.asarray(off_px + model.webcam.line_s * below_px * moved)

    def _deviations_px(self, model: PixelChain) -> tuple[float, float]:
        """Standard deviations of a coordinate, px, and of its noise; see :class:`PixelFit`."""
        off_px, passed_s = self._off_px(model), np.diff(self._path.stamps_s)
        apart_px = np.diff(off_px, axis=0)[(passed_s > 0.0) & (passed_s < MAX_GAP_S)]
        noise_px = math.nan
        if len(apart_px) >= LEAST_PAIRS:
            noise_px = _deviation_px(apart_px) / math.sqrt(2.0)
        return _deviation_px(off_px), noise_px

    def _descend(
        self, model: PixelChain, images: np.ndarray, scale_px: float, least_gain: float
    ) -> _Optimum:
        """The optimum that the steps of Levenberg, Marquardt and Nielsen lead to."""
        best, damping, growth = self._optimum(model, images, scale_px), 0.01, 2.0
        for _ in range(_STEPS):
            held = damping * np.diag(best.hessian)
            step = np.linalg.solve(best.hessian + np.diag(held), -best.gradient)
            try:
                tried = self._optimum(changed(best.model, step), images, scale_px)
            except (ValueError, OverflowError):  # after a step too far, which is then made shorter
                tried = best
            gain = best.cost - tried.cost
            if gain > 0.0:
                expected = step @ (held * step - best.gradient)
                damping *= max(0.1, 1.0 - (2.0 * gain / expected - 1.0) ** 3)
                best, growth = tried, 2.0
                if gain < least_gain * best.cost:
                    break
            else:
                damping, growth = damping * growth, 2.0 * growth
                if damping > 1e8:  # no step is short enough
                    break
        return best

    def _optimum(self, model: PixelChain, images: np.ndarray, scale_px: float) -> _Optimum:
        """A model with its cost, in which pixels that are far off count less."""
        lens = model.webcam
        if abs(lens.late_s) > MAX_OFFSET_S:
            raise ValueError(f"images are stamped late by {lens.late_s:g} s")
        residual, slopes = residuals(model, self._path, self.pixels, images)
        residual, slopes = residual / scale_px, slopes / scale_px
        root = np.sqrt(1.0 + np.sum(residual**2, axis=-1, keepdims=True) / 4.0)
        rows = (slopes / np.sqrt(root)[..., None]).reshape(residual.size, -1)
        missed = (residual / np.sqrt(root)).ravel()
        # The chain's coordinates begin at the model, so that their prior only holds them.
        held, deviation = np.zeros((2, rows.shape[1]))
        held[-6:] = lens.numbers - [self._side, *self._middle, 0.0, 0.0, 0.0]
        held[-6] = math.log(lens.focal_px / self._side)
        focal, k1, centre = _LENS_PRIOR
        deviation[:-6], deviation[-2:] = _PRIOR, _TIME_PRIOR_S
        deviation[-6:-2] = focal, centre * self._side, centre * self._side, k1
        cost = 8.0 * float(np.sum(root - 1.0)) + float(np.sum((held / deviation) ** 2))
        gradient = rows.T @ missed + held / deviation**2
        return _Optimum(model, cost, gradient, rows.T @ rows + np.diag(deviation**-2))


def _carried(points: np.ndarray) -> np.ndarray:
    """What a chain carries, (3 K,), of points, (K, 3): the inverse of :func:`points_of`."""
    return np.append(points[0], (points[1:] - points[0]).ravel())


def _outer(pixels: np.ndarray) -> list[int]:
    """The outermost of some points, (K, 2), if there are more than the search takes."""
    if len(pixels) <= _SEARCH_POINTS:
        return list(range(len(pixels)))
    u, v = pixels.T
    ends = [end for along in (u + v, u - v) for end in (along.argmin(), along.argmax())]
    return sorted({int(end) for end in ends})


def _nearest(joints_rad: np.ndarray, to_rad: np.ndarray) -> int:
    return int(np.linalg.norm(joints_rad - to_rad, axis=1).argmin())


def _spread(values: np.ndarray, most: int) -> np.ndarray:
    """At most so many rows, evenly."""
    return values[np.linspace(0, len(values) - 1, min(most, len(values))).astype(int)]


def _deviation_px(off_px: np.ndarray) -> float:
    """Standard deviation of a coordinate, px, of vectors, (..., 2), by their median length."""
    lengths = np.linalg.norm(off_px, axis=-1)
    return max(float(np.median(lengths)) / 1.1774, 1e-3)  # the median of a Rayleigh distribution
