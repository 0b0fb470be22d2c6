"""The targets of a recording, each judged as the demo and the laboratory judge theirs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fvs_controller_node.target_motion import TargetMotion
from fvs_lab.replay.data import Recording, Series
from fvs_ros.joints import N_JOINTS
from fvs_ros.status import vector
from fvs_tools.demo import PARAMETERS, TargetRecord, TargetScore, score
from fvs_tools.score import jitter_rad_s

#: Stamps further apart than this are two moments, s: their last digits are lost in seconds.
_SAME_MOMENT_S = 1e-6
#: A target's stamp further from its arrival than this is not when it was given, s.
_GIVEN_S = 0.3
#: A target that was given longer before the first position than this is none of the recording's, s.
_BEFORE_S = 5.0
#: Without a position for so long after it was given, its start is not known, s.
_LATE_S = 0.1
#: The last second is judged as the end; so long below a bound, the ball did not just cross it, s.
_FINAL_S = 1.0
#: What ended a target too early to judge it.
_CUT_BY_END, _CUT_BY_TARGET = "the recording ends", "another target came"
#: So long after a target's arrival the status shows it, and in so many digits, s and m.
_SHOWN_S, _SAME_M = 0.25, 0.001
_DEMO = "fvs_demo_node"


@dataclass(frozen=True)
class Target:
    """One target, n samples of the ball on the way to it.

    Parameters
    ----------
    number : int
        From 1.
    moving : bool
        Whether it is one that moved: then there is no settling, but an error all along.
    record : TargetRecord
        Where it was (at last), and the ball's positions since it was given.
    errors_m : ndarray, shape (n,)
        Distances of the ball to it at each sample, m.
    score : TargetScore
        The demo's judgement; the joints' peak speed is not a number where no velocity is known.
        A settling time is None also where it is not known, and the final error not a number.
    path_m : float
        Length of the ball's path, m; longer with a noisy position.
    jitter_rad_s : float
        Of the command over the last second; not a number without commands.
    not_known : mapping of str to str
        Which of these numbers the record is too short for (``settling_5mm_s``,
        ``settling_2mm_s``, ``final_rms_m``, ``jitter_rad_s``), and what ended it.
    """

    number: int
    moving: bool
    record: TargetRecord
    errors_m: np.ndarray
    score: TargetScore
    path_m: float
    jitter_rad_s: float
    not_known: Mapping[str, str]

    @property
    def begins_late(self) -> bool:
        """Whether the recording lacks its beginning, so that the start distance is not known."""
        return self.record.time_s[0] > _LATE_S

    @property
    def rms_m(self) -> float:
        """Error over all of it, rms, m: what says something of a target that moves."""
        return float(np.sqrt(np.mean(self.errors_m**2)))


@dataclass(frozen=True)
class _Given:
    """A target as it was given: when it came, when it was given, and where it was from then on."""

    arrival_s: float
    time_s: list[float] = field(default_factory=list)
    position_m: list[np.ndarray] = field(default_factory=list)


def settle_error_m(recording: Recording) -> float:
    """The bound that counts as settled: that of the recorded demo, or the demo's default."""
    return float(recording.started(_DEMO, PARAMETERS)["settle_error_m"])


def judged_by(recording: Recording) -> Series | None:
    """The ball positions to judge by: the true ones where the bag has them."""
    return recording.series.get("true_ball") or recording.series.get("ball")


