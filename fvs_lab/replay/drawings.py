"""Pictures of a recording: curves, thinned to what can be seen of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fvs_controller_node.reasons import State
from fvs_lab.figures import grid, legend, shades
from fvs_lab.replay import story
from fvs_lab.replay.reading import Recording, Status
from fvs_lab.replay.targets import BOUNDS_M, Target
from fvs_ros.status import SILENT

_COLOURS = {
    State.WAITING.name: "#bbbbbb",
    State.READY.name: "#9ecae1",
    State.SERVOING.name: "#5fb88f",
    State.HOLDING.name: "#e69f00",
    State.FAULT.name: "#c0392b",
    SILENT: "#555555",
}
_LIMIT = "#7a6fb0"
#: A curve of many more points than this is drawn by the least and largest of each pixel.
_PIXELS = 1200
#: More targets than this are not told apart by a legend.
_NAMED = 8


def overview(recording: Recording, targets: Sequence[Target]):
    """States, limits, error, measured and commanded joint velocities."""
    heights = {"height_ratios": [0.7, 1.5, 1.5, 1.5]}
    figure, axes = grid(4, 1, (12, 9), sharex=True, gridspec_kw=heights)
    (states, error, measured, commanded) = axes[:, 0]
    _draw_states(states, story.statuses(recording))
    _draw_errors(error, targets, recording.start_s)
    _draw_velocities(measured, recording, "joints", "measured")
    _draw_velocities(commanded, recording, "commands", "commanded")
    end_s = recording.end_s - recording.start_s
    commanded.set(xlabel="time since the recording began, s", xlim=(0.0, end_s))
    legend(figure, 7)
    return figure


def _draw_states(axis: Any, statuses: Sequence[Status]) -> None:
    spans = [(one.start_s, one.length_s) for one in story.merged(statuses, "limit") if one.limit]
    axis.broken_barh(spans, (-0.4, 0.8), facecolors=_LIMIT, edgecolors=_LIMIT)
    states = story.merged(statuses, "state")
    # Rare ones last, so that a long neighbour's edge does not cover them.
    for state, _, _ in story.totals(states, "state"):
        spans = [(one.start_s, one.length_s) for one in states if one.state == state]
        colour = _COLOURS.get(state, "#ffd7f0")
        axis.broken_barh(spans, (0.6, 0.8), facecolors=colour, edgecolors=colour, label=state)
    axis.set(ylim=(-0.6, 1.6), yticks=[0, 1], yticklabels=["a limit is active", "controller"])
    axis.grid(visible=False)


def _draw_errors(axis: Any, targets: Sequence[Target], begun_s: float) -> None:
    """The distance to each target, each curve from its time, and the bounds of settling."""
    named = len(targets) <= _NAMED
    for number, (one, colour) in enumerate(zip(targets, shades(len(targets)), strict=True)):
        error_mm = np.maximum(1e3 * one.errors_m, 0.01)
        look = {"color": colour, "label": f"target {number + 1}" if named else None}
        _curve(axis, one.given_s - begun_s + one.time_s, error_mm, **look)
    for bound_m in BOUNDS_M.values():
        _level(axis, 1e3 * bound_m, f"{1e3 * bound_m:g} mm")
    axis.set(yscale="log", ylabel="distance to the\ntarget, mm")


def _draw_velocities(axis: Any, recording: Recording, key: str, words: str) -> None:
    started, series = recording.started, recording.series.get(key)
    names = [name.removesuffix("_joint") for name in started["joint_names"]]
    axis.set_ylabel(f"{words} joint\nvelocities, rad/s")
    if series is not None:
        for name, column in zip(names, series.values[:, -len(names) :].T, strict=True):
            _curve(axis, series.arrival_s - recording.start_s, column, label=name)
    for sign, text in ((1.0, "limit"), (-1.0, "")):
        _level(axis, sign * started["max_joint_velocity_rad_s"], text)


def paths(targets: Sequence[Target]):
    """The paths of ball or tag, as the camera sees them and from above."""
    figure, (axes,) = grid(1, 2, (12, 5.5))
    colours = shades(len(targets))
    for axis, up in zip(axes, (1, 2), strict=True):
        for target, colour in zip(targets, colours, strict=True):
            path_mm = 1e3 * target.position_m[:: len(target.position_m) // _PIXELS + 1]
            axis.plot(path_mm[:, 0], path_mm[:, up], color=colour, linewidth=1.6)
            axis.plot(path_mm[0, 0], path_mm[0, up], "o", color=colour, markersize=4)
            end_mm = 1e3 * target.target_m[[0, up]]
            axis.plot(*end_mm, "+", color=colour, markersize=13, mew=2)
        axis.set(xlabel="x, mm", ylabel=f"{'xyz'[up]}, mm")
        axis.axis("equal")
    axes[0].set_title("as the camera sees it")
    axes[0].invert_yaxis()  # the camera's y points down
    axes[1].set_title("from above")
    return figure


def steps(found: story.Prediction):
    """T1 and T2 over time."""
    figure, ((each,), (summed,)) = grid(2, 1, (12, 6.4), sharex=True)
    time_s = found.time_s - found.time_s[0]
    for values_m, words in ((found.motion_m, "motion"), (found.t1_m, "T1")):
        _curve(each, time_s, np.maximum(1e3 * values_m, 0.01), ".", label=words)
    _curve(summed, time_s, 1e3 * found.t2_m, label="T2: all errors summed up")
    each.set(yscale="log", ylabel="each step, mm")
    summed.set(ylabel="sum, mm", xlabel="time since the first step, s")
    legend(figure)
    return figure


def _curve(axis: Any, x: np.ndarray, y: np.ndarray, style: str = "-", **look: Any) -> None:
    """Draw a curve of any number of points, thinned to what can be seen of it."""
    if len(x) > 4 * _PIXELS:
        starts = np.linspace(0, len(x), _PIXELS, endpoint=False).astype(int)
        y = np.stack([np.fmin.reduceat(y, starts), np.fmax.reduceat(y, starts)], axis=1).ravel()
        x = np.repeat(x[starts], 2)
    axis.plot(x, y, style, linewidth=1.1, markersize=2.5, **look)


def _level(axis: Any, level: float, name: str) -> None:
    """Draw a dashed line at a bound, with its name."""
    axis.axhline(level, color="black", linewidth=0.9, linestyle="--")
    axis.text(0.004, level, name, transform=axis.get_yaxis_transform(), va="bottom", size=8)
