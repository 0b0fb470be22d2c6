"""Whether the camera was just turned: the last steps then fit another rotation far better.

A blow to the camera moves the ball in its view, and mostly by more than the joints explain. But the
turn and the shift may cancel where the ball happens to be; then it shows only by the way the next
steps go. Each of them is judged by noise: with residuals ``dx - p`` of predicted steps p, and Q the
rotation that fits the last few best, the gain ``sum |dx - p|^2 - sum |dx - Q p|^2`` over the
variance of a step is chi-square distributed with three degrees of freedom while nothing was turned.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

import numpy as np

from fvs_estimator_node.rotations import nearest_rotation, rotation_angle_rad
from fvs_ros.vectors import length

#: The last steps that are looked at: so many at least and at most, and no more than these m need.
_FEWEST, _MOST_STEPS, _WAY_M = 3, 6, 0.03
#: Chi-square, 3 degrees of freedom, that chance exceeds once in some ten million steps.
_CHANCE = 36.0
#: A smaller turn is followed without being noticed, rad; what stays unexplained, a share at most.
_LEAST_RAD, _UNEXPLAINED = 0.25, 0.3
#: Variance of one coordinate of a step, m^2: the first guess, and its bounds; share of a new square
#: in it, and how many variances one counts for at most, at rest and in motion, where it may be the
#: turn that is looked for. Nothing is judged before so many were heard, nor beyond so large a share
#: of the largest variance.
_VARIANCE_M2, _LEAST_M2, _MOST_M2 = 2e-6, 8e-8, 2e-4
_TOO_NOISY = 0.75
_SHARE, _CLIP_STILL, _CLIP, _HEARD = 0.03, 9.0, 3.0, 20
#: How little the identity counts where the steps leave a rotation open.
_TINY = 1e-3

Step = tuple[np.ndarray, np.ndarray]


class TurnWatch:
    """Compares what was predicted of the last steps with what was seen."""

    def __init__(self) -> None:
        self._variance_m2 = _VARIANCE_M2
        self._heard = 0
        self._steps: deque[Step] = deque(maxlen=_MOST_STEPS)

    @property
    def deviation_m(self) -> float:
        """Standard deviation of one coordinate of a step, as learned, m."""
        return float(self._variance_m2**0.5)

    @property
    def too_noisy(self) -> bool:
        """Whether the noise is so large that more of it would not be known from a turn."""
        return self._variance_m2 > _TOO_NOISY * _MOST_M2

    def clear(self) -> None:
        """Forget the steps; the noise stays known."""
        self._steps.clear()

    def add(self, factor: np.ndarray, predicted_m: np.ndarray, seen_m: np.ndarray) -> list[Step]:
        """Tell one step, and hear whether it and those before it are of a camera that was turned.

        Parameters
        ----------
        factor : ndarray, shape (3, 3)
            What the predictions are to be multiplied with, as known now.
        predicted_m, seen_m : ndarray, shape (3,)
            The ball's step before the factor, and as seen, m.

        Returns
        -------
        list of (ndarray, ndarray)
            The steps, predicted and seen, that were made since the turn; empty without one.
        """
        self._steps.append((predicted_m, seen_m))
        steps = self._last()
        enough = len(steps) >= _FEWEST and self._heard >= _HEARD and not self.too_noisy
        if enough and self._turned(factor, steps):
            self._steps.clear()
            return steps
        self._hear(seen_m - factor @ predicted_m, _CLIP)
        return []

    def rest(self, seen_m: np.ndarray) -> None:
        """Tell what was seen of a step in which nothing moved, m, (3,): noise."""
        self._hear(seen_m, _CLIP_STILL)

    def _hear(self, off_m: np.ndarray, clip: float) -> None:
        square = float(off_m @ off_m) / 3.0
        if not math.isfinite(square):
            return
        self._heard += 1
        share = _SHARE
        if self._heard > _HEARD:
            square = min(square, clip * self._variance_m2)
        else:  # the mean of all, with the first guess as one of them
            share = 1.0 / (1.0 + self._heard)
            square = min(square, _MOST_M2)
        self._variance_m2 += share * (square - self._variance_m2)
        self._variance_m2 = min(max(self._variance_m2, _LEAST_M2), _MOST_M2)

    def _last(self) -> list[Step]:
        steps: list[Step] = []
        way_m = 0.0
        for step in reversed(self._steps):
            steps.insert(0, step)
            way_m += length(step[0])
            if len(steps) >= _FEWEST and way_m > _WAY_M:
                break
        return steps

    def _turned(self, factor: np.ndarray, steps: Iterable[Step]) -> bool:
        predicted, seen = (np.array(one) for one in zip(*steps, strict=True))
        predicted = predicted @ factor.T
        off2 = np.square(seen - predicted).sum(axis=1)
        before = float(off2.sum())
        if before <= _CHANCE * self._variance_m2:
            return False
        size = float(np.square(predicted).sum())
        turn = nearest_rotation(seen.T @ predicted + _TINY * size * np.eye(3))
        left2 = np.square(seen - predicted @ turn.T).sum(axis=1)
        after = float(left2.sum())
        return bool(
            before - after > _CHANCE * self._variance_m2
            and after < _UNEXPLAINED * before
            # Every step speaks for it: what fits a single outlier does not fit its neighbours.
            and (left2 < off2).all()
            and rotation_angle_rad(turn) > _LEAST_RAD
        )
