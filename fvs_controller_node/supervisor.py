"""The only exit for commands: decides at every tick whether the arm may move, and how fast.

It is pure and deterministic: the caller passes a steady clock. Inputs arrive as events. At every
tick, ``permit`` runs the monitors in order and says what objects to motion, and ``release`` limits
the law's output, or brings the arm to rest. It always returns n finite numbers.
"""

from __future__ import annotations

from math import inf
from typing import NamedTuple

import numpy as np

from fvs_controller_node.agreement import Verdict
from fvs_controller_node.base import ControlOutput
from fvs_controller_node.config import SupervisorConfig
from fvs_controller_node.goal import Goal
from fvs_controller_node.inbox import Inbox
from fvs_controller_node.monitors import PredictionMonitor, SingularityMonitor
from fvs_controller_node.reasons import Finding, Reason, State, Stop
from fvs_controller_node.redundancy import singular_values
from fvs_ros.following import TrackingFault
from fvs_ros.kinds import ErrorText
from fvs_ros.limiter import CommandLimiter
from fvs_ros.vectors import all_finite, largest, length
from fvs_ros.view import WHERE, Barrier

#: Speed at which the arm may leave a singular pose, rad/s.
_LEAVING_RAD_S = 0.1

#: Share of the speed limit that is left just before the arm is held.
_LEAST_SHARE = 0.25


class Present(NamedTuple):
    """The controller's data at a tick, for a feature of m numbers, d motions, and n joints."""

    joints_rad: np.ndarray | None  #: newest positions, (n,)
    z: np.ndarray | None  #: the feature, predicted to now, (m,)
    jacobian: np.ndarray | None  #: m/rad, (d, n)
    pending_rad: np.ndarray  #: motion that was commanded and is still to come, (n,)
    problem: str = ""  #: why there is no feature
    verdict: Verdict | None = None  #: on seen and predicted motion; None while too little moved
    not_following: TrackingFault | None = None  #: the joint that does not follow its command
    drift_m_s: np.ndarray | None = None  #: the feature's own velocity, (d,); None at rest
    freedom: int | None = None  #: most motions that an arm can make as the cameras see it now


