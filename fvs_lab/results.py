"""One tidy table, a row per run: its medians, ratios and shares with intervals, and as text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

_RESAMPLES, _LEVEL = 2000, 0.95
#: With fewer runs not even the whole range of the data is a 95 % interval of their median.
DECISIVE = 6

# ---- statistics -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Interval:
    """An estimate with its 95 % interval; infinite where runs did not settle."""

    value: float
    low: float
    high: float
    #: Number of runs behind it; fewer than ``DECISIVE`` decide nothing.
    count: int = DECISIVE

    def text(self, digits: int = 2, factor: float = 1.0) -> str:
        """``0.62 [0.58, 0.71]``, in another unit by a factor."""
        ends = (number_text(factor * one, digits) for one in (self.value, self.low, self.high))
        return "{} [{}, {}]".format(*ends)

    def above(self, bound: float) -> bool | None:
        """Whether it is above a bound: all of the interval, none of it, or undecided (None)."""
        return self._decided(self.low > bound, self.high < bound)

    def below(self, bound: float) -> bool | None:
        """Whether it is below a bound: all of the interval, none of it, or undecided (None)."""
        return self._decided(self.high < bound, self.low > bound)

    def _decided(self, yes: bool, no: bool) -> bool | None:
        return yes if self.count >= DECISIVE and yes != no else None


def median(values: Sequence[float], repeats: int = 1) -> Interval:
    """Median and its bootstrap interval (percentiles of resampled medians).

    Infinite values are runs that never settled. ``repeats`` is the number of searches whose runs
    of the same cases follow one another; the bootstrap then resamples both cases and searches.
    """
    data = np.asarray(values, dtype=float)
    return _bootstrapped(lambda chosen: np.median(data[chosen], axis=-1), data.size, repeats)


def ratio_of_medians(
    numerator: Sequence[float], denominator: Sequence[float], repeats: int = 1
) -> Interval:
    """Ratio of two medians over the same cases in the same order, by a paired bootstrap."""
    above, below = np.asarray(numerator, dtype=float), np.asarray(denominator, dtype=float)
    if above.shape != below.shape:
        raise ValueError(f"paired runs must be as many: got {above.size} and {below.size}")

    def ratio(chosen: np.ndarray) -> np.ndarray:
        with np.errstate(invalid="ignore", divide="ignore"):
            ratios = np.median(above[chosen], axis=-1) / np.median(below[chosen], axis=-1)
        return np.where(np.isnan(ratios), np.inf, ratios)

    return _bootstrapped(ratio, above.size, repeats)


def wilson(hits: int, count: int) -> Interval:
    """A share and Wilson's 95 % interval, which holds near 0 and 1 as well."""
    from scipy.stats import binomtest

    ends = binomtest(hits, count).proportion_ci(_LEVEL, method="wilson")
    return Interval(hits / count, float(ends.low), float(ends.high), count)


def _bootstrapped(
    statistic: Callable[[np.ndarray], np.ndarray], count: int, repeats: int = 1
) -> Interval:
    """A statistic of the runs with some numbers, (..., n), over drawn cases of drawn repeats."""
    rng, cases = np.random.default_rng(0), count // repeats
    drawn = rng.integers(0, cases, (_RESAMPLES, 1, cases))
    again = rng.integers(0, repeats, (_RESAMPLES, repeats, 1))
    samples = statistic((cases * again + drawn).reshape(_RESAMPLES, -1))
    # Percentiles that are samples: interpolation with infinity is none.
    low, high = np.quantile(samples, (0.5 - 0.5 * _LEVEL, 0.5 + 0.5 * _LEVEL), method="nearest")
    return Interval(float(statistic(np.arange(count))), float(low), float(high), cases)


# ---- the tidy table -------------------------------------------------------------------------


