"""What happened, and when: states, limits, warnings, silences, timing, predictions."""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from fvs_estimator_node.loop import StepPairing
from fvs_lab.replay.reading import CONTROLLER, Event, Recording, Series
from fvs_ros.status import SILENT, SILENT_S
from fvs_tools.score import criteria

SERVOING, SETTLED, SHUT_DOWN = "SERVOING", "SETTLED", "SHUT_DOWN"
#: The state after the last status of a controller that was stopped in order.
ENDED = "ENDED"
#: Inputs of the controller, and the parameter with the age from which on it holds the arm.
INPUTS = {
    "joints": "joint_states_max_age_s",
    "ball": "ball_max_age_s",
    "jacobian": "jacobian_max_age_s",
}


class Spell(NamedTuple):
    """A time in which the controller's status stayed as it was, since the recording began, s."""

    start_s: float
    length_s: float
    state: str
    reason: str
    limit: str
    text: str


def statuses(recording: Recording) -> list[Spell]:
    """Each status until the next one, with ``SILENT`` or ``ENDED`` where none came for a second."""
    found: list[Spell] = []
    following_s = [*(one.arrival_s for one in recording.statuses[1:]), recording.end_s]
    for one, next_s in zip(recording.statuses, following_s, strict=False):
        start_s, length_s = one.arrival_s - recording.start_s, next_s - one.arrival_s
        limit = one.limit if one.state == SERVOING else ""
        held_s = min(length_s, SILENT_S)
        found.append(Spell(start_s, held_s, one.state, one.reason, limit, one.text))
        if length_s > SILENT_S:
            words = "no word from the controller"
            found.append(Spell(start_s + held_s, length_s - held_s, SILENT, "", "", words))
    if found and found[-1].state == SILENT and _ended_in_order(recording):
        found[-1] = found[-1]._replace(state=ENDED, text="the controller was stopped")
    return found


def _ended_in_order(recording: Recording) -> bool:
    """Whether the controller was stopped, not killed: it left zeros, and then all else stopped."""
    last = recording.statuses[-1]
    commands, joints = recording.series.get("commands"), recording.series.get("joints")
    if last.reason == SHUT_DOWN:
        return True
    if commands is None or joints is None or commands.values[-1].any():
        return False
    return bool(joints.arrival_s[-1] - last.arrival_s < 5.0)


def merged(spells: Iterable[Spell], *fields: str) -> list[Spell]:
    """Neighbours that agree in some fields as one spell, with the words of the first."""
    groups = (list(group) for _, group in groupby(spells, attrgetter(*fields)))
    return [group[0]._replace(length_s=sum(one.length_s for one in group)) for group in groups]


def states(recording: Recording) -> list[Spell]:
    """The controller's states and reasons in order."""
    return merged(statuses(recording), "state", "reason")


def totals(spells: Sequence[Spell], *fields: str) -> list[tuple[Any, int, float]]:
    """Value of some fields, number of spells and their time, s; the longest first."""
    value = attrgetter(*fields)
    groups = [(key, list(group)) for key, group in groupby(sorted(spells, key=value), value)]
    found = [(key, len(group), sum(one.length_s for one in group)) for key, group in groups]
    return sorted(found, key=lambda one: -one[2])


def limit_shares(recording: Recording) -> list[dict[str, Any]]:
    """Limits that shaped the command: how long, s, and share of the time on the way to targets."""
    every = statuses(recording)
    on_way = [one for one in every if one.state == SERVOING and one.reason != SETTLED]
    way_s = sum(one.length_s for one in on_way) or np.nan
    on_way_s = {limit: time_s for limit, _, time_s in totals(on_way, "limit")}
    return [
        {"limit": limit, "time_s": time_s, "way": on_way_s.get(limit, 0.0) / way_s}
        for limit, _, time_s in totals(every, "limit")
        if limit
    ]


def events(recording: Recording) -> list[Event]:
    """Warnings, changed parameters and silences by first time since the recording began, s.

    Those that came again are one. The controller also logs its states: these are left out.
    """
    spells = states(recording)
    names = {one.state for one in spells}
    found = [
        one
        for one in recording.events
        if not (one.who.endswith(CONTROLLER) and one.text.partition(":")[0] in names)
    ]
    limits_s = recording.started()
    for key, parameter in INPUTS.items():
        if key in recording.series:
            one = recording.series[key]
            gaps_s = np.diff(one.arrival_s)
            for index in np.flatnonzero(gaps_s > limits_s[parameter]):
                words = f"silent for {gaps_s[index]:.2f} s"
                found.append(Event(float(one.arrival_s[index]), one.topic, words))
    found = [one._replace(time_s=one.time_s - recording.start_s) for one in found]
    found += [
        Event(one.start_s, CONTROLLER, f"silent for {one.length_s:.2f} s")
        for one in spells
        if one.state == SILENT
    ]
    return _counted(found)


