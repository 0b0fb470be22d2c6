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
from fvs_ros.history import MAX_BACKSTEP_S, JointHistory, jump_of

#: Two samples further apart than this belong to different runs, s.
_MAX_GAP_S = 0.25
#: Ball positions that may wait for later joint states; the oldest gives way.
_MAX_WAITING = 10
#: A longer step is not learned from: a slow arm drifts, s.
_MAX_STEP_S = 0.5
#: An older sliding variable counts as zero, s.
_MAX_SLIDING_AGE_S = 0.2


@dataclass(frozen=True)
class BallSample:
    """A ball position and the joints at its exposure.

    Parameters
    ----------
    stamp_s : float
        Exposure time, s.
    joints_rad : ndarray, shape (n,)
        Joint positions at that time, rad.
    ball_m : ndarray, shape (m,)
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
    max_latency_s : float
        A ball position stamped further than this before the newest joint state is not paired: no
        camera is that slow, so the two clocks differ, s.

    Attributes
    ----------
    dropped : int
        Number of ball positions that could not be paired.
    last_reason : str
        Why the last ball position was dropped; empty if none was.
    """

    def __init__(self, max_latency_s: float = 0.5) -> None:
        self._max_latency_s = max_latency_s
        self._history = JointHistory()
        self._waiting: deque[tuple[float, np.ndarray]] = deque()
        self._newest_stamp_s: float | None = None
        self._paired_stamp_s: float | None = None
        self._run = 0
        self.dropped = 0
        self.last_reason = ""

    def forget_balls(self) -> None:
        """Forget the ball positions, keep the joint states, and start a new run."""
        self._waiting.clear()
        self._newest_stamp_s = None
        self._break_run()

    def reset(self) -> None:
        """Forget all joint states and waiting ball positions, and start a new run."""
        self._history.clear()
        self.forget_balls()

    def add_joints(self, stamp_s: float, joints_rad: np.ndarray) -> list[BallSample]:
        """Take a joint state, s and rad, (n,); returns the ball positions that waited for it."""
        if not (np.isfinite(stamp_s) and np.all(np.isfinite(joints_rad))):
            return []
        newest, newest_s = self._history.newest, self._history.newest_stamp_s
        passed_s = 0.0 if newest_s is None else stamp_s - newest_s
        if passed_s > 0.0 and jump_of(joints_rad - newest, passed_s) is not None:
            self._history.clear()
            self._drop("the joints jumped", len(self._waiting))
        if not self._history.add(stamp_s, joints_rad):
            self._drop("the joint states' clock jumped", len(self._waiting))
            self._newest_stamp_s = None
        return self._pair()

    def add_ball(self, stamp_s: float, ball_m: np.ndarray) -> list[BallSample]:
        """Take a ball position, exposure in s and m, (m,); returns what can be paired now."""
        if not (np.isfinite(stamp_s) and np.all(np.isfinite(ball_m))):
            self._drop("a ball position or its stamp is not finite")
            return []
        last = self._newest_stamp_s
        if last is not None and stamp_s <= last:
            if stamp_s >= last - MAX_BACKSTEP_S:
                self._drop("a ball position's stamp is repeated or older than the last")
                return []
            self._drop("the ball positions' clock jumped back", len(self._waiting))
        self._newest_stamp_s = stamp_s
        self._waiting.append((stamp_s, np.array(ball_m, dtype=float)))
        if len(self._waiting) > _MAX_WAITING:
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
            if last is not None and not 0.0 < stamp_s - last <= _MAX_GAP_S:
                self._run += 1
            self._paired_stamp_s = stamp_s
            samples.append(BallSample(stamp_s, joints, ball_m, self._run))
        return samples

    def _drop(self, reason: str, waiting: int | None = None) -> None:
        """Count ball positions that are lost: one, or all that wait; start a new run."""
        if waiting is not None:
            self._waiting.clear()
        self.dropped += 1 if waiting is None else waiting
        self.last_reason = reason
        self._break_run()

    def _break_run(self) -> None:
        if self._paired_stamp_s is not None:
            self._run += 1
        self._paired_stamp_s = None


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
        That of :class:`ExposureMatcher`, s.

    Attributes
    ----------
    matcher : ExposureMatcher
        The source of samples, with its counters.
    """

    def __init__(self, min_step_rad: float = 0.01, max_latency_s: float = 0.5) -> None:
        self.matcher = ExposureMatcher(max_latency_s)
        self._min_step_rad = min_step_rad
        self._anchor: BallSample | None = None
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

    def _steps(self, samples: list[BallSample]) -> list[MotionStep]:
        steps = [self.step(sample) for sample in samples]
        return [step for step in steps if step is not None]

    def step(self, sample: BallSample) -> MotionStep | None:
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
