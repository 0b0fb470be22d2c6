"""Whether the images are stamped late or early: the ball then goes as predicted, but not when.

However a camera stands, it does not change how far the ball goes. So lengths tell stamps from
turns: with model positions p, seen ones x and a lag of n images,
``|x(k) - x(k - m)| = |p(k - n) - p(k - n - m)|`` for one n and every k. Each n of a grid is judged
by what it leaves of that. While the ball goes evenly, or rests, one n is as good as another, and
nothing is decided. A camera that is being carried changes lengths, too; so a lag counts only where
the ball went the way that it was to go.
"""

from __future__ import annotations

import math

import numpy as np

#: Lags that are compared, images each way, and the images over which lengths are compared.
_MOST, _SPAN = 12, 3
_KEPT = _MOST + _SPAN + 1
_LAGS = 0.5 * np.arange(-2 * _MOST, 2 * _MOST + 1)
#: Images after which an old one's weight has decayed by 63 %.
_KEEP = float(np.exp(-1.0 / 30.0))
#: A lag of at least this many images is believed if no lag leaves this many times as much, and a
#: root sum square this much larger, m.
_LEAST, _TIMES, _WORSE_M = 1.0, 3.0, 0.02
#: Share of the last positions' squared way that a lag may leave unexplained.
_OFF_SHARE = 0.1
#: Where predicted lengths vary by less, one lag is as good as another, m.
_VARIES_M = 0.02
#: A ball that went this much further in one image than predicted for any was bumped, or is seen in
#: a wrong place: other lags would hear of it at other times, m.
_JUMP_M = 0.01


class StampWatch:
    """Finds the lag of the images behind the joints."""

    def __init__(self) -> None:
        self._model: np.ndarray | None = None
        self._seen = np.zeros((_KEPT, 0))
        self._stamps_s = np.zeros(_KEPT)
        self._count = 0
        self._left_m2 = np.zeros(_LAGS.size)

    def add(
        self, stamp_s: float, seen_m: np.ndarray, model_m: np.ndarray, rotation: np.ndarray
    ) -> float:
        """Take one pair, in the order of the stamps.

        Parameters
        ----------
        stamp_s : float
            The pair's time, s.
        seen_m, model_m : ndarray, shape (3,)
            The ball in the image and by the joints, m.
        rotation : ndarray, shape (3, 3)
            From the model to the image, as far as known.

        Returns
        -------
        float
            How late the stamps are, s; negative for early ones, 0 where nothing says so.
        """
        if self._model is None:
            self._model, self._seen = (np.zeros((_KEPT, len(model_m))) for _ in range(2))
        for kept, new in ((self._model, model_m), (self._seen, seen_m), (self._stamps_s, stamp_s)):
            kept[1:] = kept[:-1].copy()
            kept[0] = new
        self._count += 1
        if self._count < _KEPT:
            return 0.0
        if _steps(self._seen).max() > _steps(self._model).max() + _JUMP_M:
            return 0.0
        went_m, saw_m = _lengths(self._model), _lengths(self._seen)
        if went_m.max() - went_m.min() < _VARIES_M:
            return 0.0
        off_m = np.concatenate([saw_m[:0:-1] - went_m[0], saw_m[0] - went_m])
        self._left_m2 = _KEEP * self._left_m2 + off_m**2
        best = int(self._left_m2.argmin())
        lag, least_m2 = float(_LAGS[best]), float(self._left_m2[best])
        now_m2 = float(self._left_m2[_LAGS.size // 2])
        if abs(lag) < _LEAST or now_m2 < _TIMES * least_m2 or now_m2 - least_m2 < _WORSE_M**2:
            return 0.0
        off = self._off_share(self._model, lag, rotation)
        if off > _OFF_SHARE or _TIMES * off > self._off_share(self._model, 0.0, rotation):
            return 0.0
        return lag * float(np.median(-np.diff(self._stamps_s)))

    def _off_share(self, model_m: np.ndarray, lag: float, rotation: np.ndarray) -> float:
        """Share of the last positions' squared way that a lag leaves unexplained."""
        backs = np.arange(_KEPT - math.ceil(abs(lag)))
        went, saw = _at(model_m, backs + max(lag, 0.0)), _at(self._seen, backs + max(-lag, 0.0))
        went, saw = went - went.mean(axis=0), saw - saw.mean(axis=0)
        off_m2 = float(np.square(saw - went @ rotation.T).sum())
        return off_m2 / max(float(np.square(saw).sum()), 1e-9)


def _at(kept: np.ndarray, back: np.ndarray) -> np.ndarray:
    """The positions this many images ago, in between evenly."""
    whole = np.minimum(back.astype(int), len(kept) - 2)
    share = (back - whole)[:, None]
    return np.asarray((1.0 - share) * kept[whole] + share * kept[whole + 1])


def _steps(kept: np.ndarray) -> np.ndarray:
    """How far the ball went from each position to the next, m."""
    return np.asarray(np.linalg.norm(np.diff(kept, axis=0), axis=1))


def _lengths(kept: np.ndarray) -> np.ndarray:
    """How far the ball went in a span that ended 0, 0.5, 1, ... images ago, m."""
    halves = np.empty((2 * _KEPT - 1, kept.shape[1]))
    halves[::2] = kept
    halves[1::2] = 0.5 * (kept[1:] + kept[:-1])
    off = halves[: 2 * _MOST + 1] - halves[2 * _SPAN : 2 * _SPAN + 2 * _MOST + 1]
    return np.asarray(np.sqrt(np.square(off).sum(axis=1)))
