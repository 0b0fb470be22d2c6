"""Small monitors, each of which checks one condition at every tick in motion.

:class:`~fvs_controller_node.goal.Progress` is another one. The singularity is checked at rest, too.
"""

from __future__ import annotations

import numpy as np

from fvs_controller_node.agreement import Verdict
from fvs_controller_node.config import SupervisorConfig
from fvs_controller_node.reasons import Finding, Reason
from fvs_ros.vectors import length

#: Least measured share of the predicted motion of an image that follows the arm. A turned camera
#: shows all of it, in another direction; with a Jacobian that still learns, about all of it shows.
LEAST_SEEN = 0.3

#: A held Jacobian is released when its smallest singular value is this far into the slow band.
_RELEASE_SHARE = 0.3
#: A held arm may leave slowly while the singular value stays above this share of its value at the
#: request, and above this share of the hold limit.
_LEAVE_SHARE, _HOPELESS_SHARE = 0.7, 0.2
#: Longest way out, s.
_LEAVE_S = 10.0


class PredictionMonitor:
    """Whether the camera sees what the Jacobian predicts."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Begin anew: a start."""
        self._mispredicted_m = 0.0  # predicted motion meanwhile

    def check(
        self,
        verdict: Verdict | None,
        jacobian: np.ndarray,
        moved_rad: np.ndarray,
        config: SupervisorConfig,
    ) -> Finding | None:
        """Find an image that does not follow the arm, or a Jacobian that predicts badly.

        ``moved_rad`` is the joints' motion since the last tick, (n,).
        """
        text = config.kind.length_text
        if verdict is not None and verdict.seen_share < LEAST_SEEN:
            return Reason.IMAGE_NOT_FOLLOWING.because(
                of=verdict.of,
                time_s=verdict.time_s,
                predicted=text(verdict.predicted_m),
                seen=text(verdict.seen_share * verdict.predicted_m),
            )
        if verdict is None or verdict.error_ratio <= config.prediction_hold:
            self._mispredicted_m = 0.0
            return None
        self._mispredicted_m += length(jacobian.dot(moved_rad))
        if self._mispredicted_m < config.prediction_hold_m:
            return None
        return Reason.PREDICTION_ERROR.because(
            of=verdict.of,
            value=verdict.error_ratio,
            limit=config.prediction_hold,
            distance=text(config.prediction_hold_m),
        )


class SingularityMonitor:
    """Holds the arm near a singularity, with hysteresis, and lets it leave on request."""

    def __init__(self) -> None:
        self._held = False
        self.leaving = False  #: whether the arm is on its way out, on request
        self._left_s = 0.0
        self._floor: float | None = None  # the value must stay above it while the arm leaves

    def leave(self, value: float, hold: float) -> bool:
        """Let a held arm leave, unless the value is hopeless; returns whether it may.

        ``value`` is the Jacobian's smallest singular value, ``hold`` its limit, m/rad.
        """
        if self._floor is None:
            self._floor = max(_LEAVE_SHARE * value, _HOPELESS_SHARE * hold)
        self.leaving, self._left_s = value >= self._floor, 0.0
        return self.leaving

    def go_on(self, dt_s: float) -> None:
        """Count a tick on the way out; the permission ends after some time."""
        self._left_s += dt_s
        if self._left_s > _LEAVE_S:
            self.leaving = False

    def check(self, value: float, config: SupervisorConfig) -> Finding | None:
        """Hold the arm where the smallest singular value, m/rad, is too small for motion."""
        hold, slow = config.singular_hold_m_rad, config.singular_slow_m_rad
        limit = hold + (_RELEASE_SHARE * (slow - hold) if self._held else 0.0)
        self._held = value < limit
        if not self._held:
            self.leaving, self._floor = False, None
        elif value < (self._floor or 0.0):
            self.leaving = False
        if self._held and not self.leaving:
            return Reason.NEAR_SINGULAR.because(value=value, limit=limit)
        return None
