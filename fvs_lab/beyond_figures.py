"""Pictures of what is beyond the paper."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fvs_lab.beyond_camera import MOMENTS
from fvs_lab.beyond_results import KEPT, Results
from fvs_lab.beyond_terms import (
    BEST,
    CLAIRVOYANT,
    EXTENDED,
    FOLLOWERS,
    PROPOSED,
    WORLDS,
    times_s,
)
from fvs_lab.beyond_tracking import CIRCLE, LINE
from fvs_lab.style import COLOURS, pyplot, save

#: What never settles, or is slower than this, stands here.
_SLOWEST_FLOORS, _SLOWEST_RATIO = 8.0, 4.0


def _colour(name: str) -> str:
    return COLOURS[name.split(",", maxsplit=1)[0]]


def minute(results: Results, folder: Path) -> str:
    """Draw the errors of what a minute taught; returns the file's name."""
    plt = pyplot()
    figure, axis = plt.subplots(figsize=(8.6, 3.6), layout="constrained")
    rows = {
        "chain, box M": [one.chain_box for one in results.minutes],
        "chain, workspace": [one.chain_workspace for one in results.minutes],
        "networks it taught, box M": [one.taught_box for one in results.minutes],
        "networks, workspace": [one.taught_workspace for one in results.minutes],
        "the paper's training, box M": [one.paper_box for one in results.minutes],
        "the paper's training, workspace": [one.paper_workspace for one in results.minutes],
    }
    colours = [COLOURS[name] for name in (BEST, EXTENDED, PROPOSED) for _ in range(2)]
    for place, (values, colour) in enumerate(zip(rows.values(), colours, strict=True)):
        filled = colour if place % 2 == 0 else "none"
        axis.scatter(
            100 * np.array(values), np.full(len(values), place), color=colour, facecolor=filled
        )
    axis.set_xscale("log")
    axis.set_xlabel("error of the Jacobian, median over joints, %")
    axis.set_yticks(range(len(rows)), rows)
    axis.invert_yaxis()
    save(figure, folder / "minute.png")
    return "minute.png"


def races(results: Results, folder: Path) -> str:
    """Draw settling over the floors, and jitter; returns the file's name."""
    plt = pyplot()
    figure, (*lefts, right) = plt.subplots(
        1, 3, figsize=(14.0, 6.0), sharey=True, layout="constrained"
    )
    for left, bound in zip(lefts, ("5 mm", "2 mm"), strict=True):
        _dots(left, results.in_floors(results.played_s(bound), bound), 0, "black")
        for place, name in enumerate(results.races, start=1):
            over = results.over_floor(name, bound)
            _dots(left, np.minimum(over, _SLOWEST_FLOORS), place, _colour(name))
        left.axvline(1.0, color="black", linewidth=0.8)
        left.set_xscale("log")
        ticks = (1, 1.5, 2, 3, 5, 8)
        left.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        left.minorticks_off()
        left.set_xlabel(f"settling to {bound} over the physical floor")
    for place, (name, outcomes) in enumerate(results.races.items(), start=1):
        jitter = [1e3 * one.jitter_rad_s for one in outcomes if np.isfinite(one.jitter_rad_s)]
        _dots(right, jitter, place, _colour(name))
    right.set_xscale("log")
    decades = (0.1, 0.2, 0.5, 1, 2, 5, 10)
    right.set_xticks(decades, [f"{tick:g}" for tick in decades])
    right.minorticks_off()
    right.set_xlabel("jitter of the command at rest, mrad/s")
    right.set_yticks(range(1 + len(results.races)), [CLAIRVOYANT, *results.races])
    right.invert_yaxis()
    save(figure, folder / "races.png")
    return "races.png"


