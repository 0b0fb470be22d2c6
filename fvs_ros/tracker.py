"""Tracks the feature from images and predicted motion, and finds outliers.

One filter and one innovation (seen minus predicted) serve every method and law. Whether the image
follows the arm is judged from the accepted images (:mod:`fvs_controller_node.prediction`).
"""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple

import numpy as np

from fvs_ros.vectors import length

#: Share of the predicted motion that may be wrong. Smaller: a ball that moves differently from the
#: prediction is followed late. Larger: noise is not averaged in motion.
_MODEL_ERROR_SHARE = 0.05
#: The gain never falls below this: what is at rest may still drift.
_LEAST_GAIN = 0.02
#: Weight of a new innovation in their mean; the mean's bound, in deviations (exceeded by chance
#: once in 10^5 images); and the bound of one innovation, in deviations. Without the last, the worst
#: image of heavy-tailed noise looks like a ball that has moved.
_MEAN_SHARE, _BEHIND, _MEAN_CLIP = 0.2, 5.0, 4.0
#: An image further off is an outlier: in standard deviations, plus m.
OUTLIER, _GATE_M = 6.0, 0.002
#: After this count in a row the camera or ball moves, even if no two of them agree.
_REPEATS = 6

#: Bounds of the standard deviation of a coordinate, m; it is taken for the largest at first.
_LEAST_M, _MOST_M = 1e-4, 1e-2
#: Count of second differences kept, and the weight of the initial guess among them.
_WINDOW, _GUESS = 64, 4
#: The lower quartile is used, which outliers hardly change: its z-score.
_QUARTILE = -0.6745


class Image(NamedTuple):
    """One image, and the arm's motion up to it.

    Parameters
    ----------
    stamp_s : float
        Exposure, s.
    seen_m : ndarray, shape (m,)
        The feature as seen, m.
    moved_m : ndarray, shape (m,)
        What the joints have moved it by then, ``sum J dr``, from any origin, m.
    source : object
        What the caller wants back with it.
    """

    stamp_s: float
    seen_m: np.ndarray
    moved_m: np.ndarray
    source: Any = None