def targets(recording: Recording) -> list[Target]:
    """Judge every target that the bag has ball positions for."""
    ball, given = judged_by(recording), recording.series.get("target")
    if ball is None or given is None:
        return []
    time_s = _times(ball)
    runs = _taken(recording, _grouped(given, time_s))
    target_s = recording.started(_DEMO, PARAMETERS)["target_s"]
    found: list[Target] = []
    for (one, replaced_s), (following, _) in zip(runs, [*runs[1:], (None, 0.0)], strict=True):
        end_s = np.inf if following is None else following.time_s[0]
        end_s = min(end_s, one.time_s[0] + replaced_s)
        if following is None and _DEMO in recording.scenario:
            end_s = _first_after(time_s, one.time_s[0], target_s)
        target = _judge(recording, ball, time_s, one, end_s, len(found) + 1)
        if target is not None:
            cut = _CUT_BY_TARGET if np.isfinite(end_s) else _CUT_BY_END
            given_whole = target.record.time_s[-1] >= target_s
            # The demo's own verdict, and its number, after its time: whatever came then.
            whole = given_whole and _DEMO in recording.scenario
            found.append(target if whole else _without_guesses(target, cut, given_whole))
    return found


def _without_guesses(target: Target, cut: str, given_whole: bool) -> Target:
    """The target without numbers that its record is too short for.

    The ball may just have crossed a bound when the record ended: that it stayed below takes a
    second to know, whether the file ended or another target came. One that was above is "never"
    below only if another target came, or if it had the time that the demo gives.
    """
    end_s = target.record.time_s[-1]
    final = end_s - target.record.time_s[0] >= _FINAL_S
    not_known = {}
    if not target.moving:
        never = cut == _CUT_BY_TARGET or given_whole
        for name in ("settling_5mm_s", "settling_2mm_s"):
            settled_s = getattr(target.score, name)
            if not (never if settled_s is None else end_s - settled_s >= _FINAL_S):
                not_known[name] = cut
        final = final and "settling_5mm_s" not in not_known
    if not final:
        not_known |= dict.fromkeys(("final_rms_m", "jitter_rad_s"), cut)
    judged = target.score
    return replace(
        target,
        score=replace(
            judged,
            settling_5mm_s=None if "settling_5mm_s" in not_known else judged.settling_5mm_s,
            settling_2mm_s=None if "settling_2mm_s" in not_known else judged.settling_2mm_s,
            final_rms_m=judged.final_rms_m if final else float("nan"),
        ),
        jitter_rad_s=target.jitter_rad_s if final else float("nan"),
        not_known=not_known,
    )


def _taken(recording: Recording, runs: Sequence[_Given]) -> list[tuple[_Given, float]]:
    """The targets that the controller took, and how long after it another one took its place, s.

    Its status tells: one that it refused is not there, and one that was set by a service stands
    there without a message. A bag without it, or a target on its way, has nothing to compare.
    """
    told = [
        (status.arrival_s, target_m)
        for status in recording.said.get("controller", ())
        if (target_m := vector(status.values, "target_{}_m")) is not None
    ]

    def shown(one: _Given, following: _Given | None) -> list[tuple[float, bool]]:
        """When the status told a target after this one, and whether it was this one."""
        end_s = np.inf if following is None else following.arrival_s
        return [
            (at_s, bool(np.abs(target_m - one.position_m[0]).max() < _SAME_M))
            for at_s, target_m in told
            if one.arrival_s + _SHOWN_S < at_s < end_s
        ]

    def compared(runs: Sequence[_Given]) -> list[tuple[_Given, list[tuple[float, bool]]]]:
        pairs = zip(runs, [*runs[1:], None], strict=bool(runs))
        return [(one, [] if len(one.time_s) > 1 else shown(one, after)) for one, after in pairs]

    taken = [one for one, seen in compared(runs) if not seen or any(same for _, same in seen)]
    found: list[tuple[_Given, float]] = []
    for one, seen in compared(taken):
        last_s = max((at_s for at_s, same in seen if same), default=np.inf)
        other_s = min((at_s for at_s, _ in seen if at_s > last_s), default=np.inf)
        found.append((one, other_s - one.arrival_s))
    return found


def _times(series: Series) -> np.ndarray:
    """When each sample was so: its stamp, or else its arrival, s."""
    return np.where(np.isfinite(series.stamp_s), series.stamp_s, series.arrival_s)


