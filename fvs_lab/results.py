"""One tidy table, a row per run: its medians, ratios and shares with intervals, and as text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np

# ---- statistics -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Interval:
    """An estimate with its 95 % interval; infinite where runs did not settle."""

    value: float
    low: float
    high: float
    #: Number of cases behind it. With fewer than six, not even the whole range of the data is a
    #: 95 % interval of their median: they decide nothing.
    count: int = 6

    def text(self, digits: int = 2, factor: float = 1.0) -> str:
        """``0.62 [0.58, 0.71]``, in another unit by a factor."""
        ends = (number_text(factor * end, digits) for end in (self.value, self.low, self.high))
        return "{} [{}, {}]".format(*ends)

    def above(self, bound: float) -> bool | None:
        """Whether it is above a bound: all of the interval, none of it, or undecided (None)."""
        return self._decided(self.low > bound, self.high < bound)

    def below(self, bound: float) -> bool | None:
        """Whether it is below a bound: all of the interval, none of it, or undecided (None)."""
        return self._decided(self.high < bound, self.low > bound)

    def _decided(self, yes: bool, no: bool) -> bool | None:
        return yes if self.count >= 6 and yes != no else None


def median(values: Sequence[float], repeats: int = 1) -> Interval:
    """Median and its bootstrap interval (percentiles of resampled medians).

    Infinite values are runs that never settled. With ``repeats``, the values of as many runs of
    the same cases follow one another; cases are resampled.
    """
    return _bootstrapped(_median, np.reshape(values, (1, repeats, -1)))


def ratio_of_medians(
    numerator: Sequence[float], denominator: Sequence[float], repeats: int = 1
) -> Interval:
    """Ratio of two medians over the same cases in the same order, by a paired bootstrap."""
    if len(numerator) != len(denominator):
        raise ValueError(
            f"paired runs must be as many: got {len(numerator)} and {len(denominator)}"
        )

    def ratio(runs: np.ndarray) -> np.ndarray:
        above, below = _median(runs)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.nan_to_num(above / below, nan=np.inf, posinf=np.inf)

    return _bootstrapped(ratio, np.reshape([numerator, denominator], (2, repeats, -1)))


def wilson(hits: int, count: int) -> Interval:
    """A share and Wilson's 95 % interval, which holds near 0 and 1 as well."""
    from scipy.stats import binomtest

    ends = binomtest(hits, count).proportion_ci(method="wilson")
    return Interval(hits / count, float(ends.low), float(ends.high), count)


def _median(runs: np.ndarray) -> np.ndarray:
    """Over repeats and cases, (..., repeats, samples, cases) -> (..., samples)."""
    return np.asarray(np.median(runs, axis=(-3, -1)))


