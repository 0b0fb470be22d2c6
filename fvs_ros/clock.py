"""The control loop's clock, for ages and time-outs."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

#: Simulated time that stands still for longer has ended or is paused, s. Longer than the simulator
#: waits for an answer.
_STILL_S = 5.0
#: Simulated time that advances by more at once has jumped, s.
_JUMP_S = 1.0
#: With this number of running programs per core, some are late.
_PROGRAMS_PER_CORE = 2.0


def blamed(lateness: str) -> str:
    """Words on an input that is late, with the cause before them if this computer is too busy."""
    try:
        running = int(Path("/proc/loadavg").read_text().split()[3].partition("/")[0])
    except (OSError, ValueError, IndexError):  # not on this system
        return lateness
    busy = running >= _PROGRAMS_PER_CORE * len(os.sched_getaffinity(0))
    return f"this computer is too busy: {lateness}" if busy else lateness


class LoopClock:
    """Seconds for ages and time-outs; they never jump and never go back.

    In simulated time a busy machine makes nothing late. If simulated time stops, real time
    replaces it.

    Parameters
    ----------
    simulated_s : callable, optional
        Returns simulated time, s; without it, time is real.
    steady_s : callable
        Returns real time, s.
    """

    def __init__(
        self,
        simulated_s: Callable[[], float] | None = None,
        steady_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._simulated_s, self._steady_s = simulated_s, steady_s
        self._now_s = self._heard_s = steady_s()
        self._stamp_s = 0.0

    def now_s(self) -> float:
        """Seconds since an arbitrary start."""
        steady_s = self._steady_s()
        if self._simulated_s is None:
            return steady_s
        passed_s = self._simulated_s() - self._stamp_s
        if passed_s != 0.0:
            self._stamp_s += passed_s
            self._heard_s = steady_s
            self._now_s += passed_s if 0.0 < passed_s < _JUMP_S else 0.0
        elif steady_s - self._heard_s > _STILL_S:
            self._now_s += steady_s - self._heard_s - _STILL_S
            self._heard_s = steady_s - _STILL_S
        return self._now_s
