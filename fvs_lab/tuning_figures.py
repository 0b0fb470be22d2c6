"""One picture a parameter: runs, settling time and jitter for each of its values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fvs_lab.style import pyplot, save
from fvs_lab.trials import BOUNDS_M, Outcome

if TYPE_CHECKING:
    from fvs_lab.tuning import Knob

_COLOURS = ("#440154", "#3b528b", "#21918c", "#5ec962", "#d9b912")


def knob(folder: Path, one: Knob, results: Mapping[tuple[str, Any], Sequence[Outcome]]) -> str:
    """Draw what a parameter does; returns the file's name."""
    plt = pyplot()
    figure, (run, settling, jitter) = plt.subplots(
        1, 3, figsize=(12.0, 3.4), width_ratios=(2.0, 1.0, 1.0), layout="constrained"
    )
    places = range(len(one.values))
    for value, colour in zip(one.values, _COLOURS, strict=True):
        series = results[one.name, value][0].series
        run.semilogy(
            series["time_s"],
            1e3 * series["error_m"],
            color=colour,
            linewidth=2.4 if value == one.default else 1.3,
            label=f"{value:g}" + (", the default" if value == one.default else ""),
        )
    run.axhline(1e3 * BOUNDS_M["5 mm"], color="black", linewidth=0.8, linestyle=":")
    run.set_xlabel("time since the target was given, s")
    run.set_ylabel("true error, mm")
    run.legend(title=one.name, title_fontsize=9)
    panels = (
        (settling, "time to 5 mm, s", [[x.settled_s for x in results[one.name, v]]
                                        for v in one.values]),
        (jitter, "jitter at rest, mrad/s", [[1e3 * x.jitter_rad_s for x in results[one.name, v]]
                                             for v in one.values]),
    )  # fmt: skip
    for axis, label, columns in panels:
        finite = [[x for x in column if np.isfinite(x)] for column in columns]
        for place, column, colour in zip(places, finite, _COLOURS, strict=True):
            axis.plot([place] * len(column), column, "o", color=colour, markersize=4, alpha=0.6)
        axis.plot(places, [np.median(c) for c in columns], color="#555555", linewidth=1.2)
        axis.set_xticks(places, [f"{value:g}" for value in one.values])
        axis.set_xlabel(one.name)
        axis.set_title(label, fontsize=10)
        axis.set_ylim(bottom=0.0)
    file = f"{one.name.replace('.', '_')}.png"
    save(figure, folder / file)
    return file