def _first_after(time_s: np.ndarray, start_s: float, least_s: float) -> float:
    """The first time that is so much later than a start, s; computed as the demo does."""
    later = time_s[time_s - start_s >= least_s]  # a sum is rounded otherwise
    return float(later[0]) if later.size else np.inf


def _grouped(given: Series, ball_s: np.ndarray) -> list[_Given]:
    """Targets one after another; those that the controller takes for one on its way are one."""
    runs: list[_Given] = []
    motion = TargetMotion()
    last: np.ndarray | None = None
    for arrival_s, stamp_s, position_m in zip(
        given.arrival_s, given.stamp_s, given.values, strict=True
    ):
        if last is not None and np.array_equal(last, position_m):
            continue  # said again
        last = position_m
        given_s = _given_s(stamp_s, arrival_s, ball_s)
        if not motion.continues(position_m, given_s):
            runs.append(_Given(float(arrival_s)))
        motion.restart(position_m, given_s)
        runs[-1].time_s.append(given_s)
        runs[-1].position_m.append(position_m)
    return runs


def _given_s(stamp_s: float, arrival_s: float, ball_s: np.ndarray) -> float:
    """When a target was given, by the clock of the ball's positions."""
    if np.isfinite(stamp_s) and ball_s[0] - _BEFORE_S < stamp_s < ball_s[-1] + _GIVEN_S:
        nearest_s = float(ball_s[np.argmin(np.abs(ball_s - stamp_s))])
        if abs(nearest_s - stamp_s) < _SAME_MOMENT_S:
            return nearest_s  # the demo's, who stamps it with the position it saw
        # Not by another machine's clock; or before the recording heard any clock.
        if abs(arrival_s - stamp_s) < _GIVEN_S or arrival_s < ball_s[0] + _GIVEN_S:
            return float(stamp_s)
    return float(arrival_s)


def _judge(
    recording: Recording,
    ball: Series,
    time_s: np.ndarray,
    given: _Given,
    end_s: float,
    number: int,
) -> Target | None:
    start_s = given.time_s[0]
    chosen = np.flatnonzero((time_s >= start_s) & (time_s <= end_s))
    if chosen.size == 0:
        return None
    record = TargetRecord(given.position_m[-1], start_s)
    for index in chosen:
        record.add_position(float(time_s[index]), ball.values[index])
    joints = recording.series.get("joints")
    if joints is not None:
        joint_s = _times(joints)
        for index in np.flatnonzero((joint_s > start_s) & (joint_s <= end_s)):
            velocity_rad_s = joints.values[index, N_JOINTS:]
            if np.isfinite(velocity_rad_s).all():
                record.add_joint_velocity(float(joint_s[index]), velocity_rad_s)
    judged = score(record, settle_error_m(recording))
    if not record.joint_velocity_rad_s:
        judged = replace(judged, peak_joint_speed_rad_s=float("nan"))
    positions = ball.values[chosen]
    wanted = np.searchsorted(given.time_s, time_s[chosen], side="right") - 1
    errors = np.linalg.norm(positions - np.array(given.position_m)[wanted], axis=1)
    return Target(
        number=number,
        moving=len(given.time_s) > 1,
        record=record,
        errors_m=errors,
        score=judged,
        path_m=float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum()),
        jitter_rad_s=_jitter(recording.series.get("commands"), ball, chosen),
        not_known={},
    )


def _jitter(commands: Series | None, ball: Series, chosen: Sequence[int] | np.ndarray) -> float:
    """Jitter of the commands that came in the last second of some ball positions."""
    if commands is None:
        return float("nan")
    end_s = ball.arrival_s[chosen[-1]]
    last = (commands.arrival_s > end_s - _FINAL_S) & (commands.arrival_s <= end_s)
    return jitter_rad_s(commands.values[last]) if last.sum() > 1 else float("nan")
