"""The whole estimator without ROS: timeline, tracker, steps and method in one object.

The node passes messages in and publishes the results; the laboratory uses the same object.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from fvs_estimator_node.base import Estimator, MotionStep
from fvs_ros.timeline import Sample, Timeline
from fvs_ros.tracker import Image, Tracker

#: Longest step that is learned from (slow arms drift), and largest age of an input, s; an older
#: sliding variable counts as zero.
_MAX_STEP_S, FRESH_S = 0.5, 0.2
#: Stamp error, late or early, above which the control loop does not come to rest, s.
_MOST_LATE_S = 0.08
#: Number of recent ball positions that are paired again after a stamp correction.
_LAST = 16
#: Largest lag in the search, images each way, and span over which lengths are compared, images.
_MOST, _SPAN = 12, 3
#: Share of the past that is kept at each image: it decays by 63 % in 30.
_KEEP = 29.0 / 30.0
#: A lag counts if the residual without it is this many times larger, and larger by this root sum
#: square, m; and if its own residual is below this share of the last positions' squared motion.
_TIMES, _WORSE_M, _OFF_SHARE = 3.0, 0.02, 0.1
#: A step of the ball that exceeds every predicted one by this, m, is a bump or a false detection.
#: It would bias each lag at another time.
_JUMP_M = 0.01


class StepPairing:
    """Builds motion steps from joint states and ball positions.

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
            d_ball_m=sample.ball_m - anchor.ball_m,
            sliding_variable=sliding,
        )


class StampWatch:
    """Estimates the lag of the stamps behind the joints, in images, from lengths of ball motion.

    A camera's pose does not change how far the ball moves, so lengths separate stamp errors from
    camera rotations. With predicted positions p, seen ones x and a lag of n images,
    ``|x(k) - x(k - m)| = |p(k - n) - p(k - n - m)|`` for one n and every k. Each n is rated by its
    residual. At rest or at constant speed all n fit equally, and no lag is found. A camera that is
    being carried changes lengths, too; so a lag counts only if the ball also moved in the predicted
    direction.
    """

    def __init__(self) -> None:
        self._kept: deque[tuple[float, np.ndarray, np.ndarray]] = deque(maxlen=_MOST + _SPAN + 1)
        self._left_m2 = np.zeros(2 * _MOST + 1)

    def add(self, stamp_s: float, seen_m: np.ndarray, predicted_m: np.ndarray) -> float:
        """Take the next pair: its time, s, and the ball's seen and predicted position, m, (m,).

        The prediction may have any origin. Returns the delay of the stamps, s: negative for early
        ones, 0 without evidence.
        """
        self._kept.appendleft((stamp_s, seen_m, predicted_m))
        if len(self._kept) < _MOST + _SPAN + 1:
            return 0.0
        stamps_s, seen, predicted = (np.array(one) for one in zip(*self._kept, strict=True))
        if _lengths(seen, 1).max() > _lengths(predicted, 1).max() + _JUMP_M:
            return 0.0
        went_m, saw_m = _lengths(predicted, _SPAN), _lengths(seen, _SPAN)
        off_m = np.concatenate([saw_m[:0:-1] - went_m[0], saw_m[0] - went_m])
        self._left_m2 = _KEEP * self._left_m2 + off_m**2
        lag = int(self._left_m2.argmin()) - _MOST
        least_m2, now_m2 = self._left_m2.min(), self._left_m2[_MOST]
        if lag == 0 or now_m2 < _TIMES * least_m2 or now_m2 - least_m2 < _WORSE_M**2:
            return 0.0
        went, saw = predicted[max(lag, 0) :], seen[max(-lag, 0) :]
        went, saw = (one[: len(seen) - abs(lag)] for one in (went, saw))
        went, saw = went - went.mean(axis=0), saw - saw.mean(axis=0)
        if np.square(saw - went).sum() > _OFF_SHARE * np.square(saw).sum():
            return 0.0
        return lag * float(np.median(-np.diff(stamps_s)))


def _lengths(positions: np.ndarray, span: int) -> np.ndarray:
    """Length of the ball's motion over a span of images that ended 0, 1, ... images ago, m."""
    return np.asarray(np.linalg.norm(positions[:-span] - positions[span:], axis=1))


