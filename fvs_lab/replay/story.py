"""What happened, and when: states, limits, warnings, silences, timing, predictions."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import attrgetter
from typing import Any

import numpy as np

from fvs_estimator_node.loop import StepPairing
from fvs_lab.replay.reading import CONTROLLER, Event, Recording, Series, Status
from fvs_ros.status import SILENT, SILENT_S
from fvs_tools.score import criteria

SERVOING, SETTLED, SHUT_DOWN = "SERVOING", "SETTLED", "SHUT_DOWN"
#: Inputs of the controller, and the parameter with the age from which on it holds the arm.
_INPUTS = {
    "joints": "joint_states_max_age_s",
    "ball": "ball_max_age_s",
    "jacobian": "jacobian_max_age_s",
}


def statuses(recording: Recording) -> list[Status]:
    """Each status until the next one, since the recording began; ``SILENT`` if none came for 1 s.

    After the last one of a controller that was stopped, which says so, there is none.
    """
    found: list[Status] = []
    following_s = [*(one.start_s for one in recording.statuses[1:]), recording.end_s]
    for one, next_s in zip(recording.statuses, following_s, strict=False):
        length_s = next_s - one.start_s
        held_s = length_s if one.reason == SHUT_DOWN else min(length_s, SILENT_S)
        limit = one.limit if one.state == SERVOING else ""
        begun = one._replace(start_s=one.start_s - recording.start_s, limit=limit)
        found.append(begun._replace(length_s=held_s))
        if held_s < length_s:
            silence = (SILENT, "", "", "no word from the controller")
            found.append(Status(begun.start_s + held_s, *silence, length_s=length_s - held_s))
    return found


def merged(some: Iterable[Status], *fields: str) -> list[Status]:
    """Neighbours that agree in some fields as one, with the words of the first."""
    groups = (list(group) for _, group in groupby(some, attrgetter(*fields)))
    return [group[0]._replace(length_s=sum(one.length_s for one in group)) for group in groups]


def states(recording: Recording) -> list[Status]:
    """The controller's states and reasons in order."""
    return merged(statuses(recording), "state", "reason")


def totals(some: Sequence[Status], *fields: str) -> list[tuple[Any, int, float]]:
    """Value of some fields, how often, and for how long in all, s; the longest first."""
    value = attrgetter(*fields)
    groups = [(key, list(group)) for key, group in groupby(sorted(some, key=value), value)]
    found = [(key, len(group), sum(one.length_s for one in group)) for key, group in groups]
    return sorted(found, key=lambda one: -one[2])


def limits(recording: Recording) -> list[dict[str, Any]]:
    """Limits that shaped the command on the way to targets: how long, s, and share of that time."""
    on_way = [one for one in statuses(recording) if one.state == SERVOING and one.reason != SETTLED]
    way_s = sum(one.length_s for one in on_way)
    return [
        {"limit": limit, "length_s": time_s, "way": time_s / way_s}
        for limit, _, time_s in totals(on_way, "limit")
        if limit
    ]


def events(recording: Recording) -> list[Event]:
    """Warnings, changed parameters and silent inputs by first time since the recording began, s.

    Those that differ only in time and numbers are one. The controller also logs its states: these
    are left out.
    """
    names = {one.state for one in recording.statuses}
    found = [
        one
        for one in recording.events
        if not (one.who.endswith(CONTROLLER) and one.text.partition(":")[0] in names)
    ]
    for key, parameter in _INPUTS.items():
        if key in recording.series:
            series = recording.series[key]
            gaps_s = np.diff(series.arrival_s)
            for index in np.flatnonzero(gaps_s > recording.started[parameter]):
                words = f"silent for {gaps_s[index]:.2f} s"
                found.append(Event(float(series.arrival_s[index]), series.topic, words))
    first: dict[tuple[str, str], Event] = {}
    for event in sorted(found):
        alike = event.who, re.sub(r"\d+(\.\d+)?", "", event.text)
        known = first.get(alike, event._replace(time_s=event.time_s - recording.start_s, times=0))
        first[alike] = known._replace(times=known.times + event.times)
    return list(first.values())


# ---- timing ---------------------------------------------------------------------------------


def rhythms(recording: Recording) -> list[dict[str, Any]]:
    """Rate, jitter, longest gap and age of each topic; NaN where they are not known."""
    found = []
    for topic, series in recording.topics.items():
        gaps_ms = 1e3 * np.diff(series.arrival_s)
        ages_ms = 1e3 * (series.arrival_s - series.stamp_s)
        known = ages_ms[np.isfinite(ages_ms)] if np.isfinite(ages_ms).any() else [np.nan]
        if gaps_ms.any():
            found.append(
                {
                    "topic": topic,
                    "messages": len(series),
                    "rate_hz": 1e3 / gaps_ms.mean(),
                    "jitter_ms": gaps_ms.std(),
                    "longest_gap_ms": gaps_ms.max(),
                    "median_age_ms": np.median(known),
                    "p99_age_ms": np.percentile(known, 99),
                }
            )
    return found


