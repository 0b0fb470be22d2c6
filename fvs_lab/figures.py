"""What the laboratory's figures are made of: curves, dots, and points with ranges."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fvs_lab.results import METRICS, Metric, Results
from fvs_lab.statistics import median
from fvs_lab.style import COLOURS, pyplot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: For those that have no colour of their own in the laboratory.
_SPARE = ("#56B4E9", "#8C564B", "#999999")


def panels(rows: int, columns: int, size: tuple[float, float], **shared: Any):
    """A figure and its axes, shape (rows, columns); the size is in inches."""
    return pyplot().subplots(
        rows, columns, figsize=size, squeeze=False, layout="constrained", **shared
    )


def colour_of(name: str) -> str:
    """The laboratory's colour of a scheme: ``best`` and ``best, tuned`` have the same."""
    return COLOURS.get(re.split("[, ]", name)[0], COLOURS["frozen"])


def colours_of(names: Sequence[str]) -> dict[str, str]:
    """A colour of its own for each, the laboratory's where there is one."""
    colours: dict[str, str] = {}
    spare = iter(_SPARE * len(names))
    for name in names:
        own = COLOURS.get(name.split(",")[0])
        colours[name] = own if own and own not in colours.values() else next(spare)
    return colours


def shades(count: int) -> list[Any]:
    """Colours of something that grows."""
    return list(pyplot().get_cmap("viridis")(np.linspace(0.0, 0.92, count)))


def error_curve(axis: Axes, series: Mapping[str, np.ndarray], **look: Any) -> None:
    """Draw the error of a recorded run over time, mm, on a logarithmic axis."""
    axis.semilogy(series["time_s"], 1e3 * np.maximum(series["error_m"], 1e-6), **look)


def bound_line(axis: Axes, bound: float, upright: bool = False) -> None:
    """Draw a thin dotted line at a bound."""
    draw = axis.axvline if upright else axis.axhline
    draw(bound, color="black", linewidth=0.8, linestyle=":")


def dots(
    axis: Axes, rows: Mapping[str, Sequence[float]], most: float = np.inf, named: bool = True
) -> None:
    """Draw a row of dots per name, and a bar at their median; from above.

    Parameters
    ----------
    axis : Axes
        Where to draw.
    rows : mapping of str to sequence of float
        The values; what is larger than ``most`` stands there.
    most : float
        Largest value shown.
    named : bool
        Whether to write the names beside the axis.
    """
    for place, (name, values) in enumerate(rows.items()):
        shown = [min(value, most) for value in values if np.isfinite(min(value, most))]
        if not shown:
            continue
        look: dict[str, Any] = {"color": colour_of(name)}
        axis.plot(shown, [place] * len(shown), "o", alpha=0.45, markersize=4, **look)
        centre = median(shown).value
        axis.plot([centre, centre], [place - 0.32, place + 0.32], linewidth=2.5, **look)
    if named:
        axis.set_yticks(range(len(rows)), list(rows))
        axis.set_ylim(len(rows) - 0.5, -0.5)


def ranges(
    axis: Axes,
    places: Sequence[float] | np.ndarray,
    values: Sequence[tuple[float, float, float]] | np.ndarray,
    **look: Any,
) -> None:
    """Draw points with the ends of their bars; each value is (point, low, high)."""
    finite = np.array(values, dtype=float).reshape(-1, 3)
    finite[~np.isfinite(finite)] = np.nan
    point, low, high = finite.T
    shown: dict[str, Any] = {"marker": "o", "markersize": 4, "elinewidth": 0.8} | look
    axis.errorbar(places, point, (point - low, high - point), **shown)


def medians(
    axis: Axes,
    results: Results,
    by: str,
    metric: str,
    most: float = np.inf,
    least: float = -np.inf,
    known: Mapping[str, Metric] = METRICS,
    **look: Any,
) -> None:
    """Draw the medians of a metric, in its unit, with intervals over the values of a column."""
    one = known[metric]
    groups = results.groups(by)
    middles = [runs.median(metric) for runs in groups.values()]
    ends = [(found.value, found.low, found.high) for found in middles]
    ranges(axis, list(groups), np.clip(one.factor * np.array(ends), least, most), **look)
    axis.set_ylabel(one.label)


def plain_ticks(axis: Axes, ticks: Sequence[float], across: bool = True) -> None:
    """Logarithmic axis with these ticks as plain numbers."""
    name = "x" if across else "y"
    axis.set(**{f"{name}scale": "log"})
    labels = [f"{tick:g}" for tick in ticks]
    (axis.set_xticks if across else axis.set_yticks)(ticks, labels)
    axis.minorticks_off()


def legend(figure: Figure, axis: Axes, columns: int = 4) -> None:
    """One legend below all panels."""
    figure.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=columns)


def keys(figure: Figure, looks: Mapping[str, Mapping[str, Any]], columns: int = 4) -> None:
    """A legend of looks rather than of what was drawn."""
    line = pyplot().Line2D
    handles = [line([], [], label=label, **look) for label, look in looks.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=columns)
