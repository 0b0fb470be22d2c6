"""The pictures of the comparison of estimators."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fvs_lab.estimators_contestants import CONTESTANTS
from fvs_lab.estimators_study import DRAWN, NOISE, Study
from fvs_lab.statistics import median
from fvs_lab.style import COLOURS, pyplot, save

_TITLES = {"t1_m": "T1: error of one prediction, mm", "t2_m": "T2: errors summed up, mm"}
#: Who is drawn, with style and width (points) of the line.
LINES = {
    "rbf": ("-", 2.6),
    "rbf_fast": ("--", 1.6),
    "frozen": ("-", 2.2),
    "lkf_explored": ("-", 1.6),
    "ukf_explored": ("-", 6.0),
    "lkf_model": ("--", 1.6),
    "lkf_zero": (":", 1.6),
    "rls_explored": ("-", 1.6),
    "broyden_explored": ("-", 1.6),
}


def _line(name: str) -> dict[str, Any]:
    one = CONTESTANTS[name]
    style, width = LINES[name]
    line = {
        "linestyle": style,
        "linewidth": width,
        "color": COLOURS[one.method],
        "label": one.label,
    }
    if one.method == "ukf":  # broad and pale, behind the LKF's
        line |= {"alpha": 0.45, "zorder": 1.5}
    return line


def against_time(found: Study, criterion: str, folder: Path) -> str:
    """Draw ``t1_m`` or ``t2_m`` against time, a panel a world; returns the file's name."""
    figure, panels = pyplot().subplots(
        1, len(DRAWN), figsize=(12.5, 5.6), layout="constrained", sharey=True
    )
    highest, lowest = 0.0, np.inf
    for panel, world in zip(panels, DRAWN, strict=True):
        for name in LINES:
            curve = 1e3 * found.curve(world, name, criterion)
            lowest, highest = min(lowest, np.nanmin(curve)), max(highest, np.nanmax(curve))
            panel.plot(found.curve_time_s, curve, **_line(name))
        panel.set(title=world.label, xlabel="time, s", xlim=(0.0, found.duration_s))
        panel.set_xticks(np.arange(0.0, found.duration_s, 0.25 * found.duration_s))
    panels[0].set_ylabel(_TITLES[criterion])
    _logarithmic(panels[0])
    panels[0].set_ylim(0.7 * lowest, 1.4 * highest)
    _legend(figure, panels[0])
    name = f"{criterion.removesuffix('_m')}.png"
    save(figure, folder / name)
    return name


def against_angle(found: Study, folder: Path) -> str:
    """Draw T1 and the Jacobian's error against the camera's rotation; the file's name."""
    figure, panels = pyplot().subplots(1, 2, figsize=(12.5, 5.6), layout="constrained")
    worlds = [NOISE, *found.turned]
    angles_deg = np.array([world.turn_deg for world in worlds])
    names = [name for name in LINES if name != "lkf_zero"]
    for panel, (criterion, factor, title) in zip(
        panels,
        (
            ("t1_m", 1e3, "T1, mean over the motion, mm"),
            ("jacobian_error", 1e2, "error of the whole Jacobian, %"),
        ),
        strict=True,
    ):
        for number, name in enumerate(names):
            middles = [median(found.values(world, name, criterion)) for world in worlds]
            values = factor * np.array([one.value for one in middles])
            ends = factor * np.array([[one.low, one.high] for one in middles]).T
            # side by side, for the intervals to be seen; the UKF behind the LKF, which is before it
            place = number - 1 if CONTESTANTS[name].method == "ukf" else number
            panel.errorbar(
                angles_deg + 0.3 * (place - 0.5 * len(names)),
                values,
                yerr=np.abs(ends - values),
                marker="o",
                markersize=4,
                elinewidth=1.0,
                capsize=2,
                **_line(name),
            )
        _logarithmic(panel)
        panel.set_xticks(angles_deg, [f"{angle:g}°" for angle in angles_deg])
        panel.set(title=title, xlabel="camera rotated since training by")
    _legend(figure, panels[0])
    save(figure, folder / "rotation.png")
    return "rotation.png"


def _logarithmic(panel: Any) -> None:
    from matplotlib.ticker import LogLocator

    panel.set_yscale("log")
    panel.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    panel.yaxis.set_major_formatter("{x:g}")


def _legend(figure: Any, panel: Any) -> None:
    """One legend for all panels, below them."""
    figure.legend(*panel.get_legend_handles_labels(), loc="outside lower center", ncols=4)
