"""The targets of a recording, each judged as the demo judges its own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from fvs_controller_node.target_motion import TargetMotion
from fvs_lab.replay.recording import Recording, Series
from fvs_tools.demo import FINE_ERROR_M, PARAMETERS, TargetScore, judge
from fvs_tools.score import jitter_rad_s

_DEMO = "fvs_demo_node"
#: Stamps closer than this are of one moment, s: seconds as floating point lose the last digits.
_SAME_MOMENT_S = 1e-6
#: A target's stamp further from its arrival is by another clock; nearer, it may be latched, s.
_SAME_CLOCK_S = 5.0
#: Without a ball position for this long after a target, its start distance is not known, s.
_LATE_S = 0.1
#: The ball is at a target once it stayed there for this long, s.
_FINAL_S = 1.0
#: From this long after a target's arrival on the status shows it, with these digits, s and m.
_SHOWN_S, _SAME_M = 0.25, 0.001


@dataclass(frozen=True)
class Target:
    """One target, n ball positions on the way to it.

    Parameters
    ----------
    moving : bool
        Whether it moved: then there is no settling, but an error over all its time.
    target_m : ndarray, shape (3,)
        Where it was, at last, m.
    given_s : float
        When it was given, s.
    time_s : ndarray, shape (n,)
        Times of the ball positions since then, s.
    position_m : ndarray, shape (n, 3)
        Ball positions, m.
    errors_m : ndarray, shape (n,)
        Their distances to the target, m.
    score : TargetScore
        The demo's judgement. None and NaN also stand for what is not known.
    path_m : float
        Length of the ball's path, m; longer with a noisy position.
    jitter_rad_s : float
        Of the command over the last second, rad/s; NaN without commands.
    not_known : mapping of str to str
        Numbers that the record is too short for, and what ended it.
    """

    moving: bool
    target_m: np.ndarray
    given_s: float
    time_s: np.ndarray
    position_m: np.ndarray
    errors_m: np.ndarray
    score: TargetScore
    path_m: float
    jitter_rad_s: float
    not_known: Mapping[str, str]

    @property
    def begins_late(self) -> bool:
        """Whether its beginning is missing, so that the start distance is not known."""
        return bool(self.time_s[0] > _LATE_S)

    @property
    def rms_m(self) -> float:
        """Error over all its time, rms, m."""
        return float(np.sqrt(np.mean(self.errors_m**2)))


def bounds_m(recording: Recording) -> tuple[float, float]:
    """The two bounds of settling, m: that of the recorded demo, or its default, and a finer one."""
    return float(recording.started(_DEMO, PARAMETERS)["settle_error_m"]), FINE_ERROR_M


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
    settle_error_m, _ = bounds_m(recording)
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
            target = _judge(ball.taking(chosen), run, joints, commands, settle_error_m)
            cut = "another target came" if np.isfinite(end_s) else "the recording ends"
            given_whole = bool(target.time_s[-1] >= target_s)
            if not (of_demo and given_whole):  # else the demo's own verdict
                target = _without_guesses(target, cut, given_whole)
            found.append(target)
    return found


def _runs(given: Series, ball_s: np.ndarray) -> list[Series]:
    """Targets one after another; updates that the controller takes for one moving target are one.

    Their stamps are when each was given, by the clock of the ball positions.
    """
    repeated = np.append(False, (np.diff(given.values, axis=0) == 0.0).all(axis=1))
    given = given.taking(~repeated)
    given = replace(given, stamp_s=_given_s(given, ball_s))
    motion, starts = TargetMotion(), []
    for index, (position_m, time_s) in enumerate(zip(given.values, given.stamp_s, strict=True)):
        if not motion.continues(position_m, time_s):
            starts.append(index)
        motion.restart(position_m, time_s)
    return [given.taking(slice(*ends)) for ends in pairwise([*starts, len(given)])]


def _given_s(given: Series, ball_s: np.ndarray) -> np.ndarray:
    """When targets were given, by the clock of the ball positions in order, s, shape (n,)."""
    own_clock = np.abs(given.arrival_s - given.stamp_s) < _SAME_CLOCK_S
    given_s = np.where(own_clock, given.stamp_s, given.arrival_s)
    # The demo stamps a target with the position that it saw.
    near_s = ball_s[np.searchsorted(ball_s, given_s - _SAME_MOMENT_S).clip(max=len(ball_s) - 1)]
    return np.where(np.abs(near_s - given_s) < _SAME_MOMENT_S, near_s, given_s)


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
            first, last = np.searchsorted(shown_s, [run.arrival_s[0] + _SHOWN_S, end_s])
            those = slice(first, last if len(run) == 1 else first)
            off_m = np.abs(shown_m[those] - run.values[0]).max(axis=1)
            yield run, shown_s[those], off_m < _SAME_M

    taken = [run for run, times_s, same in seen(runs) if same.any() or not times_s.size]
    found = []
    for run, times_s, same in seen(taken):
        others_s = times_s[np.flatnonzero(same)[-1] + 1 :] if same.any() else times_s[:0]
        passed_s = others_s[0] - run.arrival_s[0] if others_s.size else np.inf
        found.append((run, float(run.stamp_s[0] + passed_s)))
    return found


def _judge(
    ball: Series,
    run: Series,
    joints: Series | None,
    commands: Series | None,
    settle_error_m: float,
) -> Target:
    """Judge the way to one target by its ball positions; all but the target in order of time."""
    start_s, end_s = run.stamp_s[0], ball.time_s[-1]
    time_s = ball.time_s - start_s
    wanted = np.searchsorted(run.stamp_s, ball.time_s, side="right") - 1
    errors_m = np.linalg.norm(ball.values - run.values[wanted], axis=1)
    speeds_rad_s = np.empty(0)
    if joints is not None:
        chosen = _between(joints.time_s, start_s, end_s)
        speeds_rad_s = joints.values[chosen, joints.values.shape[1] // 2 :]
        speeds_rad_s = speeds_rad_s[np.isfinite(speeds_rad_s).all(axis=1)]
    score = judge(time_s, errors_m, speeds_rad_s, settle_error_m)
    if not speeds_rad_s.size:
        score = replace(score, peak_joint_speed_rad_s=float("nan"))
    jitter = float("nan")
    if commands is not None:
        arrived_s = ball.arrival_s[-1]
        last = commands.values[_between(commands.arrival_s, arrived_s - _FINAL_S, arrived_s)]
        jitter = jitter_rad_s(last) if len(last) > 1 else jitter
    return Target(
        moving=len(run) > 1,
        target_m=run.values[-1],
        given_s=float(start_s),
        time_s=time_s,
        position_m=ball.values,
        errors_m=errors_m,
        score=score,
        path_m=float(np.linalg.norm(np.diff(ball.values, axis=0), axis=1).sum()),
        jitter_rad_s=jitter,
        not_known={},
    )


def _between(time_s: np.ndarray, start_s: float, end_s: float) -> slice:
    """The samples after a start and up to an end, of times in order."""
    return slice(*np.searchsorted(time_s, [start_s, end_s], side="right"))


def _without_guesses(target: Target, cut: str, given_whole: bool) -> Target:
    """The target without the numbers that its record is too short for.

    A settling time is known after a second below the bound. "Never" is known where another target
    came, or after the time that the demo gives.
    """
    never = given_whole or cut == "another target came"
    last_s = target.time_s[-1]

    def known(at_s: float | None) -> bool:
        return target.moving or (never if at_s is None else bool(last_s - at_s >= _FINAL_S))

    coarse_s, fine_s = target.score.settling_5mm_s, target.score.settling_2mm_s
    final = known(coarse_s) and last_s >= _FINAL_S
    score = replace(
        target.score,
        settling_5mm_s=coarse_s if known(coarse_s) else None,
        settling_2mm_s=fine_s if known(fine_s) else None,
        final_rms_m=target.score.final_rms_m if final else float("nan"),
    )
    unknown = {
        "settling_5mm_s": not known(coarse_s),
        "settling_2mm_s": not known(fine_s),
        "final_rms_m": not final,
        "jitter_rad_s": not final,
    }
    return replace(
        target,
        score=score,
        jitter_rad_s=target.jitter_rad_s if final else float("nan"),
        not_known={name: cut for name, is_unknown in unknown.items() if is_unknown},
    )
