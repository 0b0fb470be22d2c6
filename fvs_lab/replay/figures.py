"""Pictures of a recording: errors, paths, timing, predictions; the first is in ``overview.py``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fvs_lab.replay import timing
from fvs_lab.replay.data import Recording
from fvs_lab.replay.estimates import Prediction
from fvs_lab.replay.runs import Target
from fvs_lab.style import pyplot, save

#: More targets than this are not told apart by a legend.
_NAMED = 8
_SMALLEST_M = 1e-5
_INPUTS = {"joints": "#0072B2", "ball": "#D55E00", "jacobian": "#009E73"}


def colours(targets: Sequence[Target]) -> np.ndarray:
    """One colour a target, as in the demo's figure."""
    return pyplot().get_cmap("viridis")(np.linspace(0.05, 0.85, len(targets)))


def plain_numbers(axis: Any) -> None:
    """Write 0.1, 1, 10 at a logarithmic axis, rather than powers."""
    axis.yaxis.set_major_formatter("{x:g}")


def errors(targets: Sequence[Target], bounds_m: Sequence[float], folder: Path) -> str:
    """Draw the distance to each target since it was given; the file's name."""
    figure, axis = pyplot().subplots(figsize=(9, 4.6), layout="constrained")
    for target, colour in zip(targets, colours(targets), strict=True):
        label = f"target {target.number}" + (", moving" if target.moving else "")
        shown = 1e3 * np.maximum(target.errors_m, _SMALLEST_M)
        axis.semilogy(target.record.time_s, shown, color=colour, linewidth=1.4, label=label)
    for bound_m in bounds_m:
        axis.axhline(1e3 * bound_m, color="black", linewidth=0.8, linestyle=":")
        axis.text(
            1.01, 1e3 * bound_m, f"{1e3 * bound_m:g} mm", transform=axis.get_yaxis_transform(),
            va="center",
        )  # fmt: skip
    axis.set(xlabel="time since the target was given, s", ylabel="distance to the target, mm")
    axis.margins(x=0.01)
    plain_numbers(axis)
    if len(targets) <= _NAMED:
        axis.legend(ncols=2)
    save(figure, folder / "errors.png")
    return "errors.png"


def paths(targets: Sequence[Target], folder: Path) -> str:
    """Draw the ball's ways from three sides; the file's name."""
    figure, axes = pyplot().subplots(2, 2, figsize=(9, 8.4), layout="constrained")
    every_m = np.concatenate(
        [[target.record.target_m, *target.record.position_m] for target in targets]
    )
    middle_m = 0.5 * (every_m.max(axis=0) + every_m.min(axis=0))
    # One scale for all three, so that they can be compared.
    reach_m = 0.55 * float((every_m.max(axis=0) - every_m.min(axis=0)).max())
    views: tuple[tuple[Any, int, int, str], ...] = (
        (axes[0, 0], 0, 1, "as the camera sees it"),
        (axes[0, 1], 2, 1, "from the side"),
        (axes[1, 0], 0, 2, "from above"),
    )
    for axis, across, up, title in views:
        for target, colour in zip(targets, colours(targets), strict=True):
            way_m = np.array(target.record.position_m)
            goal_m = target.record.target_m
            straight = np.stack([way_m[0], goal_m])
            axis.plot(straight[:, across], straight[:, up], color="0.6", linewidth=0.9, zorder=1)
            axis.plot(way_m[:, across], way_m[:, up], color=colour, linewidth=1.8)
            axis.plot(way_m[0, across], way_m[0, up], "o", color=colour, markersize=4)
            axis.plot(
                goal_m[across], goal_m[up], "+", color=colour, markersize=13, markeredgewidth=2
            )
        axis.set(xlabel=f"{'xyz'[across]}, m", ylabel=f"{'xyz'[up]}, m", title=title)
        axis.set_aspect("equal")
        low, high = middle_m - reach_m, middle_m + reach_m
        axis.set_xlim(low[across], high[across])
        ends = (low[up], high[up])
        axis.set_ylim(*(ends[::-1] if up == 1 else ends))  # the camera's y points down
    legend = axes[1, 1]
    legend.axis("off")
    for target, colour in zip(targets[:_NAMED], colours(targets), strict=False):
        legend.plot([], [], color=colour, linewidth=1.8, label=f"way to target {target.number}")
    legend.plot([], [], "o", color="0.3", markersize=4, label="where the ball was then")
    legend.plot([], [], "+", color="0.3", markersize=13, markeredgewidth=2, label="target")
    legend.plot([], [], color="0.6", linewidth=0.9, label="straight to it")
    legend.legend(loc="center")
    save(figure, folder / "paths.png")
    return "paths.png"


