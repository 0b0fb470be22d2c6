"""One collection run: when the arm may move, where it goes, and what is recorded. No ROS.

The collector moves the arm without a controller behind it, so it has a guard of its own, with the
same limits: nothing moves before joints and ball are seen, a late input stops the arm, a ball out
of view sends it back toward where it started, and a joint that leaves its box or moves against
its command ends the run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from math import isfinite
from typing import Any

import numpy as np

from fvs_estimator_node.dataset import DataSet
from fvs_estimator_node.knowledge import Knowledge
from fvs_estimator_node.motion import RandomMotion
from fvs_estimator_node.pairing import BallSample, ExposureMatcher
from fvs_ros.following import Following
from fvs_ros.history import StampGate
from fvs_ros.joints import LARGEST_RAD, N_JOINTS, UR_JOINT_NAMES
from fvs_ros.limits import limit_acceleration, limit_speed, ramp_to_zero

#: The ball counts as seen again after so many positions.
_FRESH_BALLS = 5
#: A tick counts for at most this long, s: a late one must not make a big step.
_MAX_TICK_S = 0.05
#: Commands and motion are compared with this memory, s, and have to disagree for so long, s.
_AGAINST_MEMORY_S, _AGAINST_S = 0.3, 0.2
#: A joint moves against its command if it makes this share of it the other way.
_AGAINST_SHARE = 0.3
#: Slower commands than this say nothing, rad/s.
_LEAST_COMMAND_RAD_S = 0.02
#: A joint may be so far outside its box, or as far as it can brake within, rad.
_BOX_MARGIN_RAD = 0.1
#: A commander without a name so many times in a row, told four times a second, ends the run.
_NAMELESS_LOOKS = 3


class State(Enum):
    """What the run is doing."""

    WAITING = "WAITING"
    MOVING = "MOVING"
    RETURNING = "RETURNING"
    HOLDING = "HOLDING"
    DONE = "DONE"
    FAILED = "FAILED"


@dataclass(frozen=True)
class RunConfig:
    """Limits of a collection run.

    Parameters
    ----------
    max_joint_velocity_rad_s, max_joint_acceleration_rad_s2 : float
        Limits of each joint's command.
    joint_states_max_age_s, ball_max_age_s : float
        Older ones stop the arm, or send it home, s.
    give_up_s : float
        A trouble that lasts this long ends the run, s.
    follow_time_s : float
        So long the arm may fail to move as commanded, s.
    max_latency_s : float
        Longest delay of a ball position that is believed, s.
    joint_names : tuple of str
        For the words only.
    """

    max_joint_velocity_rad_s: float
    max_joint_acceleration_rad_s2: float
    joint_states_max_age_s: float = 0.1
    ball_max_age_s: float = 0.5
    give_up_s: float = 10.0
    follow_time_s: float = 3.0
    max_latency_s: float = 0.5
    joint_names: tuple[str, ...] = UR_JOINT_NAMES

    @property
    def box_margin_rad(self) -> float:
        """A joint further than this outside the motion's box ends the run, rad."""
        braking_rad = 0.5 * self.max_joint_velocity_rad_s**2 / self.max_joint_acceleration_rad_s2
        return max(_BOX_MARGIN_RAD, braking_rad)


def data_set_of(samples: Sequence[BallSample], **particulars: Any) -> DataSet:
    """A data set of samples; ``particulars`` are its other fields."""
    return DataSet(
        stamps_s=np.array([s.stamp_s for s in samples]),
        joints_rad=np.array([s.joints_rad for s in samples]),
        ball_m=np.array([s.ball_m for s in samples]),
        segment=np.array([s.run for s in samples]),
        **particulars,
    )


class _Against:
    """Finds a joint that moves against its command: their product stays negative."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Begin anew: the arm was held."""
        self._asked, self._made = np.zeros(N_JOINTS), np.zeros(N_JOINTS)
        self._against_s = np.zeros(N_JOINTS)
        self._joints: np.ndarray | None = None

    def add(self, command_rad_s: np.ndarray, joints_rad: np.ndarray, dt_s: float) -> int | None:
        """Tell one tick; the joint that has moved against its command, None if none has."""
        moved = joints_rad - (joints_rad if self._joints is None else self._joints)
        self._joints = joints_rad
        keep = _AGAINST_MEMORY_S / (_AGAINST_MEMORY_S + dt_s)
        self._asked = keep * (self._asked + command_rad_s**2 * dt_s)
        self._made = keep * (self._made + command_rad_s * moved)
        against = (self._asked > _LEAST_COMMAND_RAD_S**2 * _AGAINST_MEMORY_S) & (
            self._made < -_AGAINST_SHARE * self._asked
        )
        self._against_s = np.where(against, self._against_s + dt_s, 0.0)
        worst = int(self._against_s.argmax())
        return worst if self._against_s[worst] > _AGAINST_S else None


