"""Limits on a joint velocity command of n numbers, rad/s."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from operator import lt

import numpy as np

from fvs_ros.joints import UR_POSITION_LIMITS_RAD, ArmJoints
from fvs_ros.params import ParameterError, live_parameter
from fvs_ros.vectors import largest

#: A tick counts for at most this long, s: a late one must not make a big step.
MAX_TICK_S = 0.05
#: Shares of the acceleration limit that braking is planned with: for a target, and for the end of
#: a joint's range. With 0.9 a joint passed its end by up to 90 mrad (3 rad/s, a lag of 90 ms) while
#: the drives' lag was not known yet; with 0.6 by 0.2 mrad.
BRAKING_SHARE, _RANGE_SHARE = 0.9, 0.6


def limit_speed(velocity: np.ndarray, max_speed: float) -> np.ndarray:
    """Scale the command as a whole so that no joint is faster than ``max_speed``."""
    fastest = largest(velocity)
    if fastest <= max_speed:
        return velocity
    # The product of the two can pass the limit by the last bit.
    return np.clip(velocity * (max_speed / fastest), -max_speed, max_speed)


def braking_speed(travel_rad: float, acceleration: float, dt_s: float) -> float:
    """Find the speed from which, from the next tick on, one can brake in a travel, rad/s."""
    step = acceleration * dt_s
    return float((step * step + 2.0 * acceleration * travel_rad) ** 0.5 - step)


def limit_acceleration(velocity: np.ndarray, last: np.ndarray, max_step: float) -> np.ndarray:
    """Find the command nearest to ``velocity`` whose step from ``last`` is at most ``max_step``.

    If a shorter command in the same direction is within reach, the longest such one; otherwise
    each joint changes as far as allowed.

    Parameters
    ----------
    velocity, last : ndarray, shape (n,)
        Wanted command and the one before, rad/s.
    max_step : float
        Largest change of any joint, rad/s.

    Returns
    -------
    ndarray, shape (n,)
        Never further than ``max_step`` from ``last`` in any joint.
    """
    if largest(velocity - last) <= max_step:
        return velocity
    low, high = last - max_step, last + max_step
    scale, lowest = 1.0, 0.0
    for v, lo, hi in zip(velocity.tolist(), low.tolist(), high.tolist(), strict=True):
        if v > 0.0:
            scale, lowest = min(scale, hi / v), max(lowest, lo / v)
        elif v < 0.0:
            scale, lowest = min(scale, lo / v), max(lowest, hi / v)
        elif not lo <= 0.0 <= hi:
            lowest = np.inf
    wanted = velocity * scale if lowest <= scale else velocity
    return np.minimum(np.maximum(wanted, low), high)


def ramp_to_zero(last: np.ndarray, max_step: float) -> np.ndarray:
    """Take one step to rest: the last command, its fastest joint slower by ``max_step``."""
    fastest = largest(last)
    if fastest <= max_step:
        return np.zeros_like(last)
    return last * (1.0 - max_step / fastest)


@dataclass(frozen=True)
class JointLimits(ArmJoints):
    """Limits of the arm's joints: of position, one of each joint, and of every joint's command.

    A joint moves towards an end of its range at most at the velocity limit times its share of the
    margin, and never faster than it can brake (``braking_speed``); away from the end it is free.
    Each joint is slowed alone, so the others continue and the arm slides along the limit.
    """

    max_joint_velocity_rad_s: float = live_parameter(
        1.0, "Velocity limit of every joint, rad/s; the whole command is scaled.", 0.01, pi
    )
    max_joint_acceleration_rad_s2: float = live_parameter(
        6.0, "Acceleration limit of every joint's command, rad/s^2.", 0.05, 40.0
    )
    joint_min_rad: tuple[float, ...] = live_parameter(
        tuple(-limit for limit in UR_POSITION_LIMITS_RAD),
        "Lower ends of the joints' ranges, rad, in the order of joint_names.",
        -4.0 * pi,
        4.0 * pi,
    )
    joint_max_rad: tuple[float, ...] = live_parameter(
        UR_POSITION_LIMITS_RAD,
        "Upper ends of the joints' ranges, rad, in the order of joint_names.",
        -4.0 * pi,
        4.0 * pi,
    )
    joint_limit_margin_rad: float = live_parameter(
        0.2,
        "Distance from the end of its range at which a joint begins to slow down, rad; a data set "
        "is collected outside of it.",
        0.01,
        2.0,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        lower, upper, joints = self.joint_min_rad, self.joint_max_rad, len(self.joint_names)
        if not len(lower) == len(upper) == joints or not all(map(lt, lower, upper)):
            raise ParameterError(
                f"joint_min_rad and joint_max_rad need {joints} numbers, one for each of "
                f"joint_names, each minimum below its maximum; got {list(lower)} and {list(upper)}"
            )

    def near_end(self, joints_rad: np.ndarray) -> bool:
        """Whether a joint, (n,), rad, is within the margin of an end of its range, or beyond."""
        margin = self.joint_limit_margin_rad
        ranges = zip(joints_rad.tolist(), self.joint_min_rad, self.joint_max_rad, strict=True)
        return any(not low + margin <= joint <= high - margin for joint, low, high in ranges)

    def slow_down(
        self,
        velocity: np.ndarray,
        joints: np.ndarray,
        max_acceleration: float,
        dt_s: float,
        pending_rad: np.ndarray,
    ) -> tuple[np.ndarray, list[int]]:
        """Slow down every joint that nears an end of its range.

        Pending motion, ``pending_rad``, reduces the room if it goes towards the end; it adds none
        if it goes away.

        Returns
        -------
        ndarray, shape (n,)
            The command, rad/s.
        list of int
            The joints that were slowed.
        """
        slowed: list[int] = []
        values = velocity.tolist()
        acceleration = _RANGE_SHARE * max_acceleration
        # With the robot's lag of 35 ms a faster approach than 5 times the distance would pass it.
        slope = min(self.max_joint_velocity_rad_s / self.joint_limit_margin_rad, 5.0)
        both = zip(values, joints.tolist(), pending_rad.tolist(), strict=True)
        for i, (v, q, ahead) in enumerate(both):
            room = self.joint_max_rad[i] - q if v > 0.0 else q - self.joint_min_rad[i]
            room = max(0.0, room - max(0.0, ahead if v > 0.0 else -ahead))
            cap = min(slope * room, braking_speed(room, acceleration, dt_s))
            if abs(v) > cap:
                values[i] = cap if v > 0.0 else -cap
                slowed.append(i)
        return (np.array(values), slowed) if slowed else (velocity, slowed)

    def brake_to_rest(
        self,
        last: np.ndarray,
        joints: np.ndarray | None,
        dt_s: float,
        pending_rad: np.ndarray,
    ) -> np.ndarray:
        """Find the next command, (n,), rad/s, on the way to rest from the last one."""
        # From full speed it stops within 0.5 s, however small the acceleration limit is.
        acceleration = max(self.max_joint_acceleration_rad_s2, self.max_joint_velocity_rad_s / 0.5)
        step = acceleration * dt_s
        velocity = ramp_to_zero(last, step)
        if joints is None:
            return velocity
        # The ramp is as long as the fastest joint's; one that nears its limit brakes harder.
        velocity, _ = self.slow_down(velocity, joints, acceleration, dt_s, pending_rad)
        return np.clip(velocity, last - step, last + step)