class EstimationLoop:
    """Joint states and ball positions in; Jacobian, chain and status out.

    Outliers are ignored, as in the controller. Stamp errors, once found, are corrected before
    images and joints are paired.

    Parameters
    ----------
    estimator : Estimator
        Learns from the samples and estimates the Jacobian.
    pairing : StepPairing, optional
        Builds steps from the messages.

    Attributes
    ----------
    learns : bool
        Off, the estimator learns nothing.
    steps : int
        Number of steps learned from.
    late_s : float
        How late the ball positions' stamps are, s; negative for early ones.
    """

    def __init__(self, estimator: Estimator, pairing: StepPairing | None = None) -> None:
        self.estimator = estimator
        self.pairing = pairing if pairing is not None else StepPairing()
        self.learns = True
        self._tracker = Tracker()
        self._moved_m = np.zeros(0)  # of the ball by the joints, up to the last sample
        self._balls: deque[tuple[float, np.ndarray]] = deque(maxlen=_LAST)  # as they came
        self._forget()

    def _forget(self) -> None:
        self._last: Sample | None = None
        self.steps = 0
        self._stamps, self.late_s = StampWatch(), 0.0
        self._balls.clear()
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

    def add_ball(self, stamp_s: float, ball_m: np.ndarray) -> bool:
        """Take a ball position, exposure in s and m, (m,); whether the estimator learned."""
        self._balls.append((stamp_s, ball_m))
        return self._learn(self.pairing.timeline.add_ball(stamp_s - self.late_s, ball_m))

    def add_sliding_variable(self, stamp_s: float, sliding_variable: np.ndarray) -> None:
        """Take the controller's sliding variable, s and m, (m,)."""
        self.pairing.add_sliding_variable(stamp_s, sliding_variable)

    # --- outputs ---

    @property
    def remark(self) -> str:
        """What does not fit although there is an estimate; empty if all is well."""
        if not self.late_s:
            return self.estimator.remark
        late_s, which = abs(self.late_s), "late" if self.late_s > 0.0 else "early"
        return (
            f"image stamps are too {which} by about {late_s:.2f} s; add {self.late_s:.2f} to the "
            "detector's stamp_delay_s or set the clocks, then call ~/reset"
        )

    @property
    def problem(self) -> str:
        """Why the arm must not move on the estimate; empty if it may."""
        return self.remark if abs(self.late_s) > _MOST_LATE_S else self.estimator.problem

    def status_values(self) -> dict[str, Any]:
        """Live key numbers of pairing and method."""
        return {
            "steps_learned": self.steps,
            "ball_positions_not_paired": self.pairing.timeline.dropped,
            "last_not_paired_because": self.pairing.timeline.last_reason,
            "images_late_s": self.late_s,
            "position_noise_m": self._tracker.noise_m,
            **self.estimator.status_values(),
        }

    # --- between ---

    def _learn(self, samples: list[Sample]) -> bool:
        accepted = [one for sample in samples for one in self._judge(sample)]
        self._accepted += accepted  # only now: to judge may correct stamps, which learns, too
        # The first image shows that the camera was moved since the training, if its noise is known.
        judged = self._tracker.noise.known or bool(self.estimator.problem)
        if not judged and len(self._accepted) < _LAST:
            return False
        accepted, self._accepted = self._accepted, []
        learns = self.learns and self.estimator.learns and bool(accepted)
        for sample in accepted:
            step = self.pairing.step(sample)
            if not learns:
                continue
            self.estimator.observe(sample.joints_rad, sample.ball_m, self._tracker.noise_m)
            if step is not None:
                self.estimator.update(step)
                self.steps += 1
        return learns

    def _judge(self, sample: Sample) -> list[Sample]:
        """The samples that are now confirmed as inliers, oldest first."""
        last, self._last = self._last, sample
        if self.estimator.problem:
            self._last = None  # no prediction to judge by
            return [sample]
        if last is None or last.run != sample.run:
            self._stamps = StampWatch()
        if last is None:
            self._tracker.restart()
            moved_m = np.zeros_like(sample.ball_m)
        else:
            d_joints = sample.joints_rad - last.joints_rad
            jacobian = self.estimator.jacobian(last.joints_rad + 0.5 * d_joints)
            moved_m = self._moved_m + jacobian @ d_joints
        self._moved_m = moved_m
        images = self._tracker.add(Image(sample.stamp_s, sample.ball_m, moved_m, sample))
        late_s = self._stamps.add(sample.stamp_s, sample.ball_m, moved_m)
        if late_s:
            self._correct_stamps(late_s)
            return []
        return [image.source for image in images]

    def _correct_stamps(self, late_s: float) -> None:
        """Reset the estimator and pair the last ball positions again, with corrected stamps."""
        self.late_s += late_s
        self._stamps = StampWatch()
        self.estimator.reset()
        self.pairing.timeline.forget_balls()
        for stamp_s, ball_m in list(self._balls):
            self._learn(self.pairing.timeline.add_ball(stamp_s - self.late_s, ball_m))
