"""The one exit for commands: decides at every tick whether the arm may move, and how fast.

Pure and deterministic: the caller passes a steady clock. Inputs are reported as events;
``tick`` asks the monitors in order, asks the law only if none objects, limits what it says,
and always answers n finite numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, isfinite

import numpy as np

from fvs_controller_node.base import ControlOutput
from fvs_controller_node.goal import Goal
from fvs_controller_node.inbox import Inbox
from fvs_controller_node.limiter import Limiter
from fvs_controller_node.monitors import (
    FollowingMonitor,
    Motion,
    PredictionMonitor,
    ProgressMonitor,
)
from fvs_controller_node.reasons import Finding, Reason, State, Stop
from fvs_controller_node.singularity import SingularityWatch
from fvs_controller_node.supervisor_config import SupervisorConfig
from fvs_ros.agreement import Verdict
from fvs_ros.vectors import all_finite, largest, length

#: A tick counts for at most this long, s: a late one must not make a big step.
MAX_TICK_S = 0.05

#: Speed that is left just before the arm is held, as a share.
_SLOWEST_SHARE = 0.25

#: Speed at which the arm leaves a singular pose on request, rad/s, and for how long at most, s.
_LEAVE_RAD_S, _LEAVE_TIME_S = 0.1, 10.0

_PAUSES = (Reason.PROGRAM_STOPPED, Reason.SPEED_SCALING_ZERO)

#: Asks the law: (error (m,) m, last command (n,) rad/s, dt s) -> its output.
Propose = Callable[[np.ndarray, np.ndarray, float], ControlOutput]


@dataclass(frozen=True)
class Command:
    """What leaves the controller at one tick.

    Parameters
    ----------
    velocity_rad_s : ndarray, shape (n,)
        Joint velocities in kinematic order, rad/s; always finite.
    state : State
        The supervisor's state.
    finding : Finding
        Why.
    active_limit : str
        Limits that shaped the command, comma separated; empty if none did.
    output : ControlOutput or None
        The law's answer; None when it was not asked.
    """

    velocity_rad_s: np.ndarray
    state: State
    finding: Finding
    active_limit: str
    output: ControlOutput | None

    @property
    def reason(self) -> Reason:
        """Why, as a row of the table."""
        return self.finding.reason

    @property
    def text(self) -> str:
        """Why, in words with numbers."""
        return self.finding.text


class Supervisor:
    """The state machine between the control law and the robot.

    Parameters
    ----------
    config : SupervisorConfig
        Limits and thresholds.
    """

    def __init__(self, config: SupervisorConfig | None = None) -> None:
        self._config = config or SupervisorConfig()
        self.inputs = Inbox(self._config, self._end_by_event)
        joints = len(self._config.joint_names)
        self.goal = Goal(self._config)
        self._following = FollowingMonitor()
        self._monitors = (
            PredictionMonitor(),
            ProgressMonitor(self.goal.progress),
            self._following,
        )
        self._limiter = Limiter(joints)
        self._singularity = SingularityWatch()
        self._leaving_s = 0.0
        self._held_s = 0.0
        self._verdict: Verdict | None = None  # of seen and predicted motion
        self._pending = np.zeros(joints)  # motion still to come, rad
        self._started = False
        self._autostart_left = self._config.autostart
        self._ended: Finding | None = None  # what ended the session and needs a start
        self._shut_down = False
        self._ticked_s = -inf
        self._problem = ""  # why the ball's position is not known
        missing = self.inputs.find(-inf)
        assert missing is not None
        self._last = Command(self._limiter.velocity_rad_s, State.WAITING, missing, "", None)

    # ---- inputs ---------------------------------------------------------------------------

    def configure(self, config: SupervisorConfig) -> None:
        """Change limits and thresholds while running.

        ``autostart`` counts at creation only.
        """
        self._config = config
        self.goal.configure(config)
        self.inputs.configure(config)

    def start(self, now_s: float) -> tuple[bool, str]:
        """Begin to servo; or, while held near a singularity, let the arm leave it slowly.

        Returns
        -------
        bool
            Whether the arm servoes, or will when an input that is late comes back.
        str
            What was done, or why not.
        """
        if self._started:
            return self._leave(now_s) or (True, f"already started: {self._last.text}")
        finding = self._objection(now_s)
        if finding is not None:
            return self._leave(now_s) or (False, f"not started: {finding.text}")
        self._begin()
        return True, "started"

    def _leave(self, now_s: float) -> tuple[bool, str] | None:
        """Let the arm leave a singular pose, if it is held there for nothing else."""
        finding = self._objection(now_s)
        if finding is None or finding.reason is not Reason.NEAR_SINGULAR:
            return None
        assert self.inputs.conditioning is not None
        value, hold = self.inputs.conditioning.smallest, self._config.singular_hold_m_rad
        if not self._singularity.leave(value, hold):
            return False, (
                f"not started: the Jacobian is too singular to leave ({value:.4f} m/rad); call the "
                "estimator's ~/reset, or move the arm by hand"
            )
        if not self._started:
            self._begin()
            self._singularity.leave(value, hold)
        self._leaving_s = 0.0
        self.goal.progress.restart()
        return True, "leaving the singular pose slowly; held again should it come nearer to it"

    def stop(self) -> tuple[bool, str]:
        """End servoing; the arm ramps to rest. It does not start again by itself."""
        was_started = self._started
        self._started = False
        self._autostart_left = False
        self._ended = None
        self._singularity.stay()
        return True, "stopping" if was_started else "was not started; it will not start by itself"

    def shutdown(self) -> Command:
        """End for good: zeros now and for ever."""
        self._shut_down = True
        self._started = False
        self._ended = Reason.SHUT_DOWN.because()
        self._limiter.stop()
        return self._answer(self._ended, "", None)

    # ---- what it says ---------------------------------------------------------------------

    @property
    def started(self) -> bool:
        """Whether the arm servoes, or will when what holds it is over."""
        return self._started

    @property
    def config(self) -> SupervisorConfig:
        """Limits and thresholds in force."""
        return self._config

    @property
    def velocity_rad_s(self) -> np.ndarray:
        """The last command, after every limit, rad/s, shape (n,)."""
        return self._limiter.velocity_rad_s.copy()

    @property
    def last(self) -> Command:
        """The last command with its state and reason."""
        return self._last

    def tick(
        self,
        now_s: float,
        dt_s: float,
        joints_rad: np.ndarray | None,
        position_m: np.ndarray | None,
        propose: Propose,
        *,
        pending_rad: np.ndarray | None = None,
        problem: str = "",
        verdict: Verdict | None = None,
    ) -> Command:
        """Decide on the command for this tick.

        Parameters
        ----------
        now_s : float
            Steady clock, s.
        dt_s : float
            Time since the last tick, s.
        joints_rad : ndarray, shape (n,), or None
            Newest joint positions.
        position_m : ndarray, shape (m,), or None
            Ball position predicted to now, m.
        propose : callable
            Asks the law; called only if the arm may move.
        pending_rad : ndarray, shape (n,), optional
            Joint motion that was commanded and is still to come.
        problem : str
            Why there is no position, if there is none.
        verdict : Verdict, optional
            How seen and predicted motion agree, as far as enough moved to say.
        """
        dt_s = min(dt_s, MAX_TICK_S) if isfinite(dt_s) and dt_s > 0.0 else 0.0
        steady_dt_s = min(max(now_s - self._ticked_s, 0.0), MAX_TICK_S)
        self._ticked_s = now_s
        self.goal.see(position_m, dt_s, self._last.state is State.SERVOING)
        self._problem = problem
        self._verdict = verdict
        if pending_rad is not None:
            self._pending = pending_rad
        finding = self._objection(now_s)
        if finding is None and self._autostart_left and self._ended is None:
            self._begin()
        output: ControlOutput | None = None
        if finding is None and self._started and joints_rad is not None:
            finding = self._trouble_in_motion(dt_s, joints_rad)
            if finding is None:
                finding, output = self._ask(propose, dt_s)
        finding = self._held_long(finding, steady_dt_s)
        if finding is not None and finding.reason.needs_start:
            self._end_session(finding)
        if output is not None and joints_rad is not None:
            return self._move(output, joints_rad, dt_s)
        self._following.pause()
        if finding is not None:
            self._singularity.stay()  # a permission holds for one way out, not for ever
        # Simulated time may stand still; coming to rest must not.
        return self._rest(finding, joints_rad, dt_s or steady_dt_s)

    def status_values(self, now_s: float) -> dict[str, float | str]:
        """Key numbers for a status message, always the same keys in the same order."""
        nan = float("nan")
        singular = self.inputs.conditioning
        error = self.goal.error_m
        values: dict[str, float | str] = {
            "state": self._last.state.value,
            "reason": self._last.reason.name,
            "started": str(self._started).lower(),
            "settled": str(self.goal.settled).lower(),
            "error_m": nan if error is None else length(error),
            "active_limit": self._last.active_limit,
            "fastest_joint_rad_s": largest(self._limiter.velocity_rad_s),
            "smallest_singular_value_m_rad": nan if singular is None else singular.smallest,
            "condition_number": nan if singular is None else singular.condition,
            "prediction_error_ratio": self._error_ratio,
        }
        values |= self.inputs.status_values(now_s)
        vectors = {
            "target_{}_m": self.goal.target_m,
            "position_{}_m": self.goal.position_m,
            "exponent_{}": None if self._last.output is None else self._last.output.exponent,
        }
        for name, vector in vectors.items():
            for axis, value in zip(
                "xyz", [nan] * len("xyz") if vector is None else vector, strict=True
            ):
                values[name.format(axis)] = float(value)
        return values

    # ---- rules: may it move? --------------------------------------------------------------

    def _objection(self, now_s: float) -> Finding | None:
        """Find the first rule that forbids motion now, started or not."""
        if self._shut_down:
            return Reason.SHUT_DOWN.because()
        # Who waits to be asked for a target may count on the arm to start at once.
        return (
            self.inputs.find(now_s)
            or self._no_position()
            or self._no_target()
            or self._near_singular()
        )

    def _no_position(self) -> Finding | None:
        if self.goal.position_m is not None:
            return None
        return Reason.NO_POSITION.because(why=self._problem or "no image is usable yet")

    def _no_target(self) -> Finding | None:
        return Reason.NO_TARGET.because() if self.goal.target_m is None else None

    def _near_singular(self) -> Finding | None:
        assert self.inputs.conditioning is not None
        value = self.inputs.conditioning.smallest
        limit = self._singularity.held_below(
            value, self._config.singular_hold_m_rad, self._config.singular_slow_m_rad
        )
        if limit is None:
            return None
        return Reason.NEAR_SINGULAR.because(value=value, limit=limit)

    def _trouble_in_motion(self, dt_s: float, joints: np.ndarray) -> Finding | None:
        """Find what only shows while the arm moves; every monitor counts at every tick."""
        assert self.inputs.jacobian is not None
        motion = Motion(
            dt_s,
            joints,
            self._limiter.velocity_rad_s,
            self.inputs.speed_scaling,
            self.inputs.jacobian,
            self._verdict,
        )
        findings = [monitor.check(motion, self._config) for monitor in self._monitors]
        return next((finding for finding in findings if finding is not None), None)

    @property
    def _error_ratio(self) -> float:
        """Error of predicted motion over the motion; not a number while unknown."""
        return float("nan") if self._verdict is None else self._verdict.error_ratio

    def _held_long(self, finding: Finding | None, dt_s: float) -> Finding | None:
        """Let a hold of a started arm end in a needed start, once no one expects it to go on."""
        if finding is None or not self._started:
            self._held_s = 0.0
            return finding
        self._held_s += dt_s
        limit_s = self._config.resume_within_s
        if self._held_s <= limit_s or finding.reason.needs_start:
            return finding
        return Reason.HELD_LONG.because(limit_s=limit_s, why=finding.text)

    def _ask(self, propose: Propose, dt_s: float) -> tuple[Finding | None, ControlOutput | None]:
        error, velocity_rad_s = self.goal.error_m, self._limiter.velocity_rad_s
        assert error is not None
        if dt_s <= 0.0:
            return None, ControlOutput(velocity_rad_s, 0.0 * error, np.ones_like(error))
        try:
            output = propose(error, velocity_rad_s.copy(), dt_s)
            expected = {"command": velocity_rad_s, "sliding variable": error, "exponent": error}
            given = (output.velocity_rad_s, output.sliding_variable, output.exponent)
            for (name, like), value in zip(expected.items(), given, strict=True):
                if np.shape(value) != like.shape or not all_finite(np.asarray(value)):
                    raise ValueError(f"its {name} is {value}")
        except Exception as error:  # whatever a law does wrong, the arm must stop
            return Reason.LAW_FAULT.because(why=f"{type(error).__name__}: {error}"), None
        return None, output

    # ---- how it moves, how it rests ---------------------------------------------------------

    def _move(self, output: ControlOutput, joints: np.ndarray, dt_s: float) -> Command:
        config = self._config
        share, slowed = self._speed_share()
        fast = config.speed.max_joint_velocity_rad_s * share
        if self._singularity.leaving:
            fast = min(fast, _LEAVE_RAD_S)
            self._leaving_s += dt_s
            if self._leaving_s > _LEAVE_TIME_S:
                self._singularity.stay()
        active = self._limiter.move(
            np.asarray(output.velocity_rad_s, dtype=float),
            joints,
            dt_s,
            config,
            max_speed_rad_s=fast,
            pending_rad=self._pending,
        )
        reason = Reason.SETTLED if self.goal.progress.settled else Reason.SERVOING
        error = self.goal.error_m
        assert error is not None
        error_mm = 1e3 * length(error)
        return self._answer(reason.because(error_mm=error_mm), ", ".join(slowed + active), output)

    def _speed_share(self) -> tuple[float, list[str]]:
        """Share of the velocity limit that the Jacobian's condition and quality leave."""
        config = self._config
        share, active = 1.0, []
        assert self.inputs.conditioning is not None
        value = self.inputs.conditioning.smallest
        if value < config.singular_slow_m_rad:
            share = _ramp(value, config.singular_hold_m_rad, config.singular_slow_m_rad)
            active.append(f"near singular ({value:.3f} m/rad)")
        if (ratio := self._error_ratio) > config.prediction_slow:
            share *= _ramp(ratio, config.prediction_hold, config.prediction_slow)
            active.append(f"prediction error ({ratio:.2f})")
        return max(share, _SLOWEST_SHARE), active

    def _rest(self, finding: Finding | None, joints: np.ndarray | None, dt_s: float) -> Command:
        """Bring the arm to rest, and say why."""
        # What ended the session goes on being said, unless something worse is wrong now.
        worse = finding is not None and finding.reason.stop is Stop.AT_ONCE
        if not self._started and self._ended is not None and not worse:
            finding = self._ended
            if finding.reason in _PAUSES and not self.inputs.pauses():
                finding = Reason.PAUSE_OVER.because()
        if finding is None:
            finding = Reason.READY.because()
        if finding.reason.stop is Stop.AT_ONCE:
            self._limiter.stop()
            return self._answer(finding, "", None)
        moving = self._limiter.come_to_rest(joints, dt_s, self._config, self._pending)
        return self._answer(finding, "acceleration" if moving else "", None)

    def _answer(self, finding: Finding, active_limit: str, output: ControlOutput | None) -> Command:
        reason = finding.reason
        if self._started or self._ended is not None or reason is Reason.READY:
            state = reason.state
        else:
            state = State.WAITING
        self._last = Command(
            self._limiter.velocity_rad_s.copy(), state, finding, active_limit, output
        )
        return self._last

    # ---- bookkeeping ------------------------------------------------------------------------

    def _begin(self) -> None:
        self._started = True
        self._autostart_left = False
        self._ended = None
        self._singularity.stay()
        for monitor in self._monitors:
            monitor.restart()

    def _end_by_event(self, finding: Finding) -> None:
        """End the session; a pause of the robot is said of one that has ended before, too."""
        self._end_session(finding)
        if self._ended is not None and finding.reason in _PAUSES and not self._shut_down:
            self._ended = finding

    def _end_session(self, finding: Finding) -> None:
        """Stop until a new start, if it was started."""
        if self._started:
            self._started = False
            self._autostart_left = False
            self._singularity.stay()
            self._ended = finding


def _ramp(value: float, at_zero: float, at_one: float) -> float:
    """0 to 1 as ``value`` goes from ``at_zero`` to ``at_one``."""
    return min(1.0, max(0.0, (value - at_zero) / (at_one - at_zero)))
