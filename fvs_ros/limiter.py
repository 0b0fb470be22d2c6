"""The one exit of joint velocity commands: the next command, within every limit of the joints."""

from __future__ import annotations

from math import inf

import numpy as np

from fvs_ros.limits import BELOW, JointLimits, braking_speed, limit_speed
from fvs_ros.vectors import largest
from fvs_ros.view import Barrier

#: Share of the acceleration limit that braking for the end of a range is planned with. With 0.9 a
#: joint passed its end by up to 90 mrad (3 rad/s, a lag of 90 ms) while the drives' lag was not
#: known yet; with 0.6 by 0.2 mrad.
_RANGE_SHARE = 0.6


class CommandLimiter:
    """Limits joint velocities, and brings the arm to rest; remembers the last command.

    Whatever is wanted, each command is within the limits of speed, of acceleration, of jerk where
    there is one, and of the joints' ranges. A joint that nears an end of its range is slowed alone,
    so the others continue and the arm slides along the limit. Away from the end it is free.

    The driver holds a command for ``hold_s``, s, if the next one is late: until then no joint
    leaves its range; 0: for the tick alone. ``velocity_rad_s`` is the last command, rad/s, (n,),
    not to be changed in place.
    """

    def __init__(self, limits: JointLimits, hold_s: float = 0.0) -> None:
        self.limits, self._hold_s = limits, hold_s
        self.stop()

    def stop(self) -> None:
        """Command zeros at once."""
        self.velocity_rad_s = self._step = np.zeros(len(self.limits.joint_names))

    def move(
        self,
        wanted_rad_s: np.ndarray,
        joints_rad: np.ndarray,
        dt_s: float,
        pending_rad: np.ndarray,
        fastest_rad_s: float = inf,
        barrier: Barrier | None = None,
    ) -> list[str]:
        """Command the velocity nearest to what is wanted, (n,); returns the limits that shaped it.

        A tick that counts for nothing changes no command. Pending motion, (n,), was commanded and
        is still to come: it reduces the room to an end if it goes towards it, and adds none if it
        goes away. A speed limit may be below that of the arm. A barrier keeps an object in view;
        only braking for it takes longer than a tick.
        """
        limits, active = self.limits, list[str]()
        fastest_rad_s = min(fastest_rad_s, limits.max_joint_velocity_rad_s)
        velocity = limit_speed(wanted_rad_s, fastest_rad_s, limits.share)
        if velocity is not wanted_rad_s:
            active.append("velocity")
        if barrier is not None:
            velocity, where = barrier.nearest(velocity, limits.share)
            velocity = limit_speed(velocity, fastest_rad_s, limits.share)
            active += [where] if where else []
        acceleration, room_s = limits.max_joint_acceleration_rad_s2, self._hold_s or dt_s
        allowed, slowed = self.slow_down(velocity, joints_rad, acceleration, room_s, pending_rad)
        active += [f"range of {limits.joint_names[joint]}" for joint in slowed]
        if barrier is not None:
            allowed = barrier.shortened(allowed)
        velocity = self._step_to(allowed, dt_s)
        if velocity is not allowed and (velocity != allowed).any():
            active.append("acceleration")
        self._take(self._clip_to_range(velocity, joints_rad, pending_rad), dt_s)
        return active

    def rest(
        self, joints_rad: np.ndarray | None, dt_s: float, pending_rad: np.ndarray
    ) -> np.ndarray:
        """Command one step to rest; from full speed it is reached within 0.5 s. Returns it."""
        limits, last = self.limits, self.velocity_rad_s
        if dt_s <= 0.0:
            return last
        if limits.max_joint_jerk_rad_s3 > 0.0:
            velocity = self._step_to(np.zeros_like(last), dt_s)
        else:
            fast, most = limits.max_joint_velocity_rad_s, limits.max_joint_acceleration_rad_s2
            acceleration = max(most, fast / 0.5)
            step = BELOW * acceleration * dt_s * limits.share
            velocity = ramp_to_zero(last, step)
            if joints_rad is not None:
                # The ramp is as long as the fastest joint's; one near its end brakes harder.
                velocity, _ = self.slow_down(velocity, joints_rad, acceleration, dt_s, pending_rad)
                velocity = np.clip(velocity, last - step, last + step)
        if joints_rad is not None:
            velocity = self._clip_to_range(velocity, joints_rad, pending_rad)
        self._take(velocity, dt_s)
        return self.velocity_rad_s

    def _take(self, velocity: np.ndarray, dt_s: float) -> None:
        """Take a command into effect; a tick that counts for nothing changes none."""
        if dt_s > 0.0:
            self._step, self.velocity_rad_s = velocity - self.velocity_rad_s, velocity

    def _step_to(self, velocity: np.ndarray, dt_s: float) -> np.ndarray:
        """The next command on the way to a velocity, within acceleration and jerk."""
        limits, last = self.limits, self.velocity_rad_s
        most = BELOW * limits.max_joint_acceleration_rad_s2 * limits.share
        if limits.max_joint_jerk_rad_s3 <= 0.0:
            return limit_acceleration(velocity, last, most * dt_s)
        jerk = BELOW * limits.max_joint_jerk_rad_s3 * limits.share
        before = self._step / dt_s if dt_s > 0.0 else self._step
        return limit_jerk(velocity, last, before, most, jerk, dt_s)

    def slow_down(
        self,
        velocity: np.ndarray,
        joints_rad: np.ndarray,
        acceleration: float,
        dt_s: float,
        pending_rad: np.ndarray,
    ) -> tuple[np.ndarray, list[int]]:
        """Slow down every joint that nears an end of its range; also returns which."""
        limits, slowed, values = self.limits, list[int](), velocity.tolist()
        acceleration *= _RANGE_SHARE
        # With the robot's lag of 35 ms a faster approach than 5 times the distance would pass it.
        slope = min(limits.max_joint_velocity_rad_s / limits.joint_limit_margin_rad, 5.0)
        jerk, fast = limits.max_joint_jerk_rad_s3, largest(velocity / limits.share)
        # Without a jerk limit, no joint with so much room is slowed.
        ample = max(fast / slope, fast * (0.5 * fast / acceleration + dt_s)) if not jerk else inf
        each = zip(values, joints_rad.tolist(), pending_rad.tolist(), limits.each, strict=True)
        for i, (v, q, ahead, (lower, upper, share, (offset, allowed))) in enumerate(each):
            room = upper - q - max(0.0, ahead) if v > 0.0 else q - lower - max(0.0, -ahead)
            if room > ample * share and allowed == inf:
                continue
            room = max(0.0, room)
            driver = braking_speed(room, allowed, dt_s, jerk) - offset if allowed < inf else inf
            room /= share
            cap = share * min(slope * room, braking_speed(room, acceleration, dt_s, jerk))
            cap = min(cap, max(0.0, driver))
            if abs(v) > cap:
                values[i] = cap if v > 0.0 else -cap
                slowed.append(i)
        return (np.array(values), slowed) if slowed else (velocity, slowed)

    def _clip_to_range(
        self, velocity: np.ndarray, joints_rad: np.ndarray, pending_rad: np.ndarray
    ) -> np.ndarray:
        """The command that, held, keeps joints in their ranges; beyond, a joint may come back."""
        if not self._hold_s:
            return velocity
        limits, joints_rad = self.limits, joints_rad + pending_rad
        least = np.minimum(0.0, (limits.lower_rad - joints_rad) / self._hold_s)
        most = np.maximum(0.0, (limits.upper_rad - joints_rad) / self._hold_s)
        return np.clip(velocity, least, most)


