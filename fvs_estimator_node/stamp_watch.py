"""Finds a constant time offset of the image stamps from the lengths of the ball's steps.

However a camera stands, it does not change how far the ball goes. So lengths tell stamps from
turns: with predicted positions p, seen ones x and a lag of n images,
``|x(k) - x(k - m)| = |p(k - n) - p(k - n - m)|`` for one n and every k. Each n is judged by what it
leaves of that. While the ball goes evenly, or rests, one n is as good as another, and nothing is
decided. A camera that is being carried changes lengths, too; so a lag counts only where the ball
went the way that it was to go.
"""

from __future__ import annotations

from collections import deque

import numpy as np

#: Largest lag that is looked for, images each way, and the images over which lengths are compared.
_MOST, _SPAN = 12, 3
_KEPT = _MOST + _SPAN + 1
#: Share of the past that is kept at each image: it decays by 63 % in 30.
_KEEP = 29.0 / 30.0
#: A lag counts if none leaves this many times as much, and a root sum square this much larger, m.
_TIMES, _WORSE_M = 3.0, 0.02
#: Share of the last positions' squared way that a lag may leave unexplained.
_OFF_SHARE = 0.1
#: A ball that went this much further in one image than predicted for any was bumped, or is seen in
#: a wrong place: it would count at other times for other lags, m.
_JUMP_M = 0.01


class StampWatch:
    """Finds the lag of the images behind the joints."""

    def __init__(self) -> None:
        self._kept: deque[tuple[float, np.ndarray, np.ndarray]] = deque(maxlen=_KEPT)
        self._left_m2 = np.zeros(2 * _MOST + 1)

    def add(self, stamp_s: float, seen_m: np.ndarray, predicted_m: np.ndarray) -> float:
        """Take one pair, in the order of the stamps.

        Parameters
        ----------
        stamp_s : float
            The pair's time, s.
        seen_m, predicted_m : ndarray, shape (m,)
            The ball in the image, and by the joints from any origin, m.

        Returns
        -------
        float
            How late the stamps are, s; negative for early ones, 0 where nothing says so.
        """
        self._kept.appendleft((stamp_s, seen_m, predicted_m))
        if len(self._kept) < _KEPT:
            return 0.0
        stamps_s, seen, predicted = (np.array(one) for one in zip(*self._kept, strict=True))
        if _lengths(seen, 1).max() > _lengths(predicted, 1).max() + _JUMP_M:
            return 0.0
        went_m, saw_m = _lengths(predicted, _SPAN), _lengths(seen, _SPAN)
        off_m = np.concatenate([saw_m[:0:-1] - went_m[0], saw_m[0] - went_m])
        self._left_m2 = _KEEP * self._left_m2 + off_m**2
        best = int(self._left_m2.argmin())
        lag, least_m2, now_m2 = best - _MOST, self._left_m2[best], self._left_m2[_MOST]
        if lag == 0 or now_m2 < _TIMES * least_m2 or now_m2 - least_m2 < _WORSE_M**2:
            return 0.0
        off = _off_share(predicted, seen, lag)
        if off > _OFF_SHARE or _TIMES * off > _off_share(predicted, seen, 0):
            return 0.0
        return (lag + self._between(best)) * float(np.median(-np.diff(stamps_s)))

    def _between(self, best: int) -> float:
        """How far the lowest point of the parabola through three lags is from the middle one."""
        if not 0 < best < 2 * _MOST:
            return 0.0
        left, middle, right = self._left_m2[best - 1 : best + 2]
        return float(0.5 * (left - right) / max(left - 2.0 * middle + right, 1e-12))


def _lengths(positions: np.ndarray, span: int) -> np.ndarray:
    """How far the ball went in a span of images that ended 0, 1, ... images ago, m."""
    return np.asarray(np.linalg.norm(positions[:-span] - positions[span:], axis=1))


def _off_share(predicted: np.ndarray, seen: np.ndarray, lag: int) -> float:
    """Share of the seen squared way that a lag leaves unexplained."""
    count = len(seen) - abs(lag)
    went, saw = predicted[max(lag, 0) :][:count], seen[max(-lag, 0) :][:count]
    went, saw = went - went.mean(axis=0), saw - saw.mean(axis=0)
    return float(np.square(saw - went).sum()) / max(float(np.square(saw).sum()), 1e-9)
