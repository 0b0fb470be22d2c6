"""How long the drives take to do what they are told.

A drive that answers a velocity late by T is behind the commanded path by T times the velocity:
``r_commanded - r = T u + constant``. Both sides, freed of what is slow, are compared over time.
It does not matter whether T is dead time, lag or the age of the joint states.
"""

from __future__ import annotations

from collections import deque
from math import exp

import numpy as np

from fvs_ros.core.joints import N_JOINTS

#: What is slower than this is no lag, s; memory of the comparison, s.
_SLOW_S, _MEMORY_S = 1.0, 20.0
#: The first guess counts like motion at this speed for a while, rad^2/s.
_TRUST = 0.05
#: No drive is slower than this, s.
_MOST_S, _MOST_TICKS = 0.2, 200


class DriveLag:
    """Estimates the lag of the drives from commands and joint positions.

    Parameters
    ----------
    first_s : float
        What it is taken for before anything has moved, s.
    """

    def __init__(self, first_s: float = 0.03) -> None:
        self._cross, self._power = first_s * _TRUST, _TRUST
        self.restart()

    @property
    def lag_s(self) -> float:
        """The lag, s."""
        return min(max(self._cross / self._power, 0.0), _MOST_S)

    def restart(self) -> None:
        """Begin anew to compare (the arm was moved by something else); the lag stays known."""
        self._stamp_s = 0.0
        self._joints: np.ndarray | None = None
        self._behind, self._slow_behind = np.zeros(N_JOINTS), np.zeros(N_JOINTS)
        self._slow_command = np.zeros(N_JOINTS)
        self._told: deque[tuple[float, np.ndarray]] = deque(maxlen=_MOST_TICKS)

    def pending_rad(self) -> np.ndarray:
        """Motion that was commanded and is still to come, rad, shape (6,)."""
        total, left_s = np.zeros(N_JOINTS), self.lag_s
        for length_s, command in reversed(self._told):
            if left_s <= 0.0:
                break
            total += min(length_s, left_s) * command
            left_s -= length_s
        return total

    def add(
        self,
        stamp_s: float,
        command_rad_s: np.ndarray,
        joints_rad: np.ndarray,
        compare: bool = True,
    ) -> None:
        """Tell one joint state.

        Parameters
        ----------
        stamp_s : float
            Its stamp, s: the times of arrival jitter, and would feign a lag.
        command_rad_s : ndarray, shape (6,)
            The command in force since the one before, rad/s.
        joints_rad : ndarray, shape (6,)
            Joint positions, rad.
        compare : bool
            Whether the arm goes as fast as it is told; one with its speed slider down does not,
            and would feign a lag as well.
        """
        before_s, self._stamp_s = self._stamp_s, stamp_s
        before, self._joints = self._joints, joints_rad
        dt_s = stamp_s - before_s
        if before is None or dt_s <= 0.0:
            return
        self._told.append((dt_s, command_rad_s))
        if not compare:
            return
        self._behind = self._behind + command_rad_s * dt_s - (joints_rad - before)
        share = dt_s / (_SLOW_S + dt_s)
        self._slow_behind = self._slow_behind + share * (self._behind - self._slow_behind)
        self._slow_command = self._slow_command + share * (command_rad_s - self._slow_command)
        behind, command = self._behind - self._slow_behind, command_rad_s - self._slow_command
        power = float(command @ command) * dt_s
        keep = exp(-dt_s / _MEMORY_S) if power > 1e-6 else 1.0
        # However long a stall was: no more than the slowest drive would be behind.
        late = min(max(float(behind @ command) * dt_s, 0.0), _MOST_S * power)
        self._cross = keep * self._cross + late
        self._power = keep * self._power + power
        if self._power < 1e-3 * _TRUST:
            self._cross, self._power = self.lag_s * _TRUST, _TRUST
