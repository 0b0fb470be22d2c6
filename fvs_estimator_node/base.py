"""What every estimator of the Jacobian offers, and the step it learns from."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np

from fvs_ros.chain import SerialChain


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
    def camera_rotation(self) -> np.ndarray:
        """How the camera has been turned since the training, (3, 3), as far as that is learned."""
        return np.eye(3)

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

    def observe(self, joints_rad: np.ndarray, ball_m: np.ndarray) -> None:  # noqa: B027
        """Hear where the ball is, also at rest: called for every image, before the update.

        Parameters
        ----------
        joints_rad : ndarray, shape (6,)
            Joints at the exposure, rad.
        ball_m : ndarray, shape (3,)
            Ball position, camera frame, m.
        """

    @abstractmethod
    def reset(self) -> None:
        """Forget what was learned online."""

    def status_values(self) -> dict[str, float]:
        """Live key numbers of the method by name, with the unit in the name; finite."""
        return {}
