"""What the estimators that know nothing but the last steps share.

They hold one 3x6 Jacobian and no map of the workspace: wherever the arm is, it is the Jacobian of
the last motions, and it follows the arm as fast as the steps tell it to. They differ in how much
of each prediction error goes into which entry.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, TypeVar

import numpy as np

from fvs_estimator_node.base import Estimator, MotionStep
from fvs_estimator_node.rbf import N_FEATURES, RbfModel
from fvs_ros.joints import N_JOINTS
from fvs_ros.params import Parameter

#: Where the Jacobian starts.
FROM_MODEL, FROM_ZERO = "model", "zero"
INITIALS = (FROM_MODEL, FROM_ZERO)

_IDENTITY = np.eye(N_JOINTS)
_NO_COVARIANCE = np.zeros((0, 0))


@dataclass(frozen=True)
class OnlineConfig:
    """Settings of every online estimator.

    Parameters
    ----------
    initial : str
        Where the Jacobian starts: ``model``, the trained networks' Jacobian at the first joints
        that the estimator is asked at or told of; or ``zero``, which knows nothing: there is no
        estimate until something else has moved the arm (see ``OnlineEstimator.problem``).
    min_motion_rad : float
        Steps in which no joint moved this far change nothing, rad.
    """

    initial: str = FROM_MODEL
    min_motion_rad: float = 1e-3

    def __post_init__(self) -> None:
        if self.initial not in INITIALS:
            raise ValueError(f"unknown initial {self.initial!r}; known are {', '.join(INITIALS)}")
        self._want(self.min_motion_rad >= 0.0, "min_motion_rad", "at least 0")

    def _want(self, holds: bool, name: str, wanted: str) -> None:
        """Refuse a number that is not what was wanted, or not finite."""
        value = getattr(self, name)
        if not (holds and math.isfinite(value)):
            raise ValueError(f"{name} must be finite and {wanted}, got {value}")


Config = TypeVar("Config", bound=OnlineConfig)


def read_config(kind: type[Config], method: str, values: Mapping[str, Any]) -> Config:
    """Configuration from parameter values (``lkf.initial`` and so on); others are passed over."""
    names = {field.name for field in fields(kind)}
    given = {name: values[f"{method}.{name}"] for name in names if f"{method}.{name}" in values}
    return kind(**given)


def online_parameters(method: str) -> tuple[Parameter, ...]:
    """The parameters of :class:`OnlineConfig` as a node declares them."""
    return (
        Parameter(
            f"{method}.initial",
            OnlineConfig.initial,
            "Where the Jacobian starts: the trained networks' at the first joints, or zero; "
            "from zero there is no estimate until something else has moved the arm.",
            choices=INITIALS,
        ),
        Parameter(
            f"{method}.min_motion_rad",
            OnlineConfig.min_motion_rad,
            "Steps with less joint motion than this change nothing, rad.",
            0.0,
            1.0,
        ),
    )


def deviation_parameters(
    method: str, initial_m_rad: float, noise_m: float
) -> tuple[Parameter, ...]:
    """What a method with a covariance is told about its start and its measurements."""
    return (
        Parameter(
            f"{method}.initial_deviation_m_rad",
            initial_m_rad,
            "Standard deviation of each entry of the initial Jacobian, m/rad; about 0.5 when it "
            "starts from zero.",
            1e-4,
            10.0,
        ),
        Parameter(
            f"{method}.measurement_noise_m",
            noise_m,
            "Standard deviation of one coordinate of a ball position, m.",
            1e-6,
            1.0,
        ),
    )


class OnlineEstimator(Estimator):
    """One Jacobian, learned from steps alone; a method adds how.

    Parameters
    ----------
    model : RbfModel, optional
        The trained networks; needed if the Jacobian starts from them.
    config : OnlineConfig
        Settings.
    covariance : ndarray, shape (n, n), optional
        Initial covariance of the estimate, for methods that have one, (m/rad)^2.

    Raises
    ------
    ValueError
        If the Jacobian is to start from a model and there is none.
    """

    def __init__(
        self,
        model: RbfModel | None,
        config: OnlineConfig,
        covariance: np.ndarray = _NO_COVARIANCE,
    ) -> None:
        if config.initial == FROM_MODEL and model is None:
            raise ValueError("initial is 'model', but there is no trained model; or start at zero")
        self._model = model if config.initial == FROM_MODEL else None
        self._min_motion_rad = config.min_motion_rad
        self._initial_covariance = covariance
        self.reset()

    @property
    def updates(self) -> int:
        """Number of steps learned from."""
        return self._updates

    @property
    def refused(self) -> int:
        """Number of steps that could not be used, and so changed nothing."""
        return self._refused

    @property
    def covariance(self) -> np.ndarray:
        """Present covariance of the estimate, (m/rad)^2; a copy, empty without one."""
        return self._covariance.copy()

    def reset(self) -> None:
        """Forget what was learned, the initial Jacobian and the counts."""
        self._jacobian: np.ndarray | None = None
        if self._model is None:
            self._jacobian = np.zeros((N_FEATURES, N_JOINTS))
        self._initial_jacobian = self._jacobian
        self._covariance = self._initial_covariance
        self._updates = 0
        self._refused = 0

    def jacobian(self, joints_rad: np.ndarray) -> np.ndarray:
        """Present estimate, m/rad, shape (3, 6), the same for all joints once it has begun."""
        return self._begun(joints_rad).copy()

    def _begun(self, joints_rad: np.ndarray) -> np.ndarray:
        if self._jacobian is None:
            assert self._model is not None
            start = self._model.jacobian(joints_rad)
            if not np.all(np.isfinite(start)):
                return start
            self._jacobian = self._initial_jacobian = start
        return self._jacobian

    def update(self, step: MotionStep) -> None:
        """Learn from one step; too little motion or anything not finite changes nothing."""
        if np.abs(step.d_joints_rad).max() < self._min_motion_rad:
            return
        with np.errstate(all="ignore"):
            learned = self._try(step)
        if learned is None:
            self._refused += 1
            return
        self._jacobian, self._covariance = learned
        self._updates += 1

    def _try(self, step: MotionStep) -> tuple[np.ndarray, np.ndarray] | None:
        """Jacobian and covariance after a step; None if it must not be learned from."""
        if not (
            0.0 < step.dt_s < math.inf
            and _is_finite(step.joints_rad)
            and _is_finite(step.d_joints_rad)
            and _is_finite(step.d_ball_m)
        ):
            return None
        before = self._begun(step.joints_rad)
        try:
            jacobian, covariance = self._learned(
                before, self._covariance, step.dt_s, step.d_joints_rad, step.d_ball_m
            )
            if covariance.size:
                # Raises unless positive definite, so that a covariance that lost this to
                # rounding is never kept, and the next step finds a sound one.
                np.linalg.cholesky(covariance)
        except np.linalg.LinAlgError:
            return None
        if not (_is_finite(jacobian) and _is_finite(covariance)):
            return None
        return jacobian, covariance

    @abstractmethod
    def _learned(
        self,
        jacobian: np.ndarray,
        covariance: np.ndarray,
        dt_s: float,
        d_joints_rad: np.ndarray,
        d_ball_m: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Jacobian and covariance after one finite step with motion; new arrays.

        What is not finite, or raises ``LinAlgError``, is not kept.
        """

    @property
    def problem(self) -> str:
        """Why there is no estimate yet: a zero Jacobian that has seen no motion is none."""
        if self._model is None and self._updates == 0:
            return "it starts from zero and has seen no motion; move the arm by other means"
        return ""

    def status_values(self) -> dict[str, float]:
        """Counts, the change since the start, and the deviation of an entry (rms), m/rad."""
        change = 0.0
        if self._jacobian is not None and self._initial_jacobian is not None:
            change = float(np.linalg.norm(self._jacobian - self._initial_jacobian))
        values = {
            "updates": float(self._updates),
            "refused": float(self._refused),
            "jacobian_change_m_rad": change,
        }
        if self._covariance.size:
            variance = float(np.trace(self._covariance)) / len(self._covariance)
            values["entry_deviation_m_rad"] = math.sqrt(variance)
        return values


