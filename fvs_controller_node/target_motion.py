"""How a target moves, from the updates of its position.

A target that is told again and again is a moving one. A parabola through its last updates gives
its velocity and where it is now; the loop then need not wait for an error to see that the target
has gone on. A target told once, or seldom, or that jumps, stands where it was told.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from fvs_controller_node.allocation import Inverse
from fvs_controller_node.base import N_AXES
from fvs_controller_node.pseudo_inverse import DampedInverse
from fvs_ros.core.joints import N_JOINTS
from fvs_ros.core.vectors import length

#: Updates that make a motion, and from which on its curvature is believed.
_LEAST, _CURVED = 3, 5
#: Updates further apart than this are two targets, s.
_MAX_GAP_S = 0.25
#: No target goes further than this between two updates: it is another one, m.
_JUMP_M = 0.05
#: No target that an arm could go along with is faster, m/s.
_FASTEST_M_S = 1.0
#: So many intervals between updates a motion goes on without a further one, and it is no faster
#: than the fastest step by this factor: one odd update must not throw the target about.
_INTERVALS, _FASTER = 3.0, 1.2
#: A stamp further than this from the joint states' is of another clock, s.
_OWN_CLOCK_S = 0.2
#: Velocity of a target that stands, m/s.
STANDING = np.zeros(N_AXES)
STANDING.flags.writeable = False


@dataclass(frozen=True)
class Target:
    """Where a target is and how it moves.

    Parameters
    ----------
    position_m : ndarray, shape (3,)
        m.
    velocity_m_s : ndarray, shape (3,)
        m/s.
    """

    position_m: np.ndarray
    velocity_m_s: np.ndarray


class TargetMotion:
    """The target's motion over time.

    Parameters
    ----------
    window_s : float
        Updates of so long are looked at, s, but five at least: a longer window is calmer, a
        shorter one quicker.
    """

    def __init__(self, window_s: float = 0.15) -> None:
        if not window_s > 0.0:
            raise ValueError(f"target_window_s must be positive, got {window_s}")
        self.window_s = window_s
        self._updates: deque[tuple[float, np.ndarray]] = deque(maxlen=64)
        self._standing: Target | None = None
        self._curve: np.ndarray | None = None
        self._interval_s, self._fastest_m_s = 0.0, 0.0  # between updates

    def restart(self, position_m: np.ndarray, now_s: float = 0.0) -> None:
        """Take a target that stands."""
        self._updates.clear()
        self._take(np.array(position_m, dtype=float), now_s)
        self._curve = None

    def _take(self, position: np.ndarray, now_s: float) -> None:
        self._updates.append((now_s, position))
        self._standing = Target(position, STANDING)

    def continues(self, position_m: np.ndarray, now_s: float) -> bool:
        """Whether a position, m, (3,), at a time, s, is of a target on its way."""
        if not self._updates:
            return False
        last_s, last = self._updates[-1]
        soon = -_OWN_CLOCK_S < now_s - last_s < _MAX_GAP_S
        return soon and float(np.linalg.norm(position_m - last)) < _JUMP_M

    def update(self, position_m: np.ndarray, now_s: float) -> bool:
        """Take the target's position at a time, s; whether that goes on with a motion."""
        position = np.array(position_m, dtype=float)
        if not self.continues(position, now_s):
            self.restart(position, now_s)
            return False
        # Joint states, whose stamps may be the clock, can be rarer than updates.
        if now_s <= self._updates[-1][0]:
            now_s = self._updates.pop()[0]
        self._take(position, now_s)
        while now_s - self._updates[0][0] > self.window_s and len(self._updates) > _CURVED:
            self._updates.popleft()
        self._fit(now_s)
        return True

    def _fit(self, now_s: float) -> None:
        count = len(self._updates)
        if count < _LEAST:
            self._curve = None
            return
        since_s = np.array([time_s - now_s for time_s, _ in self._updates])
        positions = np.array([position for _, position in self._updates])
        powers = np.vander(since_s, 3 if count >= _CURVED else 2, increasing=True)
        self._curve = np.linalg.lstsq(powers, positions, rcond=None)[0]
        steps_s = np.diff(since_s)
        self._interval_s = float(steps_s.mean())
        steps_m = np.linalg.norm(np.diff(positions, axis=0), axis=1)
        self._fastest_m_s = _FASTER * float((steps_m / np.maximum(steps_s, 1e-3)).max())

    def at(self, now_s: float) -> Target | None:
        """The target now, s; None before the first one.

        After the last update it goes on for a few intervals, straight on after the first, and then
        stands where it was told last: the same object then, whenever one asks.
        """
        if not self._updates:
            return None
        last_s, last = self._updates[-1]
        since_s = now_s - last_s
        curve = self._curve
        # A target stamped a little ahead of the joint states is looked back at.
        longest_s = min(_MAX_GAP_S, _INTERVALS * self._interval_s)
        if curve is None or not -_OWN_CLOCK_S < since_s < longest_s:
            return self._standing
        velocity = curve[1].copy()
        position = curve[0] + since_s * velocity
        if len(curve) > 2:
            bent_s = min(since_s, self._interval_s)
            position += bent_s * (2.0 * since_s - bent_s) * curve[2]
            velocity += 2.0 * bent_s * curve[2]
        speed = length(velocity)
        if speed > _FASTEST_M_S:
            return self._standing
        if speed > self._fastest_m_s:
            velocity *= self._fastest_m_s / speed
            position = last + since_s * velocity
        return Target(position, velocity)