def _bootstrapped(statistic: Callable[[np.ndarray], np.ndarray], runs: np.ndarray) -> Interval:
    """A statistic of runs, (..., repeats, cases), over cases that are drawn anew."""
    cases = runs.shape[-1]
    drawn = np.random.default_rng(0).integers(0, cases, (2000, cases))
    # Percentiles that are samples: interpolation with infinity is none.
    low, high = np.quantile(statistic(runs[..., drawn]), (0.025, 0.975), method="nearest")
    value = np.squeeze(statistic(runs[..., None, :]))
    return Interval(float(value), float(low), float(high), cases)


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

    def where(self, **values: Any) -> Results:
        """The rows with these values."""
        return self.those(lambda row: all(row.get(name) == value for name, value in values.items()))

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
        rows_of: dict[Any, list[Mapping[str, Any]]] = {}
        for row in self.rows:
            key = tuple(row[name] for name in names)
            rows_of.setdefault(key if len(names) > 1 else key[0], []).append(row)
        return {key: Results(rows) for key, rows in rows_of.items()}

    def values(self, name: str) -> list[Any]:
        """A column, of the rows that have it."""
        return [row[name] for row in self.rows if row.get(name) is not None]

    def distinct(self, name: str) -> int:
        """Number of different values of a column."""
        return len({row.get(name) for row in self.rows})

    def median(self, name: str) -> Interval:
        """Median of a column with its interval."""
        return median(self.values(name), self.distinct("search"))

    def over(self, other: Results, name: str) -> Interval:
        """Ratio of the medians of a column, paired by case.

        Where one of both has several searches of its gains, the runs of the other repeat.
        """
        repeats = max(self.distinct("search"), other.distinct("search"))
        ours, theirs = (
            runs.values(name) * (repeats // runs.distinct("search")) for runs in (self, other)
        )
        return ratio_of_medians(ours, theirs, repeats)

    def share(self, name: str = "settled") -> Interval:
        """Share of the rows whose column is true."""
        return wilson(sum(map(bool, self.values(name))), len(self))


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
    "over_1px": Metric("to 1 px over floor"),
    "to_1px_s": Metric("to 1 px, s"),
    "over_undisturbed": Metric("over undisturbed"),
    "final_rms_m": Metric("final error, mm rms", 1e3),
    "jitter_rad_s": Metric("jitter, mrad/s", 1e3),
    "jacobian_error": Metric("Jacobian error, %", 1e2, 1),
    "learned": Metric("Jacobian error, %", 1e2, 3),
    "pace": Metric("own pace"),
    "speed_m_s": Metric("speed, m/s"),
    "rest_m": Metric("final position, mm", 1e3),
    "rest_deg": Metric("final angle, °", 1.0, 3),
    "most_m": Metric("largest error, mm", 1e3),
    "swing_deg": Metric("swing, °"),
    "turns_1_s": Metric("reversals, 1/s", 1.0, 1),
    "good": Metric("within 1 mm and 0.3°"),
    "rms_m": Metric("distance from the target, mm rms", 1e3),
    "position_m": Metric("position, mm", 1e3),
    "angle_deg": Metric("angle, °", 1.0, 3),
    "bound_s": Metric("corrected bound, s"),
    "printed_s": Metric("printed bound, s"),
    "within": Metric("within the corrected"),
    "printed_kept": Metric("within the printed"),
    "t1_m": Metric("T1, mm", 1e3, 3),
    "t1_px": Metric("T1, px", 1.0, 3),
    "rest_px": Metric("final error, px"),
    "focal": Metric("focal length, %", 1e2),
    "k1_off": Metric("error of k1", 1.0, 4),
    "t2_max_m": Metric("largest T2, mm", 1e3, 1),
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


@dataclass(frozen=True)
class Table:
    """Declaration of a table: a row per group of runs with the same values in some columns.

    Columns are summed up by their median with its interval, or by what stands after a colon:
    ``half`` is the median alone, ``90 %``, ``95 %`` and ``largest`` are runs, ``of`` counts those
    that are true, ``causes`` counts each text. A cell is ``-`` where there is nothing.
    """

    #: Its caption is the template's macro ``table_NAME``.
    name: str
    by: Sequence[str]
    columns: Sequence[str]
    #: Rows of the tidy table with these values.
    where: Mapping[str, Any] = field(default_factory=dict)
    #: A column for whose values each of the others is summed up once, side by side.
    across: str = ""

    def rows(self, runs: Results) -> list[dict[str, str]]:
        """The rows of these runs, by the headers of their columns."""
        runs, rows = runs.where(**self.where), []
        values = [*runs.groups(self.across)] if self.across else [None]
        for group in runs.groups(*self.by).values():
            row = {label_of(name): number_text(group.rows[0][name]) for name in self.by}
            for value, column in product(values, self.columns):
                name, _, how = column.partition(":")
                header = label_of(name) + (f", {how}" if how in ("90 %", "95 %", "largest") else "")
                if self.across:
                    header = f"{value}: {header}" if len(self.columns) > 1 else str(value)
                cell = group.where(**{self.across: value}) if self.across else group
                row[header] = _cell(cell, name, how)
            rows.append(row)
        return rows


def _cell(runs: Results, name: str, how: str) -> str:
    """A column of some runs in a cell; ``how`` is what stands after the colon."""
    metric, values = METRICS.get(name, Metric(name)), runs.values(name)
    if not values:
        return "-"
    if how == "of":
        return f"{sum(map(bool, values))} of {len(runs)}"
    if how == "causes":
        counted = Counter(filter(None, values)).most_common()
        return "; ".join(f"{count} {cause}" for cause, count in counted)
    if not how:
        return runs.median(name).text(metric.digits, metric.factor)
    # A run itself, as nothing lies between a time and never.
    part = {"90 %": 0.9, "95 %": 0.95, "largest": 1.0}.get(how)
    value = runs.median(name).value if part is None else np.quantile(values, part, method="higher")
    return number_text(metric.factor * float(value), metric.digits)
