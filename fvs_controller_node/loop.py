"""The whole controller without ROS: predictor, law and supervisor, joined once.

The node hands messages in and sends what ``tick`` answers; the laboratory uses the same object.
"""

from __future__ import annotations

from math import inf

import numpy as np

from fvs_controller_node.anticipation import Anticipation
from fvs_controller_node.base import NO_FEED_FORWARD, ControlInput, ControlLaw, ControlOutput
from fvs_controller_node.drive_lag import DriveLag
from fvs_controller_node.inbox import BALL, JOINT_STATES, KINEMATIC_CHAIN
from fvs_controller_node.predictor import BallPredictor
from fvs_controller_node.reasons import State
from fvs_controller_node.supervisor import Command, Supervisor
from fvs_controller_node.target_motion import Target, TargetFollower
from fvs_ros.chain import SerialChain
from fvs_ros.timeline import StampGate, jump_of

#: Velocity of a target that stands, m/s.
_STANDING = np.zeros(1)
#: After a longer gap between two joint states their step is not checked, s.
_JUMP_S = 0.5
#: The estimator publishes the chain more often than this; an older one is not used, s.
_CHAIN_MAX_AGE_S = 1.5


class ServoLoop:
    """Data goes through once: joints, ball and Jacobian in; one command out.

    Parameters
    ----------
    law : ControlLaw
        The control law.
    predictor : BallPredictor
        Predicts the ball to now.
    supervisor : Supervisor
        The one exit.
    follower : TargetFollower
        Keeps up with a moving target.
    anticipation : Anticipation
        Shows the law what will be when its command takes effect.
    """

    def __init__(
        self,
        law: ControlLaw,
        predictor: BallPredictor,
        supervisor: Supervisor,
        follower: TargetFollower,
        anticipation: Anticipation,
    ) -> None:
        self.law = law
        self.predictor = predictor
        self.supervisor = supervisor
        self.follower = follower
        self.anticipation = anticipation
        self._drive_lag = DriveLag()
        self._pending_rad = self._drive_lag.pending_rad()
        self._chain: SerialChain | None = None
        self._chain_s = -inf
        self._stamp_s = 0.0
        self._target_updates = self._target_count = 0
        self._aim: Target | None = None  # the target that the supervisor has
        self._target_m_s = _STANDING
        self._joint_stamps, self._ball_stamps = StampGate(), StampGate()
        self._joints: np.ndarray | None = None
        self._last_joints: tuple[float, np.ndarray | None] = (0.0, None)  # as they came
        self._jacobian: np.ndarray | None = None
        self._home: np.ndarray | None = None  # joints at the last start

    def add_joints(self, now_s: float, stamp_s: float, joints_rad: np.ndarray) -> None:
        """Take a joint state: arrival on the steady clock and stamp, s; positions (n,), rad."""
        if not self._joint_stamps.advances(stamp_s):
            self.supervisor.inputs.stuck(now_s, JOINT_STATES)
            return
        jump = self._jump(stamp_s, joints_rad)
        if jump:
            self.predictor.reset()  # the ball did not move with it
            self.supervisor.inputs.bad_input(now_s, JOINT_STATES, jump)
        elif self.supervisor.inputs.add_joint_states(now_s, joints_rad):
            self._stamp_s = stamp_s
            self._joints = self._drive_lag.add(
                stamp_s,
                self.supervisor.velocity_rad_s,
                np.array(joints_rad, dtype=float),
                compare=self.supervisor.inputs.full_speed
                and self.supervisor.last.state is State.SERVOING,
            )
            if self._chain is not None and self._jacobian is not None:
                self._jacobian = self._chain.jacobian(self._joints)
            if self._jacobian is not None:
                self.predictor.add_joints(stamp_s, self._joints, self._jacobian)

    def _jump(self, stamp_s: float, joints_rad: np.ndarray) -> str:
        """Say what is impossible about a joint state after the last one; empty if nothing is."""
        before_s, before = self._last_joints
        self._last_joints = (stamp_s, joints_rad)
        passed_s = stamp_s - before_s
        if before is None or before.shape != joints_rad.shape or not 0.0 < passed_s < _JUMP_S:
            return ""
        moved = joints_rad - before
        joint = jump_of(moved, passed_s)
        if joint is None:
            return ""
        return (
            f"{self.supervisor.config.joint_names[joint]} jumped by {abs(moved[joint]):.2f} rad in "
            f"{passed_s:.3f} s; do two nodes publish joint states?"
        )

    def add_ball(
        self, now_s: float, stamp_s: float, position_m: np.ndarray, frame: str | None = None
    ) -> None:
        """Take a ball position: arrival on the steady clock and exposure stamp, s; (m,), m."""
        if not self._ball_stamps.advances(stamp_s):
            self.supervisor.inputs.stuck(now_s, BALL)
        elif self.supervisor.inputs.add_ball(now_s, position_m, frame):
            self.predictor.add_ball(stamp_s, position_m)

    def add_jacobian(self, now_s: float, jacobian: np.ndarray) -> None:
        """Take the estimated Jacobian, (m, n), m/rad, and its arrival; a chain's goes before it."""
        if self.supervisor.inputs.add_jacobian(now_s, jacobian) and (
            self._chain is None or self._jacobian is None
        ):
            self._jacobian = np.array(jacobian, dtype=float)

    def add_chain(self, now_s: float, chain: SerialChain) -> None:
        """Take the forward model as the camera sees it now, and its arrival."""
        if self.law.reads_chain:
            self._chain, self._chain_s = chain, now_s
            self.supervisor.inputs.add_chain(now_s)

    def bad_chain(self, now_s: float, why: str) -> None:
        """Report that a forward model came that cannot be used, and why."""
        if self.law.reads_chain:
            self._chain, self._chain_s = None, now_s
            self.supervisor.inputs.bad_input(now_s, KINEMATIC_CHAIN, why)

    def add_target(
        self, position_m: np.ndarray, frame: str, stamp_s: float = 0.0
    ) -> tuple[bool, str]:
        """Take a target, (m,), m; one that is updated often moves.

        A stamp (s; 0 for now) says when it was there, on the clock of the joint states. The answer
        is the supervisor's: see :meth:`~fvs_controller_node.goal.Goal.set`.
        """
        own = frame == self.supervisor.config.feature_frame
        if own and self.follower.overtaken(position_m, stamp_s, self._stamp_s):
            return True, "target passed over: a newer one has come"
        moving = self.follower.expects(position_m, stamp_s, self._stamp_s)
        accepted, text = self.supervisor.goal.set(position_m, frame, moving=moving)
        if accepted:
            self._target_updates += 1
            self._target_count += not (moving and self.follower.enabled)
            self.follower.update(position_m, stamp_s, self._stamp_s)
        return accepted, text

    def set_current_as_target(self, now_s: float) -> tuple[bool, str]:
        """Make the ball's present position the target, if it is known now."""
        late = self.supervisor.inputs.late(now_s)
        if late is not None:
            return False, f"target refused: {late}"
        position = self.position_m
        if position is None:
            return False, "target refused: the ball's position is not known yet"
        accepted, text = self.supervisor.goal.set(position, self.supervisor.config.feature_frame)
        if accepted:
            self._target_updates += 1
            self._target_count += 1
            self.follower.stand(position, self._stamp_s)
        return accepted, text

    @property
    def jacobian(self) -> np.ndarray | None:
        """The Jacobian in use, m/rad, shape (m, n), or None; a copy."""
        return None if self._jacobian is None else self._jacobian.copy()

    @property
    def position_m(self) -> np.ndarray | None:
        """The ball's position, predicted to the newest joint state, m, or None."""
        return self.predictor.predict()

    def tick(self, now_s: float, dt_s: float) -> Command:
        """Decide on the command for this tick.

        Parameters
        ----------
        now_s : float
            Steady clock, s.
        dt_s : float
            Time since the last tick, s.
        """
        if now_s - self._chain_s > _CHAIN_MAX_AGE_S:
            self._chain = None  # its publisher is gone, or has another method now
            self.supervisor.inputs.no_chain()
        aim = self.follower.at(self._stamp_s)
        if aim is not self._aim:
            self._aim = aim
            moves = aim is not None and self.supervisor.goal.track(aim.position_m)
            self._target_m_s = aim.velocity_m_s if aim is not None and moves else _STANDING
        self._pending_rad = self._drive_lag.pending_rad()
        if self._home is None:  # what moved before this start says nothing of now
            self.predictor.agreement.restart()
        command = self.supervisor.tick(
            now_s,
            dt_s,
            self._joints,
            self.position_m,
            self._propose,
            pending_rad=self._pending_rad,
            problem=self.predictor.problem,
            verdict=self.predictor.agreement.verdict,
        )
        if command.state is not State.SERVOING:
            self.law.reset()
        if not self.supervisor.started:
            self._home = None
        return command

    def status_values(self, now_s: float) -> dict[str, float | str]:
        """Return the supervisor's key numbers, the images' latency, the law's settling bound."""
        latency_s = self.predictor.latency_s
        error_m = self.supervisor.goal.error_m
        bound_s = None if error_m is None else self.law.settling_bound_s(error_m)
        return {
            **self.supervisor.status_values(now_s),
            "image_latency_s": float("nan") if latency_s is None else latency_s,
            "position_noise_m": self.predictor.tracker.noise_m,
            "position_deviation_m": self.predictor.tracker.deviation_m,
            "drive_lag_s": self._drive_lag.lag_s,
            "settling_bound_without_limits_s": float("nan") if bound_s is None else bound_s,
        }

    def _propose(self, error_m: np.ndarray, applied: np.ndarray, dt_s: float) -> ControlOutput:
        assert self._jacobian is not None
        assert self._joints is not None
        if self._home is None:
            self._home = self._joints
        target_m_s, feed_forward = self._target_m_s, NO_FEED_FORWARD
        if target_m_s.any():
            feed_forward = self.follower.feed_forward(
                target_m_s, self._jacobian, self._joints, self._home
            )
        state = ControlInput(
            error_m,
            self._jacobian,
            applied - feed_forward,
            self._joints,
            dt_s,
            chain=self._chain,
            home_rad=self._home,
            measurement_count=self.predictor.images + self._target_updates,
            target_count=self._target_count,
            feed_forward_rad_s=feed_forward,
        )
        state = self.anticipation.shift(
            state, self._pending_rad, self._drive_lag.lag_s * target_m_s
        )
        output = self.law.command(state)
        if not self.law.brakes:
            output = self.anticipation.brake(output, state)
        return output._replace(velocity_rad_s=output.velocity_rad_s + feed_forward)