def _dots(axis, values: Sequence[float] | np.ndarray, place: float, colour: str) -> None:
    """Draw a row of dots and their median as a bar."""
    if len(values) == 0:
        return
    axis.plot(values, np.full(len(values), place), "o", color=colour, alpha=0.45, markersize=5)
    middle = float(np.median(values))
    axis.plot([middle, middle], [place - 0.3, place + 0.3], color=colour, linewidth=2.5)


def camera(results: Results, folder: Path) -> str:
    """Draw how much slower a moved camera makes everybody; returns the file's name."""
    plt = pyplot()
    moments = MOMENTS[1:]
    figure, axes = plt.subplots(
        1, len(moments), figsize=(13.5, 3.8), sharey=True, layout="constrained"
    )
    for axis, moment in zip(axes, moments, strict=True):
        for place, name in enumerate(results.shaken):
            ratios = [min(one, _SLOWEST_RATIO) for one in results.slowdown(moment, name)]
            _dots(axis, ratios, place, _colour(name))
        axis.axvline(KEPT, color="black", linewidth=0.8, linestyle="--")
        axis.set_xlim(right=_SLOWEST_RATIO + 0.1)
        axis.set_title(moment, fontsize=10)
        axis.set_xlabel("settling over that of the undisturbed run")
    axes[0].set_yticks(range(len(results.shaken)), results.shaken)
    axes[0].invert_yaxis()
    save(figure, folder / "camera.png")
    return "camera.png"


def worlds(results: Results, folder: Path) -> str:
    """Draw settling time and rest in other worlds; returns the file's name."""
    plt = pyplot()
    figure, (upper, lower) = plt.subplots(
        2, 1, figsize=(12.5, 5.4), sharex=True, layout="constrained"
    )
    for shift, name in enumerate(FOLLOWERS):
        for place, number in enumerate(results.world_numbers):
            outcomes = results.worlds[number, name]
            at = place + 0.22 * (shift - 1)
            label = name if place == 0 else None
            times = np.minimum(times_s(outcomes), 4.0)
            rests = [1e3 * one.final_rms_m for one in outcomes]
            for axis, values in ((upper, times), (lower, rests)):
                low, middle, high = np.quantile(values, (0.1, 0.5, 0.9))
                axis.plot([at, at], [low, high], color=_colour(name), linewidth=1.5, alpha=0.6)
                axis.plot(at, middle, "o", color=_colour(name), label=label)
    upper.set_ylabel("to 5 mm, s (4: never)")
    lower.set_ylabel("final rms, mm")
    lower.set_yscale("log")
    names = [f"{WORLDS[number].kind}\n{WORLDS[number].label}" for number in results.world_numbers]
    lower.set_xticks(range(len(names)), names)
    upper.set_ylim(0.0, 1.1 * upper.get_ylim()[1])
    figure.legend(*upper.get_legend_handles_labels(), loc="outside upper center", ncol=3)
    save(figure, folder / "worlds.png")
    return "worlds.png"


def tracking(results: Results, folder: Path) -> str:
    """Draw tracking errors against the target's speed; returns the file's name."""
    plt = pyplot()
    figure, axes = plt.subplots(1, 2, figsize=(10.5, 4.0), sharey=True, layout="constrained")
    speeds = results.speeds_m_s()
    for axis, kind in zip(axes, (LINE, CIRCLE), strict=True):
        for name in FOLLOWERS:
            for feed_forward, style in ((True, "o-"), (False, "x:")):
                rms_mm = [
                    1e3 * float(np.median(results.tracking_m(kind, one, name, feed_forward)))
                    for one in speeds
                ]
                label = name if feed_forward else f"{name}, alone"
                axis.plot(speeds, rms_mm, style, color=_colour(name), label=label)
        axis.set_yscale("log")
        axis.set_xlabel("speed of the target, m/s")
        axis.set_title(kind, fontsize=10)
    axes[0].set_ylabel("distance from the target, rms, mm")
    figure.legend(*axes[1].get_legend_handles_labels(), loc="outside upper center", ncol=6)
    save(figure, folder / "tracking.png")
    return "tracking.png"
