"""Pairs ball positions with joint motion between the same exposures: the one place for time.

A ball position carries the stamp of its exposure. :class:`ExposureMatcher` finds the joints at
that stamp, waiting for a later joint state if need be, and numbers continuous runs of such
samples. :class:`StepPairing` makes steps out of them. Whatever breaks the flow of time (a gap, a
repeated or older stamp, a clock jump, a ball that was lost) starts a new run, and nothing is ever
paired across runs.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from fvs_estimator_node.base import MotionStep
from fvs_ros.history import JointHistory, jump_of


@dataclass(frozen=True)
class BallSample:
    """A ball position and the joints at its exposure.

    Parameters
    ----------
    stamp_s : float
        Exposure time, s.
    joints_rad : ndarray, shape (6,)
        Joint positions at that time, rad.
    ball_m : ndarray, shape (3,)
        Ball position in the camera frame, m.
    run : int
        Number of the continuous run it belongs to.
    """

    stamp_s: float
    joints_rad: np.ndarray
    ball_m: np.ndarray
    run: int


class ExposureMatcher:
    """Finds the joints at each ball position's exposure.

    Parameters
    ----------
    max_gap_s : float
        Two samples further apart than this belong to different runs, s.
    max_joint_gap_s : float
        No interpolation between two joint states further apart than this, s.
    max_backstep_s : float
        Largest step back in time that is taken for a reordered message, s; beyond, the clock
        jumped.
    max_waiting : int
        Number of ball positions that may wait for later joint states; the oldest gives way.
    max_latency_s : float
        A ball position stamped further than this before the newest joint state is not paired: no
        camera is that slow, so the two clocks differ, s.
    """

    def __init__(
        self,
        max_gap_s: float = 0.25,
        max_joint_gap_s: float = 0.1,
        max_backstep_s: float = 0.1,
        max_waiting: int = 10,
        max_latency_s: float = 0.5,
    ) -> None:
        if (
            min(max_gap_s, max_joint_gap_s, max_latency_s) <= 0.0
            or max_backstep_s < 0.0
            or max_waiting < 1
        ):
            raise ValueError(
                "gaps and max_latency_s must be positive, max_backstep_s not negative and "
                f"max_waiting at least 1, got {max_gap_s}, {max_joint_gap_s}, {max_latency_s}, "
                f"{max_backstep_s}, {max_waiting}"
            )
        self._max_gap_s = max_gap_s
        self._max_backstep_s = max_backstep_s
        self._max_waiting = max_waiting
        self._max_latency_s = max_latency_s
        self._history = JointHistory(
            length_s=2.0, max_gap_s=max_joint_gap_s, max_backstep_s=max_backstep_s
        )
        self._waiting: deque[tuple[float, np.ndarray]] = deque()
        self._heard_stamp_s: float | None = None
        self._paired_stamp_s: float | None = None
        self._run = 0
        self._dropped = 0
        self._last_reason = ""

    @property
    def dropped(self) -> int:
        """Number of ball positions that could not be paired."""
        return self._dropped

    @property
    def last_reason(self) -> str:
        """Why the last ball position was dropped, in words; empty if none was."""
        return self._last_reason

    def break_run(self) -> None:
        """Start a new run: what comes next does not continue what came before."""
        if self._paired_stamp_s is not None:
            self._run += 1
        self._paired_stamp_s = None

    def forget_balls(self) -> None:
        """Forget the ball positions, keep the joint states, and start a new run."""
        self._waiting.clear()
        self._heard_stamp_s = None
        self.break_run()

    def reset(self) -> None:
        """Forget all joint states and waiting ball positions, and start a new run."""
        self._history.clear()
        self.forget_balls()

    def add_joints(self, stamp_s: float, joints_rad: np.ndarray) -> list[BallSample]:
        """Take a joint state; returns the ball positions that waited for it.

        Parameters
        ----------
        stamp_s : float
            Time of the joint state, s.
        joints_rad : ndarray, shape (6,)
            Joint positions, rad.
        """
        if not (np.isfinite(stamp_s) and np.all(np.isfinite(joints_rad))):
            return []
        newest, newest_s = self._history.newest, self._history.newest_stamp_s
        passed_s = 0.0 if newest_s is None else stamp_s - newest_s
        if passed_s > 0.0 and jump_of(joints_rad - newest, passed_s) is not None:
            self._history.clear()
            self._drop_waiting("the joints jumped")
        if not self._history.add(stamp_s, joints_rad):
            self._drop_waiting("the joint states' clock jumped")
            self._heard_stamp_s = None
        return self._pair()

    def add_ball(self, stamp_s: float, ball_m: np.ndarray) -> list[BallSample]:
        """Take a ball position; returns what can be paired now, mostly this one or nothing.

        Parameters
        ----------
        stamp_s : float
            Exposure time, s.
        ball_m : ndarray, shape (3,)
            Ball position in the camera frame, m.
        """
        if not (np.isfinite(stamp_s) and np.all(np.isfinite(ball_m))):
            self._drop("a ball position or its stamp is not finite")
            return []
        last = self._heard_stamp_s
        if last is not None and stamp_s <= last:
            if stamp_s >= last - self._max_backstep_s:
                self._drop("a ball position's stamp is repeated or older than the last")
                return []
            self._drop_waiting("the ball positions' clock jumped back")
        self._heard_stamp_s = stamp_s
        self._waiting.append((stamp_s, np.array(ball_m, dtype=float)))
        if len(self._waiting) > self._max_waiting:
            self._waiting.popleft()
            self._drop("no joint state came for a ball position")
        return self._pair()

    def _pair(self) -> list[BallSample]:
        samples = []
        newest = self._history.newest_stamp_s
        while self._waiting and newest is not None and self._waiting[0][0] <= newest:
            stamp_s, ball_m = self._waiting.popleft()
            if newest - stamp_s > self._max_latency_s:
                self._drop(
                    f"a ball position is stamped {newest - stamp_s:.2f} s before the newest joint "
                    "state; check that both clocks agree (NTP)"
                )
                continue
            joints = self._history.at(stamp_s)
            if joints is None:
                self._drop("the joint states have a gap at a ball position's exposure")
                continue
            last = self._paired_stamp_s
            if last is not None and not 0.0 < stamp_s - last <= self._max_gap_s:
                self._run += 1
            self._paired_stamp_s = stamp_s
            samples.append(BallSample(stamp_s, joints, ball_m, self._run))
        return samples

    def _drop(self, reason: str) -> None:
        self._dropped += 1
        self._last_reason = reason
        self.break_run()

    def _drop_waiting(self, reason: str) -> None:
        self._dropped += len(self._waiting)
        self._waiting.clear()
        self._last_reason = reason
        self.break_run()


class StepPairing:
    """Makes motion steps of joint states and ball positions.

    A step ends at the first sample whose joints have moved enough since the anchor, and the next
    begins there. If that takes too long the anchor moves on, so that a drift of a slow arm is
    never taken for a step.

    Parameters
    ----------
    min_joint_motion_rad : float
        Joint motion (of the joint that moved most) that makes a step, rad.
    max_step_s : float
        Longest step, s.
    max_gap_s : float
        Two ball positions further apart than this are never paired, s.
    max_sliding_age_s : float
        A sliding variable older than this at the step's end counts as zero, s.
    matcher : ExposureMatcher, optional
        Where the samples come from; by default a new one with ``max_gap_s``.
    """

    def __init__(
        self,
        min_joint_motion_rad: float = 0.01,
        max_step_s: float = 0.5,
        max_gap_s: float = 0.25,
        max_sliding_age_s: float = 0.2,
        matcher: ExposureMatcher | None = None,
    ) -> None:
        if min_joint_motion_rad <= 0.0 or max_step_s <= 0.0:
            raise ValueError(
                "min_joint_motion_rad and max_step_s must be positive, got "
                f"{min_joint_motion_rad}, {max_step_s}"
            )
        self._min_joint_motion_rad = min_joint_motion_rad
        self._max_step_s = max_step_s
        self._max_sliding_age_s = max_sliding_age_s
        self._matcher = matcher if matcher is not None else ExposureMatcher(max_gap_s)
        self._anchor: BallSample | None = None
        self._sliding: tuple[float, np.ndarray] | None = None

    @property
    def matcher(self) -> ExposureMatcher:
        """The source of samples, with its counters."""
        return self._matcher

    def reset(self) -> None:
        """Forget everything heard."""
        self._matcher.reset()
        self._anchor = None
        self._sliding = None

    def add_joints(self, stamp_s: float, joints_rad: np.ndarray) -> list[MotionStep]:
        """Take a joint state; returns the steps it completes."""
        return self._steps(self._matcher.add_joints(stamp_s, joints_rad))

    def add_ball(self, stamp_s: float, ball_m: np.ndarray) -> list[MotionStep]:
        """Take a ball position; returns the steps it completes."""
        return self._steps(self._matcher.add_ball(stamp_s, ball_m))

    def add_sliding_variable(self, stamp_s: float, sliding_variable: np.ndarray) -> None:
        """Take the controller's sliding variable; the newest one goes into coming steps."""
        value = np.array(sliding_variable, dtype=float)
        if value.shape == (3,) and np.all(np.isfinite(value)) and np.isfinite(stamp_s):
            self._sliding = (stamp_s, value)

    def _steps(self, samples: list[BallSample]) -> list[MotionStep]:
        steps = [self.step(sample) for sample in samples]
        return [step for step in steps if step is not None]

    def step(self, sample: BallSample) -> MotionStep | None:
        """The step that a sample completes, if it does."""
        anchor = self._anchor
        if anchor is None or sample.run != anchor.run:
            self._anchor = sample
            return None
        dt_s = sample.stamp_s - anchor.stamp_s
        if dt_s > self._max_step_s:
            self._anchor = sample
            return None
        d_joints = sample.joints_rad - anchor.joints_rad
        if np.abs(d_joints).max() < self._min_joint_motion_rad:
            return None
        self._anchor = sample
        return MotionStep(
            stamp_s=sample.stamp_s,
            dt_s=dt_s,
            joints_rad=anchor.joints_rad + 0.5 * d_joints,
            d_joints_rad=d_joints,
            d_ball_m=sample.ball_m - anchor.ball_m,
            sliding_variable=self._sliding_at(sample.stamp_s),
        )

    def _sliding_at(self, stamp_s: float) -> np.ndarray:
        if self._sliding is None or abs(stamp_s - self._sliding[0]) > self._max_sliding_age_s:
            return np.zeros(3)
        return self._sliding[1].copy()
