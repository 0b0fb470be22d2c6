"""Random joint motion for collecting data: smooth, bounded, inside a box, and all over it.

Each joint oscillates across its range at nearly constant speed with soft turns, and no two joints
have the same frequency. Such a path, a billiard in n dimensions, fills its box evenly. The arm
follows it in closed loop: path velocity plus a small gain on the deviation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fvs_ros.limits import JointLimits, limit_speed
from fvs_ros.params import another_default, parameter

#: Least speed of a joint relative to the fastest allowed, and how many sets of speeds are tried.
_LEAST_SHARE, _DRAWS = 0.5, 64
#: Share of the acceleration limit that a path uses, and the least and the greatest sharpness of its
#: turns: from nearly a sine to nearly a corner.
_TURNING_SHARE, _SHARPNESS = 0.8, (0.05, 0.98)
#: Position gain, 1/s, and tolerance of the return to the start, rad times a joint's share.
_POSITION_GAIN, _HOME_RAD = 2.0, 0.02


@dataclass(frozen=True)
class MotionConfig(JointLimits):
    """Bounds of the motion; a ``ValueError`` if values do not fit together."""

    duration_s: float = parameter(120.0, "duration of motion and recording", 2.0, 7200.0)
    joint_range_rad: tuple[float, ...] = parameter(
        (0.5,),
        "half width of the box of motion about the joints at the start, rad (m)",
        0.0,
        3.2,
        broadcast=True,
    )
    max_joint_velocity_rad_s: float = another_default(JointLimits, "max_joint_velocity_rad_s", 0.65)
    max_joint_acceleration_rad_s2: float = another_default(
        JointLimits, "max_joint_acceleration_rad_s2", 3.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        joints, ranges = len(self.joint_names), self.joint_range_rad
        if len(ranges) not in (1, joints):
            raise ValueError(
                f"joint_range_rad must be a list of {joints} numbers, one for each of joint_names, "
                f"or one for all; got {len(ranges)}"
            )
        object.__setattr__(self, "joint_range_rad", ranges * (joints // len(ranges)))
        if max(self.joint_range_rad) == 0.0:
            raise ValueError("joint_range_rad is 0 for all joints, expected one that moves")

    @property
    def path_speed_rad_s(self) -> float:
        """Speed of the path, rad/s: a twentieth is left for following it."""
        return 0.95 * self.max_joint_velocity_rad_s


class RandomMotion:
    """Joint velocities that explore a box about the start pose, rad, (n,).

    Each joint follows ``centre + half asin(k sin(phase + rate t)) / asin(k)``: a sine for a
    sharpness k near 0, straight lines with sharp turns near 1. (With sines, networks from a
    two-minute recording had a third more error.) Equal generators give equal motions; a start pose
    outside the joint limits raises ValueError.

    ``box_rad`` holds the least and greatest joint positions of the path, (2, n), and
    ``rate_rad_s`` the rates of the joints' phases, (n,).
    """

    def __init__(
        self, start_rad: np.ndarray, config: MotionConfig, rng: np.random.Generator
    ) -> None:
        start = np.array(start_rad, dtype=float)
        lower = config.lower_rad + config.margin_rad
        upper = config.upper_rad - config.margin_rad
        joint = int(np.maximum(lower - start, start - upper).argmax())
        if not lower[joint] <= start[joint] <= upper[joint]:
            raise ValueError(
                f"{config.joint_names[joint]} starts at {start[joint]:.3g} rad (m), closer to an "
                f"end of its range than {config.margin_rad[joint]:.3g} (joint_limit_margin_rad); "
                "move it inside"
            )
        reach = np.asarray(config.joint_range_rad)
        self._config, self._start = config, start
        self.box_rad = np.stack(
            [np.maximum(start - reach, lower), np.minimum(start + reach, upper)]
        )
        # The path is made in units of the joints' shares, in which all are equally fast.
        self._unit = config.share
        self._half = 0.5 * (self.box_rad[1] - self.box_rad[0]) / self._unit
        self._centre = 0.5 * (self.box_rad[1] + self.box_rad[0])
        # Time to leave the start pose, or to come back.
        self._ramp_s = 4.0 * float(self._half.max()) / config.path_speed_rad_s
        self._draw(rng)
        self._anchor, self._anchor_time_s = start, 0.0
        self._returning = False

    def _draw(self, rng: np.random.Generator) -> None:
        """Draw speeds, then phases."""
        half, config = self._half, self._config
        acceleration = _TURNING_SHARE * config.max_joint_acceleration_rad_s2
        # In a narrow box a joint cannot reach the speed limit, so the shares refer to its reachable
        # speed.
        sine_speed = np.sqrt(acceleration * half / _acceleration_factor(_SHARPNESS[0]))
        top = np.minimum(config.path_speed_rad_s, sine_speed)
        speed = top * _unequal_shares(half, top, rng)
        self._phase_rad = rng.uniform(0.0, 2.0 * math.pi, len(half))
        sharp = np.linspace(*_SHARPNESS, 500)
        allowed = acceleration * half / np.maximum(speed, 1e-9) ** 2
        self._sharpness = k = np.interp(allowed, _acceleration_factor(sharp), sharp)
        self.rate_rad_s = speed * np.arcsin(k) / (np.where(half > 0.0, half, np.inf) * k)

    def path(self, time_s: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the exploring path is, without its soft start and end.

        At times since the start, s, (...): positions, rad, and velocities, rad/s, (..., n) each.
        """
        rate, k, full = self.rate_rad_s, self._sharpness, np.arcsin(self._sharpness)
        phase = self._phase_rad + rate * np.asarray(time_s)[..., None]
        sine = k * np.sin(phase)
        half = self._unit * self._half
        position = self._centre + half * np.arcsin(sine) / full
        velocity = half * rate * k * np.cos(phase) / (full * np.sqrt(1.0 - sine**2))
        return position, velocity

    def command(self, time_s: float, joints_rad: np.ndarray) -> np.ndarray:
        """Velocities to follow the motion, rad/s, (n,), within the speed limit.

        At a time since the start, s, and measured joint positions, rad, (n,).
        """
        reference, velocity = self._reference(time_s)
        command = velocity + _POSITION_GAIN * (reference - joints_rad)
        return limit_speed(command, self._config.max_joint_velocity_rad_s, self._unit)

    def _reference(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        end_s, position, velocity = self._config.duration_s, self._start, np.zeros(len(self._start))
        if self._returning or time_s >= end_s:
            return position, velocity
        position, velocity = self.path(time_s)
        for home, from_s, direction in (
            (self._anchor, time_s - self._anchor_time_s, 1.0),
            (self._start, end_s - time_s, -1.0),
        ):
            share, slope = _soft_step(from_s / self._ramp_s)
            from_home = position - home
            velocity = share * velocity + direction * slope / self._ramp_s * from_home
            position = home + share * from_home
        return position, velocity

    def return_home(self) -> None:
        """Turn back to the start pose, for instance because the ball is out of sight."""
        self._returning = True

    def resume(self, time_s: float, joints_rad: np.ndarray) -> None:
        """Explore again, from where the arm is; the path has gone on in the meantime."""
        if self._returning:
            self._returning = False
            self._anchor = np.array(joints_rad, dtype=float)
            self._anchor_time_s = time_s

    def done(self, time_s: float, joints_rad: np.ndarray) -> bool:
        """Whether the time is over and the arm back at its start pose."""
        far = np.abs((np.asarray(joints_rad) - self._start) / self._unit).max()
        return bool(time_s >= self._config.duration_s and far <= _HOME_RAD)


def _unequal_shares(half_rad: np.ndarray, top: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Shares of the joints' top speeds for which no two joints come close to one rhythm.

    Two joints of nearly one rhythm draw nearly one line instead of filling their rectangle.
    """
    moving = half_rad > 0.0
    shares = rng.uniform(_LEAST_SHARE, 1.0, (_DRAWS, len(half_rad)))
    rates = np.sort((shares * top)[:, moving] / half_rad[moving], axis=1)
    return shares[np.diff(rates, axis=1).min(axis=1, initial=np.inf).argmax()]


def _acceleration_factor(k: np.ndarray | float) -> np.ndarray:
    """Greatest acceleration of asin(k sin phase) times half width over the speed squared."""
    return np.arcsin(k) / (k * np.sqrt(1.0 - k * k))


def _soft_step(fraction: float) -> tuple[float, float]:
    """A smooth step from 0 to 1 and its slope."""
    t = min(max(fraction, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t), 6.0 * t * (1.0 - t)
