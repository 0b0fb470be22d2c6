"""What the drives make of what they are told: how late they do it, and how much of it.

Drives that answer velocities u late by T, and at a share g of them, follow the commanded path p by
``r = g p - g T u + constant``. Both sides, freed of what is slow, are compared over time. It does
not matter whether T is dead time, lag or the age of the joint states.

Told so, the joints are known before they are measured, but for the constant. At rest it is
averaged, so that the noise of the encoders does not become motion.
"""

from __future__ import annotations

import numpy as np

from fvs_ros.core.history import JointHistory
from fvs_ros.core.joints import N_JOINTS

#: What the lag is taken for before anything has moved, s.
_FIRST_S = 0.03
#: No drive is slower than this; what is slower than that is no lag, s.
_MOST_S, _SLOW_S = 0.2, 1.0
#: No drive does less of what it is told.
_LEAST_GAIN = 0.5
#: The first guess of gain and lag counts like so much motion, and all that was seen like no more
#: than that: squares of way, rad^2 s, and speed, rad^2/s, over time. A first gain that counts for
#: less is corrected sooner where drives are weak, and takes lag for weakness where they are not.
_FIRST_GAIN, _FIRST_LAG, _MEMORY = 0.05, 0.05, 20.0
#: Time over which the constant is averaged at rest, s, and the speed from which on it is not: there
#: a wrong lag or gain would be worse than the encoders' noise, rad/s.
_AVERAGED_S, _MOVING_RAD_S = 0.16, 0.02


class DriveLag:
    """Estimates lag and gain of the drives from commands and joint positions.

    Attributes
    ----------
    lag_s, gain : float
        The lag, s, and the share of the commanded speed that is reached.
    """

    def __init__(self) -> None:
        self.lag_s, self.gain = _FIRST_S, 1.0
        # Normal equations of r = g p + h u, with h = -g T.
        self._normal = np.diag([_FIRST_GAIN, _FIRST_LAG])
        self._right = self._normal @ [1.0, -_FIRST_S]
        self._told = JointHistory()  # the path as commanded
        self._constant: np.ndarray | None = None
        self._joints = np.zeros(N_JOINTS)
        # Path, speed and joints, and what is slow of them.
        self._now, self._slow = np.zeros((3, N_JOINTS)), np.zeros((3, N_JOINTS))

    def pending_rad(self) -> np.ndarray:
        """Motion that was commanded and is still to come, rad, shape (6,)."""
        told, done = self._told.newest, self._done(self.lag_s)
        return np.zeros(N_JOINTS) if told is None or done is None else self.gain * (told - done)

    def _done(self, late_s: float) -> np.ndarray | None:
        """The path that had been commanded so long ago, rad, shape (6,)."""
        newest_s = self._told.newest_stamp_s
        return None if newest_s is None else self._told.at(newest_s - late_s)

    def add(
        self,
        stamp_s: float,
        command_rad_s: np.ndarray,
        joints_rad: np.ndarray,
        compare: bool = True,
    ) -> np.ndarray:
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
            Whether the arm goes as it is told; one with its speed slider down, or moved by somebody
            else, does not, and would feign a lag as well.

        Returns
        -------
        ndarray, shape (6,)
            Joint positions with less noise where the arm goes as it is told, rad.
        """
        before_s, told = self._told.newest_stamp_s, self._told.newest
        moved, self._joints = joints_rad - self._joints, joints_rad
        if before_s is None or told is None:
            self._told.add(stamp_s, np.zeros(N_JOINTS))
            return joints_rad
        dt_s = stamp_s - before_s
        went_on = self._told.add(stamp_s, told + dt_s * command_rad_s)
        if dt_s <= 0.0 or not (went_on and compare):
            self._constant = None
            return joints_rad
        self._now[:2] = self._now[0] + dt_s * command_rad_s, command_rad_s
        self._now[2] += moved
        self._slow += dt_s / (_SLOW_S + dt_s) * (self._now - self._slow)
        fast = self._now - self._slow
        keep = max(1.0 - float(fast[1] @ fast[1]) * dt_s / _MEMORY, 0.0)
        products = dt_s * fast[:2] @ fast.T
        self._normal = keep * self._normal + products[:, :2]
        self._right = keep * self._right + products[:, 2]
        gain, late = np.linalg.solve(self._normal, self._right)
        self.gain = float(min(max(gain, _LEAST_GAIN), 1.0))
        self.lag_s = float(min(max(-late / self.gain, 0.0), _MOST_S))
        return self._averaged(joints_rad, dt_s)

    def _averaged(self, joints_rad: np.ndarray, dt_s: float) -> np.ndarray:
        done, before = self._done(self.lag_s), self._done(self.lag_s + dt_s)
        if done is None or before is None:
            return joints_rad
        path = self.gain * done
        constant = joints_rad - path
        if self._constant is None:
            self._constant = constant
        # The faster of the command and of what it makes of the joints now.
        speed = np.maximum(np.abs(self._now[1]), np.abs(done - before) / dt_s)
        share = np.maximum(dt_s / _AVERAGED_S, speed**2 / (speed**2 + _MOVING_RAD_S**2))
        self._constant = self._constant + np.minimum(share, 1.0) * (constant - self._constant)
        return path + self._constant
