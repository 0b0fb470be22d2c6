"""Random joint motion for collecting data: smooth, bounded, inside a box, and all over it.

Each joint goes to and fro across its range at nearly constant speed, turning softly, and no two
joints keep time. Such a path, a billiard in six dimensions, fills its box evenly. It is followed
in closed loop: velocity of the path plus a small gain on the distance from it. On the way it may
change over to other speeds, and it may be told to come home early.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from fvs_ros.joints import N_JOINTS, TRAINING_BOX_RAD
from fvs_ros.limits import limit_speed

#: Least speed of a joint relative to the fastest allowed, and how many sets of speeds are tried.
_LEAST_SHARE = 0.5
_DRAWS = 64
#: Share of the acceleration limit that a path uses, and the least sharpness of its turns: nearly a
#: sine.
_TURNING_SHARE, _LEAST_SHARPNESS = 0.8, 0.05

#: A motion lasts as long as so many soft starts at least.
_LEAST_RAMPS = 2.5


@dataclass(frozen=True)
class MotionConfig:
    """Bounds of the motion.

    Parameters
    ----------
    duration_s : float
        From rest at the start pose to rest at the start pose, s.
    joint_range_rad : tuple of float
        How far each joint may go from its start to either side, rad; 0 keeps it still.
    max_joint_velocity_rad_s : float
        Speed of the fastest joint, rad/s; never exceeded by a command.
    max_joint_acceleration_rad_s2 : float
        Acceleration of a joint, rad/s^2; never exceeded by commands in a row.
    lower_limits_rad, upper_limits_rad : tuple of float
        Limits of the joints, rad; the box ends ``limit_margin_rad`` before them. A user knows
        them as ``joint_min_rad`` and ``joint_max_rad``.
    limit_margin_rad : float
        Distance kept from the limits, rad.
    position_gain : float
        Velocity per distance from the path, 1/s.

    Raises
    ------
    ValueError
        If values do not fit together, or the duration is too short to go and return.
    """

    duration_s: float = 120.0
    joint_range_rad: tuple[float, ...] = TRAINING_BOX_RAD
    max_joint_velocity_rad_s: float = 0.65
    max_joint_acceleration_rad_s2: float = 3.0
    lower_limits_rad: tuple[float, ...] = (-2.0 * math.pi,) * N_JOINTS
    upper_limits_rad: tuple[float, ...] = (2.0 * math.pi,) * N_JOINTS
    limit_margin_rad: float = 0.1
    position_gain: float = 2.0

    def __post_init__(self) -> None:
        for name in ("joint_range_rad", "lower_limits_rad", "upper_limits_rad"):
            values = tuple(float(v) for v in getattr(self, name))
            if len(values) != N_JOINTS or not all(math.isfinite(v) for v in values):
                raise ValueError(f"{name} must be {N_JOINTS} finite numbers, got {list(values)}")
            object.__setattr__(self, name, values)
        if min(self.joint_range_rad) < 0.0 or max(self.joint_range_rad) == 0.0:
            raise ValueError(
                "joint_range_rad must not be negative, and one joint at least must move, got "
                f"{list(self.joint_range_rad)}"
            )
        for name in (
            "duration_s",
            "max_joint_velocity_rad_s",
            "max_joint_acceleration_rad_s2",
            "position_gain",
        ):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        lower, upper = np.array(self.lower_limits_rad), np.array(self.upper_limits_rad)
        room = upper - lower - 2.0 * self.limit_margin_rad
        if not np.all(room > 0.0):
            raise ValueError(
                f"joint_min_rad must be more than {2.0 * self.limit_margin_rad:g} rad below "
                f"joint_max_rad, got {lower.tolist()} and {upper.tolist()}"
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


@dataclass(frozen=True)
class Course:
    """Going to and fro for ever: joint = centre + half asin(k sin(phase + rate t)) / asin(k).

    Parameters
    ----------
    phase_rad, rate_rad_s : ndarray, shape (6,)
        Phases at time 0, rad, and rates, rad/s.
    sharpness : ndarray, shape (6,)
        k, 0 to 1: a sine near 0, straight lines with sharp turns near 1; 0 for a joint that keeps
        still.
    """

    phase_rad: np.ndarray
    rate_rad_s: np.ndarray
    sharpness: np.ndarray


class RandomMotion:
    """Joint velocities that explore a box about the start pose.

    Parameters
    ----------
    start_rad : ndarray, shape (6,)
        Start pose, rad.
    config : MotionConfig
        Bounds.
    rng : numpy Generator
        Decides speeds and phases; equal generators give equal motions.

    Raises
    ------
    ValueError
        If the start pose is outside the joint limits.
    """

    def __init__(
        self, start_rad: np.ndarray, config: MotionConfig, rng: np.random.Generator
    ) -> None:
        start = np.array(start_rad, dtype=float)
        if start.shape != (N_JOINTS,) or not np.all(np.isfinite(start)):
            raise ValueError(f"the start pose must be {N_JOINTS} finite numbers, got {start}")
        lower = np.asarray(config.lower_limits_rad) + config.limit_margin_rad
        upper = np.asarray(config.upper_limits_rad) - config.limit_margin_rad
        if np.any(start < lower) or np.any(start > upper):
            raise ValueError(
                f"the start pose {np.round(start, 3).tolist()} is closer than "
                f"{config.limit_margin_rad} rad to a joint limit"
            )
        reach = np.asarray(config.joint_range_rad)
        self._config = config
        self._start = start
        self._low = np.maximum(start - reach, lower)
        self._high = np.minimum(start + reach, upper)
        self._half = 0.5 * (self._high - self._low)
        self._centre = 0.5 * (self._high + self._low)
        self._ramp_s = config.ramp_s(float(self._half.max()))
        self._course = self.draw(rng)
        self._end_s = config.duration_s
        self._anchor = start
        self._anchor_time_s = 0.0
        self._returning = False
        self._last: tuple[float, np.ndarray] | None = None

    @property
    def box_rad(self) -> np.ndarray:
        """Least and greatest joint positions of the path, rad, shape (2, 6)."""
        return np.stack([self._low, self._high])

    @property
    def duration_s(self) -> float:
        """Duration, s: less than was configured after :meth:`end_early`."""
        return self._end_s

    @property
    def course(self) -> Course:
        """The course that the path follows now."""
        return self._course

    def draw(self, rng: np.random.Generator) -> Course:
        """Draw a course of this box within these limits: speeds, then phases."""
        config = self._config
        acceleration = _TURNING_SHARE * config.max_joint_acceleration_rad_s2
        # In a narrow box a joint never gets to the speed limit. Shares are of the speed it gets to,
        # and all joints turn as softly: with sharper turns the slower ones would nearly catch up.
        sine_speed = np.sqrt(acceleration * self._half / _turn_factor(_LEAST_SHARPNESS))
        top = np.minimum(config.path_speed_rad_s, sine_speed) / config.path_speed_rad_s
        speeds = config.path_speed_rad_s * (_untimed_shares(self._half, top, rng) * top)
        phase = rng.uniform(0.0, 2.0 * math.pi, N_JOINTS)
        sharpness, rate = np.zeros(N_JOINTS), np.zeros(N_JOINTS)
        for i in np.flatnonzero(self._half > 0.0):
            usable = acceleration if top[i] == 1.0 else 0.0
            sharpness[i], rate[i] = _turning(self._half[i], speeds[i], usable)
        return Course(phase, rate, sharpness)

    def continued(self, course: Course, time_s: float) -> Course:
        """Shift a course in phase so that it goes on where the path is at that time.

        Position and direction of every joint agree; only the speeds differ.
        """
        k, before = course.sharpness, self._course
        angle = before.phase_rad + before.rate_rad_s * time_s
        moving = k > 0.0
        full = np.arcsin(np.where(moving, before.sharpness, 1.0))
        share = np.arcsin(before.sharpness * np.sin(angle)) / full
        sine = np.sin(share * np.arcsin(k)) / np.where(moving, k, 1.0)
        forth = np.arcsin(np.clip(sine, -1.0, 1.0))
        phase = np.where(np.cos(angle) >= 0.0, forth, math.pi - forth)
        return replace(course, phase_rad=phase - course.rate_rad_s * time_s)

    def change_over(self, course: Course, time_s: float) -> None:
        """Follow another course's speeds from now on, without a jump."""
        self._course = self.continued(course, time_s)

    def end_early(self, time_s: float) -> None:
        """Come home from now on, as softly as at the end."""
        self._end_s = min(self._end_s, time_s + self._ramp_s)

    def path(
        self, time_s: float | np.ndarray, course: Course | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where the exploring path is, without its soft start and end.

        Parameters
        ----------
        time_s : float or ndarray, shape (...)
            Time since the start, s.
        course : Course, optional
            Another course than the present one.

        Returns
        -------
        tuple of ndarray, shape (..., 6) each
            Position, rad, and velocity, rad/s.
        """
        course = course if course is not None else self._course
        rate, k = course.rate_rad_s, course.sharpness
        phase = course.phase_rad + rate * np.asarray(time_s)[..., None]
        moving = k > 0.0
        full = np.arcsin(np.where(moving, k, 1.0))
        sine = k * np.sin(phase)
        position = self._centre + self._half * np.arcsin(sine) / full
        velocity = self._half * rate * k * np.cos(phase) / (full * np.sqrt(1.0 - sine**2))
        return (
            np.where(moving, position, self._start),
            np.where(moving, velocity, 0.0),
        )

    def command(self, time_s: float, joints_rad: np.ndarray) -> np.ndarray:
        """Velocities to send now.

        Parameters
        ----------
        time_s : float
            Time since the start, s; must not go back.
        joints_rad : ndarray, shape (6,)
            Measured joint positions, rad.

        Returns
        -------
        ndarray, shape (6,)
            Joint velocities, rad/s; zeros if the measurement is not finite.
        """
        config = self._config
        joints = np.asarray(joints_rad, dtype=float)
        if not np.all(np.isfinite(joints)):
            self._last = None
            return np.zeros(N_JOINTS)
        reference, velocity = self._reference(time_s)
        wanted = velocity + config.position_gain * (reference - joints)
        wanted = limit_speed(wanted, config.max_joint_velocity_rad_s)
        # a joint beyond the box goes inward or not at all
        wanted = np.where((joints > self._high) & (wanted > 0.0), 0.0, wanted)
        wanted = np.where((joints < self._low) & (wanted < 0.0), 0.0, wanted)
        before_s, before = self._last if self._last is not None else (time_s, np.zeros(N_JOINTS))
        change = config.max_joint_acceleration_rad_s2 * max(time_s - before_s, 0.0)
        command = before + np.clip(wanted - before, -change, change)
        if not np.all(np.isfinite(command)):  # of a position that is finite but beyond all reason
            self._last = None
            return np.zeros(N_JOINTS)
        self._last = (time_s, command)
        return command.copy()

    def _reference(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        end_s = self._end_s
        if self._returning or time_s >= end_s:
            return self._start, np.zeros(N_JOINTS)
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
        return bool(time_s >= self._end_s and near)


def _untimed_shares(half_rad: np.ndarray, top: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Shares of the joints' top speeds for which no two joints come close to one rhythm.

    Two joints of nearly one rhythm draw nearly one line instead of filling their rectangle.
    """
    moving = half_rad > 0.0
    best_gap, best = -1.0, np.ones(N_JOINTS)
    for _ in range(_DRAWS):
        shares = rng.uniform(_LEAST_SHARE, 1.0, N_JOINTS)
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

    def needed(k: float) -> float:
        return speed**2 / half_rad * _turn_factor(k)

    low, high = _LEAST_SHARPNESS, 0.98
    if needed(high) <= acceleration:
        low = high
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if needed(middle) <= acceleration else (low, middle)
    return low, speed * math.asin(low) / (half_rad * low)


def _soft_step(fraction: float) -> tuple[float, float]:
    """A smooth step from 0 to 1 and its slope."""
    t = min(max(fraction, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t), 6.0 * t * (1.0 - t)
