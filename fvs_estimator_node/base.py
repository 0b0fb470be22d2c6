"""What every estimator of the Jacobian offers, the step it learns from, and how it is judged."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np

from fvs_ros.core.chain import SerialChain
from fvs_ros.core.vectors import length


@dataclass(frozen=True)
class MotionStep:
    """What the ball and the joints did between the same two exposures.

    Parameters
    ----------
    stamp_s : float
        Exposure time of the second image, s.
    dt_s : float
        Time between the two exposures, s, positive.
    joints_rad : ndarray, shape (6,)
        Joint positions half way, rad: where the Jacobian that explains the step belongs.
    d_joints_rad : ndarray, shape (6,)
        Joint motion, rad.
    d_ball_m : ndarray, shape (3,)
        Ball motion in the camera frame, m.
    sliding_variable : ndarray, shape (3,)
        The controller's sliding variable s, as it was last heard; zeros without a controller.
    """

    stamp_s: float
    dt_s: float
    joints_rad: np.ndarray
    d_joints_rad: np.ndarray
    d_ball_m: np.ndarray
    sliding_variable: np.ndarray = field(default_factory=lambda: np.zeros(3))

    @property
    def start_stamp_s(self) -> float:
        """Exposure time of the first image, s."""
        return self.stamp_s - self.dt_s

    @property
    def joint_velocity(self) -> np.ndarray:
        """Mean joint velocity, rad/s, shape (6,)."""
        return self.d_joints_rad / self.dt_s

    @property
    def ball_velocity(self) -> np.ndarray:
        """Mean ball velocity, m/s, shape (3,)."""
        return self.d_ball_m / self.dt_s


class Estimator(ABC):
    """Estimates the 3x6 Jacobian of the ball's position with respect to the joints.

    An estimator is told steps and asked for Jacobians; it knows neither topics nor clocks.
    """

    #: Whether :meth:`update` can change anything.
    learns = True

    @property
    def problem(self) -> str:
        """Why there is no estimate yet, in words; empty if there is one."""
        return ""

    @property
    def remark(self) -> str:
        """What does not fit although there is an estimate, in words; empty if all is well."""
        return ""

    @property
    def chain(self) -> SerialChain | None:
        """The serial chain as the camera sees it now; None from an estimator that has none."""
        return None

    @abstractmethod
    def jacobian(self, joints_rad: np.ndarray) -> np.ndarray:
        """Estimate at given joints, m/rad.

        Parameters
        ----------
        joints_rad : ndarray, shape (6,)
            Joint positions, rad.

        Returns
        -------
        ndarray, shape (3, 6)
            A new array, the caller's to keep.
        """

    @abstractmethod
    def update(self, step: MotionStep) -> None:
        """Learn from one step.

        A step that cannot be learned from (too little motion, something not finite) changes
        nothing and raises nothing.
        """

    def observe(  # noqa: B027
        self, joints_rad: np.ndarray, ball_m: np.ndarray, stamp_s: float = math.nan
    ) -> None:
        """Hear where the ball is, also at rest: called for every image, before the update.

        Parameters
        ----------
        joints_rad : ndarray, shape (6,)
            Joints at the exposure, rad.
        ball_m : ndarray, shape (3,)
            Ball position, camera frame, m.
        stamp_s : float
            Time of the exposure, s; not a number if nobody knows.
        """

    @abstractmethod
    def reset(self) -> None:
        """Forget what was learned online."""

    def status_values(self) -> dict[str, float]:
        """Live key numbers of the method by name, with the unit in the name; finite."""
        return {}


#: A ball that went further than predicted by this, m, in one step and no other of so many: the
#: camera was bumped. The Jacobian's errors come again.
_JUMP_M, _JUMP_STEPS = 0.04, 100


class PredictionMonitor:
    """How well the Jacobian predicts the ball, judged before it learns from the step.

    A single step of a few millimetres says little when each position is a millimetre off.
    Predictions of consecutive steps are therefore summed, each made with the Jacobian of its
    time, until the joints have moved ``base_rad``; sum against sum, the noise of the positions in
    between cancels. A base in which the ball neither moved nor was predicted to move by
    ``min_ball_motion_m`` (say, only joint 6 turned) is counted in the error, not in the ratio.
    A single jump of the ball in its view is a bump of the camera, and is not counted either: it
    would outweigh all steps for seconds, although no Jacobian has anything to do with it.

    Parameters
    ----------
    base_rad : float
        Joint motion (largest joint, path length) that makes one judgement, rad.
    min_ball_motion_m : float
        Smallest ball motion, measured or predicted, for which a ratio is meant, m.
    memory : float
        Number of judgements after which an old one has lost 63 % of its say.
    """

    def __init__(
        self, base_rad: float = 0.1, min_ball_motion_m: float = 0.01, memory: float = 10.0
    ) -> None:
        if base_rad <= 0.0 or min_ball_motion_m <= 0.0 or memory < 1.0:
            raise ValueError(
                "base_rad and min_ball_motion_m must be positive and memory at least 1, got "
                f"{base_rad}, {min_ball_motion_m}, {memory}"
            )
        self._base_rad = base_rad
        self._min_ball_motion_m = min_ball_motion_m
        self._forget = 1.0 - math.exp(-1.0 / memory)
        self.reset()

    def reset(self) -> None:
        """Forget all judgements."""
        self._count = 0
        self._ratio_count = 0
        self._mean_squared_error = 0.0
        self._ratio_error = 0.0
        self._ratio_motion = 0.0
        self._last_stamp_s: float | None = None
        self._since_jump = _JUMP_STEPS
        self._start_base()

    def _start_base(self) -> None:
        self._moved_rad = np.zeros(6)
        self._ball_m = np.zeros(3)
        self._predicted_m = np.zeros(3)
        self._jump: tuple[np.ndarray, np.ndarray] | None = None  # seen and predicted, not counted

    @property
    def count(self) -> int:
        """Number of judgements so far."""
        return self._count

    @property
    def rms_m(self) -> float | None:
        """Root mean square prediction error over one base, m; None before the first."""
        return math.sqrt(self._mean_squared_error) if self._count else None

    @property
    def ratio(self) -> float | None:
        """Prediction error as a share of the ball's motion; None before the first.

        0 is perfect; 1 is as good as predicting that the ball stays where it is. The motion is
        the larger one of measured and predicted, so that the ratio stays below 2.
        """
        return math.sqrt(self._ratio_error / self._ratio_motion) if self._ratio_count else None

    def observe(self, step: MotionStep, jacobian: np.ndarray) -> None:
        """Judge one step; call it before the estimator's update.

        Parameters
        ----------
        step : MotionStep
            The step; consecutive ones begin where the last ended, others start a new base.
        jacobian : ndarray, shape (3, 6)
            Estimate at ``step.joints_rad`` that has not learned from this step, m/rad.
        """
        last = self._last_stamp_s
        self._last_stamp_s = step.stamp_s
        if last is None or abs(step.start_stamp_s - last) > 1e-6:
            self._start_base()
        predicted = jacobian @ step.d_joints_rad
        if not (np.all(np.isfinite(predicted)) and np.all(np.isfinite(step.d_ball_m))):
            self._start_base()
            return
        seen = step.d_ball_m
        self._since_jump += 1
        if length(seen) - length(predicted) > _JUMP_M:
            since, self._since_jump = self._since_jump, 0
            if since > _JUMP_STEPS:
                self._jump = seen, predicted
                return
            if self._jump is not None:  # another one: it was none of the camera's
                seen, predicted = seen + self._jump[0], predicted + self._jump[1]
        self._jump = None
        self._moved_rad += np.abs(step.d_joints_rad)
        self._ball_m += seen
        self._predicted_m += predicted
        if self._moved_rad.max() >= self._base_rad:
            self._judge()
            self._start_base()

    def _judge(self) -> None:
        error = self._ball_m - self._predicted_m
        squared_error = float(error @ error)
        self._count += 1
        weight = max(self._forget, 1.0 / self._count)
        self._mean_squared_error += weight * (squared_error - self._mean_squared_error)
        motion = max(
            float(self._ball_m @ self._ball_m), float(self._predicted_m @ self._predicted_m)
        )
        if motion >= self._min_ball_motion_m**2:
            self._ratio_count += 1
            weight = max(self._forget, 1.0 / self._ratio_count)
            self._ratio_error += weight * (squared_error - self._ratio_error)
            self._ratio_motion += weight * (motion - self._ratio_motion)