class Command(NamedTuple):
    """What leaves the controller at one tick."""

    velocity_rad_s: np.ndarray  #: joint velocities, (n,), in kinematic order; always finite
    state: State
    finding: Finding  #: why
    active_limit: str  #: limits that shaped the command, comma separated; empty if none did
    output: ControlOutput | None  #: the law's answer; None when it was not asked

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

    ``inputs`` takes the messages, ``goal`` the target; ``last`` is the last command with its state
    and reason.
    """

    def __init__(self, config: SupervisorConfig | None = None) -> None:
        self.config = config = config or SupervisorConfig()
        #: Whether the arm servoes, or will once the present hold is over.
        self.started = False
        self._starts_itself = config.autostart
        self._ended: Finding | None = None  # what ended the session and needs a start
        self._held_since_s: float | None = None
        self.inputs = Inbox(config, self.end)
        self.goal = Goal(config)
        self._prediction, self._singularity = PredictionMonitor(), SingularityMonitor()
        joints = len(config.joint_names)
        self._limiter = CommandLimiter(config)
        self._present = Present(None, None, None, np.zeros(joints))
        self._smallest_m_rad = inf  # smallest singular value of its Jacobian
        self._where = ""  # in the view, where that limits the motion
        self._shut_down = False
        missing = self.inputs.find(-inf)
        assert missing is not None
        self.last = Command(self._limiter.velocity_rad_s, State.WAITING, missing, "", None)

    def configure(self, config: SupervisorConfig) -> None:
        """Change limits and thresholds while running; ``autostart`` counts at creation only."""
        self.config = self._limiter.limits = config
        self.goal.configure(config)
        self.inputs.configure(config)

    # ---- start and stop -------------------------------------------------------------------

    def start(self, now_s: float) -> tuple[bool, str]:
        """Begin to servo; or, while held near a singularity, let the arm leave it slowly.

        Returns whether the arm servoes, or will when an input that is late comes back; and what was
        done, or why not.
        """
        finding = self._objection(now_s)
        if finding is not None and finding.reason is Reason.NEAR_SINGULAR:
            return self._leave()
        if self.started:
            return True, f"already started: {self.last.text}"
        if finding is not None:
            return False, f"not started: {finding.text}"
        self._begin()
        return True, "started"

    def _leave(self) -> tuple[bool, str]:
        """Let the arm leave a singular pose that is the only reason for its hold."""
        value = self._smallest_m_rad
        if not self._singularity.leave(value, self.config.singular_hold_m_rad):
            return False, (
                f"not started: the Jacobian is too singular to leave ({value:.4f} m/rad); call the "
                "estimator's ~/reset, or move the arm by hand"
            )
        if not self.started:
            self._begin()
        self.goal.progress.restart()
        return True, "leaving the singular pose slowly; the arm is held if it gets closer"

    def _begin(self) -> None:
        self.started, self._starts_itself, self._ended = True, False, None
        for monitor in (self._prediction, self.goal.progress):
            monitor.restart()

    def end(self, finding: Finding) -> None:
        """End the session, if there is one, until a new start."""
        if self.started:
            self.started, self._ended = False, finding

    def stop(self) -> tuple[bool, str]:
        """End servoing; the arm ramps to rest. It does not start again by itself."""
        self.started, self._starts_itself, self._ended = False, False, None
        self._singularity.leaving = False
        return True, "stopping; it moves only after ~/start"

    def shutdown(self) -> Command:
        """End permanently: zeros from now on, or a ramp to them within a jerk limit."""
        self.stop()
        self._shut_down = True
        self._ended = Reason.SHUT_DOWN.because()
        return self._rest(self._ended, None, 0.0)

    @property
    def velocity_rad_s(self) -> np.ndarray:
        """The last command, after every limit, rad/s, shape (n,)."""
        return self._limiter.velocity_rad_s.copy()

    # ---- the tick -------------------------------------------------------------------------

    def permit(self, now_s: float, dt_s: float, present: Present) -> Finding | None:
        """Return why the arm must not move in this tick, or None if the law is to move it.

        ``now_s`` is the steady clock, ``dt_s`` what the tick counts for.
        """
        before, self._present = self._present, present
        jacobian = present.jacobian
        self.goal.see(present.z, dt_s, self.last.state is State.SERVOING)
        if jacobian is not None and jacobian is not before.jacobian:
            task = self.config.kind.of_task(present.z, jacobian)
            values = singular_values(task)[: present.freedom]
            self._smallest_m_rad = float(values[-1])
        finding = self._objection(now_s)
        if finding is not None:
            return finding
        if self._starts_itself:
            self._begin()
        return self._trouble_in_motion(dt_s) if self.started else Reason.READY.because()

    def release(
        self, now_s: float, dt_s: float, finding: Finding | None, output: ControlOutput | None
    ) -> Command:
        """The command of this tick: the law's output within all limits, or one step to rest.

        Without an output, ``finding`` says why there is none.
        """
        finding, joints_rad = self._end_long_hold(finding, now_s), self._present.joints_rad
        if output is not None and joints_rad is not None:
            return self._move(output, joints_rad, dt_s)
        self._singularity.leaving = False  # the permission is for one exit only
        return self._rest(finding, joints_rad, dt_s)

    def _objection(self, now_s: float) -> Finding | None:
        """Find the first rule that forbids motion now, started or not."""
        if self._shut_down:
            return Reason.SHUT_DOWN.because()
        finding = self.inputs.find(now_s)
        if finding is not None:
            return finding
        # The target is checked last: it is requested only if nothing else is missing.
        if self.goal.z is None:
            why = self._present.problem or "no image is usable yet"
            return Reason.NO_POSITION.because(what=self.config.kind.what, why=why)
        if self.goal.target is None:
            return Reason.NO_TARGET.because(name=self.goal.awaited)
        return self._singularity.check(self._smallest_m_rad, self.config)

    def _trouble_in_motion(self, dt_s: float) -> Finding | None:
        """Check the monitors that apply in motion; every one of them runs at every tick."""
        config, present = self.config, self._present
        assert present.jacobian is not None
        moved_rad = dt_s * self._limiter.velocity_rad_s
        if config.follows_object:
            self.goal.progress.travel_m += length(present.jacobian.dot(moved_rad))
        findings = (
            self._prediction.check(present.verdict, present.jacobian, moved_rad, config),
            self.goal.progress.check(config, self._remark),
            self._following(present.not_following),
        )
        return next((finding for finding in findings if finding is not None), None)

    def _following(self, fault: TrackingFault | None) -> Finding | None:
        if fault is None:
            return None
        config, joint = self.config, fault.joint
        commanded, moved = config.unit[joint] * np.array(fault[1:])
        name = config.joint_names[joint]
        return Reason.NOT_FOLLOWING.because(joint=name, commanded=commanded, moved=moved)

    def _end_long_hold(self, finding: Finding | None, now_s: float) -> Finding | None:
        """A hold that lasts too long requires a new start."""
        if finding is None or not self.started:
            self._held_since_s = None
            return finding
        self._held_since_s = now_s if self._held_since_s is None else self._held_since_s
        limit_s = self.config.resume_within_s
        if now_s - self._held_since_s > limit_s and not finding.reason.needs_start:
            finding = Reason.HELD_LONG.because(limit_s=limit_s, why=finding.text)
        if finding is not None and finding.reason.needs_start:
            self.end(finding)
        return finding

    # ---- how it moves, how it rests -------------------------------------------------------

    def _move(self, output: ControlOutput, joints: np.ndarray, dt_s: float) -> Command:
        verdict = self._present.verdict
        ratio = 0.0 if verdict is None else verdict.error_ratio
        config = self.config
        share, active = _speed_share(self._smallest_m_rad, ratio, config)
        fast = config.max_joint_velocity_rad_s * share * self.goal.speed
        if self._singularity.leaving:
            fast = min(fast, _LEAVING_RAD_S)
            self._singularity.go_on(dt_s)
        wanted, pending_rad = np.asarray(output.velocity_rad_s, float), self._present.pending_rad
        view = self._view() if wanted.any() else None  # what rests is not led off its target
        active += self._limiter.move(wanted, joints, dt_s, pending_rad, fast, view)
        if not all_finite(self.velocity_rad_s):  # whatever went wrong on the way
            self._limiter.stop()
            fault = Reason.LAW_FAULT.because(why="the limits gave numbers that are not finite")
            self.end(fault)
            return self._rest(fault, joints, dt_s)
        self._where = next((limit for limit in active if limit in WHERE), "")
        reason = Reason.SETTLED if self.goal.progress.settled else Reason.SERVOING
        error = self.goal.error_m
        assert error is not None
        finding = reason.because(error=ErrorText(config.kind, error), remark=self._remark)
        return self._command(finding, ", ".join(active), output)

    def _view(self) -> Barrier | None:
        """What keeps the object in the view of a camera on the arm."""
        present, kind = self._present, self.config.kind
        if not kind.on_arm or present.z is None:
            return None
        assert present.jacobian is not None
        return self.config.barrier(
            kind, present.z, present.jacobian, present.pending_rad, present.drift_m_s
        )

    @property
    def _remark(self) -> str:
        """What is given up for the view, after a sentence."""
        return f"; slowed, the {self.config.kind.what} is {self._where}" if self._where else ""

    def _rest(self, finding: Finding | None, joints: np.ndarray | None, dt_s: float) -> Command:
        """Bring the arm to rest, and say why."""
        # What ended the session remains the reason, unless something worse is wrong now.
        worse = finding is not None and finding.reason.stop is Stop.AT_ONCE
        if self._ended is not None and not worse:
            finding = self._ended
        finding = finding or Reason.READY.because()
        at_once = finding.reason.stop is Stop.AT_ONCE and not self.config.max_joint_jerk_rad_s3
        if at_once or not self._limiter.velocity_rad_s.any():
            self._limiter.stop()
            return self._command(finding, "", None)
        self._limiter.rest(joints, dt_s, self._present.pending_rad)
        return self._command(finding, "acceleration", None)

    def _command(
        self, finding: Finding, active_limit: str, output: ControlOutput | None
    ) -> Command:
        reason = finding.reason
        asked = self.started or self._ended is not None or reason is Reason.READY
        state = reason.state if asked else State.WAITING
        self.last = Command(self.velocity_rad_s, state, finding, active_limit, output)
        return self.last

    def status_values(self, now_s: float) -> dict[str, float | str]:
        """Key numbers for a status message, always the same keys in the same order."""
        nan, last, config = float("nan"), self.last, self.config
        error, verdict = self.goal.error_m, self._present.verdict
        singular = nan if self._present.jacobian is None else self._smallest_m_rad
        values: dict[str, float | str] = {
            "state": last.state.value,
            "reason": last.reason.name,
            "started": str(self.started).lower(),
            "settled": str(error is not None and self.goal.progress.settled).lower(),
            **config.kind.status_values(error),
            "reference": self.goal.reference,
            "active_limit": last.active_limit,
            "fastest_joint_rad_s": largest(self._limiter.velocity_rad_s),
            "smallest_singular_value_m_rad": singular,
            "prediction_error_ratio": nan if verdict is None else verdict.error_ratio,
            **self.inputs.status_values(now_s),
        }
        for name, z in (("target", self.goal.target), ("position", self.goal.z)):
            for i, axis in enumerate(config.kind.axes[: config.kind.box_size]):
                values[f"{name}_{axis}_m"] = nan if z is None else float(z[i])
        target, columns = self.goal.target, config.kind.columns
        for i in range(config.kind.box_size, len(columns)):  # its orientation
            number = nan if target is None else float(config.kind.columns_of(target)[i])
            values[f"target_{columns[i]}"] = number
        return values


def checked(output: ControlOutput, joints: int, size: int) -> ControlOutput:
    """A law's output, if it is for n joints and errors of a size, d; else a ``ValueError``."""
    for name, value, count in zip(output._fields, output, (joints, size, size), strict=True):
        if np.shape(value) != (count,) or not all_finite(np.asarray(value)):
            raise ValueError(f"its {name} is {value}")
    return output


def _speed_share(
    smallest_m_rad: float, error_ratio: float, config: SupervisorConfig
) -> tuple[float, list[str]]:
    """Share of the velocity limit that the Jacobian's condition and quality leave."""
    share, active = 1.0, []
    if smallest_m_rad < config.singular_slow_m_rad:
        share = _ramp(smallest_m_rad, config.singular_hold_m_rad, config.singular_slow_m_rad)
        active.append(f"near singular ({smallest_m_rad:.3f} m/rad)")
    if error_ratio > config.prediction_slow:
        share *= _ramp(error_ratio, config.prediction_hold, config.prediction_slow)
        active.append(f"prediction error ({error_ratio:.2f})")
    return max(share, _LEAST_SHARE), active


def _ramp(value: float, at_zero: float, at_one: float) -> float:
    """0 to 1 as ``value`` goes from ``at_zero`` to ``at_one``."""
    return min(1.0, max(0.0, (value - at_zero) / (at_one - at_zero)))