def ages(recording: Recording, folder: Path) -> str:
    """Draw how old and how regular the inputs were; the file's name."""
    limits = timing.controller_values(recording)
    figure, (old, apart) = pyplot().subplots(
        2, 1, figsize=(10, 6.2), sharex=True, layout="constrained"
    )
    start_s = recording.start_s
    for key, colour in _INPUTS.items():
        series = recording.series.get(key)
        if series is None:
            continue
        name = series.topic.rpartition("/")[2]
        flow = recording.flows[series.topic]
        if np.isfinite(flow.stamp_s).any():
            old.plot(
                flow.arrival_s - start_s,
                1e3 * (flow.arrival_s - flow.stamp_s),
                ".",
                color=colour,
                markersize=2.5,
                label=f"{name}: stamp to arrival",
            )
        apart.semilogy(
            series.arrival_s[1:] - start_s,
            1e3 * np.maximum(np.diff(series.arrival_s), _SMALLEST_M),
            ".",
            color=colour,
            markersize=2.5,
            label=name,
        )
        limit_ms = 1e3 * limits[timing.INPUTS[key]]
        apart.axhline(limit_ms, color=colour, linewidth=1.0, linestyle="--")
    if {"ball", "commands"} <= recording.series.keys():
        arrival_s, latency_s = timing.command_latencies_s(
            recording.series["ball"], recording.series["commands"]
        )
        old.plot(
            arrival_s - start_s, 1e3 * latency_s, ".", color="0.3", markersize=2.5,
            label="image to the first command after it",
        )  # fmt: skip
    old.set_ylabel("age, ms")
    old.set_ylim(bottom=0.0)
    apart.set(ylabel="since the last message, ms", xlabel="time, s")
    apart.set_ylim(bottom=0.5)
    plain_numbers(apart)
    apart.plot([], [], color="0.3", linestyle="--", label="above its line the arm is held")
    for axis in (old, apart):
        if axis.get_legend_handles_labels()[0]:
            axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), markerscale=4)
    save(figure, folder / "ages.png")
    return "ages.png"


def estimates(found: Prediction, recording: Recording, folder: Path) -> str:
    """Draw T1 and T2 over time; the file's name."""
    figure, (each, summed) = pyplot().subplots(
        2, 1, figsize=(9, 5.6), sharex=True, layout="constrained"
    )
    time_s = found.time_s - recording.start_s
    each.semilogy(
        time_s, 1e3 * np.maximum(found.motion_m, _SMALLEST_M), ".", color="0.6",
        label="motion of the ball",
    )  # fmt: skip
    each.semilogy(
        time_s, 1e3 * np.maximum(found.t1_m, _SMALLEST_M), ".", color="#0072B2",
        label="T1: how far its prediction was off",
    )  # fmt: skip
    each.set_ylabel("each step, mm")
    plain_numbers(each)
    summed.plot(time_s, 1e3 * found.t2_m, color="#D55E00", label="T2: all predictions summed up")
    summed.set(ylabel="sum, mm", xlabel="time, s")
    summed.set_ylim(bottom=0.0)
    for axis in (each, summed):
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    save(figure, folder / "estimates.png")
    return "estimates.png"
