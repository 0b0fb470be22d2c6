"""How much of an image is believed against what the joints' motion predicts.

*Fixed* believes one share of every image. *Adaptive* is a Kalman filter of the ball's position,
one axis like the other two: it learns at rest how noisy the images are, and in motion by what
share of it the Jacobian mispredicts. At rest it averages the noise away; in motion, when the
prediction is worth less, it follows the images.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, inf

import numpy as np

FIXED, ADAPTIVE = "fixed", "adaptive"

#: Noise of an image before anything is known, its bounds, m.
_NOISE_M, _LEAST_NOISE_M, _MOST_NOISE_M = 1e-3, 5e-5, 2e-2
#: Share of the predicted motion that is wrong: before anything is known, and its bounds.
_WRONG, _LEAST_WRONG, _MOST_WRONG = 0.1, 0.005, 0.5
#: A motion between two images below this says nothing of the Jacobian, one above nothing of the
#: noise, m.
_STILL_M, _MOVED_M = 1e-3, 4e-3
#: Share of a new squared innovation in what is learned, after the first so many images.
_SHARE, _FIRST = 0.03, 5.0
#: The same for the prediction where all that was learned of it is to be learned anew; and the way
#: after which such a doubt has faded to 37 % where the ball is too slow to learn from, m.
_FIRST_MOVING, _FADE_M = 2.0, 0.05
#: An innovation counts for at most so many variances in what is learned.
_CLIP = 9.0
#: The gain never falls below this: what is at rest may still drift.
_LEAST_GAIN = 0.02
#: An image this far off is passed over: in standard deviations, and m besides.
_GATE, _GATE_M = 6.0, 0.002
#: Two outliers that are apart by less than this share of the first may agree.
_ALIKE = 0.5


@dataclass
class FixedFusion:
    """Believes a fixed share of each image.

    Parameters
    ----------
    gain : float
        The share K, above 0, at most 1.
    outlier_m : float
        An image further than this, plus the distance the ball was predicted to move, from the
        prediction is passed over, m.
    """

    gain: float = 0.3
    outlier_m: float = 0.03

    def __post_init__(self) -> None:
        if not 0.0 < self.gain <= 1.0:
            raise ValueError(f"fusion_gain must be above 0 and at most 1, got {self.gain}")
        if not 0.0 < self.outlier_m < inf:
            raise ValueError(f"outlier_m must be positive, got {self.outlier_m}")

    @property
    def noise_m(self) -> float | None:
        """Standard deviation of a coordinate of an image; None, for it is not learned."""
        return None

    @property
    def deviation_m(self) -> float | None:
        """Standard deviation of a coordinate of the estimate; None, for it is not known."""
        return None

    def restart(self) -> None:
        """Forget the estimate's past: it begins with an image."""

    def doubt(self) -> None:
        """Camera or ball was moved: nothing, for nothing was learned of the prediction."""

    def agree(self, first_m: np.ndarray, second_m: np.ndarray, motion_m: np.ndarray) -> bool:
        """Whether two outliers in a row, m, (3,), say the same: no, there is no saying."""
        return False

    def correct(self, innovation_m: np.ndarray, motion_m: np.ndarray) -> np.ndarray | None:
        """What to add to the prediction.

        Parameters
        ----------
        innovation_m : ndarray, shape (3,)
            Image minus prediction, m.
        motion_m : ndarray, shape (3,)
            Predicted motion since the last image, m.

        Returns
        -------
        ndarray, shape (3,), or None
            m; None for an outlier.
        """
        if not _norm(innovation_m) <= self.outlier_m + _norm(motion_m):
            return None
        return self.gain * innovation_m


