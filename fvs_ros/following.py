"""Whether each joint follows its command: commanded against measured motion."""

from __future__ import annotations

from math import inf
from typing import NamedTuple

import numpy as np

from fvs_ros.clock import MAX_PERIOD_S, MISSING_PERIODS
from fvs_ros.timeline import History
from fvs_ros.vectors import largest

#: No drive lags by more, s.
LONGEST_LAG_S = 0.2
#: Least motion beyond its lag by which a joint is judged, rad (m).
_ASKED_RAD = 0.03
#: Least share of it that a joint makes: a speed slider that nobody reports may be at a fifth.
_LEAST_SHARE = 0.15
#: Comparisons begin anew after this much of a joint's path, rad (m); a look takes a while, so there
#: is one after half of it.
_APART_RAD = 0.5 * _ASKED_RAD
#: Count of open comparisons: far enough back for the lag at full speed.
_OPEN = 20
#: Joint states may be late, or apart, by this: at 1 rad/s that is what a comparison leaves, s.
_SURE_S = 0.025
#: Weight of a joint state when their period is learned.
_LEARNING = 0.1
#: What is forgotten of lateness, s per s.
_FORGET = 0.05


class TrackingFault(NamedTuple):
    """A joint, by its place, that does not follow: motion commanded, and made since then."""

    joint: int
    commanded_rad: float
    moved_rad: float


class Following:
    """Compares the commanded path with the joint states, by their stamps.

    With a lag of at most ``lag``, a joint is between ``path(t - lag)`` and ``path(t)``. Since a
    comparison began it was asked to move at least the gap between that interval then and now.
    """

    def __init__(self) -> None:
        self._path = History()  # as commanded, rad, (n,), by the time that was judged
        self._looked = np.zeros(0)  # the path at the last look
        self._before = np.zeros(0)  # the command before the path began, rad/s
        #: Where comparisons began, newest first: least and largest path that may be done then, the
        #: joints and the path, (4, k, n).
        self._begun = np.zeros((4, _OPEN, 0))
        self._period_s = MAX_PERIOD_S  # of the joint states
        self._least_late_s = inf  # from their stamps to their arrivals
        self.restart()

    def restart(self) -> None:
        """Begin anew: a start, a hold."""
        self._path.clear()
        self._stamp_s: float | None = None  # of the last joint state
        self.fault: TrackingFault | None = None  #: the joint that does not follow; None if all do

    def add(
        self,
        now_s: float,
        stamp_s: float,
        command_rad_s: np.ndarray,
        joints_rad: np.ndarray,
        lag_s: float = LONGEST_LAG_S,
    ) -> None:
        """Take a joint state, (n,), its arrival and stamp, and the command in force before, (n,).

        After a gap it begins anew: a velocity goes on in it, but a position stands. So it does at
        a late joint state: commands are late then, too. ``lag_s`` is the largest lag that the
        drives may have.
        """
        step_s = 0.0 if self._stamp_s is None else stamp_s - self._stamp_s
        self._stamp_s = stamp_s
        late_s, goes_on = now_s - stamp_s, 0.0 < step_s < 1.0  # no clock has jumped
        calmer_s = self._least_late_s + _FORGET * step_s if goes_on else inf
        self._least_late_s = min(late_s, calmer_s)
        apart_s = max(MISSING_PERIODS * self._period_s, _SURE_S)
        gap = not (0.0 < step_s <= apart_s and late_s - self._least_late_s <= _SURE_S)
        self._period_s += _LEARNING * (min(max(step_s, 0.0), MAX_PERIOD_S) - self._period_s)
        if gap:
            self._path.clear()
            self._path.add(0.0, np.zeros_like(joints_rad))
            self._before = command_rad_s
            self._looked = np.zeros_like(joints_rad)
            self._begun = np.zeros((4, _OPEN, joints_rad.size))
            self._begun[0], self._begun[1] = np.sort([-lag_s * command_rad_s, self._looked], axis=0)
            self._begun[2] = joints_rad
            return
        path, time_s = self._path.newest, self._path.newest_stamp_s
        assert path is not None
        assert time_s is not None
        path, time_s = path + step_s * command_rad_s, time_s + step_s
        self._path.add(time_s, path)
        if largest(path - self._looked) >= 0.5 * _APART_RAD:
            then_s = time_s - lag_s - self._period_s  # a command waits for a joint state, too
            late = self._path.at(then_s)
            self._look(path, then_s * self._before if late is None else late, joints_rad)

    def _look(self, path: np.ndarray, late: np.ndarray, joints: np.ndarray) -> None:
        """Compare, with the path now and a lag ago and the joints, rad, (n,)."""
        self._looked, begun = path, self._begun
        low, high, moved = np.minimum(path, late), np.maximum(path, late), joints - begun[2]
        stuck = _astray(low - begun[1], high - begun[0], moved)
        stuck |= _astray(begun[0] - high, begun[1] - low, -moved)
        if stuck.any():
            since, joint = np.argwhere(stuck)[0]
            commanded_rad = float(path[joint] - begun[3, since, joint])
            self.fault = TrackingFault(int(joint), commanded_rad, float(moved[since, joint]))
        far = np.abs(path - begun[3, 0]) >= _APART_RAD
        if far.any():
            begun[:, 1:, far] = begun[:, :-1, far]
            begun[:, 0, far] = np.array([low, high, joints, path])[:, far]


def _astray(least: np.ndarray, most: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """Which joints were asked to go one way only, and did not, or went the other way."""
    made = np.where(least >= _ASKED_RAD, _LEAST_SHARE * least, -_ASKED_RAD)
    return (least >= 0.0) & (most >= _ASKED_RAD) & (moved < made)
