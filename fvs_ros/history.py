"""Time-stamped joint positions, interpolated at an image's exposure."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from math import pi

import numpy as np

#: No joint is faster, nor a step between two joint states larger than this besides, rad/s and rad.
_FASTEST_RAD_S, _JUMP_RAD = 1.5 * pi, 0.1

#: A stamp that goes back by no more is a late message; by more, the clock jumped, s.
MAX_BACKSTEP_S = 0.1


def jump_of(step_rad: np.ndarray, passed_s: float) -> int | None:
    """The joint that made an impossible step, rad, (6,), in this time, s; None if none did."""
    joint = int(np.abs(step_rad).argmax())
    return joint if abs(step_rad[joint]) > _JUMP_RAD + _FASTEST_RAD_S * passed_s else None


class StampGate:
    """Lets a message pass whose stamp is newer than the last: a frozen stream is not fresh."""

    def __init__(self) -> None:
        self._last_s: float | None = None

    def advances(self, stamp_s: float) -> bool:
        """Whether the stamp is new, s."""
        last = self._last_s
        if last is not None and last - MAX_BACKSTEP_S <= stamp_s <= last:
            return False
        self._last_s = stamp_s
        return True


class JointHistory:
    """The last few seconds of joint positions.

    Stamps must come from one clock. A stamp that goes back by more than ``max_backstep_s``, or
    forward by more than the history's length, is a clock jump and starts the history anew;
    a repeated or slightly older stamp (a duplicate, a reordered message) is passed over.

    Parameters
    ----------
    length_s : float
        How far the history reaches back, s.
    max_gap_s : float
        No interpolation between two samples further apart than this, s.
    max_backstep_s : float
        Largest step back in time that is taken for a reordered message, s.
    """

    def __init__(
        self, length_s: float = 2.0, max_gap_s: float = 0.1, max_backstep_s: float = MAX_BACKSTEP_S
    ) -> None:
        self._length_s = length_s
        self._max_gap_s = max_gap_s
        self._max_backstep_s = max_backstep_s
        self._stamps: deque[float] = deque()
        self._joints: deque[np.ndarray] = deque()

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def newest_stamp_s(self) -> float | None:
        """Stamp of the newest sample, s, or None when empty."""
        return self._stamps[-1] if self._stamps else None

    @property
    def newest(self) -> np.ndarray | None:
        """Newest joint positions, rad, shape (6,), or None when empty."""
        return self._joints[-1] if self._joints else None

    def clear(self) -> None:
        """Forget everything."""
        self._stamps.clear()
        self._joints.clear()

    def add(self, stamp_s: float, joints_rad: np.ndarray) -> bool:
        """Append a sample.

        Parameters
        ----------
        stamp_s : float
            Time of the sample, s.
        joints_rad : ndarray, shape (6,)
            Joint positions, rad.

        Returns
        -------
        bool
            False if the clock jumped, so that the history was started anew.
        """
        jumped = False
        if self._stamps:
            step_s = stamp_s - self._stamps[-1]
            if -self._max_backstep_s <= step_s <= 0.0:
                return True
            if step_s < 0.0 or step_s > self._length_s:
                self.clear()
                jumped = True
        self._stamps.append(stamp_s)
        self._joints.append(np.array(joints_rad, dtype=float))
        while self._stamps[-1] - self._stamps[0] > self._length_s:
            self._stamps.popleft()
            self._joints.popleft()
        return not jumped

    def at(self, stamp_s: float) -> np.ndarray | None:
        """Joint positions at a moment, by linear interpolation.

        Parameters
        ----------
        stamp_s : float
            The moment, s.

        Returns
        -------
        ndarray, shape (6,), or None
            Positions, rad; None where the history does not reach, or has a gap.
        """
        if not self._stamps or not self._stamps[0] <= stamp_s <= self._stamps[-1]:
            return None
        right = bisect_right(self._stamps, stamp_s)
        if right == len(self._stamps):
            return self._joints[-1].copy()
        t0, t1 = self._stamps[right - 1], self._stamps[right]
        if t1 - t0 > self._max_gap_s:
            return None
        fraction = (stamp_s - t0) / (t1 - t0)
        return (1.0 - fraction) * self._joints[right - 1] + fraction * self._joints[right]
