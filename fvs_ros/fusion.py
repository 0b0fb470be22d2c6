"""How much of an image is believed against what the joints' motion predicts.

A Kalman filter of the feature's position, one axis like the other: it learns how noisy the images
are, and by what share of a motion the Jacobian mispredicts it. At rest it averages the noise away;
in motion, when the prediction is worth less, and where the camera itself is moved, it follows the
images.
"""

from __future__ import annotations

from collections import deque
from math import exp, inf

import numpy as np

from fvs_ros.vectors import length

#: Noise of an image before anything is known, its bounds, m.
_NOISE_M, _LEAST_NOISE_M, _MOST_NOISE_M = 1e-3, 5e-5, 2e-2
#: Share of the predicted motion that is wrong: before anything is known, and its bounds.
_WRONG, _LEAST_WRONG, _MOST_WRONG = 0.1, 0.002, 0.5
#: A motion below this says nothing of the Jacobian, m; and where it changes by more from image to
#: image, what it brings changes, too, and is not told from noise.
_MOVED_M, _STEADY_M = 4e-3, 1e-3
#: Share of a new innovation in their mean, and how far that may be off, in squared deviations of
#: all three coordinates: chance gets there once in 10^5 images.
_BEHIND_SHARE, _BEHIND = 0.2, 25.0
#: A single innovation counts for at most so many deviations of a coordinate there: it takes three
#: in a row, or a heavy tail's worst image would be taken for a ball that has gone elsewhere.
_BEHIND_CLIP = 4.0
#: Share of a new squared innovation in what is learned, after the first so many images.
_SHARE, _FIRST = 0.03, 5.0
#: The same for the prediction where all that was learned of it is to be learned anew; and the way
#: after which such a doubt has faded to 37 % where the ball is too slow to learn from, m.
_FIRST_MOVING, _FADE_M = 2.0, 0.05
#: An innovation counts for at most so many variances in what is learned.
_CLIP = 9.0
#: The gain never falls below this: what is at rest may still drift.
_LEAST_GAIN = 0.02
#: So many swings of the images are looked at for noise that the arm's own motion hides; the one of
#: this rank among them is, in the mean, so many variances; and noise is raised towards what they
#: say, by so large a share, where that is so many times the variance learned.
_SWINGS, _RANK, _OF_RANK, _SWING_SHARE, _TOO_CALM = 12, 1, 3.1, 0.3, 10.0
#: An image this far off is passed over: in standard deviations, and m besides.
_GATE, _GATE_M = 6.0, 0.002
#: Two outliers that are apart by less than this share of the first may agree.
_ALIKE = 0.5


