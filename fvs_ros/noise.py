"""How noisy a measured position is, learned from the measurements themselves."""

from __future__ import annotations

from collections import deque

import numpy as np

#: Standard deviation of a coordinate before anything is known, and its bounds, m.
FIRST_M, _LEAST_M, _MOST_M = 1e-3, 1e-4, 1e-2
#: Second differences that are kept, and how many the first guess counts for.
_WINDOW, _GUESS = 64, 4
#: Their quartile is used, so that outliers may spoil many: its deviations from the mean.
_QUARTILE = -0.6745


class NoiseVariance:
    """Variance of a coordinate of white noise n on a residual that else changes steadily.

    The second difference ``n - 2 n' + n''`` has six variances, and is blind to a steady drift (a
    wrong Jacobian, a camera that is carried). The lower quartile of its squares over that of a
    chi-square distribution (Wilson and Hilferty) is not moved by outliers now and then.
    """

    def __init__(self) -> None:
        self.variance_m2 = FIRST_M**2
        self._squares_m2: deque[float] = deque(maxlen=_WINDOW)
        self._residual: np.ndarray | None = None
        self._change: np.ndarray | None = None

    def restart(self) -> None:
        """The next residual does not follow on the last one; what was learned stays."""
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
