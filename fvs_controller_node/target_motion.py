"""Motion of the target, estimated from the updates of its position.

A target with frequent updates is a moving one. A curve through the last updates gives its velocity
and its position now, so that the loop acts before an error builds up. A target that is set once or
rarely, or that jumps, is fixed.

Measured targets are noisy, and the arm must not follow the noise. The candidates are constants,
lines and parabolas over several windows whose residual is within that noise. The one with the
smallest variance at its end is used: it has the longest window and the fewest terms.
"""

from __future__ import annotations

from collections import deque
from enum import Enum
from functools import cache
from math import inf
from operator import itemgetter

import numpy as np
from scipy.special import chdtri

from fvs_ros.filter import NoiseVariance
from fvs_ros.kinds import Kind
from fvs_ros.timeline import MAX_GAP_S
from fvs_ros.vectors import length

#: Least number of updates for a motion, and largest number kept.
_LEAST, _MOST = 3, 64
#: A polynomial term is significant if noise exceeds it once in so many updates: every false one
#: moves the arm.
_ONCE_IN = 1e4
#: Largest residual variance of a polynomial over the learned noise variance.
_SCATTER = 2.0
#: After so many updates in which it does not move, it rests; its noise is known then, too.
_RESTING = 12
#: Least noise, m.
_LEAST_NOISE_M = 5e-6
#: Shortest window, s and updates, and the ratio of the next longer one: a longer one is calmer, a
#: shorter one quicker at corners.
_WINDOW_S, _WINDOW, _LONGER = 0.15, 5, 1.6
#: Updates further apart than this, m, are two targets.
_JUMP_M = 0.05
#: No arm could follow a target that is faster, m/s.
_FASTEST_M_S = 1.0
#: A stamp further than this from the joint states' is of another clock, s.
_OWN_CLOCK_S = 0.2


class Update(Enum):
    """Kinds of position updates; of several cameras' the first of these counts."""

    NEW = "another target"
    CONTINUED = "the motion goes on"
    OVERTAKEN = "older than the last one of the same motion"


class TargetMotion:
    """Something measured that may move: where it is on its path, and how fast.

    On a curved kind of feature the path is a sum of tangent vectors, so that the motion is one of
    plain vectors.
    """

    def __init__(self, kind: Kind) -> None:
        self._kind = kind
        self._noise = NoiseVariance(3, _LEAST_NOISE_M, pooled=False)
        self.path_m = np.zeros(kind.size)  #: up to the newest measurement, (d,)
        self._updates: deque[tuple[float, np.ndarray]] = deque(maxlen=_MOST)
        self.forget()

    def forget(self) -> None:
        """Begin a new path; the learned noise stays."""
        self.last: np.ndarray | None = None  #: the newest measurement, (m,)
        self._restart()

    def _restart(self) -> None:
        self._updates.clear()
        self._noise.restart()
        self._curve: np.ndarray | None = None  # position, velocity, half the acceleration
        self._interval_s = 0.0  # between updates
        self._age_s = 0.0  # of the last one when it came

    @property
    def rests(self) -> bool:
        """Whether it has stood for a while, as far as its updates tell."""
        return len(self._updates) >= _RESTING and self._curve is not None and len(self._curve) == 1

    @property
    def noise_m(self) -> float:
        """Standard deviation of a coordinate of a measurement, as learned, m."""
        return float(np.mean(self._noise.variance_m2) ** 0.5)

    def add(self, z: np.ndarray, there_s: float = -inf, age_s: float = 0.0) -> Update:
        """Take a measurement, (m,), its time, s, and the message's age, s.

        A time of minus infinity sets a fixed target.
        """
        path_m = self.path_m if self.last is None else self.path_m + self._kind.minus(z, self.last)
        update = self.add_path(path_m, there_s, age_s)
        if update is not Update.OVERTAKEN:
            self.last = z
        return update

    def add_path(self, path_m: np.ndarray, there_s: float, age_s: float) -> Update:
        """Take the place on the path, m, (d,), where that is known instead; else as ``add``."""
        last_s = self._updates[-1][0] if self._updates else -inf
        near = there_s > -inf and -_OWN_CLOCK_S < there_s - last_s < MAX_GAP_S
        goes_on = near and length(path_m - self.path_m) < _JUMP_M
        if goes_on and there_s < last_s:
            return Update.OVERTAKEN
        self.path_m = path_m
        if not goes_on:
            self._restart()
            self._updates.append((there_s, self.path_m))
            return Update.NEW
        # Joint states, whose stamps may be the clock, can be rarer than updates.
        if there_s == last_s:
            self._updates.pop()
        else:
            self._noise.add(there_s, self.path_m)
        self._updates.append((there_s, self.path_m))
        self._fit(there_s)
        self._age_s = max(0.0, age_s)
        return Update.CONTINUED

    def _fit(self, now_s: float) -> None:
        """Find the polynomial to go on with, and the updates' interval."""
        if len(self._updates) < _LEAST:
            return
        times_s, places = map(np.array, zip(*self._updates, strict=True))
        since_s, deviation_m = times_s - now_s, self._noise.variance_m2**0.5
        # Less the last: identical updates then average to exactly the same position.
        places = (places - self.path_m) / deviation_m
        fits = list[tuple[np.ndarray, float]]()
        count = max(_WINDOW, int(np.sum(since_s >= -_WINDOW_S)))
        while not fits or count < _LONGER * len(since_s):
            fits.append(_polynomial(since_s[-count:], places[-count:]))
            count = int(_LONGER * count)
        self._curve = min(fits, key=itemgetter(1))[0] * deviation_m
        self._curve[0] += self.path_m
        self._interval_s = float(np.diff(times_s[-_WINDOW:]).mean())

    def at(self, now_s: float) -> tuple[np.ndarray | None, np.ndarray, np.ndarray | None]:
        """Where it is now, s, as a measurement, (m,), and on its path, m, (d,); and how fast, m/s.

        After the last update it continues for a few intervals, without curvature after the first
        one. Then it stands where it was last; if it rests, in the mean of its places. No velocity
        where it stands, and no measurement before the first.
        """
        stands, curve = (self.last, self.path_m, None), self._curve
        if curve is None:
            return stands
        since_s = now_s - self._updates[-1][0]
        # A target stamped slightly ahead of the joint states is interpolated backwards.
        goes_on_s = inf if self.rests else self._age_s + min(MAX_GAP_S, 3.0 * self._interval_s)
        if not -_OWN_CLOCK_S < since_s < goes_on_s:
            return stands
        position_m, velocity_m_s = curve[0], np.zeros(self._kind.size)
        if len(curve) > 1:
            position_m, velocity_m_s = position_m + since_s * curve[1], curve[1]
        if len(curve) > 2:
            bent_s = min(since_s, self._age_s + self._interval_s)
            position_m = position_m + bent_s * (2.0 * since_s - bent_s) * curve[2]
            velocity_m_s = velocity_m_s + 2.0 * bent_s * curve[2]
        if length(velocity_m_s) > _FASTEST_M_S:
            return stands
        gone_m, z = position_m - self.path_m, self.last
        if z is not None and gone_m.any():
            z = self._kind.retract(z, gone_m)
        return z, position_m, velocity_m_s


