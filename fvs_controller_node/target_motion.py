"""How a target moves, from the updates of its position.

A target that is told again and again is a moving one. A parabola through its last updates gives
its velocity and where it is now; the loop then need not wait for an error to see that the target
has gone on. A target told once, or seldom, or that jumps, stands where it was told.

Who measures a target tells its noise, too, and no arm shall go along with that. What no parabola
through four updates explains is noise: its variance is known from many of them. As many updates
are looked at as one parabola explains within that noise, and a curvature or a velocity is taken
for one only where noise would hardly feign it. A noisy target that stands is where its updates are
on average.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fvs_controller_node.pseudo_inverse import DampedInverse
from fvs_controller_node.redundancy import Inverse
from fvs_ros.vectors import length

#: Updates that make a motion, and from which on its curvature is believed; most that are kept.
_LEAST, _CURVED, _MOST = 3, 5, 64
#: What three squares of noise of unit variance sum up to: in the median, and what they exceed one
#: time in ten and in a hundred.
_MEDIAN, _LIKELY, _SIGNIFICANT = 2.366, 6.25, 11.3
#: Updates may scatter about a parabola by this times the variance learned.
_SCATTER = 2.0
#: Least noise, m; the one that is supposed until so many updates have told it; so many tell it.
_LEAST_NOISE_M, _SUPPOSED_M, _SUPPOSED, _REMEMBERED = 5e-6, 2e-3, 4, 200
#: Shortest window, s: a longer one is calmer, a shorter one quicker at corners.
_WINDOW_S = 0.15
#: Updates further apart than this are two targets, s.
_MAX_GAP_S = 0.25
#: No target goes further than this between two updates: it is another one, m.
_JUMP_M = 0.05
#: No target that an arm could go along with is faster, m/s.
_FASTEST_M_S = 1.0
#: So many intervals between updates a motion goes on without a further one, and it is no faster
#: than the fastest step by this factor: one odd update must not throw the target about.
_INTERVALS, _FASTER = 3.0, 1.2
#: A stamp further than this from the joint states' is of another clock, s.
_OWN_CLOCK_S = 0.2


@dataclass(frozen=True)
class Target:
    """Where a target is and how it moves.

    Parameters
    ----------
    position_m : ndarray, shape (3,)
        m.
    velocity_m_s : ndarray, shape (3,)
        m/s.
    """

    position_m: np.ndarray
    velocity_m_s: np.ndarray


class _Parabola:
    """Parabola through updates, a line through few; by parts of degree 0, 1, 2 and one more.

    The parts are of orthonormal polynomials: where there is only noise, each has its variance.
    """

    def __init__(self, updates: Sequence[tuple[float, np.ndarray]]) -> None:
        last_s, self._last = updates[-1]
        self.since_s = np.array([time_s - last_s for time_s, _ in updates])
        # From the last one: the mean of what is always the same is that, to the bit.
        self.positions = np.array([position for _, position in updates]) - self._last
        count = len(updates)
        self._terms = 3 if count >= _CURVED else 2
        powers = np.vander(self.since_s, min(count, _CURVED - 1), increasing=True)
        basis, self._factor = np.linalg.qr(powers)
        self._parts = basis.T @ self.positions
        self._sizes_m2 = (self._parts**2).sum(axis=1)
        rest = self.positions - basis[:, : self._terms] @ self._parts[: self._terms]
        self._rest_m2 = float((rest**2).sum()) / (self.positions.shape[1] * (count - self._terms))

    @property
    def mean(self) -> np.ndarray:
        """Mean position, m, shape (3,)."""
        return self._last + self.positions.mean(axis=0)

    def explains(self, noise_m2: float) -> bool:
        """Whether noise of a variance, m^2, may be all that is left."""
        if self._rest_m2 > _SCATTER * noise_m2:
            return False
        if self._terms < 3:
            return True
        # What bends is likely to bend further: a window is soon too long there.
        bends = self._stands_out(2, noise_m2)
        return not self._stands_out(3, noise_m2, _LIKELY if bends else _SIGNIFICANT)

    def _stands_out(self, degree: int, noise_m2: float, factor: float = _SIGNIFICANT) -> bool:
        """Whether neither the noise nor what is left of the updates would feign such a part."""
        return bool(self._sizes_m2[degree] > factor * max(noise_m2, self._rest_m2))

    def curve(self, noise_m2: float) -> np.ndarray | None:
        """Position, velocity and half the acceleration at the last update, up to what is believed.

        None if that is not even a velocity. The noise's variance is in m^2.
        """
        for degree in range(self._terms - 1, 0, -1):
            if self._stands_out(degree, noise_m2):
                used = slice(degree + 1)
                curve = np.linalg.solve(self._factor[used, used], self._parts[used])
                curve[0] += self._last
                return curve
        return None


class TargetMotion:
    """The target's motion over time.

    At least five updates and those of ``_WINDOW_S`` are looked at, and more while one parabola
    explains them within their noise.
    """

    def __init__(self) -> None:
        self._updates: deque[tuple[float, np.ndarray]] = deque(maxlen=_MOST)
        self._scatter_m2 = deque([_MEDIAN * _SUPPOSED_M**2] * _SUPPOSED, maxlen=_REMEMBERED)
        self._told: Target | None = None  # where it was told last
        self._mean: Target | None = None  # of a noisy one that stands
        self._curve: np.ndarray | None = None
        self._interval_s, self._fastest_m_s = 0.0, 0.0  # between updates
        self._age_s = 0.0  # of the last one when it was told

    def restart(self, position_m: np.ndarray, now_s: float = 0.0) -> None:
        """Take a target that stands; how noisy updates are stays known."""
        self._updates.clear()
        self._take(np.array(position_m, dtype=float), now_s)
        self._curve = self._mean = None

    def _take(self, position: np.ndarray, now_s: float) -> None:
        self._updates.append((now_s, position))
        self._told = Target(position, np.zeros_like(position))

    def continues(self, position_m: np.ndarray, now_s: float) -> bool:
        """Whether a position, m, (3,), at a time, s, is of a target on its way."""
        if not self._updates:
            return False
        last_s, last = self._updates[-1]
        soon = -_OWN_CLOCK_S < now_s - last_s < _MAX_GAP_S
        return soon and length(position_m - last) < _JUMP_M

    def overtaken(self, position_m: np.ndarray, now_s: float) -> bool:
        """Whether an update, m, (3,), of a time, s, comes after a newer one of the same way."""
        return self.continues(position_m, now_s) and now_s < self._updates[-1][0]

    def update(self, position_m: np.ndarray, now_s: float, age_s: float = 0.0) -> bool:
        """Take the target's position at a time, s, told so much later; whether it goes on a way."""
        position = np.array(position_m, dtype=float)
        if not self.continues(position, now_s):
            self.restart(position, now_s)
            return False
        if self.overtaken(position, now_s):
            return True
        # Joint states, whose stamps may be the clock, can be rarer than updates.
        if now_s == self._updates[-1][0]:
            self._updates.pop()
            self._take(position, now_s)
        else:
            self._take(position, now_s)
            self._learn_noise()
        self._fit(now_s)
        self._age_s = max(0.0, age_s)
        return True

    @property
    def noise_m(self) -> float:
        """Noise of the updates, standard deviation of each coordinate, m."""
        # Corners and odd updates are no noise: the median does without them.
        return max(_LEAST_NOISE_M, float(np.sqrt(np.median(self._scatter_m2) / _MEDIAN)))

    def _learn_noise(self) -> None:
        """Take what no parabola through the last four updates explains for noise."""
        if len(self._updates) < 4:
            return
        times_s, positions = zip(*list(self._updates)[-4:], strict=True)
        apart_s = np.subtract.outer(times_s, times_s)
        np.fill_diagonal(apart_s, 1.0)
        weights = 1.0 / apart_s.prod(axis=1)  # of the third divided difference
        rest = weights @ np.array(positions) / length(weights)
        self._scatter_m2.append(float(rest @ rest))

    def _fit(self, now_s: float) -> None:
        self._curve = self._mean = None
        if len(self._updates) < _LEAST:
            return
        noise_m2 = self.noise_m**2
        fit = _Parabola(self._updates)
        while not (explained := fit.explains(noise_m2)) and self._forget(now_s):
            fit = _Parabola(self._updates)
        self._curve = fit.curve(noise_m2)
        if self._curve is None and explained:
            self._mean = Target(fit.mean, np.zeros_like(fit.mean))
        steps_s = np.diff(fit.since_s)
        self._interval_s = float(steps_s.mean())
        steps_m = np.linalg.norm(np.diff(fit.positions, axis=0), axis=1)
        self._fastest_m_s = _FASTER * float((steps_m / np.maximum(steps_s, 1e-3)).max())

    def _forget(self, now_s: float) -> bool:
        """Leave out the oldest quarter of the updates, down to the shortest window."""
        least = max(_CURVED, sum(now_s - time_s <= _WINDOW_S for time_s, _ in self._updates))
        few = min(len(self._updates) - least, max(1, len(self._updates) // 4))
        for _ in range(few):
            self._updates.popleft()
        return few > 0

    def at(self, now_s: float) -> Target | None:
        """The target now, s; None before the first one.

        After the last update was told it goes on for a few intervals, straight on after the first,
        and then stands where it was told last. One that stands is the same object, whenever one
        asks.
        """
        if not self._updates:
            return None
        last_s, last = self._updates[-1]
        since_s = now_s - last_s
        curve = self._curve
        # A target stamped a little ahead of the joint states is looked back at.
        longest_s = self._age_s + min(_MAX_GAP_S, _INTERVALS * self._interval_s)
        if not -_OWN_CLOCK_S < since_s < longest_s:
            return self._told
        if curve is None:
            return self._mean or self._told
        velocity = curve[1].copy()
        position = curve[0] + since_s * velocity
        if len(curve) > 2:
            bent_s = min(since_s, self._age_s + self._interval_s)
            position += bent_s * (2.0 * since_s - bent_s) * curve[2]
            velocity += 2.0 * bent_s * curve[2]
        speed = length(velocity)
        if speed > _FASTEST_M_S:
            return self._told
        if speed > self._fastest_m_s:
            velocity *= self._fastest_m_s / speed
            position = last + since_s * velocity
        return Target(position, velocity)


class TargetFollower:
    """Keeps up with a moving target: where it is now, and the joint motion that goes along.

    Parameters
    ----------
    enabled : bool
        Off: every target stands where it was told last.
    inverse : Inverse, optional
        From ball velocity to joint velocities.
    """

    def __init__(self, enabled: bool = True, inverse: Inverse | None = None) -> None:
        self._motion = TargetMotion()
        self.configure(enabled, inverse or DampedInverse())
        self._stamped = False  # the last update

    def configure(self, enabled: bool, inverse: Inverse) -> None:
        """Change the settings and keep the motion."""
        self.enabled, self._inverse = enabled, inverse

    def expects(self, position_m: np.ndarray, stamp_s: float, now_s: float) -> bool:
        """Whether a target there would go on with the motion rather than be another one."""
        return self._motion.continues(
            np.asarray(position_m, dtype=float), _on_own_clock(stamp_s, now_s)
        )

    def overtaken(self, position_m: np.ndarray, stamp_s: float, now_s: float) -> bool:
        """Whether a target comes after one that was told earlier and was there later.

        Nobody knows when one without a stamp was there: it overtakes none.
        """
        position = np.asarray(position_m, dtype=float)
        return self._in_order and self._motion.overtaken(position, _on_own_clock(stamp_s, now_s))

    @property
    def _in_order(self) -> bool:
        """Whether it matters, and is known, which target was there later."""
        return self.enabled and self._stamped

    def update(self, position_m: np.ndarray, stamp_s: float, now_s: float) -> None:
        """Take a target that was there at a stamp; one from another clock counts from now, s."""
        position = np.asarray(position_m, dtype=float)
        there_s = _on_own_clock(stamp_s, now_s)
        stamped = there_s == stamp_s
        if not self._in_order and self._motion.overtaken(position, there_s):
            there_s = now_s
        self._motion.update(position, there_s, now_s - there_s)
        self._stamped = stamped

    def stand(self, position_m: np.ndarray, now_s: float) -> None:
        """Take a target that stands, whatever moved before, m, (3,)."""
        self._motion.restart(position_m, now_s)
        self._stamped = True  # that this is now is certain

    def at(self, now_s: float) -> Target | None:
        """The target now, s; None before the first, and for one that is told to stand."""
        return self._motion.at(now_s) if self.enabled else None

    def feed_forward(
        self,
        velocity_m_s: np.ndarray,
        jacobian: np.ndarray,
        joints_rad: np.ndarray,
        home_rad: np.ndarray | None = None,
    ) -> np.ndarray:
        """Joint velocities that go along with a target's velocity, m/s, (3,); rad/s, shape (n,).

        On the way they come back to ``home_rad``, (n,), if that costs little speed.
        """
        return self._inverse.joint_velocity(jacobian, velocity_m_s, joints_rad, home_rad)


def _on_own_clock(stamp_s: float, now_s: float) -> float:
    """The stamp, or now if the stamp is of another clock, s."""
    return stamp_s if abs(stamp_s - now_s) < _OWN_CLOCK_S else now_s
