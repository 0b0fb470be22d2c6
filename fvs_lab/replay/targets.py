"""The targets of a recording, each judged as the demo judges its own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise

import numpy as np

from fvs_controller_node.target_motion import continues
from fvs_lab.replay.reading import Recording, Series
from fvs_tools.demo import PARAMETERS
from fvs_tools.score import FINAL_S, FINE_ERROR_M, SETTLED_ERROR_M, jitter_rad_s, judge

#: The two bounds of settling, m: the demo's.
BOUNDS_M = (SETTLED_ERROR_M, FINE_ERROR_M)
_DEMO = "fvs_demo_node"
_SETTLING = ("settling_5mm_s", "settling_2mm_s")
#: Stamps closer than this are of one moment, s: seconds as floating point lose the last digits.
_SAME_MOMENT_S = 1e-6


@dataclass(frozen=True)
class Target:
    """One target, n ball positions on the way to it."""

    #: Whether it moved: then there is no settling, and its final error is that of all its time.
    moving: bool
    #: Where it was, at last, m, and when it was given, by the recorder's clock, s.
    target_m: np.ndarray
    given_s: float
    #: Ball positions, m, shape (n, 3), times since then, s, and distances to the target, m, (n,).
    time_s: np.ndarray
    position_m: np.ndarray
    errors_m: np.ndarray
    #: The demo's judgement, ``path_m`` of the ball, and ``jitter_rad_s`` of the command over the
    #: last second. A settling time is None if the ball never settled, and any is NaN if unknown.
    numbers: Mapping[str, float | None]
    #: Numbers that the record is too short for, and why.
    not_known: Mapping[str, str]


def judged_by(recording: Recording) -> Series | None:
    """The ball positions to judge by: the true ones where the bag has them."""
    return recording.series.get("true_ball") or recording.series.get("ball")


def targets(recording: Recording) -> list[Target]:
    """Judge every target that the controller took and that has ball positions."""
    ball, given = judged_by(recording), recording.series.get("target")
    if ball is None or given is None:
        return []
    ball, joints = ball.by_time(), recording.series.get("joints")
    joints = None if joints is None else joints.by_time()
    commands, time_s = recording.series.get("commands"), ball.time_s
    target_s = recording.started(_DEMO, PARAMETERS)["target_s"]
    of_demo = _DEMO in recording.scenario
    runs = _taken(recording, _runs(given, time_s))
    starts_s = [*(run.stamp_s[0] for run, _ in runs), np.inf]
    found = []
    for (run, replaced_s), (start_s, next_s) in zip(runs, pairwise(starts_s), strict=True):
        end_s = min(next_s, replaced_s)
        if next_s == np.inf and of_demo:
            later = np.searchsorted(time_s - start_s, target_s)  # rounded as the demo does
            end_s = min(end_s, time_s[later]) if later < len(time_s) else end_s
        chosen = slice(*np.searchsorted(time_s, [start_s, np.nextafter(end_s, np.inf)]))
        if len(time_s[chosen]):
            target = _judge(ball.taking(chosen), run, joints, commands)
            given_whole = bool(target.time_s[-1] >= target_s)
            replaced = bool(np.isfinite(end_s))
            if not (of_demo and given_whole):  # else the demo's own verdict
                cut = "another target came" if replaced else "the recording ends"
                target = _without_guesses(target, cut, never=replaced or given_whole)
            found.append(target)
    return found


def _runs(given: Series, ball_s: np.ndarray) -> list[Series]:
    """Targets one after another; updates that the controller takes for one moving target are one.

    Their stamps are when each was given, by the clock of the ball positions.
    """
    repeated = np.append(False, (np.diff(given.values, axis=0) == 0.0).all(axis=1))
    given = given.taking(~repeated)
    given = replace(given, stamp_s=_given_s(given, ball_s))
    steps = zip(np.diff(given.values, axis=0), np.diff(given.stamp_s), strict=True)
    starts = [index for index, step in enumerate(steps, 1) if not continues(*step)]
    return [given.taking(slice(*ends)) for ends in pairwise([0, *starts, len(given)])]


def _given_s(given: Series, ball_s: np.ndarray) -> np.ndarray:
    """When targets were given, by the clock of the ball positions in order, s, shape (n,)."""
    # Within 5 s a target may be latched; beyond, its stamp is by another clock.
    own_clock = np.abs(given.arrival_s - given.stamp_s) < 5.0
    given_s = np.where(own_clock, given.stamp_s, given.arrival_s)
    # The demo stamps a target with the position that it saw, in simulated time, too.
    near = np.searchsorted(ball_s, given.stamp_s - _SAME_MOMENT_S).clip(max=len(ball_s) - 1)
    of_demo = np.abs(ball_s[near] - given.stamp_s) < _SAME_MOMENT_S
    return np.where(of_demo, ball_s[near], given_s)


def _taken(recording: Recording, runs: Sequence[Series]) -> list[tuple[Series, float]]:
    """The targets that the controller took, and when a service set another one, s.

    Its status tells: it never shows a target that it refused, and shows one that was set by
    ``~/set_current_as_target`` though there is no message. A moving one is not compared.
    """
    shown = [one for one in recording.statuses if one.target_m is not None]
    shown_s = np.array([one.arrival_s for one in shown])
    shown_m = np.array([one.target_m for one in shown]).reshape(len(shown), runs[0].values.shape[1])

    def seen(runs: Sequence[Series]) -> Iterator[tuple[Series, np.ndarray, np.ndarray]]:
        """Each target, the times of the statuses in its time, and whether these show it."""
        arrivals_s = [*(run.arrival_s[0] for run in runs), np.inf]
        for run, end_s in zip(runs, arrivals_s[1:], strict=True):
            # The status shows a target 0.25 s after it came, with three digits.
            first, last = np.searchsorted(shown_s, [run.arrival_s[0] + 0.25, end_s])
            those = slice(first, last if len(run) == 1 else first)
            off_m = np.abs(shown_m[those] - run.values[0]).max(axis=1)
            yield run, shown_s[those], off_m < 0.001

    taken = [run for run, times_s, same in seen(runs) if same.any() or not times_s.size]
    found = []
    for run, times_s, same in seen(taken):
        others_s = times_s[np.flatnonzero(same)[-1] + 1 :] if same.any() else times_s[:0]
        passed_s = others_s[0] - run.arrival_s[0] if others_s.size else np.inf
        found.append((run, float(run.stamp_s[0] + passed_s)))
    return found


def _judge(way: Series, run: Series, joints: Series | None, commands: Series | None) -> Target:
    """Judge the way to one target by its ball positions; all but the target in order of time."""
    start_s, end_s = run.stamp_s[0], way.time_s[-1]
    time_s = way.time_s - start_s
    wanted = np.searchsorted(run.stamp_s, way.time_s, side="right") - 1
    errors_m = np.linalg.norm(way.values - run.values[wanted], axis=1)
    speeds_rad_s = np.empty(0)
    if joints is not None:
        speeds_rad_s = joints.values[_between(joints.time_s, start_s, end_s)]
        speeds_rad_s = speeds_rad_s[:, joints.values.shape[1] // 2 :]
        speeds_rad_s = speeds_rad_s[np.isfinite(speeds_rad_s).all(axis=1)]
    numbers: dict[str, float | None] = asdict(judge(time_s, errors_m, speeds_rad_s))
    del numbers["slowed"]
    if not speeds_rad_s.size:
        numbers["peak_joint_speed_rad_s"] = np.nan
    numbers["path_m"] = float(np.linalg.norm(np.diff(way.values, axis=0), axis=1).sum())
    numbers["jitter_rad_s"] = np.nan
    if commands is not None:
        came_s = way.arrival_s[-1]
        last = commands.values[_between(commands.arrival_s, came_s - FINAL_S, came_s)]
        numbers["jitter_rad_s"] = jitter_rad_s(last) if len(last) > 1 else np.nan
    moving = len(run) > 1
    if moving:
        numbers |= dict.fromkeys(_SETTLING, np.nan)
        numbers["final_rms_m"] = float(np.sqrt(np.mean(errors_m**2)))
    not_known = {}
    if time_s[0] > 0.1:
        numbers["start_distance_m"] = np.nan
        not_known["start_distance_m"] = "the recording begins later"
    given_s, target_m = float(way.arrival_s[0] - time_s[0]), run.values[-1]
    return Target(moving, target_m, given_s, time_s, way.values, errors_m, numbers, not_known)


def _between(time_s: np.ndarray, start_s: float, end_s: float) -> slice:
    """The samples after a start and up to an end, of times in order."""
    return slice(*np.searchsorted(time_s, [start_s, end_s], side="right"))


def _without_guesses(target: Target, cut: str, never: bool) -> Target:
    """The target without the numbers that its record is too short for.

    A settling time is known after a second below the bound, and if the ball was ``never`` there.
    """
    last_s = target.time_s[-1]
    not_known = dict(target.not_known)
    for name in () if target.moving else _SETTLING:
        settled_s = target.numbers[name]
        if not (never if settled_s is None else last_s - settled_s >= FINAL_S):
            not_known[name] = cut
    if last_s < FINAL_S or _SETTLING[0] in not_known:
        not_known |= {"final_rms_m": cut, "jitter_rad_s": cut}
    numbers = {**target.numbers, **dict.fromkeys(not_known, np.nan)}
    return replace(target, numbers=numbers, not_known=not_known)
