"""Small monitors with one interface: each asks one question while the arm moves."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from fvs_controller_node.progress import Progress
from fvs_controller_node.reasons import Finding, Reason
from fvs_controller_node.supervisor_config import SupervisorConfig
from fvs_ros.agreement import Verdict
from fvs_ros.following import Following
from fvs_ros.vectors import length

#: A ball that is seen to make less of its predicted way than this does not follow the arm. A camera
#: that was turned shows all of it, in another direction; a learning Jacobian shows about all.
_LEAST_SEEN = 0.3


@dataclass(frozen=True)
class Motion:
    """What the monitors see of one tick.

    Parameters
    ----------
    dt_s : float
        Time since the last tick, s.
    joints_rad : ndarray, shape (n,)
        Joint positions, rad.
    command_rad_s : ndarray, shape (n,)
        Command in force since the last tick, rad/s.
    speed_scaling : float
        Of the robot, 0 to 1.
    jacobian : ndarray, shape (m, n)
        m/rad.
    verdict : Verdict or None
        How seen and predicted motion agree, as far as enough moved to say.
    """

    dt_s: float
    joints_rad: np.ndarray
    command_rad_s: np.ndarray
    speed_scaling: float
    jacobian: np.ndarray
    verdict: Verdict | None


class Monitor(ABC):
    """One question about the arm in motion."""

    @abstractmethod
    def restart(self) -> None:
        """Begin anew: a start."""

    @abstractmethod
    def check(self, motion: Motion, config: SupervisorConfig) -> Finding | None:
        """Find what is wrong at this tick, if anything; called at every tick in motion."""


class PredictionMonitor(Monitor):
    """Whether the camera sees what the Jacobian predicts."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Begin anew: a start."""
        self._mispredicted_m = 0.0  # how far the ball was to go meanwhile

    def check(self, motion: Motion, config: SupervisorConfig) -> Finding | None:
        """Find an image that does not follow the arm, or a Jacobian that predicts badly."""
        verdict = motion.verdict
        if verdict is not None and verdict.seen_share < _LEAST_SEEN:
            return Reason.IMAGE_NOT_FOLLOWING.because(
                time_s=verdict.time_s,
                predicted_mm=1e3 * verdict.predicted_m,
                seen_mm=1e3 * verdict.seen_share * verdict.predicted_m,
            )
        if verdict is None or verdict.error_ratio <= config.prediction_hold:
            self._mispredicted_m = 0.0
            return None
        self._mispredicted_m += motion.dt_s * length(motion.jacobian @ motion.command_rad_s)
        if self._mispredicted_m < config.prediction_hold_m:
            return None
        return Reason.PREDICTION_ERROR.because(
            value=verdict.error_ratio,
            limit=config.prediction_hold,
            way_mm=1e3 * config.prediction_hold_m,
        )


class ProgressMonitor(Monitor):
    """Whether the error becomes smaller; :class:`Progress` counts at every tick."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress

    def restart(self) -> None:
        """Begin anew: a start."""
        self._progress.restart()

    def check(self, _motion: Motion, config: SupervisorConfig) -> Finding | None:
        """Find an error that grows, swings or stalls."""
        progress, error_mm = self._progress, 1e3 * self._progress.smooth_m
        if progress.growing:
            return Reason.ERROR_GROWING.because(
                best_mm=1e3 * progress.best_m,
                error_mm=error_mm,
                time_s=config.progress.growth_time_s,
            )
        if progress.swinging:
            return Reason.OSCILLATING.because(way_m=progress.swings_m, error_mm=error_mm)
        if progress.stalled:
            return Reason.STALLED.because(time_s=config.progress.stall_time_s, error_mm=error_mm)
        return None


class FollowingMonitor(Monitor):
    """Whether the arm does what it is commanded."""

    def __init__(self) -> None:
        self._following = Following()

    def restart(self) -> None:
        """Begin anew: a start."""
        self._following.restart()

    def pause(self) -> None:
        """Stand still while the arm is held."""
        self._following.pause()

    def check(self, motion: Motion, config: SupervisorConfig) -> Finding | None:
        """Find a joint that does not follow its command."""
        self._following.add(
            motion.command_rad_s, motion.joints_rad, motion.speed_scaling, motion.dt_s
        )
        refusal = self._following.refusal(config.follow_time_s)
        if refusal is None:
            return None
        return Reason.NOT_FOLLOWING.because(
            joint=config.joint_names[refusal.joint],
            commanded_rad=refusal.commanded_rad,
            moved_rad=refusal.moved_rad,
        )
