"""The picture to look at first: what the controller did, error and joint speeds, over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fvs_lab.replay import story
from fvs_lab.replay.data import Recording
from fvs_lab.replay.figures import colours, plain_numbers
from fvs_lab.replay.runs import Target
from fvs_lab.replay.timing import controller_values
from fvs_lab.style import pyplot, save
from fvs_ros.joints import N_JOINTS, UR_JOINT_NAMES
from fvs_ros.status import SILENT

STATES = {
    "WAITING": "#bbbbbb",
    "READY": "#9ecae1",
    "SERVOING": "#5fb88f",
    "HOLDING": "#e69f00",
    "FAULT": "#c0392b",
    SILENT: "#dddddd",
    story.ENDED: "#ffffff",
}
_LIMIT = "#7a6fb0"
#: Of a state that is none of this project's controller.
_OTHER = "#ffd7f0"
_JOINTS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_SMALLEST_M = 1e-5
#: A state is named where it takes at least this share of the width.
_NAMED_SHARE = 0.07


def overview(
    recording: Recording, targets: Sequence[Target], bounds_m: Sequence[float], folder: Path
) -> str:
    """Draw states, limits, error, measured and commanded joint speeds; the file's name."""
    plt = pyplot()
    figure, axes = plt.subplots(
        4, 1, figsize=(12, 9), sharex=True, layout="constrained", height_ratios=[0.7, 1.5, 1.5, 1.5]
    )
    _strip(axes[0], recording)
    _errors(axes[1], recording, targets, bounds_m)
    limit_rad_s = controller_values(recording)["max_joint_velocity_rad_s"]
    for axis, key, first, title in (
        (axes[2], "joints", N_JOINTS, "measured joint\nvelocities, rad/s"),
        (axes[3], "commands", 0, "commanded joint\nvelocities, rad/s"),
    ):
        _velocities(axis, recording, key, first, limit_rad_s)
        axis.set_ylabel(title)
    named = next((axis for axis in axes[2:] if axis.get_legend_handles_labels()[0]), None)
    if named is not None:
        named.legend(loc="upper left", bbox_to_anchor=(1.0, 0.93))
    axes[-1].set_xlabel("time since the recording began, s")
    axes[-1].set_xlim(0.0, recording.end_s - recording.start_s)
    save(figure, folder / "overview.png")
    return "overview.png"


def _strip(axis: Any, recording: Recording) -> None:
    length_s = recording.end_s - recording.start_s
    states = story.states(recording)
    for row, spells in ((1, states), (0, story.limits(recording))):
        # What lasted a moment is to be seen, too: drawn last, with a line around.
        for spell in sorted(spells, key=lambda one: one.start_s - one.end_s):
            left = spell.start_s - recording.start_s
            width = spell.end_s - spell.start_s
            colour = STATES.get(spell.what, _OTHER) if row else _LIMIT
            axis.broken_barh([(left, width)], (row - 0.4, 0.8), color=colour, linewidth=1.5)
    for left, width, name in _blocks(recording, states):
        if width > _NAMED_SHARE * length_s:
            axis.text(left + 0.5 * width, 1, name, ha="center", va="center", fontsize=8)
    axis.set(ylim=(-0.6, 1.6), yticks=[0, 1], yticklabels=["a limit is active", "controller"])
    axis.grid(visible=False)
    seen = list(dict.fromkeys(spell.what for spell in states))
    handles = [
        pyplot().Rectangle((0, 0), 1, 1, facecolor=STATES.get(what, _OTHER), edgecolor="#888888")
        for what in seen
    ]
    axis.legend(handles, seen, loc="upper left", bbox_to_anchor=(1.0, 1.2))


def _blocks(recording: Recording, states: Sequence[story.Spell]) -> list[tuple[float, float, str]]:
    """Left end, width and name of each stretch of one state, whatever its reasons."""
    blocks: list[tuple[float, float, str]] = []
    for spell in states:
        left = spell.start_s - recording.start_s
        width = spell.end_s - spell.start_s
        if blocks and blocks[-1][2] == spell.what:
            first, before, name = blocks[-1]
            blocks[-1] = (first, before + width, name)
        else:
            blocks.append((left, width, spell.what))
    return blocks


def _errors(
    axis: Any, recording: Recording, targets: Sequence[Target], bounds_m: Sequence[float]
) -> None:
    for target, colour in zip(targets, colours(targets), strict=True):
        given_s = target.record.start_s - recording.start_s
        axis.axvline(given_s, color=colour, linewidth=1.2, alpha=0.6)
        axis.semilogy(
            given_s + np.array(target.record.time_s),
            1e3 * np.maximum(target.errors_m, _SMALLEST_M),
            color=colour,
            linewidth=1.4,
        )
    for bound_m in bounds_m:
        axis.axhline(1e3 * bound_m, color="black", linewidth=0.8, linestyle=":")
        axis.text(
            1.005, 1e3 * bound_m, f"{1e3 * bound_m:g} mm", transform=axis.get_yaxis_transform(),
            va="center", fontsize=8,
        )  # fmt: skip
    axis.set_ylabel("distance to the\ntarget, mm")
    if targets:
        plain_numbers(axis)
    else:
        axis.text(0.5, 0.5, "no targets in the bag", transform=axis.transAxes, ha="center")


def _velocities(axis: Any, recording: Recording, key: str, first: int, limit_rad_s: float) -> None:
    series = recording.series.get(key)
    if series is None or not np.isfinite(series.values[:, first:]).any():
        axis.text(0.5, 0.5, "not in the bag", transform=axis.transAxes, ha="center")
        return
    time_s = series.arrival_s - recording.start_s
    for joint, colour in enumerate(_JOINTS):
        axis.plot(
            time_s,
            series.values[:, first + joint],
            color=colour,
            linewidth=0.9,
            label=UR_JOINT_NAMES[joint].removesuffix("_joint"),
        )
    for sign in (-1.0, 1.0):
        axis.axhline(sign * limit_rad_s, color="black", linewidth=0.9, linestyle="--")
    axis.text(
        1.005, limit_rad_s, "limit", transform=axis.get_yaxis_transform(), va="center", fontsize=8
    )
