"""One tidy table: a row per run, with what was run and what came of it as columns."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fvs_lab.statistics import Interval, median, ratio_of_medians, wilson


@dataclass(frozen=True)
class Metric:
    """How a column of numbers is shown.

    Parameters
    ----------
    label : str
        Header of a table's column and label of an axis, with the unit.
    factor : float
        From the SI unit to that unit.
    digits : int
        After the decimal point.
    """

    label: str
    factor: float = 1.0
    digits: int = 2


#: The columns that more than one experiment shows.
METRICS = {
    "to_5mm_s": Metric("to 5 mm, s"),
    "to_2mm_s": Metric("to 2 mm, s"),
    "to_1mm_s": Metric("to 1 mm, s"),
    "final_rms_m": Metric("final error, mm rms", 1e3),
    "jitter_rad_s": Metric("jitter, mrad/s", 1e3),
    "peak_joint_speed_rad_s": Metric("peak joint speed, rad/s"),
    "path_ratio": Metric("path / distance"),
    "limited_share": Metric("limited, %", 1e2, 0),
    "jacobian_error": Metric("Jacobian error, %", 1e2, 1),
}


class Results:
    """Runs as rows, each a mapping from column to value.

    Settling times are infinite for runs that never settle. The column ``search``, where there is
    one, numbers searches of gains whose runs repeat the same cases.

    Parameters
    ----------
    rows : iterable of mapping
        The runs.
    """

    def __init__(self, rows: Iterable[Mapping[str, Any]]) -> None:
        self.rows = tuple(rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[Mapping[str, Any]]:
        return iter(self.rows)

    def where(self, **given: Any) -> Results:
        """The rows with these values."""
        wanted = given.items()
        return Results(
            row for row in self.rows if all(row.get(name) == value for name, value in wanted)
        )

    def those(self, wanted: Callable[[Mapping[str, Any]], bool]) -> Results:
        """The rows that meet a condition."""
        return Results(row for row in self.rows if wanted(row))

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
        """A column."""
        return [row[name] for row in self.rows]

    def median(self, name: str) -> Interval:
        """Median of a column with its interval."""
        return median(self.values(name), self._searches())

    def over(self, other: Results, name: str) -> Interval:
        """Ratio of the medians of a column, paired by case.

        Where one of both has several searches of its gains, the runs of the other repeat.
        """
        longer = max(len(self), len(other))
        ones, others = (one.values(name) * (longer // max(1, len(one))) for one in (self, other))
        searches = max(self._searches(), other._searches())
        return ratio_of_medians(ones, others, repeats=searches)

    def share(self, name: str = "settled") -> Interval:
        """Share of the rows whose column is true."""
        return wilson(sum(map(bool, self.values(name))), len(self))

    def _searches(self) -> int:
        return max(1, len({row.get("search") for row in self.rows}))


# ---- cells of tables ------------------------------------------------------------------------

Cell = Callable[[Results], str]


def table(
    results: Results,
    by: Mapping[str, str],
    metrics: Sequence[str] = (),
    cells: Mapping[str, Cell] | None = None,
    known: Mapping[str, Metric] = METRICS,
) -> list[dict[str, str]]:
    """A row per group: its names, medians with intervals, and further cells.

    Parameters
    ----------
    results : Results
        The runs.
    by : mapping of str to str
        Columns whose values make the groups, and their headers.
    metrics : sequence of str
        Columns whose medians are shown.
    cells : mapping of str to callable, optional
        Further cells by header, each a function of the group's runs.
    known : mapping of str to Metric
        How metrics are shown.
    """
    shown = {known[name].label: middle(name, known) for name in metrics} | dict(cells or {})
    rows = []
    for key, runs in results.groups(*by).items():
        names = key if len(by) > 1 else (key,)
        row = {header: number_text(name) for header, name in zip(by.values(), names, strict=True)}
        rows.append(row | {header: cell(runs) for header, cell in shown.items()})
    return rows


def middle(name: str, known: Mapping[str, Metric] = METRICS) -> Cell:
    """Cell: the median of a column with its interval; ``-`` for rows without that column."""
    one = known[name]

    def cell(runs: Results) -> str:
        some = runs.those(lambda row: row.get(name) is not None)
        return some.median(name).text(one.digits, one.factor) if len(some) else "-"

    return cell


def settled(runs: Results) -> str:
    """Cell: how many runs settled."""
    return f"{sum(runs.values('settled'))} of {len(runs)}"


def failures(runs: Results) -> str:
    """Cell: causes of failures with their counts."""
    causes: dict[str, int] = {}
    for cause in filter(None, runs.values("failure")):
        causes[cause] = causes.get(cause, 0) + 1
    ordered = sorted(causes.items(), key=lambda one: -one[1])
    return "; ".join(f"{count} {cause}" for cause, count in ordered) or "none"


def span(values: Sequence[float], factor: float = 1.0, digits: int = 2) -> str:
    """Least and largest value."""
    low, high = (number_text(factor * end, digits) for end in (min(values), max(values)))
    return f"{low} to {high}"


def searches(name: str) -> Cell:
    """Cell: least and largest median of a column, search by search; empty for one search."""

    def cell(runs: Results) -> str:
        ones = [one.median(name).value for one in runs.those(_searched).groups("search").values()]
        return span(ones) if len(ones) > 1 else ""

    return cell


def _searched(row: Mapping[str, Any]) -> bool:
    return "search" in row


def number_text(value: Any, digits: int | None = None) -> str:
    """A number for readers: ``never`` for infinite, ``-`` for none; text as it is."""
    if not isinstance(value, float):
        return str(value)
    if not np.isfinite(value):
        return "never" if value > 0 else "-"
    return f"{value:g}" if digits is None else f"{value:.{digits}f}"
