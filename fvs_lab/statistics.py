"""Medians, their ratios, and shares, with intervals, for paired runs where some never settle."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

_RESAMPLES = 2000
_LEVEL = 0.95
#: With fewer runs not even the whole range of the data is a 95 % interval of their median.
DECISIVE = 6


@dataclass(frozen=True)
class Interval:
    """An estimate with its 95 % interval; infinite where runs did not settle.

    Parameters
    ----------
    value, low, high : float
        Estimate and ends of its interval.
    count : int
        Number of runs behind it; fewer than ``DECISIVE`` decide nothing.
    """

    value: float
    low: float
    high: float
    count: int = DECISIVE

    def text(self, digits: int = 2, factor: float = 1.0) -> str:
        """``0.62 (0.58 to 0.71)``, in another unit by a factor."""
        value, low, high = (
            "never" if not np.isfinite(number) else f"{factor * number:.{digits}f}"
            for number in (self.value, self.low, self.high)
        )
        return f"{value} ({low} to {high})"

    def above(self, bound: float) -> bool | None:
        """Whether it is above a bound: all of the interval, none of it, or undecided (None)."""
        if self.count >= DECISIVE and self.low > bound:
            return True
        return False if self.count >= DECISIVE and self.high < bound else None

    def below(self, bound: float) -> bool | None:
        """Whether it is below a bound: all of the interval, none of it, or undecided (None)."""
        if self.count >= DECISIVE and self.high < bound:
            return True
        return False if self.count >= DECISIVE and self.low > bound else None


def all_hold(parts: Iterable[bool | None]) -> bool | None:
    """Whether all hold: no if one does not, else undecided (None) if one is."""
    parts = list(parts)
    if any(part is False for part in parts):
        return False
    return None if any(part is None for part in parts) else True


def any_holds(parts: Iterable[bool | None]) -> bool | None:
    """Whether one holds: else undecided (None) if one is, else no."""
    parts = list(parts)
    if any(part is True for part in parts):
        return True
    return None if any(part is None for part in parts) else False


def median(values: Sequence[float], repeats: int = 1) -> Interval:
    """Median and its bootstrap interval (percentiles of resampled medians).

    Parameters
    ----------
    values : sequence of float
        One per run; infinite for a run that never settled.
    repeats : int
        How often the same cases follow one another, each time with what another search found:
        both cases and searches are drawn anew then.
    """
    data = np.asarray(values, dtype=float)
    medians = _median(data[_resamples(data.size, repeats)])
    return Interval(float(_median(data)), *_ends(medians), data.size // repeats)


def ratio_of_medians(
    numerator: Sequence[float], denominator: Sequence[float], *, repeats: int = 1
) -> Interval:
    """Ratio of two medians over the same cases, and its paired bootstrap interval.

    Parameters
    ----------
    numerator, denominator : sequence of float
        One per case each, in the same order.
    repeats : int
        As for :func:`median`.

    Raises
    ------
    ValueError
        If they do not have the same length.
    """
    above, below = np.asarray(numerator, dtype=float), np.asarray(denominator, dtype=float)
    if above.shape != below.shape:
        raise ValueError(f"paired runs must be as many: got {above.size} and {below.size}")
    chosen = _resamples(above.size, repeats)
    ratios = _ratio(_median(above[chosen]), _median(below[chosen]))
    middle = float(_ratio(_median(above), _median(below)))
    return Interval(middle, *_ends(ratios), above.size // repeats)


def wilson(hits: int, count: int) -> Interval:
    """A share and Wilson's 95 % interval, which holds near 0 and 1 as well.

    Parameters
    ----------
    hits, count : int
        Hits, and runs; at least one run.
    """
    from scipy.stats import binomtest

    ends = binomtest(hits, count).proportion_ci(_LEVEL, method="wilson")
    return Interval(hits / count, float(ends.low), float(ends.high), count)


def _resamples(count: int, repeats: int) -> np.ndarray:
    """Numbers of runs, shape (resamples, count): drawn cases of drawn repeats."""
    rng, cases = np.random.default_rng(0), count // repeats
    drawn = rng.integers(0, cases, (_RESAMPLES, 1, cases))
    again = rng.integers(0, repeats, (_RESAMPLES, repeats, 1))
    return (cases * again + drawn).reshape(_RESAMPLES, -1)


def _median(data: np.ndarray) -> np.ndarray:
    """The median of the last axis; infinite if one of two middle values is."""
    ordered, count = np.sort(data, axis=-1), data.shape[-1]
    return 0.5 * (ordered[..., (count - 1) // 2] + ordered[..., count // 2])


def _ratio(above: np.ndarray, below: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.asarray(above / below)
    return np.where(np.isnan(ratio), np.inf, ratio)


def _ends(samples: np.ndarray) -> tuple[float, float]:
    """Percentiles that are samples: interpolation with infinity is none."""
    ordered = np.sort(samples)
    tail = round((1.0 - _LEVEL) / 2.0 * (ordered.size - 1))
    return float(ordered[tail]), float(ordered[-1 - tail])
