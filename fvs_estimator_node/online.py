"""Estimators that use only the last steps: two Kalman filters and least squares.

Each holds one Jacobian, fitted to the last motions, and no map of the workspace. They differ in how
they distribute a prediction error over its entries.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from fvs_estimator_node.base import NETWORKS, Estimator, MotionStep
from fvs_estimator_node.rbf import FrozenRbfEstimator, RbfModel
from fvs_ros.kinds import Kind
from fvs_ros.params import Parameters, parameter


@dataclass(frozen=True)
class OnlineConfig(Parameters):
    """Settings of the online estimators."""

    initial: str = parameter(
        "model",
        "Where the Jacobian starts: the trained networks' at the first joints, or zero; "
        "from zero there is no estimate until something else has moved the arm.",
        choices=("model", "zero"),
    )
    initial_deviation_m_rad: float = parameter(
        0.1,
        "Standard deviation of each entry of the initial Jacobian, m/rad; about 0.5 when it "
        "starts from zero.",
        1e-4,
        10.0,
    )
    measurement_noise_m: float = parameter(
        1e-3,
        "Standard deviation of one coordinate of a ball position, m.",
        1e-6,
        1.0,
    )
    #: By default 1e-4 (m/rad)^2 a step at 25 steps a second.
    process_noise: float = parameter(
        2.5e-3,
        "Variance that each entry gains per second of motion, (m/rad)^2/s; larger adapts "
        "faster and is noisier. For lkf and ukf.",
        0.0,
        10.0,
    )
    forgetting: float = parameter(
        0.98,
        "Weight of a step relative to that of the next; 0.98 remembers 50 steps. For rls.",
        0.5,
        1.0,
    )

    @property
    def initial_variance(self) -> float:
        """Variance of an entry at the start, (m/rad)^2."""
        return self.initial_deviation_m_rad**2

    @property
    def step_variance_m2(self) -> float:
        """Variance of one coordinate of a step, the difference of two positions, m^2."""
        return 2.0 * self.measurement_noise_m**2


class OnlineEstimator(Estimator):
    """One Jacobian, learned from steps alone; subclasses add the update.

    It starts as that of the trained networks; without them, from zero.
    """

    config_type = OnlineConfig
    group = "online"
    made_from = NETWORKS
    #: Whether the covariance is that of all entries, (d n, d n), or that of each row, (n, n).
    of_all_entries = False

    def __init__(
        self, model: RbfModel | None = None, config: Any = None, kind: Kind | None = None
    ) -> None:
        super().__init__(kind)
        self.config: OnlineConfig = config or OnlineConfig()
        self._model = FrozenRbfEstimator(model, None, self.kind) if model is not None else None
        self.reset()

    @classmethod
    def needs(cls, config: OnlineConfig) -> str:
        """Networks, unless it starts from zero."""
        return cls.made_from if config.initial == "model" else ""

    def reset(self) -> None:
        """Forget what was learned, the initial Jacobian and the counts."""
        super().reset()
        self._jacobian: np.ndarray | None = None
        self.covariance = np.zeros((0, 0))  # of the estimate, (m/rad)^2; empty before

    def jacobian(self, joints_rad: np.ndarray, z: np.ndarray | None = None) -> np.ndarray:
        """Present estimate, m/rad, shape (d, n), the same for all joints once it has begun."""
        if self._jacobian is None:
            start = np.zeros((self.kind.size, len(joints_rad)))
            if self._model is not None:
                start = self._model.jacobian(joints_rad, z)
            if not np.all(np.isfinite(start)):
                return start
            self._jacobian = start
            size = start.size if self.of_all_entries else len(joints_rad)
            self.covariance = self.config.initial_variance * np.eye(size)
        return self._jacobian.copy()

    def update(self, step: MotionStep) -> None:
        """Learn from one step; what would not be finite changes nothing."""
        with np.errstate(all="ignore"), suppress(np.linalg.LinAlgError):
            before = self.jacobian(step.joints_rad, step.z)
            if self._jacobian is not None:  # else the networks give no number there
                jacobian, covariance = self._learned(before, self.covariance, step)
                # Raises unless positive definite, to discard a covariance with rounding errors.
                np.linalg.cholesky(covariance)
                if _is_finite(jacobian) and _is_finite(covariance):
                    self._jacobian, self.covariance = jacobian, covariance
                    self.updates += 1
                    return
        self.refused += 1

    def _predicted(self, covariance: np.ndarray, dt_s: float) -> np.ndarray:
        """The covariance before the next step, with what may have changed in a time, s."""
        return covariance + self.config.process_noise * dt_s * np.eye(len(covariance))

    @abstractmethod
    def _learned(
        self, jacobian: np.ndarray, covariance: np.ndarray, step: MotionStep
    ) -> tuple[np.ndarray, np.ndarray]:
        """Jacobian and covariance after one step; new arrays.

        What is not finite, or raises ``LinAlgError``, is not kept.
        """

    @property
    def problem(self) -> str:
        """Why there is no estimate yet: a zero Jacobian that has seen no motion is none."""
        if self._model is None and self.updates == 0:
            return "it starts from zero and has seen no motion; move the arm by other means"
        return ""

    def status_values(self) -> dict[str, float]:
        """Counts, and the deviation of an entry (rms), m/rad."""
        variances = np.diag(self.covariance)
        known = variances.mean() if variances.size else self.config.initial_variance
        return {**super().status_values(), "entry_deviation_m_rad": math.sqrt(known)}


class LkfEstimator(OnlineEstimator):
    """Kalman filter with the measurement ``d_ball = (I (x) d_joints') vec(J)``, J row-major.

    Initial covariance, process and measurement noise are the same for all rows of J, and each row
    is measured by one coordinate with the same ``d_joints``. The covariance of all entries is and
    stays ``I (x) P`` with one n x n P: one small filter, not an approximation.
    """

    def _learned(
        self, jacobian: np.ndarray, covariance: np.ndarray, step: MotionStep
    ) -> tuple[np.ndarray, np.ndarray]:
        moved, variance_m2 = step.d_joints_rad, self.config.step_variance_m2
        covariance = self._predicted(covariance, step.dt_s)
        covaried = covariance @ moved
        gain = covaried / (moved @ covaried + variance_m2)
        error_m = step.d_feature_m - jacobian @ moved
        # Joseph's form: a sum of squares, which rounding leaves positive.
        left = np.eye(len(gain)) - np.multiply.outer(gain, moved)
        after = left @ covariance @ left.T + np.multiply.outer(gain * variance_m2, gain)
        return jacobian + np.multiply.outer(error_m, gain), 0.5 * (after + after.T)


class UkfEstimator(OnlineEstimator):
    """Unscented Kalman filter of the same model as ``lkf``.

    The measurement is linear in the entries, and there an unscented transform is exact: up to
    rounding this *is* the linear filter, whatever the spread of the sigma points, at several times
    its cost. It is here because visual servoing is often compared with it. Weights as in R. van
    der Merwe, Sigma-Point Kalman Filters, 2004, with alpha 1, beta 2 and kappa 0; the middle point
    is the mean, and counts for nothing.
    """

    of_all_entries = True

    def _learned(
        self, jacobian: np.ndarray, covariance: np.ndarray, step: MotionStep
    ) -> tuple[np.ndarray, np.ndarray]:
        moved, variance_m2 = step.d_joints_rad, self.config.step_variance_m2
        predicted, weight = self._predicted(covariance, step.dt_s), 0.5 / jacobian.size
        arms = math.sqrt(jacobian.size) * np.linalg.cholesky(predicted).T
        deviations = np.concatenate([arms, -arms])  # of the points from their mean
        deviations_m = deviations.reshape(-1, *jacobian.shape) @ moved
        innovation = weight * deviations_m.T @ deviations_m + variance_m2 * np.eye(len(jacobian))
        gain = np.linalg.solve(innovation, weight * deviations_m.T @ deviations).T
        after = jacobian + (gain @ (step.d_feature_m - jacobian @ moved)).reshape(jacobian.shape)
        # The covariance of what the gain leaves of the points: P - K S K' in Joseph's form,
        # whose terms are squares, where the difference would lose its sign to rounding.
        left = deviations - deviations_m @ gain.T
        spread = weight * left.T @ left + variance_m2 * (gain @ gain.T)
        return after, 0.5 * (spread + spread.T)


class RlsEstimator(LkfEstimator):
    """Least squares over all steps, a step's weight shrinking with each that follows.

    Minimises ``sum_i f^(k-i) |d_ball_i - J d_joints_i|^2 / (2 sigma^2) + f^k |J - J0|^2 / d0^2``
    after k steps, f the forgetting factor, sigma the noise, d0 the initial deviation: the Kalman
    filter's measurement update, between steps the covariance divided by f.

    In directions without motion that division would let the covariance grow until the first
    motion that way turned noise into a wild Jacobian. There, forgetting ends at the initial
    deviation: larger eigenvalues are cut off.
    """

    def _predicted(self, covariance: np.ndarray, dt_s: float) -> np.ndarray:
        predicted, most = covariance / self.config.forgetting, self.config.initial_variance
        if predicted.trace() > most:  # the sum of the eigenvalues, all positive
            variances, directions = np.linalg.eigh(predicted)
            if variances[-1] > most:
                predicted = (directions * np.minimum(variances, most)) @ directions.T
        return np.asarray(predicted)


def _is_finite(values: np.ndarray) -> bool:
    """Whether all values and the sum of their squares are finite, in one fast check."""
    return math.isfinite(np.vdot(values, values))
