"""The whole controller without ROS: tracker, law and supervisor in one object.

The node passes messages in and sends the result of ``tick``; the laboratory uses the same object.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from typing import Any

import numpy as np

from fvs_controller_node.base import Change, ControlInput, ControlLaw, ControlOutput
from fvs_controller_node.config import ControllerConfig, SupervisorConfig, default_values, make_law
from fvs_controller_node.drive_lag import DriveLag, brake
from fvs_controller_node.inbox import BALL, JACOBIAN, JOINT_STATES, KINEMATIC_CHAIN
from fvs_controller_node.prediction import FeaturePredictor
from fvs_controller_node.reasons import State
from fvs_controller_node.redundancy import make_inverse
from fvs_controller_node.supervisor import Command, Present, Supervisor
from fvs_controller_node.target_motion import on_own_clock
from fvs_ros.chain import SerialChain
from fvs_ros.following import LONGEST_LAG_S, Following
from fvs_ros.interface import POSITION
from fvs_ros.timeline import repeats

#: The estimator publishes the chain more often than this; an older one is not used, and a bad one
#: holds the arm for as long, s.
_CHAIN_MAX_AGE_S = 1.5


class ServoLoop:
    """One pass per tick: joints, ball and Jacobian in; one command out.

    Parameters
    ----------
    values : mapping, optional
        The node's parameters by name, all of them; the defaults if not given.

    Raises
    ------
    ValueError
        If values do not fit together; the text says which.

    Attributes
    ----------
    law : ControlLaw
        The control law.
    predictor : FeaturePredictor
        Predicts the ball to now.
    supervisor : Supervisor
        The one exit.
    """

    law: ControlLaw

    def __init__(self, values: Mapping[str, Any] | None = None) -> None:
        values = default_values() if values is None else values
        self.supervisor = Supervisor(SupervisorConfig.from_values(values))
        self._feature = self.supervisor.config.servoed
        self.predictor = FeaturePredictor(self._feature)
        self._drive_lag, self._following = DriveLag(), Following()
        self.configure(values)
        self._pending_rad = self._drive_lag.pending_rad()
        self._chain: SerialChain | None = None
        self._chain_s = -inf
        self._stamp_s = 0.0
        self._change = Change.TARGET  # since the last call of the law
        self._images = 0  # number of images at that call
        #: The law's sliding variable, (d,), at the first tick after an image; else None.
        self.sliding_variable: np.ndarray | None = None
        self._ball_stamp_s: float | None = None
        self._seen = np.zeros(self._feature.size)  # in the newest image
        self._joints: np.ndarray | None = None
        self._jacobian: np.ndarray | None = None
        self._home: np.ndarray | None = None  # joints at the last start

    def configure(self, values: Mapping[str, Any]) -> None:
        """Take over changed values while running; nothing changes if one is refused."""
        law = make_law(values)
        follower = make_inverse(values, least_speed=law.plans)
        own = ControllerConfig.from_values(values)
        self.supervisor.configure(SupervisorConfig.from_values(values))
        self.law, self._follower, self._follows = law, follower, own.target_feed_forward
        # What is learned is the lag of velocities; a position drive may take longer.
        self._least_lag_s = LONGEST_LAG_S if own.command_interface == POSITION else 0.0
        self._following.restart()  # a range may count for another length now

    # ---- inputs: arrival times on the steady clock --------------------------------------------

    def add_joints(self, now_s: float, stamp_s: float, joints_rad: np.ndarray) -> None:
        """Take a joint state: arrival and stamp, s; positions (n,), rad."""
        inputs = self.supervisor.inputs
        if self._joints is not None and repeats(stamp_s, self._stamp_s):
            inputs[JOINT_STATES].stuck(now_s)
            return
        if inputs.add(JOINT_STATES, now_s, joints_rad):
            velocity, joints = self.supervisor.velocity_rad_s, np.array(joints_rad, dtype=float)
            servoing = self.supervisor.last.state is State.SERVOING
            if servoing:
                unit = self.supervisor.config.unit
                most_s = max(self._drive_lag.most_s, self._least_lag_s)
                scaled = inputs.speed_scaling * velocity / unit
                self._following.add(now_s, stamp_s, scaled, joints / unit, most_s)
            else:
                self._following.restart()
            self._stamp_s = stamp_s
            compare = servoing and inputs.full_speed
            self._joints = self._drive_lag.add(stamp_s, velocity, joints, compare)
            self._predict(stamp_s, self._joints)

    def _predict(self, stamp_s: float, joints: np.ndarray) -> None:
        """Move the predicted feature along to a joint state, s and rad, (n,)."""
        feature = self._feature
        if self._chain is not None:
            at, motion = self._chain.position_and_jacobian(joints)
            self._jacobian = feature.to_task(at, motion)
        elif self._jacobian is not None:
            now = self.position_m if feature.curved else None
            motion = feature.from_task(self._seen if now is None else now, self._jacobian)
        else:
            return
        self.predictor.add_joints(stamp_s, joints, motion)

    def bad_joints(self, why: str) -> None:
        """Take a joint state that cannot be used, and why."""
        self.predictor.reset()  # after a jump: the ball did not move with it
        self.supervisor.inputs[JOINT_STATES].bad(why)

    def add_feature(self, now_s: float, stamp_s: float, position_m: np.ndarray) -> None:
        """Take a ball position in the feature's frame: arrival and exposure, s; (m,), m."""
        if repeats(stamp_s, self._ball_stamp_s):
            self.supervisor.inputs[BALL].stuck(now_s)
            return
        self._ball_stamp_s = stamp_s
        if self.supervisor.inputs.add(BALL, now_s, position_m):
            self._seen = position_m
            self.predictor.add_feature(stamp_s, position_m)

    def add_jacobian(self, now_s: float, jacobian: np.ndarray) -> None:
        """Take the task's Jacobian, (d, n), m/rad, and its arrival; a chain's takes priority."""
        if self.supervisor.inputs.add(JACOBIAN, now_s, jacobian) and self._chain is None:
            self._jacobian = np.array(jacobian, dtype=float)

    def add_chain(self, now_s: float, chain: SerialChain) -> None:
        """Take the forward model as the camera sees it now, and its arrival."""
        self._chain, self._chain_s = chain, now_s
        self.supervisor.inputs[KINEMATIC_CHAIN].good(now_s)

    def bad_chain(self, now_s: float, why: str) -> None:
        """Take the arrival of a forward model that cannot be used, and why."""
        self._chain, self._chain_s = None, now_s
        self.supervisor.inputs[KINEMATIC_CHAIN].bad(why)

    # ---- the target ---------------------------------------------------------------------------

    def add_target(
        self, position_m: np.ndarray, frame: str, stamp_s: float = 0.0
    ) -> tuple[bool, str]:
        """Take a target, (m,), m; one that is updated often moves.

        A stamp (s; 0 for now) says when it was there, on the clock of the joint states. The answer
        is the supervisor's: see :meth:`~fvs_controller_node.goal.Goal.set`.
        """
        there_s = on_own_clock(stamp_s, self._stamp_s)
        return self._set_target(position_m, frame, there_s, self._stamp_s - there_s)

    def set_current_as_target(self, now_s: float) -> tuple[bool, str]:
        """Make the ball's present position the target, if it is known now."""
        late = self.supervisor.inputs.late(now_s)
        if late:
            return False, f"target refused: {late}"
        position = self.position_m
        if position is None:
            return False, f"target refused: the {self._feature.what}'s position is not known yet"
        return self._set_target(position, self.supervisor.config.feature_frame)

    def _set_target(self, *target: Any) -> tuple[bool, str]:
        goal = self.supervisor.goal
        accepted, text = goal.set(*target)
        if accepted:
            self._note(Change.MEASUREMENT if goal.moving and self._follows else Change.TARGET)
        return accepted, text

    def _note(self, change: Change) -> None:
        if self._change is not Change.TARGET:
            self._change = change

    # ---- the tick -----------------------------------------------------------------------------

    @property
    def jacobian(self) -> np.ndarray | None:
        """The task's Jacobian in use, m/rad, shape (d, n), or None; a copy."""
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
            What the tick counts for, s: the time until the next one.
        """
        supervisor = self.supervisor
        if now_s - self._chain_s > _CHAIN_MAX_AGE_S:
            self._chain = None  # its publisher is gone, or has another method now
            supervisor.inputs[KINEMATIC_CHAIN].forget()
        if self._follows:
            supervisor.goal.track(self._stamp_s)
        self._pending_rad = self._drive_lag.pending_rad()
        if self._home is None:  # motion before this start must not count
            self.predictor.agreement.restart()
        present = Present(
            self._joints,
            self.position_m,
            self._jacobian,
            self._pending_rad,
            self.predictor.problem,
            self.predictor.agreement.verdict,
            self._following.fault,
        )
        images = self._images
        command = supervisor.tick(now_s, dt_s, present, self._propose)
        output = command.output if self._images != images else None
        self.sliding_variable = output.sliding_variable if output is not None else None
        if command.state is not State.SERVOING:
            self.law.reset()
        if not supervisor.started:
            self._home = None
        return command

    def _propose(self, error_m: np.ndarray, applied: np.ndarray, dt_s: float) -> ControlOutput:
        """Ask the law, with arm and target predicted to when its command takes effect."""
        jacobian, joints = self._jacobian, self._joints
        goal = self.supervisor.goal
        velocity_m_s = goal.velocity_m_s if self._follows else None
        assert jacobian is not None
        assert joints is not None
        if self._home is None:
            self._home = joints
        error_m = error_m + jacobian @ self._pending_rad
        feed_forward = None
        if velocity_m_s is not None and velocity_m_s.any():
            assert goal.target_m is not None
            velocity_m_s = self._feature.to_task(goal.target_m, velocity_m_s)
            error_m = error_m - self._drive_lag.lag_s * velocity_m_s
            feed_forward = self._follower.joint_velocity(jacobian, velocity_m_s, joints, self._home)
            applied = applied - feed_forward
        if self.predictor.images != self._images:
            self._note(Change.MEASUREMENT)
        one = ControlInput(
            error_m,
            jacobian,
            applied,
            joints + self._pending_rad,
            dt_s,
            self._home,
            self._chain,
            self._change,
            feed_forward,
            self._feature,
        )
        self._change, self._images = Change.NOTHING, self.predictor.images
        output = self.law.command(one)
        if not self.law.plans:
            output = brake(output, one, self.supervisor.config)
        if feed_forward is not None:
            output = output._replace(velocity_rad_s=output.velocity_rad_s + feed_forward)
        return output

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
            "kinematic_chain_age_s": inf if self._chain is None else now_s - self._chain_s,
            "settling_bound_without_limits_s": float("nan") if bound_s is None else bound_s,
        }