class NoiseVariance:
    """Variance of a coordinate of white noise n on a residual that else changes steadily.

    The second difference ``n - 2 n' + n''`` has six variances, and is blind to a steady drift (a
    wrong Jacobian, a camera that is carried). The lower quartile of its squares over that of a
    chi-square distribution (Wilson and Hilferty) is not moved by outliers now and then.
    """

    def __init__(self) -> None:
        self.variance_m2 = _MOST_M**2
        self._squares_m2: deque[float] = deque(maxlen=_WINDOW)
        self._residual: np.ndarray | None = None
        self._change: np.ndarray | None = None

    @property
    def known(self) -> bool:
        """Whether the lower quartile is that of residuals, not of the initial guess."""
        return len(self._squares_m2) >= _GUESS + 2

    def restart(self) -> None:
        """Begin a new run of residuals; the learned variance stays."""
        self._residual = self._change = None

    def add(self, residual_m: np.ndarray) -> None:
        """Take the next residual, m, shape (m,)."""
        change = None if self._residual is None else residual_m - self._residual
        if change is not None and self._change is not None:
            second = change - self._change
            if not self._squares_m2:
                self._squares_m2.extend([self._quartile(len(second)) * self.variance_m2] * _GUESS)
            self._squares_m2.append(float(second.dot(second)))
            found = sorted(self._squares_m2)[len(self._squares_m2) // 4]
            found /= self._quartile(len(second))
            self.variance_m2 = min(max(found, _LEAST_M**2), _MOST_M**2)
        self._residual, self._change = residual_m, change

    @staticmethod
    def _quartile(m: int) -> float:
        """Lower quartile of the square of a second difference, in variances of a coordinate."""
        share = 2.0 / (9.0 * m)
        return 6.0 * m * (1.0 - share + _QUARTILE * share**0.5) ** 3


class Tracker:
    """Kalman filter of the feature's position, one axis like the other.

    The variance of the estimate has two parts, ``P + w^2 |c|^2``: the remaining noise of past
    images, and a share w of the predicted motion c that no image has corrected yet. A wrong
    Jacobian is as wrong at the next image, so its error grows with c at any speed of the ball;
    noise does not. With the noise variance R and the gain
    ``K = (P + w^2 |c|^2) / (P + w^2 |c|^2 + R)``, bounded from below,

        c -> (1 - K) c,    P -> (1 - K)^2 P + K^2 R.

    At rest it averages the noise away; in motion it follows the images.
    """

    def __init__(self) -> None:
        self.noise = NoiseVariance()
        self.restart()

    def restart(self) -> None:
        """Forget the position; the learned noise stays."""
        #: The feature at the newest image, m, (m,); None before the first.
        self.estimate_m: np.ndarray | None = None
        #: What the joints had moved it by then, m, (m,).
        self.moved_m = np.zeros(0)
        self._variance_m2 = 0.0  # P
        self._uncorrected = np.zeros(0)  # c
        self._mean = np.zeros(0)  # of the last innovations
        self._outliers: list[tuple[Image, np.ndarray]] = []  # and their innovations
        self.noise.restart()

    @property
    def noise_m(self) -> float:
        """Standard deviation of a coordinate of an image, as learned, m."""
        return float(self.noise.variance_m2**0.5)

    @property
    def deviation_m(self) -> float:
        """Standard deviation of a coordinate of the estimate, m."""
        return float(self._prediction_variance_m2() ** 0.5)

    def _prediction_variance_m2(self) -> float:
        far = self._uncorrected
        return self._variance_m2 + _MODEL_ERROR_SHARE**2 * float(far.dot(far))

    def add(self, image: Image) -> list[Image]:
        """Take an image.

        Returns
        -------
        list of Image
            Those that are accepted now, oldest first: this one; none, for an outlier; this one and
            the outliers before it, where they turn out to be true.
        """
        if self.estimate_m is None:
            return self._reinitialise(image)
        motion = image.moved_m - self.moved_m
        self.moved_m = image.moved_m
        self.estimate_m = self.estimate_m + motion
        self._uncorrected = self._uncorrected + motion
        innovation = image.seen_m - self.estimate_m
        noise_m2, predicted_m2 = self.noise.variance_m2, self._prediction_variance_m2()
        off_m = (float(innovation.dot(innovation)) / len(innovation)) ** 0.5
        if off_m <= OUTLIER * (predicted_m2 + noise_m2) ** 0.5 + _GATE_M:
            gain = max(predicted_m2 / (predicted_m2 + noise_m2), _LEAST_GAIN)
            self._variance_m2 = (1.0 - gain) ** 2 * self._variance_m2 + gain**2 * noise_m2
            self._uncorrected = (1.0 - gain) * self._uncorrected
            self.estimate_m = self.estimate_m + gain * innovation
            self._outliers.clear()
            self.noise.add(image.seen_m - image.moved_m)
            self._inflate_on_bias(innovation, predicted_m2 + noise_m2)
            return [image]
        before = self._outliers[-1][1] if self._outliers else None
        self._outliers.append((image, innovation))
        agreed = before is not None and self._agree(before, innovation, motion)
        if not agreed and len(self._outliers) < _REPEATS:
            return []
        return self._reinitialise(image)

    def _agree(self, first_m: np.ndarray, second_m: np.ndarray, motion_m: np.ndarray) -> bool:
        """Whether two outliers in a row, m, (m,), agree: the camera or ball was moved.

        Detection errors seldom repeat. The predicted motion in between may be entirely wrong after
        a turn of the camera.
        """
        apart = length(second_m - first_m)
        return apart <= OUTLIER * 2.0**0.5 * self.noise_m + 2.0 * length(motion_m)

    def _reinitialise(self, image: Image) -> list[Image]:
        images = [outlier for outlier, _ in self._outliers] or [image]
        self._outliers = []
        self.estimate_m, self.moved_m = image.seen_m.copy(), image.moved_m
        for one in images:
            self.noise.add(one.seen_m - one.moved_m)
        self._variance_m2 = self.noise.variance_m2
        self._uncorrected = np.zeros_like(image.seen_m)
        self._mean = np.zeros_like(image.seen_m)
        return images

    def _inflate_on_bias(self, innovation_m: np.ndarray, total_m2: float) -> None:
        """Inflate the variance when innovations keep one direction, whatever the cause."""
        norm_m = length(innovation_m)
        heard = min(1.0, _MEAN_CLIP * total_m2**0.5 / max(norm_m, 1e-9))
        self._mean = self._mean + _MEAN_SHARE * (heard * innovation_m - self._mean)
        expected_m2 = total_m2 * _MEAN_SHARE / (2.0 - _MEAN_SHARE)
        if float(self._mean.dot(self._mean)) > _BEHIND**2 * expected_m2:
            self._variance_m2 += norm_m**2 / len(innovation_m)
            self._mean = np.zeros_like(self._mean)
