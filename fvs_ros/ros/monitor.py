"""Arrival statistics of an input: age, rate, jitter."""

from __future__ import annotations

import math
from collections import deque

import numpy as np


class ArrivalMonitor:
    """Remembers the last arrivals of one input on a steady clock.

    Parameters
    ----------
    window : int
        Number of arrivals that rate and jitter are computed over.
    """

    def __init__(self, window: int = 100) -> None:
        self._arrivals_s: deque[float] = deque(maxlen=window)
        self.count = 0

    def arrived(self, now_s: float) -> None:
        """Note an arrival at a moment of the steady clock, s."""
        self._arrivals_s.append(now_s)
        self.count += 1

    def age_s(self, now_s: float) -> float:
        """Seconds since the newest arrival; infinite before the first."""
        return now_s - self._arrivals_s[-1] if self._arrivals_s else math.inf

    def report(self, now_s: float) -> dict[str, float | int]:
        """Age (s), rate (Hz), jitter (ms, standard deviation of the intervals) and count."""
        intervals_s = np.diff(self._arrivals_s)
        mean_s = float(np.mean(intervals_s)) if intervals_s.size else 0.0
        return {
            "age_s": self.age_s(now_s),
            "rate_hz": 1.0 / mean_s if mean_s > 0.0 else math.nan,
            "jitter_ms": 1e3 * float(np.std(intervals_s)) if intervals_s.size else math.nan,
            "count": self.count,
        }