def command_latencies(ball: Series, commands: Series) -> np.ndarray:
    """Time, s, from an image's exposure to the first command after its ball position came.

    Without a command for a second no controller was there to answer.
    """
    answered_s = np.append(commands.arrival_s, np.inf)[
        np.searchsorted(commands.arrival_s, ball.arrival_s)
    ]
    counts = (answered_s - ball.arrival_s <= SILENT_S) & np.isfinite(ball.stamp_s)
    return (answered_s - ball.stamp_s)[counts]


# ---- predictions ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Prediction:
    """Predictions of the recorded Jacobian: n steps, shape (n,) each."""

    #: End of each step, s, and length of the ball's motion, m.
    time_s: np.ndarray
    motion_m: np.ndarray
    #: The paper's criteria, eqs (40) to (42), m.
    t1_m: np.ndarray
    t2_m: np.ndarray
    #: Whether the motion is the true one; else it is measured, with its noise.
    true: bool

    @property
    def share(self) -> float:
        """Sum of T1 over that of the motion."""
        return float(self.t1_m.sum() / self.motion_m.sum())


def prediction(recording: Recording) -> Prediction | None:
    """Judge the Jacobian; None where the bag has none of this size, or no motion.

    The steps are those that the estimator makes of the same messages. Each is predicted by the
    newest Jacobian at its middle, and never by one that may have learned from the image at its
    end. Jacobians have no stamps: joint states tell one clock from the other.
    """
    series = recording.series
    if not {"joints", "ball", "jacobian"} <= series.keys():
        return None
    jacobian, true = series["jacobian"], series.get("true_ball")
    joints, ball, feature = series["joints"], series["ball"], recording.feature
    steps = _steps(joints, ball)
    if not steps:
        return None
    end_s, duration_s, d_joints_rad = map(np.array, zip(*steps, strict=True))
    before_m, after_m = (
        _at(ball if true is None else true, time_s) for time_s in (end_s - duration_s, end_s)
    )
    middle_s = np.interp(end_s - 0.5 * duration_s, joints.time_s, joints.arrival_s)
    image_s = ball.arrival_s[np.searchsorted(ball.time_s, end_s)]
    wanted_s = np.minimum(middle_s, image_s)
    newest = np.searchsorted(jacobian.arrival_s, wanted_s) - 1
    # An old Jacobian predicts nothing.
    usable = (newest >= 0) & (wanted_s - jacobian.arrival_s[newest] <= 0.3)
    usable &= np.isfinite(before_m + after_m).all(axis=1)
    tasks = feature.task_scale
    if not usable.any() or jacobian.values.shape[1] != len(tasks) * d_joints_rad.shape[1]:
        return None
    rows = jacobian.values.reshape(len(jacobian), len(tasks), -1)[newest[usable]]
    pairs = zip(after_m[usable], before_m[usable], strict=True)
    motion_m = np.array([feature.error(*map(feature.nearest, pair)) for pair in pairs])
    predicted_m = tasks * np.einsum("nij,nj->ni", rows, d_joints_rad[usable])
    t1_m, t2_m = criteria(motion_m - predicted_m)
    lengths_m = np.linalg.norm(motion_m, axis=1)
    return Prediction(end_s[usable], lengths_m, t1_m, t2_m, true is not None)


def _at(ball: Series, time_s: np.ndarray) -> np.ndarray:
    """Features at times, m, shape (n, m); NaN outside the series."""
    columns = [np.interp(time_s, ball.time_s, one, np.nan, np.nan) for one in ball.values.T]
    return np.stack(columns, axis=1)


def _steps(joints: Series, ball: Series) -> list[tuple[Any, ...]]:
    """End, s, duration, s, and joint motion, rad, of the estimator's steps."""
    pairing = StepPairing()
    steps = []
    arrivals_s = np.concatenate([joints.arrival_s, ball.arrival_s])
    for index in np.argsort(arrivals_s, kind="stable"):
        image = index - len(joints)
        if image < 0:
            angles_rad = joints.values[index, : joints.values.shape[1] // 2]
            found = pairing.timeline.add_joints(joints.time_s[index], angles_rad)
        else:
            found = pairing.timeline.add_feature(ball.time_s[image], ball.values[image])
        steps += pairing.steps(found)
    return [(one.stamp_s, one.dt_s, one.d_joints_rad) for one in steps]