class Results:
    """Runs as rows, each a mapping from column to value.

    Settling times are infinite for runs that never settle. The column ``search``, where there is
    one, numbers searches of gains whose runs repeat the same cases.
    """

    def __init__(self, rows: Iterable[Mapping[str, Any]]) -> None:
        self.rows = tuple(rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[Mapping[str, Any]]:
        return iter(self.rows)

    def where(self, **given: Any) -> Results:
        """The rows with these values."""
        return self.those(lambda row: all(row.get(name) == one for name, one in given.items()))

    def those(self, wanted: Callable[[Mapping[str, Any]], bool]) -> Results:
        """The rows that meet a condition."""
        return Results(row for row in self.rows if wanted(row))

    def adding(self, columns: Callable[[Mapping[str, Any]], Mapping[str, Any]]) -> Results:
        """The rows with further columns, which follow from those that they have."""
        return Results({**row, **columns(row)} for row in self.rows)

    def groups(self, *names: str) -> dict[Any, Results]:
        """The rows by the values of some columns, in order of appearance.

        Keys are values for a single column, tuples for several.
        """
        found: dict[Any, list[Mapping[str, Any]]] = {}
        for row in self.rows:
            key = tuple(row[name] for name in names)
            found.setdefault(key if len(names) > 1 else key[0], []).append(row)
        return {key: Results(rows) for key, rows in found.items()}

    def values(self, name: str) -> list[Any]:
        """A column, of the rows that have it."""
        return [row[name] for row in self.rows if row.get(name) is not None]

    def median(self, name: str) -> Interval:
        """Median of a column with its interval."""
        return median(self.values(name), self._searches())

    def over(self, other: Results, name: str) -> Interval:
        """Ratio of the medians of a column, paired by case.

        Where one of both has several searches of its gains, the runs of the other repeat.
        """
        longer = max(len(self), len(other))
        ones, others = (one.values(name) * (longer // max(1, len(one))) for one in (self, other))
        return ratio_of_medians(ones, others, max(self._searches(), other._searches()))

    def share(self, name: str = "settled") -> Interval:
        """Share of the rows whose column is true."""
        return wilson(sum(map(bool, self.values(name))), len(self))

    def _searches(self) -> int:
        return max(1, len({row.get("search") for row in self.rows}))


# ---- columns as text ------------------------------------------------------------------------


@dataclass(frozen=True)
class Metric:
    """How a column of numbers is shown."""

    #: Header of a table's column and label of an axis, with the unit.
    label: str
    #: From the SI unit to that unit, and digits after the decimal point.
    factor: float = 1.0
    digits: int = 2


#: All columns that are shown.
METRICS = {
    "to_5mm_s": Metric("to 5 mm, s"),
    "to_2mm_s": Metric("to 2 mm, s"),
    "over_5mm": Metric("to 5 mm over floor"),
    "over_undisturbed": Metric("over undisturbed"),
    "final_rms_m": Metric("final error, mm rms", 1e3),
    "jitter_rad_s": Metric("jitter, mrad/s", 1e3),
    "peak_joint_speed_rad_s": Metric("peak joint speed, rad/s"),
    "jacobian_error": Metric("Jacobian error, %", 1e2, 1),
    "learned": Metric("Jacobian error, %", 1e2, 3),
    "pace": Metric("own pace"),
    "rest_m": Metric("final way, mm", 1e3),
    "rest_deg": Metric("final turn, °", 1.0, 3),
    # calibration
    "place_m": Metric("place, mm", 1e3),
    "turn_deg": Metric("turn, °", 1.0, 3),
    # settling
    "bound_s": Metric("corrected bound, s"),
    "printed_s": Metric("printed bound, s"),
    "within": Metric("within the corrected"),
    "printed_kept": Metric("within the printed"),
    # estimators
    "t1_m": Metric("T1, mm", 1e3, 3),
    "t1_late_m": Metric("T1, second half, mm", 1e3, 3),
    "t2_max_m": Metric("largest T2, mm", 1e3, 1),
    # beyond
    "fit_s": Metric("fit and distillation, s of one core", 1.0, 1),
    "chain_box": Metric("chain, box M, %", 1e2, 3),
    "chain_workspace": Metric("chain, workspace, %", 1e2, 3),
    "distilled_box": Metric("distilled networks, box M, %", 1e2),
    "late_error_s": Metric("stamp delay, ms", 1e3),
    "stated": Metric("stated by the fit, %", 1e2, 3),
    "seen": Metric("as the camera sees, %", 1e2, 3),
    "honesty": Metric("stated over actual error"),
    "rms_m": Metric("distance from the target, mm rms", 1e3),
}


def label_of(name: str) -> str:
    """What readers call a column."""
    return METRICS[name].label if name in METRICS else name.replace("_", " ")


def number_text(value: Any, digits: int | None = None) -> str:
    """A number for readers: ``never`` for infinite, ``-`` for none; text as it is."""
    if not isinstance(value, float):
        return str(value)
    if not np.isfinite(value):
        return "never" if value > 0 else "-"
    return f"{value:g}" if digits is None else f"{value:.{digits}f}"


def _quantile(part: float) -> Callable[[Results, str, Metric], str]:
    """A run itself: nothing lies between a time and never."""
    return lambda runs, name, one: number_text(
        one.factor * float(np.quantile(runs.values(name), part, method="higher")), one.digits
    )


def _causes(runs: Results, name: str, _: Metric) -> str:
    counted = Counter(filter(None, runs.values(name))).most_common()
    return "; ".join(f"{count} {cause}" for cause, count in counted)


#: Ways to sum up a column: the words after its label, and what the cell says.
_SUMMARIES: Mapping[str, tuple[str, Callable[[Results, str, Metric], str]]] = {
    "median": ("", lambda runs, name, one: runs.median(name).text(one.digits, one.factor)),
    "half": (
        "",
        lambda runs, name, one: number_text(one.factor * runs.median(name).value, one.digits),
    ),
    "90 %": (", 90 %", _quantile(0.9)),
    "least": (", least", _quantile(0.0)),
    "most": (", largest", _quantile(1.0)),
    "of": ("", lambda runs, name, _: f"{sum(map(bool, runs.values(name)))} of {len(runs)}"),
    "causes": ("", _causes),
}


def table(
    runs: Results, by: Sequence[str], columns: Sequence[str], across: str = ""
) -> list[dict[str, str]]:
    """A row per group of runs with the same values in some columns.

    Columns are summed up by their median with its interval, or by what stands after a colon, as in
    ``jitter_rad_s:half`` (the median alone) and ``settled:of``. With ``across``, each is summed up
    once for each value of that column, side by side. A cell is ``-`` where there is nothing.
    """
    rows = []
    values = [*runs.groups(across)] if across else [None]
    for key, some in runs.groups(*by).items():
        names = key if len(by) > 1 else (key,)
        row = {label_of(name): number_text(one) for name, one in zip(by, names, strict=True)}
        for value, column in product(values, columns):
            name, _, how = column.partition(":")
            words, text = _SUMMARIES[how or "median"]
            header = label_of(name) + words
            if value is not None:
                header = f"{value}: {header}" if len(columns) > 1 else str(value)
            ones = some.where(**{across: value}) if across else some
            metric = METRICS.get(name, Metric(name))
            row[header] = text(ones, name, metric) if ones.values(name) else "-"
        rows.append(row)
    return rows
