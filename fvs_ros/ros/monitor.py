"""Arrival statistics of an input: age, rate, jitter."""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise


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
        arrivals = list(self._arrivals_s)
        intervals = [b - a for a, b in pairwise(arrivals)]
        rate_hz = jitter_ms = math.nan
        if intervals:
            mean_s = sum(intervals) / len(intervals)
            rate_hz = 1.0 / mean_s if mean_s > 0.0 else math.nan
            variance = sum((interval - mean_s) ** 2 for interval in intervals) / len(intervals)
            jitter_ms = 1e3 * math.sqrt(variance)
        return {
            "age_s": self.age_s(now_s),
            "rate_hz": rate_hz,
            "jitter_ms": jitter_ms,
            "count": self.count,
        }
