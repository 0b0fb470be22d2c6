"""When messages came: rates, gaps, ages, and how long an image took to become a command."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fvs_controller_node.config import PARAMETERS
from fvs_lab.replay.data import Flow, Recording, Series
from fvs_ros.status import SILENT_S

#: Inputs of the controller, and the parameter above which an age holds the arm.
INPUTS = {
    "joints": "joint_states_max_age_s",
    "ball": "ball_max_age_s",
    "jacobian": "jacobian_max_age_s",
}
#: Stamps further from their arrivals than this are of another clock, s: nothing is so slow.
_OTHER_CLOCK_S = 0.5


@dataclass(frozen=True)
class Rhythm:
    """How one topic came.

    Parameters
    ----------
    topic : str
        Full name.
    count : int
        Number of messages.
    rate_hz : float
        One over the mean interval.
    jitter_s : float
        Standard deviation of the intervals.
    longest_s : float
        Largest interval.
    age_s, worst_age_s : float
        From stamp to arrival, median and 99th percentile; not a number without stamps.
    """

    topic: str
    count: int
    rate_hz: float
    jitter_s: float
    longest_s: float
    age_s: float
    worst_age_s: float


@dataclass(frozen=True)
class Gap:
    """A silence of an input, longer than the controller waits.

    Parameters
    ----------
    topic : str
        The input.
    start_s, length_s : float
        Last arrival before it, and how long it was.
    """

    topic: str
    start_s: float
    length_s: float


def rhythms(recording: Recording) -> list[Rhythm]:
    """Every topic with at least two messages."""
    return [
        rhythm(topic, flow) for topic, flow in recording.flows.items() if len(flow.arrival_s) > 1
    ]


def rhythm(topic: str, flow: Flow) -> Rhythm:
    """One topic."""
    intervals = np.diff(flow.arrival_s)
    ages = (flow.arrival_s - flow.stamp_s)[np.isfinite(flow.stamp_s)]
    mean_s = float(intervals.mean())
    return Rhythm(
        topic=topic,
        count=len(flow.arrival_s),
        rate_hz=1.0 / mean_s if mean_s > 0.0 else float("nan"),
        jitter_s=float(intervals.std()),
        longest_s=float(intervals.max()),
        age_s=float(np.median(ages)) if ages.size else float("nan"),
        worst_age_s=float(np.percentile(ages, 99)) if ages.size else float("nan"),
    )


def controller_values(recording: Recording) -> Mapping[str, Any]:
    """The controller's parameters as started."""
    return recording.started("fvs_controller_node", PARAMETERS)


def gaps(recording: Recording) -> list[Gap]:
    """Silences of the controller's inputs, the first one first."""
    limits = controller_values(recording)
    found = []
    for key, parameter in INPUTS.items():
        series = recording.series.get(key)
        if series is None:
            continue
        intervals = np.diff(series.arrival_s)
        for index in np.flatnonzero(intervals > limits[parameter]):
            found.append(Gap(series.topic, float(series.arrival_s[index]), float(intervals[index])))
    return sorted(found, key=lambda gap: gap.start_s)


def other_clocks(recording: Recording) -> str:
    """Which stamps are not by the clock of the arrivals, in a sentence; empty if none."""
    found = []
    for key in ("joints", "ball"):
        series = recording.series.get(key)
        if series is None or not np.isfinite(series.stamp_s).any():
            continue
        behind_s = float(np.nanmedian(series.arrival_s - series.stamp_s))
        if abs(behind_s) > _OTHER_CLOCK_S:
            where = "behind" if behind_s > 0.0 else "ahead of"
            found.append(f"those of {series.topic} are {abs(behind_s):.1f} s {where} it")
    if not found:
        return ""
    return (
        f"Stamps are not by the recorder’s clock: {' and '.join(found)}, so that ages and "
        "latencies say nothing."
    )


def command_latencies_s(ball: Series, commands: Series) -> tuple[np.ndarray, np.ndarray]:
    """From an image's exposure to the first command after its ball position came.

    Images from before the first command, or from a silence of the commands, wait for nobody who
    would be slow: the controller was not there.

    Returns
    -------
    arrival_s : ndarray, shape (n,)
        When the position came, s; those with a stamp, between commands.
    latency_s : ndarray, shape (n,)
        How old the image was when that command came, s.
    """
    following = np.searchsorted(commands.arrival_s, ball.arrival_s, side="left")
    # Between the command before an image and the one after it; for ever where one is missing.
    apart_s = np.diff(commands.arrival_s, prepend=-np.inf, append=np.inf)[following]
    usable = (apart_s <= SILENT_S) & np.isfinite(ball.stamp_s)
    came_s = commands.arrival_s[following[usable]]
    return ball.arrival_s[usable], came_s - ball.stamp_s[usable]
