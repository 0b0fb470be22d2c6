"""Minimum-time law: the joints move along the least largest travel at the limits of speed.

Joints that are limited one by one are at their goal soonest where the longest travel is shortest.
So the law first looks for the joint goal ``q``: of all joints that put the ball on the target, the
one with the least largest travel from here. With a forward model of the chain that is a short
sequence of least distance problems (:mod:`fvs_controller_node.redundancy`), each about the goal
before, drawn a little to the joints that the arm was started at, and the image's offset from the
model is kept; without one the Jacobian here has to do. A moving target takes the goal along.
Then all joints go there in proportion. With D the travel left, the speed of the one with the
longest way is the largest v that lets it brake at the acceleration limit a from the next tick on,

    v = min(limit, rate D, sqrt((a dt)^2 + 2 a D) - a dt),

which is reached from any side without overshoot, and ends in finite time except for the last
fraction of a milliradian, where the rate keeps noise from becoming motion. The way left is that
from where the drives will be (:mod:`fvs_controller_node.drive_lag`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fvs_controller_node.base import Change, ControlInput, ControlLaw, ControlOutput
from fvs_controller_node.redundancy import LeastSpeedInverse
from fvs_ros.limits import BRAKING_SHARE, JointLimits, braking_speed
from fvs_ros.params import live_parameter
from fvs_ros.vectors import largest

#: The goal is searched again, with all steps, if it misses the target by more than this, m.
_JUMP_M = 0.02
#: Stages of a way that is too long for the steps, of at most 12 degrees.
_STAGES = 16


@dataclass(frozen=True)
class MinimumTimeGains(JointLimits):
    """Limits of the joints and the law's one gain."""

    minimum_time_rate_1_s: float = live_parameter(
        25.0,
        "Speed over travel of the law minimum_time close to the goal, 1/s: larger is faster and "
        "amplifies noise.",
        1.0,
        100.0,
    )


class MinimumTimeLaw(ControlLaw):
    """Least largest joint travel at the limits."""

    plans = True
    Gains = MinimumTimeGains
    gains: MinimumTimeGains
    inverse: LeastSpeedInverse
    _goal: np.ndarray | None = None

    def reset(self) -> None:
        """Forget the goal."""
        self._goal = None

    def command(self, state: ControlInput) -> ControlOutput:
        """Return the joint velocities for this tick, before any limit."""
        if self._goal is not None and state.feed_forward_rad_s is not None:
            self._goal = self._goal + state.dt_s * state.feed_forward_rad_s
        if self._goal is None or state.change is not Change.NOTHING or state.chain is None:
            self._goal = self._find_goal(state)
        left, gains = self._goal - state.joints_rad, self.gains
        travel = largest(left / gains.share)
        velocity = np.zeros(left.size)
        if travel > 0.0:
            acceleration = BRAKING_SHARE * gains.max_joint_acceleration_rad_s2
            braking = braking_speed(travel, acceleration, state.dt_s, gains.max_joint_jerk_rad_s3)
            near = gains.minimum_time_rate_1_s * travel
            velocity = left * (min(gains.max_joint_velocity_rad_s, near, braking) / travel)
        return ControlOutput.plain(velocity, state.error_m.size)

    def _find_goal(self, state: ControlInput) -> np.ndarray:
        """Joints with the ball on the target and the least largest travel, rad, shape (n,)."""
        joints, chain = state.joints_rad, state.chain
        if chain is None:
            wanted, home = -state.error_m, state.home_rad
            return joints + self.inverse.joint_velocity(state.jacobian, wanted, joints, home)
        kind, here, error_m = state.kind, chain.position(joints), state.error_m
        wanted = kind.retract(here, -error_m)
        first = self._goal is None or state.change is Change.TARGET
        goal = joints if self._goal is None else self._goal
        new = first or largest(_missing(state, goal, wanted)[0]) > _JUMP_M
        # After a new target the steps draw the goal toward the start posture. After each further
        # image one step stays near the last goal: repeated linear programmes would alternate
        # between two corners.
        goal = self._goal_from(goal, state, [wanted] * (4 if new else 1), new)
        if first and largest(_missing(state, goal, wanted)[0]) > _JUMP_M:
            # Large rotations lead elsewhere at once, but not in stages.
            shares = np.linspace(0.0, 1.0, _STAGES)
            stages = [kind.retract(here, -share * error_m) for share in shares]
            goal = self._goal_from(joints, state, [*stages, wanted, wanted], new)
        return goal

    def _goal_from(
        self, goal: np.ndarray, state: ControlInput, path: list[np.ndarray], homing: bool
    ) -> np.ndarray:
        """Joints at the end of a path of features, (m,), a step to each from the goal before."""
        joints = state.joints_rad
        for wanted in path:
            missing, jacobian = _missing(state, goal, wanted)
            travel = goal - joints
            missing, home = missing + jacobian @ travel, state.home_rad
            near = None if homing and home is not None else travel
            velocity = self.inverse.joint_velocity(jacobian, missing, joints, home, near)
            goal = np.clip(joints + velocity, self.gains.lower_rad, self.gains.upper_rad)
        return goal


def _missing(
    state: ControlInput, goal_rad: np.ndarray, wanted: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What a goal misses of the wanted feature, m, (d,), and the Jacobian there, (d, n)."""
    assert state.chain is not None
    kind = state.kind
    z, jacobian = kind.along(state.chain, goal_rad)
    return -kind.error(z, wanted), kind.of_task(z, jacobian)
