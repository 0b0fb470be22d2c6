"""Lag of the drives, and the largest speed from which the arm can still brake despite it.

A drive with lag T trails the commanded path by T times the velocity:
``r_commanded - r = T u + constant``. T is fitted to both sides after high-pass filtering. It may be
dead time, first-order lag or the age of the joint states.

The lag predicts the joints before they are measured, except for that constant. The constant is
averaged at rest, which keeps encoder noise out of the motion. A law that ignores the pending motion
(commanded, not yet executed) brakes too late. With the pending motion added, braking can be planned
close to the acceleration limit.
"""

from __future__ import annotations

import numpy as np

from fvs_controller_node.base import ControlInput, ControlOutput
from fvs_ros.following import LONGEST_LAG_S
from fvs_ros.limits import BRAKING_SHARE, JointLimits, braking_speed
from fvs_ros.timeline import History
from fvs_ros.vectors import largest

#: Time constant of the high-pass filter: slower differences are no lag, s.
_SLOW_S = 1.0
#: First guess, s; its weight, and largest weight of all data: integrals of squared speed, rad^2/s.
_FIRST_S, _FIRST, _MEMORY = 0.03, 0.05, 20.0
#: The true lag over the learned one, at most. With drives of 0.84 of the commanded speed it was
#: 1.3, and an arm that follows was held.
_DOUBT = 1.5
#: Averaging time of the constant at rest, s, and the speed that ends averaging, rad/s: above it a
#: wrong lag would do more harm than encoder noise.
_AVERAGED_S, _MOVING_RAD_S = 0.16, 0.02


class DriveLag:
    """Estimates the lag of the drives, ``lag_s``, from commands and joint positions.

    ``pending_rad`` is the motion that was commanded and is still to come, rad, (n,) or (1,).
    """

    def __init__(self) -> None:
        self.lag_s, self._known = _FIRST_S, _FIRST  # before anything has moved
        self._guessed = 1.0  # share of the first guess in the lag
        self._commanded = History()  # the path as commanded
        self._constant: np.ndarray | None = None
        self._joints: np.ndarray | float = 0.0
        self._behind: np.ndarray | float = 0.0  # how far the joints trail, but for the slow part
        self._slow_command: np.ndarray | float = 0.0
        self.pending_rad = np.zeros(1)

    @property
    def most_s(self) -> float:
        """The largest lag that the drives may have, s: of all drives, while none is known."""
        return self.lag_s * _DOUBT + self._guessed * (LONGEST_LAG_S - _FIRST_S * _DOUBT)

    def add(
        self,
        stamp_s: float,
        command_rad_s: np.ndarray,
        joints_rad: np.ndarray,
        compare: bool = True,
    ) -> np.ndarray:
        """Take a joint state, (n,), and the command in force since the previous one, (n,).

        Its stamp is used, because jitter of arrival times would look like a lag. An arm that does
        not obey (speed slider down, moved by hand) would too: then pass ``compare=False``.
        Returns the joints, (n,), rad, with less noise where the arm obeys.
        """
        before_s, commanded = self._commanded.newest_stamp_s, self._commanded.newest
        moved, self._joints = joints_rad - self._joints, joints_rad
        if before_s is None or commanded is None:
            self._commanded.add(stamp_s, np.zeros(joints_rad.size))
            return joints_rad
        dt_s = stamp_s - before_s
        commanded = commanded + dt_s * command_rad_s
        went_on = self._commanded.add(stamp_s, commanded)
        compare = compare and went_on and dt_s > 0.0
        if compare:
            self._learn(command_rad_s, moved, dt_s)
        done = self._commanded.at(stamp_s - self.lag_s)
        self.pending_rad = np.zeros(joints_rad.size) if done is None else commanded - done
        before = self._commanded.at(stamp_s - self.lag_s - dt_s) if compare else None
        if not compare:
            self._constant = None
        if done is None or before is None:
            return joints_rad
        constant = joints_rad - done
        if self._constant is None:
            self._constant = constant
        # The squared speed of the command, or of its effect on the joints now if that is faster.
        effect = (done - before) / dt_s
        speed_2 = np.maximum(command_rad_s * command_rad_s, effect * effect)
        least = min(dt_s / _AVERAGED_S, 1.0)
        share = np.maximum(least, speed_2 / (speed_2 + _MOVING_RAD_S**2))
        self._constant = self._constant + share * (constant - self._constant)
        return done + self._constant

    def _learn(self, command_rad_s: np.ndarray, moved_rad: np.ndarray, dt_s: float) -> None:
        share = dt_s / (_SLOW_S + dt_s)
        self._behind = behind = (1.0 - share) * (self._behind + command_rad_s * dt_s - moved_rad)
        self._slow_command = self._slow_command + share * (command_rad_s - self._slow_command)
        command = command_rad_s - self._slow_command
        power = float(command.dot(command)) * dt_s
        # Bounds the effect of a stall, however long: no drive lags by more.
        late = min(max(float(behind.dot(command)) * dt_s, 0.0), LONGEST_LAG_S * power)
        self._known = min(self._known + power, _MEMORY)
        self.lag_s += (late - power * self.lag_s) / self._known
        self._guessed *= 1.0 - power / self._known


def brake(output: ControlOutput, present: ControlInput, limits: JointLimits) -> ControlOutput:
    """Limit the output to a speed from which the arm can brake at the target."""
    velocity, error_m = output.velocity_rad_s, present.error_m
    closing = -float(error_m.dot(present.jacobian.dot(velocity)))
    if closing <= 0.0:
        return output
    fastest = largest(velocity / limits.share)
    # At this velocity the error is gone after this time.
    to_go_s = float(error_m.dot(error_m)) / closing
    acceleration = BRAKING_SHARE * limits.max_joint_acceleration_rad_s2
    jerk = limits.max_joint_jerk_rad_s3
    limit = braking_speed(fastest * to_go_s, acceleration, present.dt_s, jerk)
    if limit >= fastest:
        return output
    return output._replace(velocity_rad_s=(limit / fastest) * velocity)
