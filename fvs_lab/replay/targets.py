"""The targets of a recording, each judged as the demo judges its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise

import numpy as np

from fvs_controller_node.target_motion import continues
from fvs_lab.outcome import seconds
from fvs_lab.replay.reading import Recording, Series, Status
from fvs_ros.feature import Feature
from fvs_ros.topics import DEMO
from fvs_tools.demo import DemoConfig
from fvs_tools.score import (
    FINAL_S,
    FINE_ERROR_M,
    SETTLED_ERROR_M,
    jitter_rad_s,
    judge,
    way_and_arc_m,
)

#: The two bounds of settling, m, the demo's, by the names of the settling times.
BOUNDS_M = {"settling_5mm_s": SETTLED_ERROR_M, "settling_2mm_s": FINE_ERROR_M}
#: Stamps closer than this are of one moment, s: seconds as floating point lose the last digits.
_SAME_MOMENT_S = 1e-6
_NOTHING = Series("", np.empty(0), np.empty(0), np.empty((0, 0)))


@dataclass(frozen=True)
class Target:
    """One target, n ball positions on the way to it."""

    #: Whether it moved: then there is no settling, and its final error is that of all its time.
    moving: bool
    #: Where it was, at last, m, and when it was given, by the recorder's clock, s.
    target_m: np.ndarray
    given_s: float
    #: Features, m, (n, m), times since then, s, and distances to the target, m, (n,): of poses the
    #: way, or the arc at the lever arm where that is longer.
    time_s: np.ndarray
    position_m: np.ndarray
    errors_m: np.ndarray
    #: The demo's judgement, ``path_m`` of the ball, and ``jitter_rad_s`` of the command over the
    #: last second. A settling time is infinite if the ball never settled, and any number is NaN if
    #: the record is too short for it, or lacks the messages.
    numbers: Mapping[str, float]


def judged_by(recording: Recording) -> Series | None:
    """The ball positions to judge by: the true ones where the bag has them."""
    return recording.series.get("true_ball") or recording.series.get("ball")


def targets(recording: Recording) -> list[Target]:
    """Judge every target that the controller took and that has ball positions."""
    series = recording.series
    ball, given = judged_by(recording), series.get("target")
    if ball is None or given is None:
        return []
    target_s = recording.scenario.get(DEMO, {}).get("target_s", DemoConfig.target_s)
    found = []
    for run, replaced_s in _taken(_runs(given, ball.time_s), recording.statuses):
        start_s, end_s = run.stamp_s[0], replaced_s
        if DEMO in recording.scenario:
            later = np.searchsorted(ball.time_s - start_s, target_s)  # rounded as the demo does
            end_s = min([end_s, *ball.time_s[later : later + 1]])
        ends = np.searchsorted(ball.time_s, [start_s, np.nextafter(end_s, np.inf)])
        way = ball.taking(slice(*ends))
        if len(way):
            over = end_s < np.inf or way.time_s[-1] - start_s >= target_s
            found.append(_judge(recording.feature, way, run, series, over))
    return found


def _runs(given: Series, ball_s: np.ndarray) -> list[Series]:
    """Targets one after another; updates that the controller takes for one moving target are one.

    Their stamps are when each was given, by the clock of the ball positions.
    """
    repeated = np.append(False, (np.diff(given.values, axis=0) == 0.0).all(axis=1))
    given = given.taking(~repeated)
    # Within 5 s a target may be latched; beyond, its stamp is by another clock.
    own_clock = np.abs(given.arrival_s - given.stamp_s) < 5.0
    given_s = np.where(own_clock, given.stamp_s, given.arrival_s)
    # The demo stamps a target with the position that it saw, in simulated time, too.
    near = np.searchsorted(ball_s, given.stamp_s - _SAME_MOMENT_S).clip(max=len(ball_s) - 1)
    of_demo = np.abs(ball_s[near] - given.stamp_s) < _SAME_MOMENT_S
    given = replace(given, stamp_s=np.where(of_demo, ball_s[near], given_s))
    steps = zip(np.diff(given.values, axis=0), np.diff(given.stamp_s), strict=True)
    starts = [index for index, step in enumerate(steps, 1) if not continues(*step)]
    return [given.taking(slice(*ends)) for ends in pairwise([0, *starts, len(given)])]


def _taken(runs: Sequence[Series], statuses: Sequence[Status]) -> list[tuple[Series, float]]:
    """The targets that the controller took, and when another one was set, s.

    Its status never shows a target that it refused, and shows one that was set by
    ``~/set_current_as_target`` though there is no message. A moving one is not compared.
    """
    shown = [one for one in statuses if one.target_m is not None]
    shown_s = np.array([one.start_s for one in shown])
    shown_m = np.array([one.target_m for one in shown]).reshape(len(shown), -1 if shown else 1)
    found = []
    next_s = end_s = np.inf
    for run in reversed(runs):
        arrival_s, start_s = run.arrival_s[0], run.stamp_s[0]
        # The status shows a target 0.25 s after it came, with three digits.
        window = slice(*np.searchsorted(shown_s, [arrival_s + 0.25, next_s]))
        same = np.abs(shown_m[window] - run.values[0, :3]).max(axis=1) < 0.001
        if len(run) == 1 and same.size:
            if not same.any():
                continue
            others_s = shown_s[window][np.flatnonzero(same)[-1] + 1 :]
            end_s = min([end_s, *(start_s + others_s[:1] - arrival_s)])
        found.append((run, end_s))
        next_s, end_s = arrival_s, start_s
    return found[::-1]


def _judge(
    feature: Feature, way: Series, run: Series, series: Mapping[str, Series], over: bool
) -> Target:
    """Judge the way to one target by its ball positions.

    If the target's time was not over, it must have settled a second before the recording's end.
    """
    start_s, end_s, came_s = run.stamp_s[0], way.time_s[-1], way.arrival_s[-1]
    time_s = way.time_s - start_s
    wanted = np.searchsorted(run.stamp_s, way.time_s, side="right") - 1
    pairs = zip(way.values, run.values[wanted], strict=True)
    task_m = np.array([feature.error(*pair) for pair in pairs])
    errors_m = np.maximum(*way_and_arc_m(task_m))
    joints, commands = (series.get(name, _NOTHING) for name in ("joints", "commands"))
    moved = _between(joints.time_s, start_s, end_s)
    speeds_rad_s = joints.values[moved, joints.values.shape[1] // 2 :]
    speeds_rad_s = speeds_rad_s[np.isfinite(speeds_rad_s).all(axis=1)]
    last_rad_s = commands.values[_between(commands.arrival_s, came_s - FINAL_S, came_s)]
    score = judge(feature, time_s, task_m, speeds_rad_s)
    numbers = {name: seconds(one) for name, one in asdict(score).items() if name != "slowed"}
    if score.final_rms_deg is None:
        del numbers["final_rms_deg"]
    path_m = np.diff(way.values[:, :3], axis=0)
    numbers["path_m"] = float(np.linalg.norm(path_m, axis=1).sum())
    numbers["jitter_rad_s"] = jitter_rad_s(last_rad_s) if len(last_rad_s) > 1 else np.nan
    unknown = {*BOUNDS_M, "final_rms_deg"}
    if len(run) > 1:
        numbers |= dict.fromkeys(numbers.keys() & unknown, np.nan)
        numbers["final_rms_m"] = float(np.sqrt(np.mean(errors_m**2)))
    elif not (over or time_s[-1] - numbers["settling_2mm_s"] >= FINAL_S):
        unknown |= {"final_rms_m", "jitter_rad_s"}
        numbers |= dict.fromkeys(numbers.keys() & unknown, np.nan)
    if not speeds_rad_s.size:
        numbers["peak_joint_speed_rad_s"] = np.nan
    if time_s[0] > 0.1:  # the recording begins later
        numbers["start_distance_m"] = np.nan
    given_s = float(way.arrival_s[0] - time_s[0])
    return Target(len(run) > 1, run.values[-1], given_s, time_s, way.values, errors_m, numbers)


def _between(time_s: np.ndarray, start_s: float, end_s: float) -> slice:
    """The samples after a start and up to an end, of times in order."""
    return slice(*np.searchsorted(time_s, [start_s, end_s], side="right"))