def limit_acceleration(velocity: np.ndarray, last: np.ndarray, max_step: np.ndarray) -> np.ndarray:
    """Find the command nearest to a velocity, (n,), no joint further than a step from ``last``.

    If a shorter command in the same direction is within reach, the longest such one; otherwise
    each joint changes as far as allowed.
    """
    low, high = last - max_step, last + max_step
    nearest = np.minimum(np.maximum(velocity, low), high)
    if nearest.tolist() == velocity.tolist():
        return velocity
    scale, lowest = 1.0, 0.0
    for v, lo, hi in zip(velocity.tolist(), low.tolist(), high.tolist(), strict=True):
        if v > 0.0:
            scale, lowest = min(scale, hi / v), max(lowest, lo / v)
        elif v < 0.0:
            scale, lowest = min(scale, lo / v), max(lowest, hi / v)
        elif not lo <= 0.0 <= hi:
            lowest = np.inf
    return np.minimum(np.maximum(velocity * scale, low), high) if lowest <= scale else nearest


def limit_jerk(
    velocity: np.ndarray,
    last: np.ndarray,
    last_acceleration: np.ndarray,
    max_acceleration: np.ndarray,
    max_jerk: np.ndarray,
    dt_s: float,
) -> np.ndarray:
    """Find the command on the way to ``velocity`` within limits of acceleration and jerk.

    Each joint alone takes the largest acceleration from which it can come to zero just when the
    velocity is reached; all are (n,), rad/s, rad/s^2 and rad/s^3.
    """
    missing, step = velocity - last, max_jerk * dt_s
    # The square root less the step, written so that the last bit is closed, too; never 0 / 0.
    twice = 2.0 * max_jerk * np.abs(missing)
    most = np.minimum(max_acceleration, twice / (np.sqrt(step**2 + twice) + step + 1e-300))
    wanted = np.clip(np.copysign(most, missing), last_acceleration - step, last_acceleration + step)
    return last + np.clip(wanted, -max_acceleration, max_acceleration) * dt_s


def ramp_to_zero(last: np.ndarray, max_step: np.ndarray) -> np.ndarray:
    """Take one step to rest: the last command, no joint slower by more than its largest step."""
    steps = largest(last / max_step)
    return np.zeros_like(last) if steps <= 1.0 else last * (1.0 - 1.0 / steps)