def _counted(found: Sequence[Event]) -> list[Event]:
    """Events that differ only in time and numbers as one."""
    first: dict[tuple[str, str], Event] = {}
    for event in sorted(found, key=lambda one: one.time_s):
        key = event.who, re.sub(r"\d+(\.\d+)?", "", event.text)
        known = first.get(key)
        first[key] = known._replace(times=known.times + 1) if known else event
    return list(first.values())


# --- timing ---


def rhythms(recording: Recording) -> list[dict[str, Any]]:
    """Rate, jitter, longest gap and age of each topic; NaN where they are not known."""
    found = []
    for topic, series in recording.topics.items():
        gaps_ms = 1e3 * np.diff(series.arrival_s)
        ages_ms = 1e3 * (series.arrival_s - series.stamp_s)
        known = np.isfinite(ages_ms)
        ages_ms = ages_ms[known] if known.any() else np.array([np.nan])
        if gaps_ms.any():
            found.append(
                {
                    "topic": topic,
                    "count": len(series),
                    "rate_hz": 1e3 / gaps_ms.mean(),
                    "jitter_ms": gaps_ms.std(),
                    "longest_gap_ms": gaps_ms.max(),
                    "median_age_ms": np.median(ages_ms),
                    "p99_age_ms": np.percentile(ages_ms, 99),
                }
            )
    return found


def command_latencies(ball: Series, commands: Series) -> np.ndarray:
    """Time, s, from an image's exposure to the first command after its ball position came.

    Images from before the first command, or between commands that are more than a second apart,
    are left out: no controller was there to answer.
    """
    following = np.searchsorted(commands.arrival_s, ball.arrival_s)
    apart_s = np.diff(commands.arrival_s, prepend=-np.inf, append=np.inf)[following]
    answered = (apart_s <= SILENT_S) & np.isfinite(ball.stamp_s)
    return commands.arrival_s[following[answered]] - ball.stamp_s[answered]


# --- predictions ---


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
    """Judge the Jacobian; None where the bag has none, or no motion.

    A step is predicted by the newest Jacobian at its middle, and never by one that may have learned
    from the image at its end. Jacobians have no stamps: joint states tell one clock from the other.
    """
    series = recording.series
    if not {"joints", "ball", "jacobian"} <= series.keys():
        return None
    jacobian, true = series["jacobian"], series.get("true_ball")
    joints, ball = series["joints"].by_time(), series["ball"].by_time()
    end_s, duration_s, d_joints_rad, motion_m = _steps(joints, ball)
    if true is not None:
        true = true.by_time()
        motion_m = np.stack(
            [
                np.interp(end_s, true.time_s, one, np.nan, np.nan)
                - np.interp(end_s - duration_s, true.time_s, one, np.nan, np.nan)
                for one in true.values.T
            ],
            axis=1,
        )
    if not len(end_s):
        return None
    middle_s = np.interp(end_s - 0.5 * duration_s, joints.time_s, joints.arrival_s)
    image_s = ball.arrival_s[np.searchsorted(ball.time_s, end_s)]
    wanted_s = np.minimum(middle_s, image_s)
    newest = np.searchsorted(jacobian.arrival_s, wanted_s) - 1
    # An old Jacobian predicts nothing.
    usable = (newest >= 0) & (wanted_s - jacobian.arrival_s[newest] <= 0.3)
    usable &= np.isfinite(motion_m).all(axis=1)
    if not usable.any():
        return None
    rows = jacobian.values.reshape(len(jacobian), motion_m.shape[1], -1)[newest[usable]]
    motion_m = motion_m[usable]
    t1_m, t2_m = criteria(motion_m - np.einsum("nij,nj->ni", rows, d_joints_rad[usable]))
    lengths_m = np.linalg.norm(motion_m, axis=1)
    return Prediction(end_s[usable], lengths_m, t1_m, t2_m, true is not None)


def _steps(joints: Series, ball: Series) -> tuple[np.ndarray, ...]:
    """The steps that the estimator makes of the same messages in the same order, n of them.

    End and duration, s, shape (n,), joint motion, rad, and ball motion, m, shape (n, k).
    """
    pairing = StepPairing()
    timeline = pairing.timeline
    count = joints.values.shape[1] // 2
    width = 2 + count + ball.values.shape[1]
    rows = array("d")
    arrivals_s = np.concatenate([joints.arrival_s, ball.arrival_s])
    for index in np.argsort(arrivals_s, kind="stable"):
        image = index - len(joints)
        if image < 0:
            found = timeline.add_joints(joints.time_s[index], joints.values[index, :count])
        else:
            found = timeline.add_ball(ball.time_s[image], ball.values[image])
        for step in pairing.steps(found):
            rows.extend((step.stamp_s, step.dt_s, *step.d_joints_rad, *step.d_ball_m))
    steps = np.frombuffer(rows).reshape(-1, width) if rows else np.empty((0, width))
    return steps[:, 0], steps[:, 1], steps[:, 2 : 2 + count], steps[:, 2 + count :]
