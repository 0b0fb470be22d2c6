"""Whether the images are stamped late or early: the ball then goes as predicted, but not when.

However a camera stands, and however it is moved between two images, it does not change how far the
ball goes. So lengths tell stamps from turns: with model positions p, seen ones x and a lag of n
images, ``|x(k) - x(k - m)| = |p(k - n) - p(k - n - m)|`` for one n and every k. Each n of a grid is
judged by what it leaves of that, where the ball starts, stops or changes its speed. As long as
it goes evenly, or rests, one n is as good as another, and nothing is decided. Who carries the
camera changes lengths, too; so a lag counts only where the ball went the way that it was to go.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

#: Lags that are looked for, images each way, and the images over which lengths are compared.
_MOST, _SPAN = 12, 3
_KEPT = _MOST + _SPAN + 1
#: Images in motion after which an old one has lost 63 % of its say.
_KEEP = float(np.exp(-1.0 / 30.0))
#: A length that is off by more counts no more than this: it may be a bump, m.
_MOST_OFF_M = 0.03
#: A lag is believed if another one leaves so many times as much, and a root sum square so much
#: larger, m; a smaller one harms nobody, images.
_TIMES, _WORSE_M, _LEAST = 3.0, 0.02, 1.0
#: Where lengths differ by less along all positions that are kept, one lag is as good as another, m;
#: and a ball that went further by this in one image than it was to go in any was bumped, or is seen
#: in a wrong place, m: other lags would hear of it at other times.
_VARIES_M, _JUMP_M = 0.02, 0.01
#: Who carries the camera changes lengths, too, but takes the ball another way: share of the last
#: positions' squared way that may stay unexplained by a lag.
_OFF_SHARE = 0.1

_LAGS = 0.5 * np.arange(-2 * _MOST, 2 * _MOST + 1)


class StampWatch:
    """Finds the lag of what is seen behind what the joints say."""

    def __init__(self) -> None:
        self._model = np.zeros((_KEPT, 3))
        self._seen = np.zeros((_KEPT, 3))
        self._stamps_s = np.zeros(_KEPT)
        self._heard = 0
        self._left_m2 = np.zeros(_LAGS.size)

    def add(
        self,
        stamp_s: float,
        seen_m: np.ndarray,
        model_m: np.ndarray,
        rotations: Sequence[np.ndarray],
    ) -> float:
        """Tell one pair in the order of their stamps.

        Parameters
        ----------
        stamp_s : float
            The pair's time, s.
        seen_m, model_m : ndarray, shape (3,)
            Where the ball is seen, and where the joints have it, m.
        rotations : sequence of ndarray, shape (3, 3)
            How the model may be turned to the image.

        Returns
        -------
        float
            So late the stamps are, s; negative for early ones, 0 where nothing says so.
        """
        for kept, new in (
            (self._model, model_m),
            (self._seen, seen_m),
            (self._stamps_s, stamp_s),
        ):
            kept[1:] = kept[:-1].copy()
            kept[0] = new
        self._heard += 1
        if self._heard < _KEPT:
            return 0.0
        if _steps(self._seen).max() > _steps(self._model).max() + _JUMP_M:
            return 0.0
        went_m, saw_m = _lengths(self._model), _lengths(self._seen)
        if went_m.max() - went_m.min() < _VARIES_M:
            return 0.0
        off_m = np.concatenate([saw_m[:0:-1] - went_m[0], saw_m[0] - went_m])
        self._left_m2 = _KEEP * self._left_m2 + np.minimum(np.abs(off_m), _MOST_OFF_M) ** 2
        lag = self._decide(rotations)
        return lag * float(np.median(-np.diff(self._stamps_s))) if lag else 0.0

    def _decide(self, rotations: Sequence[np.ndarray]) -> float:
        """The lag in images; 0 unless there is no doubt."""
        best = int(self._left_m2.argmin())
        lag, least_m2 = float(_LAGS[best]), float(self._left_m2[best])
        now_m2 = float(self._left_m2[_LAGS.size // 2])
        if abs(lag) < _LEAST or now_m2 < _TIMES * least_m2 or now_m2 - least_m2 < _WORSE_M**2:
            return 0.0
        off = self._off_share(lag, rotations)
        if off > _OFF_SHARE or _TIMES * off > self._off_share(0.0, rotations):
            return 0.0
        return lag

    def _off_share(self, lag: float, rotations: Sequence[np.ndarray]) -> float:
        """Share of the last positions' squared way that a lag and a rotation leave unexplained."""
        backs = range(_KEPT - math.ceil(abs(lag)))
        went = np.array([_at(self._model, back + max(lag, 0.0)) for back in backs])
        saw = np.array([_at(self._seen, back + max(-lag, 0.0)) for back in backs])
        went, saw = went - went.mean(axis=0), saw - saw.mean(axis=0)
        off_m2 = min(float(np.square(saw - went @ turn.T).sum()) for turn in rotations)
        return off_m2 / max(float(np.square(saw).sum()), 1e-9)


def _at(kept: np.ndarray, back: float) -> np.ndarray:
    """The position so many images ago, in between evenly."""
    whole = int(back)
    share = back - whole
    if share == 0.0:
        return kept[whole].copy()
    return (1.0 - share) * kept[whole] + share * kept[whole + 1]


def _steps(kept: np.ndarray) -> np.ndarray:
    """How far the ball went from each position to the next, m."""
    return np.asarray(np.sqrt(np.square(np.diff(kept, axis=0)).sum(axis=1)))


def _lengths(kept: np.ndarray) -> np.ndarray:
    """How far the ball went in a span that ended 0, 0.5, 1, ... images ago, m."""
    halves = np.empty((2 * _KEPT - 1, 3))
    halves[::2] = kept
    halves[1::2] = 0.5 * (kept[1:] + kept[:-1])
    off = halves[: 2 * _MOST + 1] - halves[2 * _SPAN : 2 * _SPAN + 2 * _MOST + 1]
    return np.asarray(np.sqrt(np.square(off).sum(axis=1)))
