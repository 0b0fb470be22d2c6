"""A Kalman filter of a path that joints move and images measure, with the noise that it learns."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from fvs_ros.vectors import length

#: Share of the predicted motion that may be wrong. Smaller: what moves differently from the
#: prediction is followed late. Larger: noise is not averaged in motion.
_MODEL_ERROR = 0.05
#: The gain never falls below this: what is at rest may still drift.
_LEAST_GAIN = 0.02
#: Weight of a new innovation in their mean.
_MEAN_SHARE = 0.2
#: The mean's bound, in deviations: exceeded by chance once in 10^5 images.
_BEHIND = 5.0
#: Bound of one innovation in the mean, in deviations. Without it, the worst image of heavy-tailed
#: noise looks like a tool that has moved.
_MEAN_CLIP = 4.0
#: An image further off than this many standard deviations is an outlier.
OUTLIER = 6.0
#: Margin of that for systematic error, m.
GATE_M = 0.002
#: After this count in a row the camera or the tool moves, even if no two of them agree.
_REPEATS = 6

#: Bounds of the standard deviation of a coordinate, m; it is taken for the largest at first.
_LEAST_M, _MOST_M = 1e-4, 1e-2
#: Count of differences kept.
_WINDOW = 64
#: Weight of the initial guess among them.
_GUESS = 4
#: z-score of the lower quartile, which outliers hardly change.
_QUARTILE = -0.6745


class Image(NamedTuple):
    """One image, and the joints at its exposure."""

    stamp_s: float  #: exposure, s
    joints_rad: np.ndarray  #: joints then, rad, (n,)
    z: np.ndarray  #: what was measured, (m,)
    seen_m: np.ndarray  #: the path of z up to here: the sum of its motions, m, (d,)
    moved_m: np.ndarray  #: the part of it that the joints explain, sum J dr, from any origin, m
    run: int = 0  #: number of the continuous run it belongs to


class NoiseVariance:
    """Variance of a coordinate of white noise on a path that else changes smoothly.

    A divided difference of the second order is blind to a steady drift (a wrong Jacobian, a camera
    that is carried), one of the third to a steady acceleration as well. The lower quartile of its
    squares over that of a chi-square distribution (Wilson and Hilferty) is not moved by outliers
    now and then. ``variance_m2`` is of at least the square of ``least_m``: (1,) if all coordinates
    are pooled, else (d,).
    """

    def __init__(self, order: int = 2, least_m: float = _LEAST_M, pooled: bool = True) -> None:
        self.variance_m2 = np.array([_MOST_M**2])
        self._order, self._least_m2, self._pooled = order, least_m**2, pooled
        self._variances_m2: deque[np.ndarray] = deque(maxlen=_WINDOW)  # of each difference
        self._last: deque[tuple[float, np.ndarray]] = deque(maxlen=order + 1)

    def restart(self) -> None:
        """Begin a new run of the path; the learned variance stays."""
        self._last.clear()

    def add(self, time_s: float, path_m: np.ndarray) -> None:
        """Take the next point of the path, m, shape (d,), and its time, s, after the last one."""
        self._last.append((time_s, path_m))
        if len(self._last) <= self._order:
            return
        times_s, points_m = map(np.array, zip(*self._last, strict=True))
        apart_s = np.subtract.outer(times_s, times_s)
        np.fill_diagonal(apart_s, 1.0)
        weights = 1.0 / apart_s.prod(axis=1)
        difference = weights @ points_m
        d = len(difference) if self._pooled else 1
        squares = np.array([difference.dot(difference)]) if self._pooled else difference**2
        squares = squares / weights.dot(weights)
        spread = 2.0 / (9.0 * d)
        quartile = d * (1.0 - spread + _QUARTILE * spread**0.5) ** 3
        if not self._variances_m2:
            self._variances_m2.extend([np.full_like(squares, _MOST_M**2)] * _GUESS)
        self._variances_m2.append(squares / quartile)
        variance_m2 = np.sort(self._variances_m2, axis=0)[len(self._variances_m2) // 4]
        self.variance_m2 = np.clip(variance_m2, self._least_m2, _MOST_M**2)


class PathFilter:
    """Kalman filter of the path x that images measure, one coordinate like the other.

    The variance of the estimate has two parts, ``P + w^2 |c|^2``: the remaining noise of past
    images, and a share w of the predicted motion c that no image has corrected yet. A wrong
    Jacobian is as wrong at the next image, so its error grows with c at any speed; noise does not.
    With the noise variance R, the innovation's variance is ``S = P + w^2 |c|^2 + R``, and with the
    gain ``K = (P + w^2 |c|^2) / S``, bounded from below,

        c -> (1 - K) c,    P -> (1 - K)^2 P + K^2 R.

    At rest it averages the noise away; in motion it follows the images.
    """

    def __init__(self) -> None:
        self.noise = NoiseVariance()
        self.jumps = 0  #: how often the path began anew, after a jump that no motion explains
        self.restart()

    def restart(self) -> None:
        """Forget the path; the learned noise stays."""
        self.x: np.ndarray | None = None  #: the path at the newest image, m, (d,)
        self.moved_m = np.zeros(0)  #: what the joints had moved by then, m, (d,)
        self._P = 0.0
        self._c = np.zeros(0)
        self._mean = np.zeros(0)  # of the last innovations
        #: The newest images, with their innovations, m, (d,), that are off, and not yet confirmed.
        self.outliers: list[tuple[Image, np.ndarray]] = []
        self.noise.restart()

    @property
    def noise_m(self) -> float:
        """Standard deviation of a coordinate of an image, as learned, m."""
        return float(self.noise.variance_m2[0] ** 0.5)

    @property
    def deviation_m(self) -> float:
        """Standard deviation of a coordinate of the estimate, m."""
        return float(self._predicted_m2() ** 0.5)

    def _predicted_m2(self) -> float:
        return self._P + _MODEL_ERROR**2 * float(self._c.dot(self._c))

    def add(self, image: Image) -> list[Image]:
        """Take an image; returns those that are accepted now, oldest first.

        This one; none, for an outlier; this one and the outlier before it, where they agree.
        """
        if self.x is None:
            return self._begin(image)
        motion = image.moved_m - self.moved_m
        self.moved_m = image.moved_m
        self.x = self.x + motion
        self._c = self._c + motion
        innovation = image.seen_m - self.x
        R, predicted_m2 = float(self.noise.variance_m2[0]), self._predicted_m2()
        S = predicted_m2 + R
        off_m = (float(innovation.dot(innovation)) / len(innovation)) ** 0.5
        if off_m <= OUTLIER * S**0.5 + GATE_M:
            K = max(predicted_m2 / S, _LEAST_GAIN)
            self._P = (1.0 - K) ** 2 * self._P + K**2 * R
            self._c = (1.0 - K) * self._c
            self.x = self.x + K * innovation
            self.outliers.clear()
            self.noise.add(image.stamp_s, image.seen_m - image.moved_m)
            self._inflate_on_bias(innovation, S)
            return [image]
        before = self.outliers[-1] if self.outliers else None
        self.outliers.append((image, innovation))
        agreed = [image]
        # Two outliers in a row that agree show a camera or tool that was moved: detection errors
        # seldom repeat. The motion in between may be wrong altogether once a camera was turned.
        near_m = OUTLIER * 2.0**0.5 * self.noise_m + 2.0 * length(motion)
        if before is not None and length(innovation - before[1]) <= near_m:
            agreed = [before[0], image]
        elif len(self.outliers) < _REPEATS:
            return []
        self.jumps += 1
        return self._begin(*agreed)

    def _begin(self, *images: Image) -> list[Image]:
        image, self.outliers = images[-1], []
        self.x, self.moved_m = image.seen_m.copy(), image.moved_m
        for accepted in images:
            self.noise.add(accepted.stamp_s, accepted.seen_m - accepted.moved_m)
        self._P = float(self.noise.variance_m2[0])
        self._c = np.zeros_like(image.seen_m)
        self._mean = np.zeros_like(image.seen_m)
        return list(images)

    def _inflate_on_bias(self, innovation_m: np.ndarray, S: float) -> None:
        """Inflate the variance when innovations keep one direction, whatever the cause."""
        norm_m = length(innovation_m)
        clipped = min(1.0, _MEAN_CLIP * S**0.5 / max(norm_m, 1e-9)) * innovation_m
        self._mean = self._mean + _MEAN_SHARE * (clipped - self._mean)
        expected_m2 = S * _MEAN_SHARE / (2.0 - _MEAN_SHARE)
        if float(self._mean.dot(self._mean)) > _BEHIND**2 * expected_m2:
            self._P += norm_m**2 / len(innovation_m)
            self._mean = np.zeros_like(self._mean)
