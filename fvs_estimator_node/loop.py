"""The whole estimator without ROS: timeline, tracker, steps and method in one object.

The node passes messages in and publishes the results; the laboratory uses the same object.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from fvs_estimator_node.base import Estimator, MotionStep, OracleEstimator
from fvs_ros.feature import Feature
from fvs_ros.timeline import Sample, Timeline
from fvs_ros.tracker import Image, Tracker

#: Longest step that is learned from (slow arms drift), and largest age of an input, s; an older
#: sliding variable counts as zero.
_MAX_STEP_S, FRESH_S = 0.5, 0.2
#: Images that wait for the noise to become known before any is learned from, at most.
_WAIT_IMAGES = 16


class StepPairing:
    """Builds motion steps from joint states and features.

    A step ends at the first sample whose joints have moved enough since the anchor, and the next
    one begins there. After a timeout the anchor moves to the newest sample.

    Parameters
    ----------
    min_step_rad : float
        Least motion of the fastest joint in a step, rad. By default it moves the ball by some
        millimetres, more than the noise of its position.

    Attributes
    ----------
    timeline : ~fvs_ros.timeline.Timeline
        The source of samples, with its counters.
    """

    def __init__(self, min_step_rad: float = 0.01) -> None:
        self.timeline = Timeline()
        self._min_step_rad = min_step_rad
        self.reset()

    def reset(self) -> None:
        """Forget all inputs."""
        self.timeline.reset()
        self._anchor: Sample | None = None
        self._sliding: tuple[float, np.ndarray] | None = None

    def add_sliding_variable(self, stamp_s: float, sliding_variable: np.ndarray) -> None:
        """Take the controller's sliding variable, (m,); the newest goes into coming steps."""
        value = np.array(sliding_variable, dtype=float)
        if np.all(np.isfinite(value)) and np.isfinite(stamp_s):
            self._sliding = (stamp_s, value)

    def steps(self, samples: list[Sample]) -> list[MotionStep]:
        """The steps that samples complete."""
        return [step for step in map(self.step, samples) if step is not None]

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
        if self._sliding and abs(sample.stamp_s - self._sliding[0]) <= FRESH_S:
            sliding = self._sliding[1]
        return MotionStep(
            stamp_s=sample.stamp_s,
            dt_s=sample.stamp_s - anchor.stamp_s,
            joints_rad=anchor.joints_rad + 0.5 * d_joints,
            d_joints_rad=d_joints,
            d_feature_m=sample.feature_m - anchor.feature_m,
            sliding_variable=sliding,
        )


