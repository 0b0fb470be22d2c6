"""Makes motion steps of joint states and ball positions."""

from __future__ import annotations

import numpy as np

from fvs_estimator_node.base import MotionStep
from fvs_ros.timeline import Sample, Timeline

#: A longer step is not learned from: a slow arm drifts, s.
_MAX_STEP_S = 0.5
#: An older sliding variable counts as zero, s.
_MAX_SLIDING_AGE_S = 0.2


class StepPairing:
    """Makes motion steps of joint states and ball positions.

    A step ends at the first sample whose joints have moved enough since the anchor, and the next
    begins there. If that takes too long the anchor moves on.

    Parameters
    ----------
    min_step_rad : float
        Joint motion (of the joint that moved most) that makes a step, rad; by default one that
        moves the ball by some millimetres, more than the noise of its position.
    max_latency_s : float
        That of :class:`~fvs_ros.timeline.Timeline`, s.

    Attributes
    ----------
    matcher : ~fvs_ros.timeline.Timeline
        The source of samples, with its counters.
    """

    def __init__(self, min_step_rad: float = 0.01, max_latency_s: float = 0.5) -> None:
        self.matcher = Timeline(max_latency_s)
        self._min_step_rad = min_step_rad
        self._anchor: Sample | None = None
        self._sliding: tuple[float, np.ndarray] | None = None

    def reset(self) -> None:
        """Forget all inputs."""
        self.matcher.reset()
        self._anchor = None
        self._sliding = None

    def add_joints(self, stamp_s: float, joints_rad: np.ndarray) -> list[MotionStep]:
        """Take a joint state; returns the steps it completes."""
        return self._steps(self.matcher.add_joints(stamp_s, joints_rad))

    def add_ball(self, stamp_s: float, ball_m: np.ndarray) -> list[MotionStep]:
        """Take a ball position; returns the steps it completes."""
        return self._steps(self.matcher.add_ball(stamp_s, ball_m))

    def add_sliding_variable(self, stamp_s: float, sliding_variable: np.ndarray) -> None:
        """Take the controller's sliding variable, (m,); the newest goes into coming steps."""
        value = np.array(sliding_variable, dtype=float)
        if np.all(np.isfinite(value)) and np.isfinite(stamp_s):
            self._sliding = (stamp_s, value)

    def _steps(self, samples: list[Sample]) -> list[MotionStep]:
        steps = [self.step(sample) for sample in samples]
        return [step for step in steps if step is not None]

    def step(self, sample: Sample) -> MotionStep | None:
        """The step that a sample completes, if it does."""
        anchor = self._anchor
        if (
            anchor is None
            or sample.run != anchor.run
            or sample.stamp_s - anchor.stamp_s > _MAX_STEP_S
        ):
            self._anchor = sample
            return None
        d_joints = sample.joints_rad - anchor.joints_rad
        if np.abs(d_joints).max() < self._min_step_rad:
            return None
        self._anchor = sample
        sliding: np.ndarray | float = 0.0
        if self._sliding and abs(sample.stamp_s - self._sliding[0]) <= _MAX_SLIDING_AGE_S:
            sliding = self._sliding[1]
        return MotionStep(
            stamp_s=sample.stamp_s,
            dt_s=sample.stamp_s - anchor.stamp_s,
            joints_rad=anchor.joints_rad + 0.5 * d_joints,
            d_joints_rad=d_joints,
            d_ball_m=sample.ball_m - anchor.ball_m,
            sliding_variable=sliding,
        )
