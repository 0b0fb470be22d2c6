"""The control loop's clock, for ages and time-outs, and its pace."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from math import inf

from fvs_ros.timeline import MAX_BACKSTEP_S

#: Simulated time that stands still for longer has ended or is paused, s. Longer than the simulator
#: waits for an answer.
_STILL_S = 5.0
#: Simulated time that advances by more at once has jumped, s.
_JUMP_S = 1.0
#: Count of stamps' steps from which on their median is the period; one may be odd.
_FEWEST = 4
#: Count of the last steps that it is taken of.
_MOST = 51
#: A joint state that has not come after this many periods is missing.
MISSING_PERIODS = 2.5
#: Shortest period, s: a watchdog at stamps of nanoseconds would never rest.
_MIN_PERIOD_S = 1e-4
#: Longest period, s: fewer joint states a second move no arm.
MAX_PERIOD_S = 0.05


class Pace:
    """What a tick counts for: the period of the joint states, however early or late one comes.

    A driver holds the last command, so it sees each tick as one step, whatever time has passed:
    time that was lost is not made up. The period, ``period_s``, is the median step of the stamps,
    at most that of a rate, Hz, if one is given; 0 while unknown.
    """

    def __init__(self, rate_hz: float = 0.0) -> None:
        self._most_s = min(1.0 / rate_hz, MAX_PERIOD_S) if rate_hz else MAX_PERIOD_S
        self.period_s = self._most_s if rate_hz else 0.0
        self._steps_s: deque[float] = deque(maxlen=_MOST)
        self._stamp_s = self._counted_s = -inf

    @property
    def missing_s(self) -> float:
        """Time without a joint state after which one is missing, s."""
        return MISSING_PERIODS * (self.period_s or MAX_PERIOD_S)

    def joint_state(self, stamp_s: float) -> float:
        """What a joint state with this stamp, s, counts for, s: a period, or nothing.

        Nothing if its stamp does not advance, or if :meth:`missing` has counted its time already.
        """
        step_s, self._stamp_s = stamp_s - self._stamp_s, stamp_s
        if 0.0 < step_s < inf:
            self._steps_s.append(step_s)
            if len(self._steps_s) >= _FEWEST:
                median_s = sorted(self._steps_s)[len(self._steps_s) // 2]
                self.period_s = min(max(median_s, _MIN_PERIOD_S), self._most_s)
        if -MAX_BACKSTEP_S <= stamp_s - self._counted_s < 0.5 * self.period_s:
            return 0.0
        self._counted_s = stamp_s
        return self.period_s

    def missing(self) -> float:
        """What a tick without a joint state counts for, s."""
        self._counted_s += self.period_s
        return self.period_s


class LoopClock:
    """Seconds for ages and time-outs; they never jump and never go back.

    In simulated time a busy machine makes nothing late. If simulated time stops, real time
    replaces it. Without ``simulated_s``, which returns simulated time, s, time is real.
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