class Fusion:
    """Kalman filter that learns the noise of the images and the error of the prediction.

    What is wrong about the estimate has two parts, ``P + w^2 |c|^2``: what is left of the noise of
    past images, and a share w of the motion c that was predicted and not yet corrected. A Jacobian
    that is wrong now is as wrong at the next image: its error adds up over c, where that of noise
    would not, so that the ball may go as slowly as it likes. With the gain
    ``K = (P + w^2 |c|^2) / (P + w^2 |c|^2 + R)``, bounded from below,

        c -> (1 - K) c,    P -> (1 - K)^2 P + K^2 R.

    R is learned from how images change beyond what is predicted: a change that stays (the Jacobian
    is wrong, the camera is being carried) is no noise. w is learned from innovations after a
    motion. Innovations that go on pointing one way tell that the estimate is behind, whatever the
    cause: it is then doubted by as much.
    """

    def __init__(self) -> None:
        self._noise2 = _NOISE_M**2
        self._wrong2 = _WRONG**2
        self._seen, self._seen_moving = 0.0, _FIRST_MOVING
        self._swings_m2: deque[float] = deque(maxlen=_SWINGS)
        self._step: np.ndarray | None = None
        self._motion_before = np.zeros(3)
        self.restart()

    @property
    def noise_m(self) -> float:
        """Standard deviation of a coordinate of an image, as learned, m."""
        return float(self._noise2**0.5)

    @property
    def deviation_m(self) -> float:
        """Standard deviation of a coordinate of the estimate, m."""
        return float(self._variance() ** 0.5)

    @property
    def wrong_share(self) -> float:
        """Share of the predicted motion that is wrong, as learned."""
        return float(self._wrong2**0.5)

    def restart(self) -> None:
        """Forget the estimate's past: it begins with an image. What was learned stays."""
        self._settled = self._noise2
        self._uncorrected = np.zeros(3)
        self._behind = np.zeros(3)
        self._left: np.ndarray | None = None
        self._change: np.ndarray | None = None
        self._motion = np.zeros(3)
        self._off = np.zeros(3)  # from the estimate to the last image

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
        apart = length(second_m - first_m)
        noise = _GATE * (2.0 * self._noise2) ** 0.5
        return apart <= min(noise + 2.0 * length(motion_m), _ALIKE * length(first_m))

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
        square = float(innovation_m @ innovation_m) / 3.0
        self._uncorrected = self._uncorrected + motion_m
        if not square < inf:  # or not a number
            self._left = self._change = None
            return None
        self._look_for_noise(innovation_m, motion_m)
        total = self._variance() + self._noise2
        if square**0.5 > _GATE * total**0.5 + _GATE_M:
            self._left = self._change = None
            self._off = innovation_m
            return None
        self._learn_noise(innovation_m, motion_m)
        self._learn_wrong(min(square, _CLIP * total), length(motion_m))
        self._look_behind(innovation_m, square)
        variance = self._variance()
        gain = max(variance / (variance + self._noise2), _LEAST_GAIN)
        self._settled = (1.0 - gain) ** 2 * self._settled + gain**2 * self._noise2
        self._uncorrected = (1.0 - gain) * self._uncorrected
        self._left = self._off = (1.0 - gain) * innovation_m
        return gain * innovation_m

    def _variance(self) -> float:
        """Of a coordinate of the estimate, m^2."""
        far = self._uncorrected
        return float(self._settled + self._wrong2 * far.dot(far))

    def _look_for_noise(self, innovation_m: np.ndarray, motion_m: np.ndarray) -> None:
        """Raise R where the images swing more than it and the wrongest prediction explain.

        Noise that is far above what is known of it throws the arm about, is passed over for that,
        and would never be learned: neither in motion nor from outliers. But from image to image
        nothing else changes its direction so: a step beyond what is predicted is alike from one to
        the next, but for what the motion changed, and that is wrong by half of itself where the
        camera was turned by 30 degrees. (More must not be granted: an arm that noise throws about
        bends its way from image to image.) Outliers swing, too, but over two images there and
        back again: noise is what shows both ways. With ``d = n - n' + b``, ``d - d'`` has six
        variances of a coordinate, ``d + d'`` two. Nearly all of the swings must be large.
        """
        before, self._step = self._step, innovation_m - self._off
        bend = motion_m - self._motion_before
        self._motion_before = motion_m
        if before is None:
            return
        swing, way = self._step - before, self._step + before
        swing_m2 = float(swing.dot(swing)) - 0.25 * float(bend.dot(bend))
        self._swings_m2.append(min(swing_m2, 3.0 * float(way.dot(way))))
        if len(self._swings_m2) < _SWINGS:
            return
        noise2 = sorted(self._swings_m2)[_RANK] / _OF_RANK
        if noise2 > _TOO_CALM * self._noise2:
            self._noise2 += _SWING_SHARE * (min(noise2, _CLIP * self._noise2) - self._noise2)
            self._noise2 = min(self._noise2, _MOST_NOISE_M**2)

    def _learn_noise(self, innovation_m: np.ndarray, motion_m: np.ndarray) -> None:
        """Learn R of white noise n and a change b that is the same from image to image.

        With ``d = n - n' + b`` and ``d' = n' - n'' + b``, ``d d - d d'`` is three times R.
        """
        before, left, last_m = self._change, self._left, self._motion
        self._change = None if left is None else innovation_m - left
        self._motion = motion_m
        if before is None or self._change is None or length(motion_m - last_m) > _STEADY_M:
            return
        noise2 = float(self._change @ (self._change - before)) / 9.0
        most = _CLIP * self._noise2
        self._seen += 1.0
        share = max(_SHARE, 1.0 / (_FIRST + self._seen))
        self._noise2 += share * (min(max(noise2, -most), most) - self._noise2)
        self._noise2 = min(max(self._noise2, _LEAST_NOISE_M**2), _MOST_NOISE_M**2)

    def _learn_wrong(self, square: float, moved: float) -> None:
        far2 = float(self._uncorrected @ self._uncorrected)
        if far2 > _MOVED_M**2:
            # One coordinate's share of the error, over the whole motion.
            wrong2 = (square - self._settled - self._noise2) / far2
            self._seen_moving += 1.0
            share = max(_SHARE, 1.0 / (_FIRST_MOVING + self._seen_moving))
            self._wrong2 += share * (wrong2 - self._wrong2)
            self._wrong2 = min(max(self._wrong2, _LEAST_WRONG**2), _MOST_WRONG**2)
        elif self._wrong2 > _WRONG**2:
            self._wrong2 = _WRONG**2 + (self._wrong2 - _WRONG**2) * exp(-moved / _FADE_M)

    def _look_behind(self, innovation_m: np.ndarray, square: float) -> None:
        """Doubt the estimate where innovations go on pointing one way."""
        total = self._variance() + self._noise2
        heard_m = innovation_m * min(1.0, _BEHIND_CLIP * (total / max(3.0 * square, 1e-18)) ** 0.5)
        self._behind = self._behind + _BEHIND_SHARE * (heard_m - self._behind)
        expected = total * _BEHIND_SHARE / (2.0 - _BEHIND_SHARE)
        if float(self._behind @ self._behind) > _BEHIND * expected:
            self._settled += square
            self._behind = np.zeros(3)
