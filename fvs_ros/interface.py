"""What a robot's driver takes: joint velocities, or positions that follow them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fvs_ros.limits import JointLimits
from fvs_ros.params import Parameters, parameter

VELOCITY, POSITION = "velocity", "position"
#: A position command is ahead of its joint by at most the way at full speed in this time, s: longer
#: than any drive lags.
_LEAD_S = 0.2


@dataclass(frozen=True)
class CommandInterface(Parameters):
    """What the robot's driver takes."""

    command_interface: str = parameter(
        VELOCITY,
        "What the driver takes: velocity on forward_velocity_controller/commands, or position on "
        "forward_position_controller/commands.",
        choices=(VELOCITY, POSITION),
    )
    joint_state_rate_hz: float = parameter(
        0.0,
        "Rate of the joint states, Hz: no tick counts for more than its period. 0: learned from "
        "their stamps.",
        0.0,
        1000.0,
    )


class Backlash:
    """The joints behind motors with play: they move once it is used up."""

    def __init__(self) -> None:
        self._joints: np.ndarray | None = None

    def joints(self, motors_rad: np.ndarray, play_rad: np.ndarray | float) -> np.ndarray:
        """Joint positions, (n,), from those of the motors now; at first, play is half used up."""
        half, before = 0.5 * play_rad, motors_rad if self._joints is None else self._joints
        self._joints = np.clip(before, motors_rad - half, motors_rad + half)
        return self._joints


class PositionPath:
    """Joint positions that follow velocity commands, near the joints and within their range."""

    def __init__(self) -> None:
        self._position: np.ndarray | None = None

    def follow(
        self,
        velocity: np.ndarray,
        joints_rad: np.ndarray | None,
        dt_s: float,
        limits: JointLimits,
        active: bool,
    ) -> np.ndarray | None:
        """Positions to send, rad, (n,), for joint velocities, (n,); None if there are none.

        They begin at the measured joints, rad, (n,), in an active session, with its first motion:
        before, the joints may not be where they were last measured.
        """
        moving = bool(velocity.any())
        if not (active or moving):
            self._position = None
        if joints_rad is None or not (moving or self._position is not None):
            return None
        return self.advance(velocity, joints_rad, dt_s, limits)

    def advance(
        self, velocity: np.ndarray, joints_rad: np.ndarray, dt_s: float, limits: JointLimits
    ) -> np.ndarray:
        """Positions, rad, (n,), to be reached next: the last ones, and a velocity for a tick."""
        start = joints_rad if self._position is None else self._position
        fast = limits.max_joint_velocity_rad_s * limits.share
        lead, step = _LEAD_S * fast, dt_s * fast
        # A drive goes on to its last position, even if the joint is stuck now: no further than the
        # range, or than the joint, where that is beyond.
        low = np.maximum(joints_rad - lead, np.minimum(joints_rad, limits.lower_rad))
        high = np.minimum(joints_rad + lead, np.maximum(joints_rad, limits.upper_rad))
        wanted = np.clip(start + dt_s * velocity, low, high)
        # Back to within them, too, in steps that a driver takes.
        self._position = np.clip(wanted, start - step, start + step)
        return self._position
