"""The picture of what each change does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fvs_lab.ablation_changes import (
    Change,
    Row,
    jitter_ratio,
    settling_ratio,
)
from fvs_lab.style import pyplot, save


def ratios(changes: Sequence[Change], rows: Mapping[str, Row], folder: Path) -> str:
    """Draw ratios of settling time and jitter, a row a change; returns the file's name."""
    plt = pyplot()
    shown = [change for change in changes if change.against]
    figure, axes = plt.subplots(1, 2, figsize=(12, 8.8), sharey=True, layout="constrained")
    panels = (
        ("time to 5 mm", settling_ratio, (0.6, 5.0), (0.7, 1.0, 1.5, 2.0, 3.0, 4.0)),
        ("jitter", jitter_ratio, (0.2, 50.0), (0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)),
    )
    colours = {"control law": "#0072B2", "Jacobian": "#D55E00", "images": "#009E73"}
    for axis, (label, ratio_of, (low, high), ticks) in zip(axes, panels, strict=True):
        for place, change in enumerate(shown):
            ratio = ratio_of(rows, change.name)
            colour = colours.get(change.group, "#CC79A7")
            ends = [min(max(end, low), high) for end in (ratio.low, ratio.high)]
            axis.plot(ends, [place, place], color=colour, linewidth=1.6, alpha=0.7)
            if ratio.value < high:
                axis.plot(max(ratio.value, low), place, "o", color=colour)
            else:
                word = "never" if np.isinf(ratio.value) else f"{ratio.value:.0f}"
                axis.plot(high / 1.03, place, ">", color=colour)
                axis.text(high / 1.08, place, word, color=colour, ha="right", va="center")
        axis.axvline(1.0, color="black", linewidth=0.8)
        axis.set_xscale("log")
        axis.set_xlim(low, high)
        axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axis.minorticks_off()
        axis.set_xlabel(f"{label}, ratio")
    axes[0].set_yticks(range(len(shown)), [_label(change) for change in shown])
    axes[0].invert_yaxis()
    handles = [
        plt.Line2D([], [], color=colour, marker="o", label=group)
        for group, colour in {**colours, "camera": "#CC79A7"}.items()
    ]
    figure.legend(handles=handles, loc="outside lower center", ncol=4)
    save(figure, folder / "ablation.png")
    return "ablation.png"


def _label(change: Change) -> str:
    return f"{change.name}  [over {change.over}]" if change.over else change.name
