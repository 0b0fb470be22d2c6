"""Pictures of a recording: panels of curves, thinned to what can be seen of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fvs_controller_node.reasons import State
from fvs_lab.figures import pyplot, save
from fvs_lab.replay import story
from fvs_lab.replay.predictions import Prediction
from fvs_lab.replay.recording import Recording
from fvs_lab.replay.targets import Target
from fvs_ros.status import SILENT

STATES = {
    State.WAITING.name: "#bbbbbb",
    State.READY.name: "#9ecae1",
    State.SERVOING.name: "#5fb88f",
    State.HOLDING.name: "#e69f00",
    State.FAULT.name: "#c0392b",
    SILENT: "#555555",
    story.ENDED: "#ffffff",
}
_LIMIT = "#7a6fb0"
#: More curves than this are not told apart by a legend.
_NAMED = 8
#: A curve of many more points than this is drawn by the least and largest of each pixel.
_PIXELS = 1200
_SINCE_BEGIN = "time since the recording began, s"


@dataclass(frozen=True)
class Panel:
    """Curves over one axis.

    Parameters
    ----------
    label : str
        What they show, with its unit.
    curves : sequence of (x, y, name, colour)
        Arrays of shape (n,); no name is in no legend, and None is the next colour.
    levels : sequence of (y, name)
        Horizontal lines.
    style : str
        Matplotlib's format of the curves.
    smallest : float
        Least value that is shown on a logarithmic axis; 0 for a linear one.
    """

    label: str
    curves: Sequence[tuple[np.ndarray, np.ndarray, str, Any]]
    levels: Sequence[tuple[float, str]] = ()
    style: str = "-"
    smallest: float = 0.0

    def draw(self, axis: Any) -> None:
        """Draw it into matplotlib's axes."""
        for x, y, name, colour in self.curves:
            shown = thinned(x, np.maximum(y, self.smallest) if self.smallest else y)
            axis.plot(*shown, self.style, label=name, color=colour, linewidth=1.1, markersize=2.5)
        for level, name in self.levels:
            axis.axhline(level, color="black", linewidth=0.9, linestyle="--")
            behind = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0}
            at = axis.get_yaxis_transform()
            axis.text(0.004, level, name, transform=at, va="bottom", size=8, bbox=behind)
        if self.smallest:
            axis.set_yscale("log")
            axis.yaxis.set_major_formatter("{x:g}")
        if not self.curves:
            axis.text(0.5, 0.5, "not in the bag", transform=axis.transAxes, ha="center")
        elif len(self.curves) <= _NAMED:
            axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), markerscale=4)
        axis.set_ylabel(self.label)


