"""Whether each joint follows its command: commanded against measured motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Motions are summed with this memory, s: much longer than a drive's lag.
_MEMORY_S = 0.5

#: A joint that moves against its command is found sooner by this factor; from this motion on, rad,
#: since small motions about a target lag and so often oppose the newest command.
_AGAINST_WEIGHT, _AGAINST_RAD = 6.0, 0.02

#: Interval of the comparison, s.
_LOOK_S = 0.04

#: Least commanded motion within the memory that is judged, rad.
_LEAST_COMMANDED_RAD = 0.004

#: A joint follows if it makes this share of the motion that command and speed scaling ask for.
_LEAST_SHARE = 0.15


@dataclass(frozen=True)
class TrackingFault:
    """A joint, by its place, that does not follow: motion commanded and made in the memory."""

    joint: int
    commanded_rad: float
    moved_rad: float


class Following:
    """Compares commands with joint states, over a fading memory of half a second."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Begin anew: a start."""
        self._commanded = self._moved = np.zeros(1)
        self._off_s = np.zeros(1)  # how long each joint has not followed
        self.pause()

    def pause(self) -> None:
        """Ignore motion while the arm is held; keep what was counted."""
        self._joints: np.ndarray | None = None
        self._pending = np.zeros(1)
        self._pending_s = 0.0

    def add(
        self, command_rad_s: np.ndarray, joints_rad: np.ndarray, scaling: float, dt_s: float
    ) -> None:
        """Take a tick: the command since the last one, (n,), and the joints now, (n,).

        ``scaling`` is the robot's speed scaling, 0 to 1.
        """
        if self._joints is None:
            self._joints = joints_rad
            return
        self._pending = self._pending + (scaling * dt_s) * command_rad_s
        self._pending_s += dt_s
        if self._pending_s < _LOOK_S:
            return
        passed_s, keep = self._pending_s, _MEMORY_S / (_MEMORY_S + self._pending_s)
        self._moved = keep * (self._moved + joints_rad - self._joints)
        self._commanded = keep * (self._commanded + self._pending)
        self._joints, self._pending, self._pending_s = joints_rad, np.zeros(1), 0.0
        self._count(passed_s)

    def _count(self, passed_s: float) -> None:
        asked = np.abs(self._commanded)
        along = self._moved * np.sign(self._commanded)
        judged = asked >= _LEAST_COMMANDED_RAD
        follows = along >= _LEAST_SHARE * asked
        against = (along < -_LEAST_SHARE * asked) & (asked >= _AGAINST_RAD)
        weight = np.where(against, _AGAINST_WEIGHT, 1.0)
        self._off_s = np.where(judged & follows, 0.0, self._off_s + passed_s * weight * judged)

    def fault(self, time_s: float) -> TrackingFault | None:
        """Name the joint that has not followed for ``time_s``; None if all do."""
        joint = int(self._off_s.argmax())
        if self._off_s[joint] < time_s or self._off_s[joint] <= 0.0:
            return None
        return TrackingFault(joint, float(self._commanded[joint]), float(self._moved[joint]))
