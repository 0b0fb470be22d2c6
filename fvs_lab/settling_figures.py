"""The picture of measured and computed settling times."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from fvs_lab.settling_runs import (
    FREE_GAINS,
    IDEAL,
    NOISY,
    ORACLE,
    SILENT,
    Run,
    groups,
)
from fvs_lab.style import pyplot, save


def times(runs: Sequence[Run], folder: Path) -> str:
    """Draw measured against computed times, a panel a computation; returns the file's name."""
    plt = pyplot()
    figure, axes = plt.subplots(2, 2, figsize=(11, 8.4), sharey=True, layout="constrained")
    colours = dict(zip(FREE_GAINS, ("#0072B2", "#D55E00", "#009E73"), strict=True))
    marks = {SILENT: "o", NOISY: "x", ORACLE: "^", IDEAL: "+"}
    counted = [run for run in runs if run.gains in FREE_GAINS and not run.excluded]
    panels: tuple[tuple[str, Callable[[Run], float]], ...] = (
        ("corrected bound on the time to zero error, s", lambda run: run.bound_s),
        ("corrected bound on the time to 5 mm, s", lambda run: run.band_bound_s["5 mm"]),
        ("the theory's own motion to 5 mm (no bound), s", lambda run: run.predicted_s["5 mm"]),
        ("the paper's formula as printed, s", lambda run: run.printed_s),
    )
    tops = [run.measured_s["5 mm"] for run in counted if np.isfinite(run.measured_s["5 mm"])]
    top = 1.15 * max(tops, default=1.0)
    for axis, (label, value) in zip(axes.flat, panels, strict=True):
        for (gains, world), found in groups(counted).items():
            x = [value(run) for run in found]
            y = [min(run.measured_s["5 mm"], top) for run in found]
            axis.scatter(
                x, y, s=22, marker=marks[world], color=colours[gains], alpha=0.6, linewidth=1.0
            )
        low, high = min(axis.get_xlim()[0], 0.0), max(axis.get_xlim()[1], top)
        axis.fill_between([0.0, high], [0.0, high], color="#1f8a4c", alpha=0.08, linewidth=0.0)
        axis.plot([0.0, high], [0.0, high], color="black", linewidth=1.0)
        axis.set_xlim(low, high)
        axis.set_ylim(0.0, top)
        axis.set_xlabel(label)
        axis.text(0.97, 0.04, "sooner", transform=axis.transAxes, color="#1f8a4c", ha="right")
    for axis in axes[:, 0]:
        axis.set_ylabel("measured settling time to 5 mm, s")
    axes[1, 1].axvspan(axes[1, 1].get_xlim()[0], 0.0, color="#c0392b", alpha=0.08, linewidth=0.0)
    axes[1, 1].text(
        -0.2, 0.96 * top, "negative", color="#c0392b", ha="right", va="top", rotation=90
    )
    handles = [
        plt.Line2D([], [], color=colour, marker="s", linestyle="", label=f"exponent {gains}")
        for gains, colour in colours.items()
    ] + [
        plt.Line2D([], [], color="black", marker=mark, linestyle="", label=world)
        for world, mark in marks.items()
    ]
    figure.legend(handles=handles, loc="outside lower center", ncol=4)
    save(figure, folder / "settling.png")
    return "settling.png"
