"""Limits on a joint velocity command of n numbers, rad/s.

A joint's *share* is its velocity limit over the arm's, at most 1 and at most half its range (rad
or m): a slide of 0.2 m moves at a tenth of the arm's speed. Its acceleration limit and its margin
are the same share of the arm's. So the largest ``|v_i| / share_i`` is what is limited. For a
prismatic joint read m for rad.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import isfinite, pi
from operator import lt
from typing import Any

import numpy as np

from fvs_ros.clock import MAX_PERIOD_S
from fvs_ros.joints import UR_JOINT_NAMES, UR_POSITION_LIMITS_RAD, ArmJoints
from fvs_ros.params import ParameterError, live_parameter
from fvs_ros.urdf import UrdfJoint
from fvs_ros.vectors import LARGEST, largest

#: Shortest time in which an acceleration is known, s.
_LEAST_TICK_S = 1e-6
#: What is sent stays below each limit by this share. A driver may compute in single precision:
#: at 1 kHz and 2.6 rad/s it then rounds an acceleration by 2e-4 rad/s^2, a jerk by 0.5 rad/s^3.
BELOW = 1.0 - 1e-4
#: Share of the acceleration limit that braking for a target is planned with.
BRAKING_SHARE = 0.9


def tick_s(dt_s: float) -> float:
    """What a tick counts for, s: none if no clock could give it, at most ``MAX_PERIOD_S``."""
    return min(dt_s, MAX_PERIOD_S) if isfinite(dt_s) and dt_s > _LEAST_TICK_S else 0.0


def limit_speed(
    velocity: np.ndarray, max_speed: float, share: np.ndarray | float = 1.0
) -> np.ndarray:
    """Scale the command as a whole so that each joint stays below its share of ``max_speed``."""
    most, fastest = BELOW * max_speed, largest(velocity / share)
    return velocity if fastest <= most else velocity * (most / fastest)


def braking_speed(travel_rad: float, acceleration: float, dt_s: float, jerk: float = 0.0) -> float:
    """Find the speed from which, from the next tick on, one can brake in a travel, rad/s.

    With a jerk limit, rad/s^3, deceleration grows from zero and falls to zero at the end.
    """
    step = acceleration * dt_s
    speed = float((step * step + 2.0 * acceleration * travel_rad) ** 0.5 - step)
    if jerk <= 0.0:
        return speed
    rest = max(0.0, travel_rad - speed * dt_s)
    build_up = acceleration * acceleration / jerk  # the speed that is lost meanwhile
    if rest < build_up * acceleration / jerk:
        return (rest * rest * jerk) ** (1.0 / 3.0)
    return (0.25 * build_up * build_up + 2.0 * acceleration * rest) ** 0.5 - 0.5 * build_up


#: Full braking must be reached within this time, s: an arm must stop.
_BUILD_UP_S = 0.1
#: A joint position or speed that is no limit: none that a message may hold is larger.
UNLIMITED = LARGEST
#: Parameters that ``robot_description`` gives where they are empty.
URDF_LIMITS = ("joint_min_rad", "joint_max_rad", "joint_velocity_limits_rad_s")


@dataclass(frozen=True)
class JointLimits(ArmJoints):
    """Limits of the arm's joints: of position, and of every joint's command.

    A joint moves towards an end of its range at most at the velocity limit times its share of the
    margin, and never faster than it can brake (``braking_speed``).
    """

    max_joint_velocity_rad_s: float = live_parameter(
        1.0, "Velocity limit of every joint, rad/s; the whole command is scaled.", 0.01, pi
    )
    max_joint_acceleration_rad_s2: float = live_parameter(
        6.0,
        "Acceleration limit of every joint's command, rad/s^2; of a joint with a lower velocity "
        "limit in proportion.",
        0.05,
        40.0,
    )
    max_joint_jerk_rad_s3: float = live_parameter(
        0.0,
        "Jerk limit of every joint's command, rad/s^3, at least ten times the acceleration limit; "
        "every stop then is a ramp within both. 0 is off: what must stop at once gets zeros.",
        0.0,
        1e5,
    )
    joint_velocity_limits_rad_s: tuple[float, ...] = live_parameter(
        (),
        "Velocity limits of single joints below max_joint_velocity_rad_s, rad/s (m/s), in the "
        "order of joint_names; empty: those of robot_description.",
        1e-3,
        UNLIMITED,
    )
    joint_min_rad: tuple[float, ...] = live_parameter(
        (),
        "Lower ends of the joints' ranges, rad (m), in the order of joint_names; empty: those of "
        "robot_description, or a UR's.",
        -UNLIMITED,
        UNLIMITED,
    )
    joint_max_rad: tuple[float, ...] = live_parameter(
        (), "Upper ends, as joint_min_rad.", -UNLIMITED, UNLIMITED
    )
    joint_limit_margin_rad: float = live_parameter(
        0.2,
        "Distance from the end of its range at which a joint begins to slow down, rad; a data set "
        "is collected outside of it.",
        0.01,
        0.5,  # a quarter of the shortest range, in units of a joint's share
    )

    #: What robot_description says of each joint's speed near an end; no parameter. With an offset
    #: o and a deceleration d a joint may be as fast as sqrt(2 d room) - o.
    near_ends: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        joints = len(self.joint_names)
        for name in URDF_LIMITS:
            values = getattr(self, name)
            if len(values) not in (0, joints):
                raise ParameterError(
                    f"{name} needs {joints} numbers, one for each of joint_names; "
                    f"got {list(values)}"
                )
        jerk, acceleration = self.max_joint_jerk_rad_s3, self.max_joint_acceleration_rad_s2
        if 0.0 < jerk < acceleration / _BUILD_UP_S:
            raise ParameterError(
                f"max_joint_jerk_rad_s3 must be 0 or at least {acceleration / _BUILD_UP_S:g}, "
                f"{1.0 / _BUILD_UP_S:g} times max_joint_acceleration_rad_s2; got {jerk:g}"
            )
        if not all(map(lt, self.lower_rad, self.upper_rad)):
            raise ParameterError(
                "each of joint_min_rad must be below that of joint_max_rad; "
                f"got {self.lower_rad.tolist()} and {self.upper_rad.tolist()}"
            )

    @property
    def ranges_known(self) -> bool:
        """Whether the joints' ranges are given, or those of a UR."""
        return bool(self.joint_min_rad and self.joint_max_rad) or self._is_ur

    @property
    def _is_ur(self) -> bool:
        return self.joint_names == UR_JOINT_NAMES

    def _given_or(self, values: tuple[float, ...], default: float) -> np.ndarray:
        return np.array(values or np.full(len(self.joint_names), default))

    @cached_property
    def lower_rad(self) -> np.ndarray:
        """Lower ends of the joints' ranges, rad, (n,)."""
        ur = tuple(-end for end in UR_POSITION_LIMITS_RAD) if self._is_ur else ()
        return self._given_or(self.joint_min_rad or ur, -UNLIMITED)

    @cached_property
    def upper_rad(self) -> np.ndarray:
        """Upper ends of the joints' ranges, rad, (n,)."""
        ur = UR_POSITION_LIMITS_RAD if self._is_ur else ()
        return self._given_or(self.joint_max_rad or ur, UNLIMITED)

    @cached_property
    def unit(self) -> np.ndarray:
        """What is treated as 1 rad: 1, or half the range of a shorter joint, (n,)."""
        return np.minimum(1.0, 0.5 * (self.upper_rad - self.lower_rad))

    @cached_property
    def share(self) -> np.ndarray:
        """Each joint's velocity limit over that of the arm, at most its ``unit``, (n,)."""
        own = self._given_or(self.joint_velocity_limits_rad_s, UNLIMITED)
        return np.minimum(self.unit, own / self.max_joint_velocity_rad_s)

    @cached_property
    def margin_rad(self) -> np.ndarray:
        """Distance from the end at which each joint begins to slow down, rad, (n,)."""
        return self.joint_limit_margin_rad * self.share

    @cached_property
    def each(self) -> list[tuple[float, float, float, tuple[float, float]]]:
        """Lower and upper end, rad, share, and offset and deceleration near an end, by joint."""
        ends = self.lower_rad.tolist(), self.upper_rad.tolist()
        near = self.near_ends or (UrdfJoint.near_end,) * len(self.joint_names)
        return list(zip(*ends, self.share.tolist(), near, strict=True))

    @cached_property
    def _inside(self) -> list[tuple[float, float]]:
        lower, upper = self.lower_rad + self.margin_rad, self.upper_rad - self.margin_rad
        return list(zip(lower.tolist(), upper.tolist(), strict=True))

    def near_end(self, joints_rad: np.ndarray) -> bool:
        """Whether a joint, (n,), rad, is within the margin of an end of its range, or beyond."""
        both = zip(joints_rad.tolist(), self._inside, strict=True)
        return any(not low <= joint <= high for joint, (low, high) in both)


def with_urdf_limits(values: Mapping[str, Any], urdf: Mapping[str, UrdfJoint]) -> dict[str, Any]:
    """Parameter values, those limits that are not given taken from a URDF's joints.

    A URDF that has none of ``joint_names`` is another robot's, and says nothing. A
    ``ParameterError`` names one of them that does not move in the URDF, or has odd limits.
    """
    names = [values["tf_prefix"] + name for name in values["joint_names"]]
    joints, values = [urdf[name] for name in names if name in urdf], dict(values)
    if not joints:
        return values
    if len(joints) == len(names):
        values["near_ends"] = tuple(joint.near_end for joint in joints)
    if all(values[name] for name in URDF_LIMITS):
        return values
    for name in names:
        if name not in urdf or not urdf[name].moves:
            raise ParameterError(f"robot_description has no moving joint {name}")
        if urdf[name].problem:
            raise ParameterError(urdf[name].problem)
    limits = [
        (max(-UNLIMITED, joint.lower), min(UNLIMITED, joint.upper), min(UNLIMITED, joint.velocity))
        for joint in joints
    ]
    described = zip(URDF_LIMITS, map(list, zip(*limits, strict=True)), strict=True)
    return {**values, **{name: value for name, value in described if not values[name]}}