class CollectionRun:
    """Moves the joints and records the ball.

    Parameters
    ----------
    config : RunConfig
        Limits.
    make_motion : callable
        Makes the motion, given the joints at the start, rad, shape (6,).
    knowledge : Knowledge, optional
        Changes the motion on its way, and ends it early.

    Attributes
    ----------
    state : State
        What it is doing.
    reason : str
        Why, in words.
    samples : list of BallSample
        What was recorded.
    """

    def __init__(
        self,
        config: RunConfig,
        make_motion: Callable[[np.ndarray], RandomMotion],
        knowledge: Knowledge | None = None,
    ) -> None:
        self._config = config
        self._knowledge = knowledge
        self._make_motion = make_motion
        self._motion: RandomMotion | None = None
        self._matcher = ExposureMatcher(max_latency_s=config.max_latency_s)
        self._joint_stamps, self._ball_stamps = StampGate(), StampGate()
        self._ticked_s = -np.inf
        self._joints: np.ndarray | None = None
        self._joints_s = self._ball_s = -np.inf
        self._balls_seen = 0
        self._velocity = np.zeros(N_JOINTS)
        self._following, self._against = Following(), _Against()
        self._speed_scaling = 1.0
        self._moved_s = 0.0
        self._trouble_s: float | None = None
        self._rivals = ""
        self._nameless_looks = 0
        self.state = State.WAITING
        self.reason = "waiting for joint_states"
        self.samples: list[BallSample] = []

    @property
    def progress(self) -> float:
        """Share of the motion that is done."""
        return 0.0 if self._motion is None else min(1.0, self._moved_s / self._motion.duration_s)

    @property
    def duration_s(self) -> float:
        """How long the motion takes as far as is known, s; infinite before it begins."""
        return np.inf if self._motion is None else self._motion.duration_s

    @property
    def ended(self) -> bool:
        """Whether the run is over and the arm at rest."""
        return self.state in (State.DONE, State.FAILED) and not np.any(self._velocity)

    def joint_states(self, now_s: float, stamp_s: float, joints_rad: np.ndarray) -> None:
        """Tell joint positions: arrival on the steady clock and stamp, s; (6,), rad."""
        if not float(np.abs(joints_rad).max()) <= LARGEST_RAD:  # false for NaN, too
            self.fail(f"joint_states holds {joints_rad.tolist()}: no joint is turned that far")
            return
        if self._joint_stamps.advances(stamp_s):
            self._joints_s = now_s
            self._joints = joints_rad
        self._record(self._matcher.add_joints(stamp_s, joints_rad))

    def ball(self, now_s: float, stamp_s: float, position_m: np.ndarray) -> None:
        """Tell a ball position: arrival on the steady clock and exposure stamp, s; (3,), m."""
        if not self._ball_stamps.advances(stamp_s):
            return
        if now_s - self._ball_s > self._config.ball_max_age_s:
            self._balls_seen = 0
        self._balls_seen += 1
        self._ball_s = now_s
        self._record(self._matcher.add_ball(stamp_s, position_m))

    def speed_scaling(self, share: float) -> None:
        """Tell the robot's speed scaling, 0 to 1."""
        self._speed_scaling = share

    def rivals(self, names: Sequence[str]) -> None:
        """Tell who else publishes joint commands: two commanders make an arm jerk.

        Nothing starts while there is one. A moving arm is stopped at once for a full name, which
        has a slash; for a node not known by name yet, a moment later, so that the name is told.
        """
        self._rivals = ", ".join(names)
        named = any("/" in name for name in names)
        self._nameless_looks = self._nameless_looks + 1 if names and not named else 0
        sure = named or self._nameless_looks >= _NAMELESS_LOOKS
        if sure and self._motion is not None:
            self.fail(
                f"{self._rivals} began to command the arm as well; stop it, then collect again"
            )

    def fail(self, reason: str) -> None:
        """End the run: the arm ramps to rest, what was recorded stays."""
        if self.state not in (State.DONE, State.FAILED):
            self.state, self.reason = State.FAILED, reason

    def _record(self, samples: list[BallSample]) -> None:
        if self.state in (State.MOVING, State.RETURNING):
            self.samples.extend(samples)

    def tick(self, now_s: float, dt_s: float) -> np.ndarray:
        """Joint velocities for this tick, rad/s, shape (6,); always finite and within limits."""
        dt_s = min(dt_s, _MAX_TICK_S) if isfinite(dt_s) and dt_s > 0.0 else 0.0
        steady_dt_s = min(max(now_s - self._ticked_s, 0.0), _MAX_TICK_S)
        self._ticked_s = now_s
        if self.state not in (State.DONE, State.FAILED):
            self._decide(now_s, dt_s)
        config = self._config
        step = config.max_joint_acceleration_rad_s2 * dt_s
        wanted = self._wanted()
        if wanted is None or not np.all(np.isfinite(wanted)):
            # Simulated time may stand still; coming to rest must not.
            step = step or config.max_joint_acceleration_rad_s2 * steady_dt_s
            self._velocity = ramp_to_zero(self._velocity, step)
        else:
            wanted = limit_speed(wanted, config.max_joint_velocity_rad_s)
            self._velocity = limit_acceleration(wanted, self._velocity, step)
        return self._velocity.copy()

    def _decide(self, now_s: float, dt_s: float) -> None:
        late = self._late_joints(now_s)
        lost = self._lost_ball(now_s)
        rivals = f"{self._rivals} commands the arm as well; stop it first" if self._rivals else ""
        if late:
            self._following.restart()
            self._against.restart()
        if late or ((lost or rivals) and self._motion is None):
            self._wait(now_s, State.HOLDING, late or lost or rivals)
            return
        assert self._joints is not None
        self._watch_box()
        self._watch_following(dt_s)
        if self.state is State.FAILED:
            return
        if self._motion is None:
            try:
                self._motion = self._make_motion(self._joints)
            except ValueError as error:
                self.fail(str(error))
                return
        self._moved_s += dt_s
        motion, over_s = self._motion, self._moved_s - self._motion.duration_s
        if over_s >= 0.0:
            self._trouble_s = None
            if motion.done(self._moved_s, self._joints) or over_s > self._config.give_up_s:
                self.state, self.reason = State.DONE, f"finished{self._because()}"
        elif lost:
            motion.return_home()
            self._wait(now_s, State.RETURNING, lost)
        else:
            self._trouble_s = None
            motion.resume(self._moved_s, self._joints)
            self.state, self.reason = State.MOVING, "moving and recording"
            if self._knowledge is not None:
                self._learn(self._knowledge, motion)

    def _learn(self, knowledge: Knowledge, motion: RandomMotion) -> None:
        knowledge.look(self._moved_s, self.samples, motion)
        if knowledge.enough:
            self.reason = f"coming home{self._because()}"
        elif knowledge.trouble:
            self.reason += f" for the whole duration: {knowledge.trouble}"

    def _because(self) -> str:
        """Why the motion ended early, in words; empty if it did not."""
        known = self._knowledge
        return f": {known.words()}" if known is not None and known.enough else ""

    def _watch_box(self) -> None:
        if self._motion is None:
            return
        assert self._joints is not None
        low, high = self._motion.box_rad
        outside = np.maximum(low - self._joints, self._joints - high)
        joint = int(outside.argmax())
        if outside[joint] > self._config.box_margin_rad:
            self.fail(
                f"{self._config.joint_names[joint]} left its box: it is at "
                f"{self._joints[joint]:.2f} rad, the box is {low[joint]:.2f} to "
                f"{high[joint]:.2f} rad; check that the arm does what it is told and nothing else "
                "moves it"
            )

    def _watch_following(self, dt_s: float) -> None:
        assert self._joints is not None
        self._following.add(self._velocity, self._joints, self._speed_scaling, dt_s)
        against = self._against.add(self._velocity, self._joints, dt_s)
        if against is not None:
            self.fail(
                f"{self._config.joint_names[against]} moves against its command; check joint_names "
                "and the sign of the joint"
            )
            return
        refusal = self._following.refusal(self._config.follow_time_s)
        if refusal is not None:
            self.fail(
                f"the arm does not follow: {self._config.joint_names[refusal.joint]} was to move "
                f"{refusal.commanded_rad:.2f} rad and moved {refusal.moved_rad:.2f} rad; check "
                "that the velocity controller is active, the robot program runs and no protective "
                "stop is on"
            )

    def _wait(self, now_s: float, state: State, reason: str) -> None:
        self.state, self.reason = (State.WAITING if self._motion is None else state), reason
        if self._trouble_s is None:
            self._trouble_s = now_s
        elif now_s - self._trouble_s > self._config.give_up_s:
            if self._motion is not None and self._moved_s >= self._motion.duration_s:
                self.state = State.DONE
                self.reason = f"finished{self._because()}, though not back at the start: {reason}"
            else:
                self.fail(f"gave up after {self._config.give_up_s:g} s: {reason}")

    def _late_joints(self, now_s: float) -> str:
        age_s = now_s - self._joints_s
        if age_s <= self._config.joint_states_max_age_s:
            return ""
        heard = "none heard yet" if np.isinf(age_s) else f"the last is {age_s:.2f} s old"
        return f"no joint_states ({heard}); is the robot driver running?"

    def _lost_ball(self, now_s: float) -> str:
        age_s = now_s - self._ball_s
        if age_s <= self._config.ball_max_age_s and self._balls_seen >= _FRESH_BALLS:
            return ""
        heard = "never seen" if np.isinf(age_s) else f"last seen {age_s:.1f} s ago"
        return f"the ball is not in view ({heard})"

    def _wanted(self) -> np.ndarray | None:
        if self._joints is None or self._motion is None:
            return None
        if self.state in (State.MOVING, State.RETURNING):
            return self._motion.command(self._moved_s, self._joints)
        return None