def _polynomial(times_s: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, float]:
    """Coefficients of the simplest polynomial, (terms, d), and its end's variance over the noise.

    If no polynomial fits within the noise: the highest one, and an infinite variance.
    """
    count = len(times_s)
    most = min(3, count - 1)  # a parabola
    basis, factor = np.linalg.qr(np.vander(times_s, min(most + 1, count), increasing=True))
    parts = basis.T @ places
    # The parts are of orthonormal polynomials: where there is only noise, each has its variance.
    sizes = (parts**2).mean(axis=1)
    rest = places - basis[:, :most] @ parts[:most]
    scatter = float((rest**2).sum()) / (places.shape[1] * (count - most))
    stands_out = np.flatnonzero(sizes > _significant(places.shape[1]) * max(1.0, scatter))
    terms = 1 + int(stands_out[-1]) if len(stands_out) else 1
    explained = terms <= most and scatter <= _SCATTER
    used = slice(min(terms, most))
    curve = np.linalg.solve(factor[used, used], parts[used])
    return curve, float((basis[-1, used] ** 2).sum()) if explained else np.inf


@cache
def _significant(d: int) -> float:
    """The mean square of d coordinates of noise, over its variance, that is that rare."""
    return float(chdtri(d, 1.0 / _ONCE_IN)) / d  # chi-square; scipy.stats takes long to import


def on_own_clock(stamp_s: float, now_s: float) -> float:
    """The stamp, or now if the stamp is of another clock, s."""
    return stamp_s if abs(stamp_s - now_s) < _OWN_CLOCK_S else now_s


class TargetMotions:
    """The motions of what each camera is to show: it is told of them one by one, or of all."""

    def __init__(self, kind: Kind) -> None:
        self._each = [TargetMotion(part) for part in kind.parts]
        self._rows = kind.rows

    def forget(self) -> None:
        """Know nothing of them."""
        for motion in self._each:
            motion.forget()

    @property
    def path_m(self) -> np.ndarray:
        """How far they have gone, m, (d,)."""
        return np.concatenate([motion.path_m for motion in self._each])

    @property
    def last(self) -> np.ndarray | None:
        """What was measured last, (m,); None before the first."""
        last = [motion.last for motion in self._each if motion.last is not None]
        return np.concatenate(last) if len(last) == len(self._each) else None

    @property
    def rests(self) -> bool:
        """Whether all have stood for a while, as far as their updates tell."""
        return all(motion.rests for motion in self._each)

    @property
    def noise_m(self) -> float:
        """Standard deviation of a coordinate of a measurement, as learned, m: the largest."""
        return max(motion.noise_m for motion in self._each)

    def add(self, z: np.ndarray, there_s: float, age_s: float, camera: int | None = None) -> Update:
        """Take a measurement, (m,), or of it a camera's part; else as :meth:`TargetMotion.add`."""
        updates = {
            motion.add(z[rows], there_s, age_s)
            for i, (motion, rows) in enumerate(zip(self._each, self._rows, strict=True))
            if camera in (None, i)
        }
        return next(update for update in Update if update in updates)

    def at(self, now_s: float) -> tuple[np.ndarray | None, np.ndarray, np.ndarray | None]:
        """As :meth:`TargetMotion.at`, of all."""
        places, paths_m, velocities = zip(*(motion.at(now_s) for motion in self._each), strict=True)
        known = [z for z in places if z is not None]
        z = np.concatenate(known) if len(known) == len(places) else None
        if all(velocity is None for velocity in velocities):
            return z, np.concatenate(paths_m), None
        velocity_m_s = [
            np.zeros_like(path_m) if velocity is None else velocity
            for velocity, path_m in zip(velocities, paths_m, strict=True)
        ]
        return z, np.concatenate(paths_m), np.concatenate(velocity_m_s)