def thinned(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What looks the same as a curve of n points, shape (n,): the extremes of each pixel."""
    if len(x) <= 4 * _PIXELS:
        return x, y
    starts = np.linspace(0, len(x), _PIXELS, endpoint=False).astype(int)
    extremes = np.stack([np.fmin.reduceat(y, starts), np.fmax.reduceat(y, starts)], axis=1)
    return np.repeat(x[starts], 2), extremes.reshape(-1)


def panels(path: Path, rows: Sequence[Panel], x_label: str) -> None:
    """Draw panels with one horizontal axis, one below the other."""
    figure, axes = pyplot().subplots(
        len(rows), figsize=(12, 3.2 * len(rows)), sharex=True, layout="constrained", squeeze=False
    )
    for axis, panel in zip(axes[:, 0], rows, strict=True):
        panel.draw(axis)
    axes[-1, 0].set_xlabel(x_label)
    save(figure, path)


def overview(
    recording: Recording, targets: Sequence[Target], bounds_m: Sequence[float], path: Path
) -> None:
    """Draw states, limits, error, measured and commanded joint velocities."""
    figure, axes = pyplot().subplots(
        4, figsize=(12, 9), sharex=True, layout="constrained", height_ratios=[0.7, 1.5, 1.5, 1.5]
    )
    _draw_states(axes[0], recording)
    starts_s = [one.given_s - recording.start_s for one in targets]
    errors(targets, starts_s, bounds_m).draw(axes[1])
    _velocities(recording, "joints", "measured").draw(axes[2])
    _velocities(recording, "commands", "commanded").draw(axes[3])
    axes[3].set(xlabel=_SINCE_BEGIN, xlim=(0.0, recording.end_s - recording.start_s))
    save(figure, path)


def _draw_states(axis: Any, recording: Recording) -> None:
    spells = story.statuses(recording)
    # The short ones last, so that a long neighbour's edge does not cover them.
    states = sorted(story.merged(spells, "state"), key=lambda one: -one.length_s)
    limits = [one for one in story.merged(spells, "limit") if one.limit]
    state_colours = [STATES.get(one.state, "#ffd7f0") for one in states]
    for row, bars, colours in ((1, states, state_colours), (0, limits, [_LIMIT] * len(limits))):
        spans = [(one.start_s, one.length_s) for one in bars]
        axis.broken_barh(spans, (row - 0.4, 0.8), facecolors=colours, edgecolors=colours)
    axis.set(ylim=(-0.6, 1.6), yticks=[0, 1], yticklabels=["a limit is active", "controller"])
    axis.grid(visible=False)
    seen = dict(zip((one.state for one in states), state_colours, strict=True))
    patch = pyplot().Rectangle
    handles = [patch((0, 0), 1, 1, fc=colour, ec="#888888") for colour in seen.values()]
    axis.legend(handles, seen, loc="upper left", bbox_to_anchor=(1.0, 1.2))


def errors(
    targets: Sequence[Target], starts_s: Sequence[float], bounds_m: Sequence[float]
) -> Panel:
    """The distance to each target, its curve beginning at a time, and the bounds of settling."""
    colours = pyplot().get_cmap("viridis")(np.linspace(0.05, 0.85, len(targets)))
    curves = [
        (start_s + one.time_s, 1e3 * one.errors_m, f"target {number}", colour)
        for number, (one, start_s, colour) in enumerate(
            zip(targets, starts_s, colours, strict=True), start=1
        )
    ]
    levels = [(1e3 * bound_m, f"{1e3 * bound_m:g} mm") for bound_m in bounds_m]
    return Panel("distance to the\ntarget, mm", curves, levels if targets else (), smallest=0.01)


def _velocities(recording: Recording, key: str, words: str) -> Panel:
    started, series = recording.started(), recording.series.get(key)
    names = [name.removesuffix("_joint") for name in started["joint_names"]]
    label = f"{words} joint\nvelocities, rad/s"
    if series is None or not np.isfinite(series.values[:, -len(names) :]).any():
        return Panel(label, [])
    time_s = series.arrival_s - recording.start_s
    columns = series.values[:, -len(names) :].T
    curves = [(time_s, column, name, None) for name, column in zip(names, columns, strict=True)]
    limit_rad_s = started["max_joint_velocity_rad_s"]
    return Panel(label, curves, [(limit_rad_s, "limit"), (-limit_rad_s, "")])


def paths(targets: Sequence[Target], path: Path) -> None:
    """Draw the ball's paths, as the camera sees them and from above."""
    figure, axes = pyplot().subplots(1, 2, figsize=(12, 5.5), layout="constrained")
    colours = pyplot().get_cmap("viridis")(np.linspace(0.05, 0.85, len(targets)))
    for axis, up in zip(axes, (1, 2), strict=True):
        for target, colour in zip(targets, colours, strict=True):
            path_mm = 1e3 * target.position_m[:: len(target.position_m) // _PIXELS + 1]
            axis.plot(path_mm[:, 0], path_mm[:, up], color=colour, linewidth=1.6)
            axis.plot(path_mm[0, 0], path_mm[0, up], "o", color=colour, markersize=4)
            axis.plot(*(1e3 * target.target_m[[0, up]]), "+", color=colour, markersize=13, mew=2)
        axis.set(xlabel="x, mm", ylabel=f"{'xyz'[up]}, mm")
        axis.axis("equal")
    axes[0].set_title("as the camera sees it")
    axes[0].invert_yaxis()  # the camera's y points down
    axes[1].set_title("from above")
    save(figure, path)


def ages(recording: Recording, path: Path) -> None:
    """Draw how old and how regular the inputs were."""
    series, started = recording.series, recording.started()
    old, apart = [], []
    held: dict[float, list[str]] = {}
    for key, parameter in story.INPUTS.items():
        if key in series:
            one = recording.topics[series[key].topic]
            time_s, name = one.arrival_s - recording.start_s, one.topic.rpartition("/")[2]
            ages_s = one.arrival_s - one.stamp_s
            if np.isfinite(ages_s).any():
                old.append((time_s, 1e3 * ages_s, f"{name}: stamp to arrival", None))
            apart.append((time_s[1:], 1e3 * np.diff(time_s), name, None))
            held.setdefault(1e3 * started[parameter], []).append(name)
    if {"ball", "commands"} <= series.keys():
        arrival_s, latency_s = story.command_latencies(series["ball"], series["commands"])
        time_s = arrival_s - recording.start_s
        old.append((time_s, 1e3 * latency_s, "image to the first command after it", None))
    levels = [(age_ms, f"longer holds the arm: {', '.join(held[age_ms])}") for age_ms in held]
    rows = [
        Panel("age, ms", old, style="."),
        Panel("since the last\nmessage, ms", apart, levels, style=".", smallest=0.5),
    ]
    panels(path, rows, _SINCE_BEGIN)


def predictions(found: Prediction, path: Path) -> None:
    """Draw T1 and T2 over time."""
    time_s = found.time_s - found.time_s[0]
    each = [
        (time_s, 1e3 * found.motion_m, "motion of the ball", "0.6"),
        (time_s, 1e3 * found.t1_m, "T1: error of its prediction", None),
    ]
    summed = [(time_s, 1e3 * found.t2_m, "T2: all errors summed up", None)]
    rows = [Panel("each step, mm", each, style=".", smallest=0.01), Panel("sum, mm", summed)]
    panels(path, rows, "time since the first step, s")
