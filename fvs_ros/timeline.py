"""Time stamps: recent joint states, and the joints at an image's exposure.

A measurement carries the stamp of its exposure. :class:`Timeline` finds the joints at that stamp,
waiting for a later joint state if need be, and numbers continuous runs of such samples. Whatever
breaks the flow of time (a gap, a repeated or older stamp, a clock jump, a lost image) starts a new
run, and nothing is ever paired across runs.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

#: A stamp that goes back by no more is a late message; by more, the clock jumped, s.
MAX_BACKSTEP_S = 0.1

#: A history reaches back this far, s.
_LENGTH_S = 2.0
#: Two samples further apart are not interpolated, s.
_MAX_INTERVAL_S = 0.1

#: Two images, or updates of a target, further apart than this do not belong together, s.
MAX_GAP_S = 0.25

#: Images that may wait for later joint states; the oldest gives way.
_MAX_WAITING = 10

#: An image stamped further before the newest joint state is not paired: no camera is that
#: slow, so the two clocks differ, s.
MAX_LATENCY_S = 0.5


def repeats(stamp_s: float, last_s: float | None) -> bool:
    """Whether a stamp, s, is that of the last message, or slightly older: it is no fresh one."""
    return last_s is not None and last_s - MAX_BACKSTEP_S <= stamp_s <= last_s


def too_slow(stamps_s: Sequence[float] | np.ndarray) -> str:
    """That images with these stamps, s, (k,), are too far apart for a run; empty if not."""
    gap_s = np.median(np.diff(stamps_s)) if len(stamps_s) > 4 else 0.0
    words = "images came at {:.1f} Hz, at least {:g} are needed"
    return words.format(1.0 / gap_s, 1.0 / MAX_GAP_S) if gap_s > MAX_GAP_S else ""


class History:
    """The last two seconds, or more, of a vector, such as the joint positions.

    Stamps must come from one clock. A stamp that goes back by more than a tenth of a second, or
    forward by more than the history's length, is a clock jump and starts the history anew;
    a repeated or slightly older stamp (a duplicate, a reordered message) is ignored.
    """

    def __init__(self) -> None:
        self._stamps: list[float] = []  # no deques: they are slow to look into
        self._values: list[np.ndarray] = []

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
        """Keep a sample; False if the clock jumped, so that the history was started anew."""
        newest_s = self.newest_stamp_s
        if repeats(stamp_s, newest_s):
            return True
        jumped = newest_s is not None and not 0.0 < stamp_s - newest_s <= _LENGTH_S
        if jumped:
            self.clear()
        self._stamps.append(stamp_s)
        self._values.append(value)
        if stamp_s - self._stamps[0] > 2.0 * _LENGTH_S:  # rarely: what stays is moved
            old = bisect_right(self._stamps, stamp_s - _LENGTH_S)
            del self._stamps[:old], self._values[:old]
        return not jumped

    def at(self, stamp_s: float) -> np.ndarray | None:
        """Value at a moment, s, by linear interpolation; None in a gap, or outside."""
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
    """An image and the joints at its exposure."""

    stamp_s: float  #: exposure, s
    joints_rad: np.ndarray  #: joints then, rad, (n,)
    z: np.ndarray  #: what was measured, (m,)
    run: int  #: number of the continuous run it belongs to


class Timeline:
    """Finds the joints at each image's exposure."""

    def __init__(self) -> None:
        self.joints = History()  #: of the joint positions, rad, (n,)
        self._waiting: deque[tuple[float, np.ndarray]] = deque()
        self.dropped = 0  #: images that could not be paired
        self.clock_jumps = 0  #: of one of the two clocks
        self._run = 0
        self._paired_s: float | None = None  # the newest exposure that was paired
        self.last_reason = ""  #: why the last image was dropped
        self.reset()

    def reset(self) -> None:
        """Forget all joint states and waiting images, and start a new run."""
        self.joints.clear()
        self._waiting.clear()
        self.seen_stamp_s: float | None = None  #: newest exposure, paired or not, s
        self._break_run()

    def add_joints(self, stamp_s: float, joints_rad: np.ndarray) -> list[Sample]:
        """Take a joint state, s and rad, (n,), no jump; returns the images that waited for it."""
        if not self.joints.add(stamp_s, joints_rad):
            self._drop("the joint states' clock jumped", len(self._waiting))
            self.seen_stamp_s = None
            self.clock_jumps += 1
        return self._pair()

    def add_image(self, stamp_s: float, z: np.ndarray) -> list[Sample]:
        """Take a measurement, (m,), and its exposure, s; returns what can be paired now."""
        last_s = self.seen_stamp_s
        if repeats(stamp_s, last_s):
            self._drop("an image's stamp is repeated or older than the last")
            return []
        if last_s is not None and stamp_s < last_s:
            self._drop("the images' clock jumped back", len(self._waiting))
            self.clock_jumps += 1
        self.seen_stamp_s = stamp_s
        self._waiting.append((stamp_s, np.array(z, dtype=float)))
        if len(self._waiting) > _MAX_WAITING:
            self._waiting.popleft()
            self._drop("no joint state came for an image")
        return self._pair()

    def _pair(self) -> list[Sample]:
        samples = []
        newest_s = self.joints.newest_stamp_s
        while self._waiting and newest_s is not None and self._waiting[0][0] <= newest_s:
            stamp_s, z = self._waiting.popleft()
            if newest_s - stamp_s > MAX_LATENCY_S:
                self._drop(
                    f"an image is stamped {newest_s - stamp_s:.2f} s before the newest joint "
                    "state; check that both clocks agree (NTP), use_sim_time and the images' delay"
                )
                continue
            joints_rad = self.joints.at(stamp_s)
            if joints_rad is None:
                self._drop("the joint states have a gap at an image's exposure")
                continue
            if self._paired_s is not None and not 0.0 < stamp_s - self._paired_s <= MAX_GAP_S:
                self._run += 1
            self._paired_s = stamp_s
            samples.append(Sample(stamp_s, joints_rad, z, self._run))
        return samples

    def _drop(self, reason: str, waiting: int | None = None) -> None:
        """Count images that are lost: one, or all that wait; start a new run."""
        if waiting is not None:
            self._waiting.clear()
        self.dropped += 1 if waiting is None else waiting
        self.last_reason = reason
        self._break_run()

    def _break_run(self) -> None:
        self._run, self._paired_s = self._run + 1, None
