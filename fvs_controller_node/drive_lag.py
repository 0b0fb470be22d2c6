"""How long the drives take to do what they are told.

A drive that answers a velocity late by T is behind the commanded path by T times the velocity:
``r_commanded - r = T u + constant``. Both sides, freed of what is slow, are compared over time.
It does not matter whether T is dead time, lag or the age of the joint states.
"""

from __future__ import annotations

import numpy as np

from fvs_ros.core.history import JointHistory
from fvs_ros.core.joints import N_JOINTS

#: What it is taken for before anything has moved, s.
_FIRST_S = 0.03
#: No drive is slower than this; what is slower than that is no lag, s.
_MOST_S, _SLOW_S = 0.2, 1.0
#: The first guess counts like so much motion, and all that was seen like no more than that: the
#: square of the speed over time, rad^2/s.
_FIRST, _MEMORY = 0.05, 20.0


class DriveLag:
    """Estimates the lag of the drives from commands and joint positions."""

    def __init__(self) -> None:
        self._lag_s, self._known = _FIRST_S, _FIRST
        self._told = JointHistory()  # the path as commanded
        self._joints = np.zeros(N_JOINTS)
        self._behind, self._slow_behind = np.zeros(N_JOINTS), np.zeros(N_JOINTS)
        self._slow_command = np.zeros(N_JOINTS)

    @property
    def lag_s(self) -> float:
        """The lag, s."""
        return self._lag_s

    def pending_rad(self) -> np.ndarray:
        """Motion that was commanded and is still to come, rad, shape (6,)."""
        newest_s, told = self._told.newest_stamp_s, self._told.newest
        done = None if newest_s is None else self._told.at(newest_s - self._lag_s)
        return np.zeros(N_JOINTS) if told is None or done is None else told - done

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
        before_s, told = self._told.newest_stamp_s, self._told.newest
        moved, self._joints = joints_rad - self._joints, joints_rad
        if before_s is None or told is None:
            self._told.add(stamp_s, np.zeros(N_JOINTS))
            return
        dt_s = stamp_s - before_s
        if not self._told.add(stamp_s, told + dt_s * command_rad_s) or not compare:
            return  # the clock jumped, or the arm is not to be compared
        self._behind = self._behind + command_rad_s * dt_s - moved
        share = dt_s / (_SLOW_S + dt_s)
        self._slow_behind = self._slow_behind + share * (self._behind - self._slow_behind)
        self._slow_command = self._slow_command + share * (command_rad_s - self._slow_command)
        behind, command = self._behind - self._slow_behind, command_rad_s - self._slow_command
        power = float(command @ command) * dt_s
        # However long a stall was: no more than the slowest drive would be behind.
        late = min(max(float(behind @ command) * dt_s, 0.0), _MOST_S * power)
        self._known = min(self._known + power, _MEMORY)
        self._lag_s += (late - power * self._lag_s) / self._known
