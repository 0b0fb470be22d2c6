"""The tour: one reachable target after another, until a person takes over."""

from __future__ import annotations

import numpy as np

from fvs_tools.demo import choose_target

#: After so long without a ball the arm itself is taken to hide it, s: well before a controller
#: that holds wants a new start.
_LOST_S = 8.0
LOST = "the tour saw no ball any more"
_DISTANCE_M, _SEED = 0.3, 0


class TargetTour:
    """Chooses the next target when the last one has had its time.

    Parameters
    ----------
    candidates_m : ndarray, shape (n, 3)
        Positions the ball can be at, m, camera frame.
    period_s : float
        Time given to each, s.
    """

    def __init__(self, candidates_m: np.ndarray, period_s: float) -> None:
        self._candidates_m = candidates_m
        self._period_s = period_s
        self._rng = np.random.default_rng(_SEED)
        self._due_s = -np.inf
        self._seen_s = np.inf  # when the ball was last seen; nothing is lost before it was seen

    def lost(self, now_s: float, ball_m: np.ndarray | None) -> bool:
        """Whether the ball has been out of sight for so long that it will not come back by itself.

        An arm that does not see the ball does not move. Said once each time.

        Parameters
        ----------
        now_s : float
            Steady clock, s.
        ball_m : ndarray, shape (3,), or None
            Where the ball is, m, camera frame.
        """
        if ball_m is not None:
            self._seen_s = now_s
        lost = now_s - self._seen_s > _LOST_S
        if lost:
            self._seen_s = np.inf
        return lost

    def next(self, now_s: float, ready: bool, ball_m: np.ndarray | None) -> np.ndarray | None:
        """The next target, m, camera frame, (3,), if one is due.

        Parameters
        ----------
        now_s : float
            Steady clock, s.
        ready : bool
            Whether the controller would go there now.
        ball_m : ndarray, shape (3,), or None
            Where the ball is, m, camera frame.
        """
        if not ready or ball_m is None or now_s < self._due_s:
            return None
        self._due_s = now_s + self._period_s
        return choose_target(self._candidates_m, ball_m, _DISTANCE_M, self._rng)