class EstimationLoop:
    """Joint states and features in; Jacobian, chain and status out.

    Outliers are ignored, as in the controller.

    Parameters
    ----------
    estimator : Estimator
        Learns from the samples and estimates the Jacobian.
    feature : Feature, optional
        What is servoed; by default a ball.

    Attributes
    ----------
    pairing : StepPairing
        Builds steps from the messages.
    learns : bool
        Off, the estimator learns nothing.
    steps : int
        Number of steps learned from.
    """

    def __init__(self, estimator: Estimator, feature: Feature | None = None) -> None:
        self.estimator, self.feature = estimator, feature or Feature()
        self.pairing = StepPairing()
        self.learns = True
        self._tracker = Tracker()
        self._moved_m = np.zeros(0)  # of the feature by the joints, up to the last sample
        self._forget()

    def _forget(self) -> None:
        self._last: Sample | None = None
        self._seen_m: np.ndarray | None = None  # the feature in the newest image
        self._true: np.ndarray | None = None  # Jacobian of the task, published for the oracle
        self.steps = 0
        self._accepted: list[Sample] = []  # and not learned from yet

    def reset(self) -> None:
        """Forget what was learned online, and all inputs."""
        self.estimator.reset()
        self.pairing.reset()
        self._forget()

    # --- inputs ---

    def add_joints(self, stamp_s: float, joints_rad: np.ndarray) -> bool:
        """Take a joint state, s and rad, (n,). Returns whether the estimator learned from it."""
        return self._learn(self.pairing.timeline.add_joints(stamp_s, joints_rad))

    def add_feature(self, stamp_s: float, feature_m: np.ndarray) -> bool:
        """Take a feature, exposure in s and m, (m,); whether the estimator learned."""
        return self._learn(self.pairing.timeline.add_feature(stamp_s, feature_m))

    def add_sliding_variable(self, stamp_s: float, sliding_variable: np.ndarray) -> None:
        """Take the controller's sliding variable, s and m, (d,)."""
        self.pairing.add_sliding_variable(stamp_s, sliding_variable)

    # --- outputs ---

    @property
    def problem(self) -> str:
        """Why there is no estimate yet; empty if there is one."""
        unseen = self.feature.curved and self._seen_m is None
        return self.estimator.problem or (f"no {self.feature.seen.name} yet" if unseen else "")

    def feature_at(self, joints_rad: np.ndarray) -> np.ndarray:
        """Where the feature is at joints, rad, (n,), near those of the last image: m, (m,)."""
        estimate_m = self._tracker.estimate_m
        if self._last is None or estimate_m is None:
            assert self._seen_m is not None
            return self._seen_m
        step = joints_rad - self._last.joints_rad
        moved_m = self.estimator.jacobian(self._last.joints_rad + 0.5 * step) @ step
        return self.feature.nearest(estimate_m + moved_m)

    def set_true_jacobian(self, jacobian: np.ndarray) -> None:
        """Take the task's true Jacobian at the newest joints, m/rad, (d, n), for the oracle."""
        assert isinstance(self.estimator, OracleEstimator)
        if not self.feature.curved:
            self.estimator.set_true_jacobian(jacobian)
        elif self._seen_m is not None:
            self.estimator.set_true_jacobian(self.feature.from_task(self._seen_m, jacobian))
            self._true = jacobian

    def jacobian(self, joints_rad: np.ndarray) -> np.ndarray:
        """Of the task at the newest joints, rad, (n,): m/rad, (d, n)."""
        if self._true is not None:
            return self._true
        jacobian = self.estimator.jacobian(joints_rad)
        if not self.feature.curved:
            return jacobian
        return self.feature.to_task(self.feature_at(joints_rad), jacobian)

    def status_values(self) -> dict[str, Any]:
        """Live key numbers of pairing and method."""
        return {
            "steps_learned": self.steps,
            "images_not_paired": self.pairing.timeline.dropped,
            "last_not_paired_because": self.pairing.timeline.last_reason,
            "position_noise_m": self._tracker.noise_m,
            **self.estimator.status_values(),
        }

    # --- between ---

    def _learn(self, samples: list[Sample]) -> bool:
        self._accepted += [one for sample in samples for one in self._judge(sample)]
        # The first image shows that the camera was moved since the training, if its noise is known.
        judged = self._tracker.noise.known or bool(self.estimator.problem)
        if not judged and len(self._accepted) < _WAIT_IMAGES:
            return False
        accepted, self._accepted = self._accepted, []
        learns = self.learns and self.estimator.learns and bool(accepted)
        for sample in accepted:
            step = self.pairing.step(sample)
            if not learns:
                continue
            self.estimator.observe(sample.joints_rad, sample.feature_m, self._tracker.noise_m)
            if step is not None:
                if self.feature.curved and isinstance(step.sliding_variable, np.ndarray):
                    s = self.feature.from_task(sample.feature_m, step.sliding_variable)
                    step = replace(step, sliding_variable=s)
                self.estimator.update(step)
                self.steps += 1
        return learns

    def _judge(self, sample: Sample) -> list[Sample]:
        """The samples that are now confirmed as inliers, oldest first."""
        last, self._last = self._last, sample
        self._seen_m = sample.feature_m
        if self.estimator.problem:
            self._last = None  # no prediction to judge by
            return [sample]
        if last is None:
            self._tracker.restart()
            moved_m = np.zeros_like(sample.feature_m)
        else:
            d_joints = sample.joints_rad - last.joints_rad
            jacobian = self.estimator.jacobian(last.joints_rad + 0.5 * d_joints)
            moved_m = self._moved_m + jacobian @ d_joints
        self._moved_m = moved_m
        images = self._tracker.add(Image(sample.stamp_s, sample.feature_m, moved_m, sample))
        return [image.source for image in images]