def _is_finite(values: np.ndarray) -> bool:
    """Whether all values and the sum of their squares are finite: one fast question."""
    return math.isfinite(np.vdot(values, values))


def row_update(
    jacobian: np.ndarray,
    covariance: np.ndarray,
    noise_variance_m2: float,
    d_joints_rad: np.ndarray,
    d_ball_m: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Kalman measurement update of three rows that share one covariance.

    Parameters
    ----------
    jacobian : ndarray, shape (3, 6)
        Estimate before, m/rad.
    covariance : ndarray, shape (6, 6)
        Covariance of each row before, (m/rad)^2.
    noise_variance_m2 : float
        Variance of one coordinate of ``d_ball_m``, m^2.
    d_joints_rad : ndarray, shape (6,)
        Joint motion, rad.
    d_ball_m : ndarray, shape (3,)
        Ball motion, m.

    Returns
    -------
    jacobian : ndarray, shape (3, 6)
    covariance : ndarray, shape (6, 6)
        After, in Joseph's form: a sum of squares, which rounding leaves positive.
    """
    seen = covariance @ d_joints_rad
    gain = seen / (d_joints_rad @ seen + noise_variance_m2)
    error_m = d_ball_m - jacobian @ d_joints_rad
    left = _IDENTITY - np.multiply.outer(gain, d_joints_rad)
    after = left @ covariance @ left.T + np.multiply.outer(gain * noise_variance_m2, gain)
    return jacobian + np.multiply.outer(error_m, gain), 0.5 * (after + after.T)
