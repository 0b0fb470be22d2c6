"""The laboratory's figures: curves over time, dots by category, and bars against a quantity."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fvs_lab.results import METRICS, Results, number_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Okabe and Ito's palette, told apart by all readers; one colour a scheme, everywhere.
COLOURS = {
    "proposed": "#0072B2",
    "rbf+pid": "#D55E00",
    "ukf+mfac": "#009E73",
    "ukf+mpc": "#CC79A7",
    "rbf+mfac": "#009E73",
    "rbf+mpc": "#CC79A7",
    "extended": "#E69F00",
    "best": "#7A1FA2",
    "oracle": "#000000",
    "frozen": "#999999",
    "rbf": "#0072B2",
    "lkf": "#009E73",
    "ukf": "#56B4E9",
    "rls": "#E69F00",
}


def pyplot():
    """Import pyplot, drawing to files."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    plt.rcParams.update(
        {
            "axes.grid": True,
            "grid.alpha": 0.3,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "font.size": 10,
            "legend.frameon": False,
            "legend.fontsize": 9,
            "legend.markerscale": 2,
        }
    )
    return plt


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG and forget it."""
    figure.savefig(path, dpi=120)
    pyplot().close(figure)


def grid(rows: int, columns: int, size: tuple[float, float], **shared: Any):
    """A figure and its axes, shape (rows, columns); the size is in inches."""
    return pyplot().subplots(
        rows, columns, figsize=size, squeeze=False, layout="constrained", **shared
    )


def colour_of(name: str) -> str:
    """The laboratory's colour of a scheme: ``best`` and ``best, tuned`` have the same."""
    return COLOURS.get(re.split("[, ]", name)[0], COLOURS["frozen"])


def shades(count: int) -> list[Any]:
    """Colours of something that grows."""
    return list(pyplot().get_cmap("viridis")(np.linspace(0.0, 0.92, count)))


def plain_ticks(axis: Axes, ticks: Sequence[float]) -> None:
    """Logarithmic horizontal axis with these ticks as plain numbers."""
    axis.set_xscale("log")
    axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.minorticks_off()


def legend(figure: Figure, columns: int = 4) -> None:
    """One legend below all panels, each label once."""
    handle_of: dict[str, Any] = {}
    for axis in figure.axes:
        handles, labels = axis.get_legend_handles_labels()
        handle_of = dict(zip(labels, handles, strict=True)) | handle_of
    figure.legend(handle_of.values(), handle_of, loc="outside lower center", ncols=columns)


# ---- over time ------------------------------------------------------------------------------


def over_time(
    axis: Axes,
    runs: Results,
    curve: Callable[[Mapping[str, Any]], np.ndarray],
    by: str,
    looks: Mapping[Any, Mapping[str, Any]],
) -> None:
    """Draw a line per value of a column: the median of its runs' curves, at the same times.

    Those without a look (matplotlib's settings of a line) are left out.
    """
    for name, group in runs.groups(by).items():
        if name in looks:
            curves = np.ma.masked_invalid([curve(row) for row in group])
            middle = np.ma.median(curves, axis=0).filled(np.nan)
            time_s = group.rows[0]["series"]["time_s"]
            axis.plot(time_s, middle, **({"label": str(name)} | dict(looks[name])))


def errors_over_time(
    axis: Axes, runs: Results, by: str, looks: Mapping[Any, Mapping[str, Any]]
) -> None:
    """Draw the distance to the target, mm, on a logarithmic axis, with the bound of 5 mm."""
    over_time(axis, runs, lambda row: 1e3 * np.maximum(row["series"]["error_m"], 1e-6), by, looks)
    axis.axhline(5.0, color="black", linewidth=0.8, linestyle=":")
    axis.set(yscale="log", ylim=(0.05, 600.0))


# ---- by category ----------------------------------------------------------------------------


def dots_of(axis: Axes, runs: Results, by: str, metric: str, most: float = np.inf) -> None:
    """Draw a row of dots per value of a column, with a bar at their median; from above.

    What is larger than ``most`` stands there.
    """
    shown_as, groups = METRICS[metric], runs.groups(by)
    names = [number_text(value) for value in groups]
    for height, (name, group) in enumerate(zip(names, groups.values(), strict=True)):
        shown = np.minimum(shown_as.factor * np.array(group.values(metric), dtype=float), most)
        shown = shown[np.isfinite(shown)]
        if shown.size:
            look: dict[str, Any] = {"color": colour_of(name)}
            axis.plot(shown, np.full(shown.size, height), "o", alpha=0.45, markersize=4, **look)
            axis.plot(2 * [np.median(shown)], [height - 0.32, height + 0.32], linewidth=2.5, **look)
    axis.set_yticks(range(len(names)), names)
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.set_xlabel(shown_as.label)
    axis.label_outer()