class AdaptiveFusion:
    """Kalman filter that learns the noise of the images and the error of the prediction.

    ``P += (w |motion|)^2`` on the way from image to image, ``K = P / (P + R)``,
    ``P = (1 - K)^2 P + K^2 R``, which holds for the bounded gain, too; the innovations' squares
    teach R at rest and w in motion.
    """

    def __init__(self) -> None:
        self._noise2 = _NOISE_M**2
        self._wrong2 = _WRONG**2
        self._seen, self._seen_moving = 0.0, 1.0 / _SHARE
        self.restart()

    @property
    def noise_m(self) -> float | None:
        """Standard deviation of a coordinate of an image, as learned, m."""
        return float(self._noise2**0.5)

    @property
    def deviation_m(self) -> float | None:
        """Standard deviation of a coordinate of the estimate, m."""
        return float(self._variance**0.5)

    @property
    def wrong_share(self) -> float:
        """Share of the predicted motion that is wrong, as learned."""
        return float(self._wrong2**0.5)

    def restart(self) -> None:
        """Forget the estimate's past: it begins with an image. What was learned stays."""
        self._variance = self._noise2

    def doubt(self) -> None:
        """Camera or ball was moved: how wrong the prediction is now must be learned anew.

        Until the estimator has followed, whole images' worth of motion may be wrong. A filter that
        goes on believing the prediction would keep that error long after the Jacobian is right.
        """
        self._wrong2, self._seen_moving = _MOST_WRONG**2, 0.0

    def agree(self, first_m: np.ndarray, second_m: np.ndarray, motion_m: np.ndarray) -> bool:
        """Whether two outliers in a row, m, (3,), say the same: that camera or ball was moved.

        What is wrong about single images is seldom wrong twice in one way. The motion in between
        may be wrong altogether, for a camera that was turned.
        """
        apart = _norm(second_m - first_m)
        noise = _GATE * (2.0 * self._noise2) ** 0.5
        return apart <= min(noise + 2.0 * _norm(motion_m), _ALIKE * _norm(first_m))

    def correct(self, innovation_m: np.ndarray, motion_m: np.ndarray) -> np.ndarray | None:
        """What to add to the prediction, m, (3,), None for an outlier; see :class:`FixedFusion`."""
        moved = _norm(motion_m)
        before = self._variance
        self._variance += self._wrong2 * moved * moved
        total = self._variance + self._noise2
        square = float(innovation_m @ innovation_m) / 3.0
        if not square**0.5 <= _GATE * total**0.5 + _GATE_M:  # true for NaN, too
            return None
        self._learn(min(square, _CLIP * total), moved, before)
        gain = max(self._variance / (self._variance + self._noise2), _LEAST_GAIN)
        self._variance = (1.0 - gain) ** 2 * self._variance + gain**2 * self._noise2
        return gain * innovation_m

    def _learn(self, square: float, moved: float, before: float) -> None:
        if moved <= _MOVED_M and self._wrong2 > _WRONG**2:
            self._wrong2 = _WRONG**2 + (self._wrong2 - _WRONG**2) * exp(-moved / _FADE_M)
        if moved < _STILL_M:
            self._seen += 1.0
            share = max(_SHARE, 1.0 / (_FIRST + self._seen))
            self._noise2 += share * (square - before - self._noise2)
            self._noise2 = min(max(self._noise2, _LEAST_NOISE_M**2), _MOST_NOISE_M**2)
        elif moved > _MOVED_M:
            # One coordinate's share of the error, over the whole motion.
            wrong2 = (square - before - self._noise2) / (moved * moved)
            self._seen_moving += 1.0
            share = max(_SHARE, 1.0 / (_FIRST_MOVING + self._seen_moving))
            self._wrong2 += share * (wrong2 - self._wrong2)
            self._wrong2 = min(max(self._wrong2, _LEAST_WRONG**2), _MOST_WRONG**2)


Fusion = FixedFusion | AdaptiveFusion


def make_fusion(kind: str, gain: float, outlier_m: float) -> Fusion:
    """Build a fusion by name.

    Raises
    ------
    ValueError
        If the name is unknown or a number out of range.
    """
    if kind not in (FIXED, ADAPTIVE):
        raise ValueError(f"unknown fusion {kind!r}; known are {FIXED}, {ADAPTIVE}")
    fixed = FixedFusion(gain, outlier_m)
    return AdaptiveFusion() if kind == ADAPTIVE else fixed


def _norm(vector: np.ndarray) -> float:
    return float(vector @ vector) ** 0.5
