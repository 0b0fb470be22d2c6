"""Is the ball getting to its target? Settled, growing, stalled and swinging errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fvs_ros.params import Parameters, parameter
from fvs_ros.vectors import length

#: Time constant of the low pass on the error norm, s.
_SMOOTHING_S = 0.1
#: The error has swung when it is this far from where it was, m: more than noise does. Without a
#: swing for this time, s, it has come to rest. A sustained oscillation sums up to this way, m, and
#: to twice the way to the target besides.
_SWING_M, _REST_S, _SWINGS_M = 0.01, 1.0, 0.5


@dataclass(frozen=True)
class ProgressLimits(Parameters):
    """When the error counts as settled, when as growing, and when as stalled."""

    settled_error_m: float = parameter(
        0.005, "Settled when the error stays below this for 0.3 s, m.", 1e-5, 1.0, live=True
    )
    stall_time_s: float = parameter(
        6.0,
        "Held when an error above 20 mm has not become smaller for this time, s; half of it for an "
        "arm that does not follow, a sixth for an error that grew by half and 30 mm.",
        0.1,
        60.0,
        live=True,
    )

    settled_time_s = 0.3
    #: The error has grown when it is above its best by both.
    growth_factor, growth_m = 1.5, 0.03
    #: Errors below this are never taken for a stall.
    stall_error_m = 0.02

    @property
    def growth_time_s(self) -> float:
        """The error may be larger than it was for this time, s: that is sure sooner."""
        return self.stall_time_s / 6.0


#: The best error must fall by this share of itself to count as progress.
_PROGRESS_SHARE = 0.03


class Progress:
    """Follows the error since the start, or since a new target."""

    def __init__(self, limits: ProgressLimits) -> None:
        self.limits = limits
        self._task: np.ndarray | None = None  # the target of the last restart, m
        self.restart()

    def take_target(self, target_m: np.ndarray) -> None:
        """Begin anew for a target, m, (m,), that is another one by more than errors may grow."""
        if self._task is None or _apart(target_m, self._task) > self.limits.growth_m:
            self._task = target_m
            self.restart()

    def restart(self) -> None:
        """Begin anew: a start, or another target."""
        self._smooth_m: float | None = None
        self._best_m = float("inf")
        self._up_s = 0.0
        self._near_s = 0.0
        self._best_target: np.ndarray | None = None  # where the target was then, m
        self._mark_m = float("inf")  # the best error when progress was last made
        self._mark_target: np.ndarray | None = None
        self._since_mark_s = 0.0
        self._swung_m: tuple[np.ndarray, np.ndarray | None] | None = None  # error, target
        self._swings_m, self._still_s, self._first_m = 0.0, 0.0, 0.0

    @property
    def best_m(self) -> float:
        """Least smoothed error since the start, m."""
        return self._best_m

    @property
    def smooth_m(self) -> float:
        """The smoothed error, m."""
        return float("inf") if self._smooth_m is None else self._smooth_m

    @property
    def settled(self) -> bool:
        """Whether the error has been small for long enough."""
        return self._near_s >= self.limits.settled_time_s

    @property
    def growing(self) -> bool:
        """Whether the error has been well above its best for too long."""
        return self._up_s >= self.limits.growth_time_s

    @property
    def stalled(self) -> bool:
        """Whether the error has been large for too long without getting smaller."""
        return self._since_mark_s >= self.limits.stall_time_s

    @property
    def swings_m(self) -> float:
        """How far the error has gone, there and back, without coming to rest, m."""
        return self._swings_m

    @property
    def swinging(self) -> bool:
        """Whether it goes to and fro and does not come to rest."""
        return self._swings_m > _SWINGS_M + 2.0 * self._first_m

    def add(
        self,
        error_m: np.ndarray,
        dt_s: float,
        servoing: bool,
        target_m: np.ndarray | None = None,
    ) -> None:
        """Tell a tick.

        Parameters
        ----------
        error_m : ndarray, shape (m,)
            The error, m.
        dt_s : float
            Time since the last tick, s.
        servoing : bool
            Whether the law is in charge: all but settling counts then only.
        target_m : ndarray, shape (m,), optional
            Where the target is, m: as far as it has gone from where it was at the best, a larger
            error is not the arm's doing.
        """
        norm_m = length(error_m)
        if self._smooth_m is None:
            self._smooth_m = self._first_m = norm_m
        self._smooth_m += (norm_m - self._smooth_m) * dt_s / (dt_s + _SMOOTHING_S)
        near = self._smooth_m < self.limits.settled_error_m
        self._near_s = self._near_s + dt_s if near else 0.0
        if not servoing:
            return  # the times stand still: a short gap in the inputs must not forgive what was
        self._swing(error_m, dt_s, target_m)
        best_m = self._best_m + _apart(target_m, self._best_target)
        if self._smooth_m < best_m:
            self._best_m, self._best_target = self._smooth_m, target_m
            best_m = self._smooth_m
        up = (
            self._smooth_m > self.limits.growth_factor * best_m
            and self._smooth_m > best_m + self.limits.growth_m
        )
        self._up_s = self._up_s + dt_s if up else 0.0
        mark_m = self._mark_m + _apart(target_m, self._mark_target)
        if best_m < (1.0 - _PROGRESS_SHARE) * mark_m:
            self._mark_m, self._mark_target, self._since_mark_s = best_m, target_m, 0.0
        elif self._smooth_m > self.limits.stall_error_m:
            self._since_mark_s += dt_s
        else:
            self._since_mark_s = 0.0

    def _swing(self, error_m: np.ndarray, dt_s: float, target_m: np.ndarray | None) -> None:
        if self._swung_m is None:
            self._swung_m = error_m, target_m
        went_m = length(error_m - self._swung_m[0])
        self._still_s += dt_s
        if went_m > _SWING_M:
            # As far as the target has gone, it was not the arm that swung.
            self._swings_m += max(0.0, went_m - _apart(target_m, self._swung_m[1]))
            self._swung_m, self._still_s = (error_m, target_m), 0.0
        elif self._still_s > _REST_S:
            self._swings_m = self._first_m = 0.0


def _apart(one: np.ndarray | None, other: np.ndarray | None) -> float:
    """Distance of two places, m; zero where one is not known."""
    if one is None or other is None:
        return 0.0
    return length(one - other)
