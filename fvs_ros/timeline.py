"""Time stamps: recent joint states, and the joints at an image's exposure.

A feature carries the stamp of its exposure. :class:`Timeline` finds the joints at that
stamp, waiting for a later joint state if need be, and numbers continuous runs of such samples.
Whatever breaks the flow of time (a gap, a repeated or older stamp, a clock jump, a lost feature)
starts a new run, and nothing is ever paired across runs.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from math import pi
from typing import NamedTuple

import numpy as np

from fvs_ros.vectors import largest

#: Fastest joint, rad/s, and slack of a step between two joint states, rad: more is a jump.
_FASTEST_RAD_S, _JUMP_RAD = 1.5 * pi, 0.1

#: A stamp that goes back by no more is a late message; by more, the clock jumped, s.
MAX_BACKSTEP_S = 0.1

#: A history reaches back this far; two samples further apart are not interpolated, s.
_LENGTH_S, _MAX_INTERVAL_S = 2.0, 0.1

#: Two images, or updates of a target, further apart than this do not belong together, s.
MAX_GAP_S = 0.25

#: Images that may wait for later joint states; the oldest gives way.
_MAX_WAITING = 10

#: A feature stamped further before the newest joint state is not paired: no camera is that
#: slow, so the two clocks differ, s.
MAX_LATENCY_S = 0.5


def possible_step_rad(passed_s: float) -> float:
    """The largest step that a joint can make in this time, s."""
    return _JUMP_RAD + _FASTEST_RAD_S * abs(passed_s)


def repeats(stamp_s: float, last_s: float | None) -> bool:
    """Whether a stamp, s, is that of the last message, or slightly older: it is no fresh one."""
    return last_s is not None and last_s - MAX_BACKSTEP_S <= stamp_s <= last_s


class History:
    """The last two seconds of joint positions, or of another vector that follows from them.

    Stamps must come from one clock. A stamp that goes back by more than a tenth of a second, or
    forward by more than the history's length, is a clock jump and starts the history anew;
    a repeated or slightly older stamp (a duplicate, a reordered message) is ignored.
    """

    def __init__(self) -> None:
        self._stamps: deque[float] = deque()
        self._values: deque[np.ndarray] = deque()

    @property
    def newest_stamp_s(self) -> float | None:
        """Stamp of the newest sample, s, or None when empty."""
        return self._stamps[-1] if self._stamps else None

    @property
    def newest(self) -> np.ndarray | None:
        """Newest value, or None when empty."""
        return self._values[-1] if self._values else None

    def clear(self) -> None:
        """Forget all samples."""
        self._stamps.clear()
        self._values.clear()

    def add(self, stamp_s: float, value: np.ndarray) -> bool:
        """Append a sample.

        Parameters
        ----------
        stamp_s : float
            Time of the sample, s.
        value : ndarray
            Joint positions, rad.

        Returns
        -------
        bool
            False if the clock jumped, so that the history was started anew.
        """
        if repeats(stamp_s, self.newest_stamp_s):
            return True
        jumped = bool(self._stamps) and not 0.0 < stamp_s - self._stamps[-1] <= _LENGTH_S
        if jumped:
            self.clear()
        self._stamps.append(stamp_s)
        self._values.append(np.array(value, dtype=float))
        while self._stamps[-1] - self._stamps[0] > _LENGTH_S:
            self._stamps.popleft()
            self._values.popleft()
        return not jumped

    def at(self, stamp_s: float) -> np.ndarray | None:
        """Value at a moment, by linear interpolation.

        Parameters
        ----------
        stamp_s : float
            The moment, s.

        Returns
        -------
        ndarray or None
            None where the history does not reach, or has a gap.
        """
        if not self._stamps or not self._stamps[0] <= stamp_s <= self._stamps[-1]:
            return None
        right = bisect_right(self._stamps, stamp_s)
        if right == len(self._stamps):
            return self._values[-1].copy()
        t0, t1 = self._stamps[right - 1], self._stamps[right]
        if t1 - t0 > _MAX_INTERVAL_S:
            return None
        fraction = (stamp_s - t0) / (t1 - t0)
        return (1.0 - fraction) * self._values[right - 1] + fraction * self._values[right]


class Sample(NamedTuple):
    """An image and the joints at its exposure.

    Parameters
    ----------
    stamp_s : float
        Exposure time, s.
    joints_rad : ndarray, shape (n,)
        Joint positions at that time, rad.
    feature_m : ndarray, shape (m,)
        Feature in the camera frame, m.
    run : int
        Number of the continuous run it belongs to.
    """

    stamp_s: float
    joints_rad: np.ndarray
    feature_m: np.ndarray
    run: int


class Timeline:
    """Finds the joints at each image's exposure.

    Attributes
    ----------
    joints : History
        Of the joint positions, rad, (n,).
    seen_stamp_s : float or None
        Newest exposure, paired or not, s; None before the first.
    dropped : int
        Number of features that could not be paired.
    last_reason : str
        Why the last feature was dropped; empty if none was.
    clock_jumps : int
        How often one of the two clocks jumped.
    """

    def __init__(self) -> None:
        self.joints = History()
        self._waiting: deque[tuple[float, np.ndarray]] = deque()
        self.seen_stamp_s: float | None = None
        self._paired_stamp_s: float | None = None
        self._run = 0
        self.dropped = self.clock_jumps = 0
        self.last_reason = ""

    def reset(self) -> None:
        """Forget all joint states and waiting features, and start a new run."""
        self.joints.clear()
        self._waiting.clear()
        self.seen_stamp_s = None
        self._break_run()

    def add_joints(self, stamp_s: float, joints_rad: np.ndarray) -> list[Sample]:
        """Take a joint state, s and rad, (n,); returns the features that waited for it."""
        newest, newest_s = self.joints.newest, self.joints.newest_stamp_s
        passed_s = 0.0 if newest_s is None else stamp_s - newest_s
        if passed_s > 0.0 and largest(joints_rad - newest) > possible_step_rad(passed_s):
            self.joints.clear()
            self._drop("the joints jumped", len(self._waiting))
        if not self.joints.add(stamp_s, joints_rad):
            self._drop("the joint states' clock jumped", len(self._waiting))
            self.seen_stamp_s = None
            self.clock_jumps += 1
        return self._pair()

    def add_feature(self, stamp_s: float, feature_m: np.ndarray) -> list[Sample]:
        """Take a feature, exposure in s and m, (m,); returns what can be paired now."""
        last = self.seen_stamp_s
        if repeats(stamp_s, last):
            self._drop("a feature's stamp is repeated or older than the last")
            return []
        if last is not None and stamp_s < last:
            self._drop("the features' clock jumped back", len(self._waiting))
            self.clock_jumps += 1
        self.seen_stamp_s = stamp_s
        self._waiting.append((stamp_s, np.array(feature_m, dtype=float)))
        if len(self._waiting) > _MAX_WAITING:
            self._waiting.popleft()
            self._drop("no joint state came for a feature")
        return self._pair()

    def _pair(self) -> list[Sample]:
        samples = []
        newest = self.joints.newest_stamp_s
        while self._waiting and newest is not None and self._waiting[0][0] <= newest:
            stamp_s, feature_m = self._waiting.popleft()
            if newest - stamp_s > MAX_LATENCY_S:
                self._drop(
                    f"a feature is stamped {newest - stamp_s:.2f} s before the newest joint "
                    "state; check that both clocks agree (NTP)"
                )
                continue
            joints = self.joints.at(stamp_s)
            if joints is None:
                self._drop("the joint states have a gap at a feature's exposure")
                continue
            last = self._paired_stamp_s
            if last is not None and not 0.0 < stamp_s - last <= MAX_GAP_S:
                self._run += 1
            self._paired_stamp_s = stamp_s
            samples.append(Sample(stamp_s, joints, feature_m, self._run))
        return samples

    def _drop(self, reason: str, waiting: int | None = None) -> None:
        """Count features that are lost: one, or all that wait; start a new run."""
        if waiting is not None:
            self._waiting.clear()
        self.dropped += 1 if waiting is None else waiting
        self.last_reason = reason
        self._break_run()

    def _break_run(self) -> None:
        if self._paired_stamp_s is not None:
            self._run += 1
        self._paired_stamp_s = None
