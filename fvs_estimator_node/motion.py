"""Random joint motion for collecting data: smooth, bounded, inside a box, and all over it.

Each joint goes to and fro across its range at nearly constant speed, turning softly, and no two
joints keep time. Such a path, a billiard in n dimensions, fills its box evenly. It is followed
in closed loop: velocity of the path plus a small gain on the distance from it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fvs_ros.joints import TRAINING_BOX_RAD, UR_POSITION_LIMITS_RAD
from fvs_ros.limits import limit_speed
from fvs_ros.params import Parameters, parameter

#: Least speed of a joint relative to the fastest allowed, and how many sets of speeds are tried.
_LEAST_SHARE, _DRAWS = 0.5, 64
#: Share of the acceleration limit that a path uses, and the least sharpness of its turns: nearly a
#: sine.
_TURNING_SHARE, _LEAST_SHARPNESS = 0.8, 0.05
#: A motion lasts at least this many soft starts.
_LEAST_RAMPS = 2.5
#: Distance kept from the joint limits, rad, and velocity per distance from the path, 1/s.
_LIMIT_MARGIN_RAD, _POSITION_GAIN = 0.1, 2.0
_LIMIT_RAD = 4.0 * math.pi


@dataclass(frozen=True)
class MotionConfig(Parameters):
    """Bounds of the motion.

    Raises
    ------
    ValueError
        If values do not fit together, or the duration is too short to go and return.
    """

    duration_s: float = parameter(120.0, "how long to move and record, at most", 2.0, 7200.0)
    joint_range_rad: tuple[float, ...] = parameter(
        TRAINING_BOX_RAD,
        "half width of the box of motion about the joints at the start",
        0.0,
        3.2,
        broadcast=True,
    )
    max_joint_velocity_rad_s: float = parameter(0.65, "velocity limit of each joint", 0.01, 3.15)
    max_joint_acceleration_rad_s2: float = parameter(
        3.0, "acceleration limit of each joint's command", 0.05, 40.0
    )
    joint_min_rad: tuple[float, ...] = parameter(
        tuple(-limit for limit in UR_POSITION_LIMITS_RAD),
        "lower ends of the joints' ranges, rad; the box of motion ends 0.1 rad before them",
        -_LIMIT_RAD,
        _LIMIT_RAD,
    )
    joint_max_rad: tuple[float, ...] = parameter(
        UR_POSITION_LIMITS_RAD,
        "upper ends of the joints' ranges, rad; the box of motion ends 0.1 rad before them",
        -_LIMIT_RAD,
        _LIMIT_RAD,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        joints, ranges = len(self.joint_min_rad), self.joint_range_rad
        if len(self.joint_max_rad) != joints or len(ranges) not in (1, joints):
            raise ValueError(
                f"joint_range_rad must be a list of {joints} numbers, or one for all, and "
                f"joint_max_rad of {joints}, as joint_min_rad is; got {len(ranges)} and "
                f"{len(self.joint_max_rad)}"
            )
        object.__setattr__(self, "joint_range_rad", ranges * (joints // len(ranges)))
        if max(self.joint_range_rad) == 0.0:
            raise ValueError("joint_range_rad is 0 for all joints, expected one that moves")
        room = np.subtract(self.joint_max_rad, self.joint_min_rad) - 2.0 * _LIMIT_MARGIN_RAD
        if not np.all(room > 0.0):
            raise ValueError(
                f"joint_min_rad must be more than {2.0 * _LIMIT_MARGIN_RAD:g} rad below "
                f"joint_max_rad, got {list(self.joint_min_rad)} and {list(self.joint_max_rad)}"
            )
        widest = np.minimum(self.joint_range_rad, 0.5 * room).max()
        least_s = _LEAST_RAMPS * self.ramp_s(float(widest))
        if self.duration_s < least_s:
            raise ValueError(
                f"duration_s must be at least {least_s:.1f} to go and return within "
                f"the speed limit, got {self.duration_s:g}"
            )

    @property
    def path_speed_rad_s(self) -> float:
        """Speed of the path, rad/s: a twentieth is left for following it."""
        return 0.95 * self.max_joint_velocity_rad_s

    def ramp_s(self, half_rad: float) -> float:
        """Time to leave the start pose, or to come back, in a box of that half width, s."""
        return 4.0 * half_rad / self.path_speed_rad_s


class RandomMotion:
    """Joint velocities that explore a box about the start pose.

    Each joint follows ``centre + half asin(k sin(phase + rate t)) / asin(k)``: a sine for a
    sharpness k near 0, straight lines with sharp turns near 1.

    Parameters
    ----------
    start_rad : ndarray, shape (n,)
        Start pose, rad.
    config : MotionConfig
        Bounds.
    rng : numpy Generator
        Decides speeds and phases; equal generators give equal motions.

    Attributes
    ----------
    box_rad : ndarray, shape (2, n)
        Least and greatest joint positions of the path, rad.
    duration_s : float
        Duration, s: less than was configured after :meth:`end_early`.
    rate_rad_s : ndarray, shape (n,)
        Rates of the joints' phases, rad/s.

    Raises
    ------
    ValueError
        If the start pose is outside the joint limits.
    """

    def __init__(
        self, start_rad: np.ndarray, config: MotionConfig, rng: np.random.Generator
    ) -> None:
        start = np.array(start_rad, dtype=float)
        lower = np.asarray(config.joint_min_rad) + _LIMIT_MARGIN_RAD
        upper = np.asarray(config.joint_max_rad) - _LIMIT_MARGIN_RAD
        if start.shape != lower.shape or not np.all((start >= lower) & (start <= upper)):
            raise ValueError(
                f"the start pose {np.round(start, 3).tolist()} is closer than "
                f"{_LIMIT_MARGIN_RAD} rad to a joint limit"
            )
        reach = np.asarray(config.joint_range_rad)
        self._config = config
        self._start = start
        self.box_rad = np.stack(
            [np.maximum(start - reach, lower), np.minimum(start + reach, upper)]
        )
        self._half = 0.5 * (self.box_rad[1] - self.box_rad[0])
        self._centre = 0.5 * (self.box_rad[1] + self.box_rad[0])
        self._ramp_s = config.ramp_s(float(self._half.max()))
        self._draw(rng)
        self.duration_s = config.duration_s
        self._anchor, self._anchor_time_s = start, 0.0
        self._returning = False
        self._last: tuple[float, np.ndarray] | None = None

    def _draw(self, rng: np.random.Generator) -> None:
        """Draw speeds, then phases."""
        config, n = self._config, len(self._half)
        acceleration = _TURNING_SHARE * config.max_joint_acceleration_rad_s2
        # In a narrow box a joint never gets to the speed limit. Shares are of the speed it gets to,
        # and all joints turn as softly: with sharper turns the slower ones would nearly catch up.
        sine_speed = np.sqrt(acceleration * self._half / _turn_factor(_LEAST_SHARPNESS))
        top = np.minimum(config.path_speed_rad_s, sine_speed) / config.path_speed_rad_s
        speeds = config.path_speed_rad_s * (_unequal_shares(self._half, top, rng) * top)
        self._phase_rad = rng.uniform(0.0, 2.0 * math.pi, n)
        self._sharpness, self.rate_rad_s = np.zeros(n), np.zeros(n)
        for i in np.flatnonzero(self._half > 0.0):
            usable = acceleration if top[i] == 1.0 else 0.0
            self._sharpness[i], self.rate_rad_s[i] = _turning(self._half[i], speeds[i], usable)

    def end_early(self, time_s: float) -> None:
        """Come home from now on, as softly as at the end."""
        self.duration_s = min(self.duration_s, time_s + self._ramp_s)

    def path(self, time_s: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the exploring path is, without its soft start and end.

        Parameters
        ----------
        time_s : float or ndarray, shape (...)
            Time since the start, s.

        Returns
        -------
        tuple of ndarray, shape (..., n) each
            Position, rad, and velocity, rad/s.
        """
        rate, k = self.rate_rad_s, self._sharpness
        phase = self._phase_rad + rate * np.asarray(time_s)[..., None]
        moving = k > 0.0
        full = np.arcsin(np.where(moving, k, 1.0))
        sine = k * np.sin(phase)
        position = self._centre + self._half * np.arcsin(sine) / full
        velocity = self._half * rate * k * np.cos(phase) / (full * np.sqrt(1.0 - sine**2))
        return np.where(moving, position, self._start), np.where(moving, velocity, 0.0)

    def command(self, time_s: float, joints_rad: np.ndarray) -> np.ndarray:
        """Velocities to send now.

        Parameters
        ----------
        time_s : float
            Time since the start, s; must not go back.
        joints_rad : ndarray, shape (n,)
            Measured joint positions, rad.

        Returns
        -------
        ndarray, shape (n,)
            Joint velocities, rad/s; zeros if the measurement is not finite.
        """
        config = self._config
        joints = np.asarray(joints_rad, dtype=float)
        before_s, before = self._last or (time_s, np.zeros(len(joints)))
        reference, velocity = self._reference(time_s)
        wanted = velocity + _POSITION_GAIN * (reference - joints)
        wanted = limit_speed(wanted, config.max_joint_velocity_rad_s)
        # a joint beyond the box goes inward or not at all
        low, high = self.box_rad
        outward = ((joints > high) & (wanted > 0.0)) | ((joints < low) & (wanted < 0.0))
        wanted = np.where(outward, 0.0, wanted)
        change = config.max_joint_acceleration_rad_s2 * max(time_s - before_s, 0.0)
        command = before + np.clip(wanted - before, -change, change)
        if not (np.all(np.isfinite(joints)) and np.all(np.isfinite(command))):
            self._last = None
            return np.zeros(len(joints))
        self._last = (time_s, command)
        return command.copy()

    def _reference(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        end_s = self.duration_s
        if self._returning or time_s >= end_s:
            return self._start, np.zeros(len(self._start))
        position, velocity = self.path(time_s)
        leaving, leaving_rate = _soft_step((time_s - self._anchor_time_s) / self._ramp_s)
        position, velocity = (
            self._anchor + leaving * (position - self._anchor),
            leaving * velocity + leaving_rate / self._ramp_s * (position - self._anchor),
        )
        coming, coming_rate = _soft_step((end_s - time_s) / self._ramp_s)
        return (
            self._start + coming * (position - self._start),
            coming * velocity - coming_rate / self._ramp_s * (position - self._start),
        )

    def return_home(self) -> None:
        """Turn back to the start pose, for instance because the ball is out of sight."""
        self._returning = True

    def resume(self, time_s: float, joints_rad: np.ndarray) -> None:
        """Explore again, from where the arm is; the path has gone on in the meantime."""
        if self._returning:
            self._returning = False
            self._anchor = np.array(joints_rad, dtype=float)
            self._anchor_time_s = time_s

    def done(self, time_s: float, joints_rad: np.ndarray, tolerance_rad: float = 0.02) -> bool:
        """Whether the time is over and the arm back at its start pose."""
        near = np.abs(np.asarray(joints_rad) - self._start).max() <= tolerance_rad
        return bool(time_s >= self.duration_s and near)


def _unequal_shares(half_rad: np.ndarray, top: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Shares of the joints' top speeds for which no two joints come close to one rhythm.

    Two joints of nearly one rhythm draw nearly one line instead of filling their rectangle.
    """
    moving = half_rad > 0.0
    best_gap, best = -1.0, np.ones(len(half_rad))
    for _ in range(_DRAWS):
        shares = rng.uniform(_LEAST_SHARE, 1.0, len(half_rad))
        rates = np.sort((shares * top)[moving] / half_rad[moving])
        gap = float(np.diff(rates).min(initial=np.inf))
        if gap > best_gap:
            best_gap, best = gap, shares
    return best


def _turn_factor(k: float) -> float:
    """Greatest acceleration of asin(k sin phase) times half width over the speed squared."""
    return math.asin(k) / (k * math.sqrt(1.0 - k * k))


def _turning(half_rad: float, speed: float, acceleration: float) -> tuple[float, float]:
    """Sharpness k and rate (rad/s) of asin(k sin phase) of a speed, within an acceleration.

    The least sharpness where the acceleration does not allow for more.
    """

    def allowed(k: float) -> bool:
        return speed**2 / half_rad * _turn_factor(k) <= acceleration

    low, high = _LEAST_SHARPNESS, 0.98
    if allowed(high):
        low = high
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if allowed(middle) else (low, middle)
    return low, speed * math.asin(low) / (half_rad * low)


def _soft_step(fraction: float) -> tuple[float, float]:
    """A smooth step from 0 to 1 and its slope."""
    t = min(max(fraction, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t), 6.0 * t * (1.0 - t)