class TargetFollower:
    """Keeps up with a moving target: where it is now, and the joint motion that goes along.

    Parameters
    ----------
    window_s : float
        See :class:`TargetMotion`.
    enabled : bool
        Off: every target stands where it was told last.
    inverse : Inverse, optional
        From ball velocity to joint velocities.
    """

    def __init__(
        self, window_s: float = 0.15, enabled: bool = True, inverse: Inverse | None = None
    ) -> None:
        self._motion = TargetMotion(window_s)
        self._enabled = enabled
        self._inverse = inverse or DampedInverse()

    def configure(self, window_s: float, enabled: bool, inverse: Inverse) -> None:
        """Change the settings and keep the motion."""
        TargetMotion(window_s)  # refuses what does not fit
        self._motion.window_s, self._enabled, self._inverse = window_s, enabled, inverse

    def expects(self, position_m: np.ndarray, stamp_s: float, now_s: float) -> bool:
        """Whether a target there would go on with the motion rather than be another one."""
        return self._motion.continues(
            np.asarray(position_m, dtype=float), _on_own_clock(stamp_s, now_s)
        )

    def update(self, position_m: np.ndarray, stamp_s: float, now_s: float) -> None:
        """Take a target that was there at a stamp; one from another clock counts from now, s."""
        self._motion.update(position_m, _on_own_clock(stamp_s, now_s))

    def stand(self, position_m: np.ndarray, now_s: float) -> None:
        """Take a target that stands, whatever moved before, m, (3,)."""
        self._motion.restart(position_m, now_s)

    def at(self, now_s: float) -> Target | None:
        """The target now, s; None before the first, and for one that is told to stand."""
        return self._motion.at(now_s) if self._enabled else None

    def feed_forward(
        self, velocity_m_s: np.ndarray, jacobian: np.ndarray, joints_rad: np.ndarray
    ) -> np.ndarray:
        """Joint velocities that go along with a target's velocity, m/s, (3,); rad/s, shape (6,)."""
        if not velocity_m_s.any():
            return np.zeros(N_JOINTS)
        return self._inverse.joint_velocity(jacobian, velocity_m_s, joints_rad)


def _on_own_clock(stamp_s: float, now_s: float) -> float:
    """The stamp, or now if the stamp is of another clock, s."""
    return stamp_s if abs(stamp_s - now_s) < _OWN_CLOCK_S else now_s
