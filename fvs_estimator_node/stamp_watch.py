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

#: With images that are stamped by more too late or too early, no loop comes to rest, s.
_MOST_S = 0.08

_LAGS = 0.5 * np.arange(-2 * _MOST, 2 * _MOST + 1)


class StampWatch:
    """Finds the lag of what is seen behind what the joints say, in images."""

    def __init__(self) -> None:
        self._model = np.zeros((_KEPT, 3))
        self._seen = np.zeros((_KEPT, 3))
        self._stamps_s = np.full(_KEPT, math.nan)
        self._heard = 0
        self._left_m2 = np.zeros(_LAGS.size)
        self._lag = 0.0

    @property
    def lag(self) -> float:
        """So many images the ball is behind the joints; positive where stamps are too late."""
        return self._lag

    @property
    def lag_s(self) -> float:
        """The same in seconds; 0 without stamps."""
        times_s = self._stamps_s[: min(self._heard, _KEPT)]
        if not self._lag or np.isnan(times_s).any():
            return 0.0
        return self._lag * float(np.median(-np.diff(times_s)))

    @property
    def remark(self) -> str:
        """What is wrong with the stamps, in words; empty if nothing is."""
        if not self._lag:
            return ""
        late_s = self.lag_s
        by = f" by about {abs(late_s):.2f} s" if late_s else ""
        by += " or more" if late_s and abs(self._lag) >= _MOST else ""
        which = "late" if self._lag > 0.0 else "early"
        return (
            f"the image does not fit the arm's motion: its stamps are too {which}{by}, as the last "
            "start or stop of the ball told; set the detector's stamp_delay_s, or make the clocks "
            "agree, and call ~/reset"
        )

    @property
    def problem(self) -> str:
        """The same where they are so wrong that the arm must not move; empty otherwise."""
        return self.remark if abs(self.lag_s) > _MOST_S else ""

    def add(
        self,
        model_m: np.ndarray,
        seen_m: np.ndarray,
        stamp_s: float = math.nan,
        rotations: Sequence[np.ndarray] = (np.eye(3),),
    ) -> bool:
        """Tell one pair in the order of their stamps.

        Parameters
        ----------
        model_m, seen_m : ndarray, shape (3,)
            Where the joints have the ball, in a frame of their own, and where it is seen, m.
        stamp_s : float
            The pair's time, s.
        rotations : sequence of ndarray, shape (3, 3)
            How the model may be turned to the image, as known before any lag.

        Returns
        -------
        bool
            Whether the lag is another one now.
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
            return False
        if _steps(self._seen).max() > _steps(self._model).max() + _JUMP_M:
            return False
        went_m, saw_m = _lengths(self._model), _lengths(self._seen)
        if went_m.max() - went_m.min() < _VARIES_M:
            return False
        off_m = np.concatenate([saw_m[:0:-1] - went_m[0], saw_m[0] - went_m])
        self._left_m2 = _KEEP * self._left_m2 + np.minimum(np.abs(off_m), _MOST_OFF_M) ** 2
        return self._decide(rotations)

    def _decide(self, rotations: Sequence[np.ndarray]) -> bool:
        best = int(self._left_m2.argmin())
        if self._lag and abs(_LAGS[best] - self._lag) <= 1.0 <= abs(_LAGS[best]):
            self._lag = float(_LAGS[best])  # the same, and better known
            return False
        least_m2 = float(self._left_m2[best])
        now_m2 = float(np.interp(self._lag, _LAGS, self._left_m2))
        if now_m2 < _TIMES * least_m2 or now_m2 - least_m2 < _WORSE_M**2:
            return False
        lag = float(_LAGS[best])
        lag = lag if abs(lag) >= _LEAST else 0.0
        if lag == self._lag:
            return False
        off = self._off_share(lag, rotations)
        if off > _OFF_SHARE or _TIMES * off > self._off_share(self._lag, rotations):
            return False
        self._lag = lag
        return True

    def _off_share(self, lag: float, rotations: Sequence[np.ndarray]) -> float:
        """Share of the last positions' squared way that a lag and a rotation leave unexplained."""
        pairs = [self.pair(back, lag) for back in range(_KEPT - math.ceil(abs(lag)))]
        went, saw = (np.array(one) for one in zip(*pairs, strict=True))
        went, saw = went - went.mean(axis=0), saw - saw.mean(axis=0)
        off_m2 = min(float(np.square(saw - went @ turn.T).sum()) for turn in rotations)
        return off_m2 / max(float(np.square(saw).sum()), 1e-9)

    def pair(self, back: int = 0, lag: float | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Where the model has the ball and where it is seen, of one time, m, (3,) each.

        Parameters
        ----------
        back : int
            So many images ago; at most ``pairs`` - 1.
        lag : float, optional
            With another lag than that which was found, images.
        """
        lag = self._lag if lag is None else lag
        return _at(self._model, back + max(lag, 0.0)), _at(self._seen, back + max(-lag, 0.0))

    @property
    def pairs(self) -> int:
        """So many pairs are known."""
        return max(min(self._heard, _KEPT) - int(np.ceil(abs(self._lag))), 0)


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
