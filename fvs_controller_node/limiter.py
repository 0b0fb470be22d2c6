"""From what a law wants to what is sent: limits of speed, acceleration and range."""

from __future__ import annotations

import numpy as np

from fvs_controller_node.config import SupervisorConfig
from fvs_ros.limits import limit_acceleration, limit_speed, ramp_to_zero


class Limiter:
    """Remembers the last command and finds the next one within the limits."""

    def __init__(self, joints: int) -> None:
        self.velocity_rad_s = np.zeros(joints)  #: the last command, (n,)

    def stop(self) -> None:
        """Zeros at once."""
        self.velocity_rad_s = np.zeros_like(self.velocity_rad_s)

    def move(
        self,
        wanted_rad_s: np.ndarray,
        joints_rad: np.ndarray,
        dt_s: float,
        config: SupervisorConfig,
        max_speed_rad_s: float,
        pending_rad: np.ndarray,
    ) -> list[str]:
        """Find the next command towards the wanted one, (n,); returns the limits that shaped it.

        No joint is faster than ``max_speed_rad_s``. ``pending_rad``, (n,), is motion that was
        commanded and is still to come.
        """
        acceleration = config.speed.max_joint_acceleration_rad_s2
        active = []
        velocity = limit_speed(wanted_rad_s, max_speed_rad_s)
        if velocity is not wanted_rad_s:
            active.append("velocity")
        velocity, slowed = config.joint_range.slow_down(
            velocity,
            joints_rad,
            config.speed.max_joint_velocity_rad_s,
            acceleration,
            pending_rad,
        )
        active += [f"range of {config.joint_names[i]}" for i in slowed]
        free = velocity
        velocity = limit_acceleration(velocity, self.velocity_rad_s, acceleration * dt_s)
        if velocity is not free:
            active.append("acceleration")
        self.velocity_rad_s = velocity
        return active

    def come_to_rest(
        self,
        joints_rad: np.ndarray | None,
        dt_s: float,
        config: SupervisorConfig,
        pending_rad: np.ndarray,
    ) -> bool:
        """Find the next command on the way to rest; whether the arm still moved."""
        last, speed = self.velocity_rad_s, config.speed
        if not last.any():
            return False
        # From full speed it stops within 0.5 s, however small the acceleration limit is.
        limit = max(speed.max_joint_acceleration_rad_s2, speed.max_joint_velocity_rad_s / 0.5)
        step = limit * dt_s
        velocity = ramp_to_zero(last, step)
        if joints_rad is not None:
            # The ramp is as long as the fastest joint's; one that nears its limit brakes harder.
            velocity, _ = config.joint_range.slow_down(
                velocity, joints_rad, speed.max_joint_velocity_rad_s, limit, pending_rad
            )
            velocity = np.clip(velocity, last - step, last + step)
        self.velocity_rad_s = velocity
        return True
