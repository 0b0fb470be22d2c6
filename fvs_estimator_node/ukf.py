"""Unscented Kalman filter of the Jacobian's 18 entries.

The measurement is linear in the entries, and there an unscented transform is exact: up to
rounding this *is* the linear filter of ``lkf.py``, at several times its cost. It is here because
it is what visual servoing is often compared with, and so that the comparison can be made.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fvs_estimator_node.lkf import KalmanConfig, kalman_parameters
from fvs_estimator_node.online import OnlineEstimator
from fvs_estimator_node.rbf import N_FEATURES, RbfModel
from fvs_ros.joints import N_JOINTS
from fvs_ros.params import Parameter

_N = N_FEATURES * N_JOINTS
_IDENTITY = np.eye(_N)


@dataclass(frozen=True)
class UkfConfig(KalmanConfig):
    """Noise, start and sigma points.

    Parameters
    ----------
    alpha, beta, kappa : float
        Spread of Merwe's scaled sigma points. With small ``alpha`` the weights are large and
        cancel each other's digits; 1 and a ``kappa`` of 0 leave all weights between 0 and 2.
    """

    alpha: float = 1.0
    beta: float = 2.0
    kappa: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._want(self.alpha > 0.0, "alpha", "positive")
        self._want(self.beta >= 0.0, "beta", "at least 0")
        self._want(self.kappa > -_N, "kappa", f"above -{_N}")


#: Parameters of the method ``ukf`` as a node declares them.
UKF_PARAMETERS = (
    *kalman_parameters("ukf"),
    Parameter("ukf.alpha", UkfConfig.alpha, "Spread of the sigma points.", 1e-2, 2.0),
    Parameter("ukf.beta", UkfConfig.beta, "Extra weight of the middle sigma point.", 0.0, 10.0),
    Parameter("ukf.kappa", UkfConfig.kappa, "Second spread of the sigma points.", -17.0, 100.0),
)


class UkfEstimator(OnlineEstimator):
    """Unscented filter with 37 sigma points, of the model that ``LkfEstimator`` filters.

    Weights and points as in R. van der Merwe, Sigma-Point Kalman Filters, 2004. The entries are a
    random walk, and the transform of a walk's unchanged mean is exact, so that prediction only
    adds to the covariance.

    Parameters
    ----------
    model : RbfModel, optional
        The trained networks; needed unless ``config.initial`` is ``zero``.
    config : UkfConfig, optional
        Noise, start and sigma points.
    """

    def __init__(self, model: RbfModel | None = None, config: UkfConfig | None = None) -> None:
        self._config = config = config if config is not None else UkfConfig()
        scale = config.alpha**2 * (_N + config.kappa)
        middle = 1.0 - _N / scale
        self._spread = math.sqrt(scale)
        self._mean_weights = np.full(2 * _N + 1, 0.5 / scale)
        self._mean_weights[0] = middle
        self._weights = self._mean_weights[:, None].copy()
        self._weights[0] += 1.0 - config.alpha**2 + config.beta
        super().__init__(model, config, config.initial_deviation_m_rad**2 * np.eye(_N))

    @property
    def config(self) -> UkfConfig:
        """Noise, start and sigma points."""
        return self._config

    def _learned(
        self,
        jacobian: np.ndarray,
        covariance: np.ndarray,
        dt_s: float,
        d_joints_rad: np.ndarray,
        d_ball_m: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        variance_m2 = self._config.step_variance_m2
        predicted = covariance + self._config.process_noise * dt_s * _IDENTITY
        arms = self._spread * np.linalg.cholesky(predicted).T
        points = np.concatenate([np.zeros((1, _N)), arms, -arms]) + jacobian.reshape(_N)
        seen_m = points.reshape(-1, N_FEATURES, N_JOINTS) @ d_joints_rad

        mean, mean_m = self._mean_weights @ points, self._mean_weights @ seen_m
        off, off_m = points - mean, seen_m - mean_m
        weighted_m = self._weights * off_m
        innovation = off_m.T @ weighted_m + variance_m2 * np.eye(N_FEATURES)
        gain = np.linalg.solve(innovation, weighted_m.T @ off).T
        after = mean + gain @ (d_ball_m - mean_m)
        # The covariance of what the gain leaves of the points: P - K S K' in Joseph's form,
        # whose terms are squares, where the difference would lose its sign to rounding.
        left = off - off_m @ gain.T
        spread = left.T @ (self._weights * left) + variance_m2 * (gain @ gain.T)
        return after.reshape(N_FEATURES, N_JOINTS), 0.5 * (spread + spread.T)
