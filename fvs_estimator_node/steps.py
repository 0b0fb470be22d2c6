"""Builds the motion steps that estimators learn from."""

from __future__ import annotations

import numpy as np

from fvs_estimator_node.base import MotionStep
from fvs_ros.filter import Image

#: Longest step that is learned from, s: slow arms drift.
_MAX_STEP_S = 0.5
#: Largest age of an input, s; an older sliding variable counts as zero.
FRESH_S = 0.2


class StepPairing:
    """Builds motion steps from images.

    A step ends at the first image whose joints have moved enough since the step's first image, and
    the next one begins there. After a timeout it begins at the newest image.

    Parameters
    ----------
    min_step_rad : float
        Least motion of the fastest joint in a step, rad. By default it moves the ball by some
        millimetres, more than the noise of its position.
    """

    def __init__(self, min_step_rad: float = 0.01) -> None:
        self._min_step_rad = min_step_rad
        self.reset()

    def reset(self) -> None:
        """Forget all inputs."""
        self._anchor: Image | None = None  # where the present step began
        self._sliding: tuple[float, np.ndarray] | None = None

    def add_sliding_variable(self, stamp_s: float, sliding_m: np.ndarray) -> None:
        """Take the controller's sliding variable, m, (d,); the newest goes into coming steps."""
        if np.all(np.isfinite(sliding_m)):
            self._sliding = (stamp_s, sliding_m)

    def step(self, image: Image) -> MotionStep | None:
        """The step that an image completes, if it does."""
        anchor = self._anchor
        if (
            anchor is None
            or image.run != anchor.run
            or image.stamp_s - anchor.stamp_s > _MAX_STEP_S
        ):
            self._anchor = image
            return None
        d_joints = image.joints_rad - anchor.joints_rad
        if np.abs(d_joints).max() < self._min_step_rad:
            return None
        self._anchor = image
        sliding: np.ndarray | float = 0.0
        if self._sliding and abs(image.stamp_s - self._sliding[0]) <= FRESH_S:
            sliding = self._sliding[1]
        return MotionStep(
            stamp_s=image.stamp_s,
            dt_s=image.stamp_s - anchor.stamp_s,
            joints_rad=anchor.joints_rad + 0.5 * d_joints,
            d_joints_rad=d_joints,
            d_feature_m=image.seen_m - anchor.seen_m,
            z=image.z,
            sliding_variable=sliding,
        )
