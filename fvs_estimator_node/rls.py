"""Recursive least squares with a forgetting factor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fvs_estimator_node.online import (
    OnlineConfig,
    OnlineEstimator,
    deviation_parameters,
    online_parameters,
    row_update,
)
from fvs_estimator_node.rbf import RbfModel
from fvs_ros.joints import N_JOINTS
from fvs_ros.params import Parameter


@dataclass(frozen=True)
class RlsConfig(OnlineConfig):
    """Memory and start of the least squares.

    Parameters
    ----------
    forgetting : float
        Weight of a step relative to that of the next, above 0 up to 1; 0.98 remembers 50 steps.
    measurement_noise_m : float
        Standard deviation of one coordinate of a ball position, m. With
        ``initial_deviation_m_rad`` it says how many steps outweigh the initial Jacobian.
    initial_deviation_m_rad : float
        Standard deviation of each entry of the initial Jacobian, m/rad.
    wind_up_limit : float
        Largest deviation in any direction of joint motion, as a multiple of the initial one; at
        least 1, which is: nothing is ever known less well than at the start.
    """

    forgetting: float = 0.98
    measurement_noise_m: float = 1e-3
    initial_deviation_m_rad: float = 0.1
    wind_up_limit: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._want(0.0 < self.forgetting <= 1.0, "forgetting", "above 0 and at most 1")
        self._want(self.measurement_noise_m > 0.0, "measurement_noise_m", "positive")
        self._want(self.initial_deviation_m_rad > 0.0, "initial_deviation_m_rad", "positive")
        self._want(self.wind_up_limit >= 1.0, "wind_up_limit", "at least 1")


#: Parameters of the method ``rls`` as a node declares them.
RLS_PARAMETERS = (
    *online_parameters("rls"),
    Parameter(
        "rls.forgetting",
        RlsConfig.forgetting,
        "Weight of a step relative to that of the next.",
        0.5,
        1.0,
    ),
    *deviation_parameters("rls", RlsConfig.initial_deviation_m_rad, RlsConfig.measurement_noise_m),
    Parameter(
        "rls.wind_up_limit",
        RlsConfig.wind_up_limit,
        "Largest deviation in any direction, as a multiple of the initial one.",
        1.0,
        1e3,
    ),
)


class RlsEstimator(OnlineEstimator):
    """Least squares over all steps, a step's weight shrinking with each that follows.

    Minimises ``sum_i f^(n-i) |d_ball_i - J d_joints_i|^2 / (2 sigma^2) + f^n |J - J0|^2 / d0^2``
    after n steps, f the forgetting factor, sigma the noise, d0 the initial deviation: the Kalman
    filter's measurement update, between steps the covariance divided by f.

    Parameters
    ----------
    model : RbfModel, optional
        The trained networks; needed unless ``config.initial`` is ``zero``.
    config : RlsConfig, optional
        Memory and start.
    """

    def __init__(self, model: RbfModel | None = None, config: RlsConfig | None = None) -> None:
        self._config = config = config if config is not None else RlsConfig()
        initial = config.initial_deviation_m_rad**2
        self._variance_m2 = 2.0 * config.measurement_noise_m**2
        self._most = config.wind_up_limit**2 * initial
        super().__init__(model, config, initial * np.eye(N_JOINTS))

    @property
    def config(self) -> RlsConfig:
        """Memory and start."""
        return self._config

    def _learned(
        self,
        jacobian: np.ndarray,
        covariance: np.ndarray,
        dt_s: float,
        d_joints_rad: np.ndarray,
        d_ball_m: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        predicted = self._limited(covariance / self._config.forgetting)
        return row_update(jacobian, predicted, self._variance_m2, d_joints_rad, d_ball_m)

    def _limited(self, covariance: np.ndarray) -> np.ndarray:
        """The covariance without more than the largest variance in any direction.

        Rest is the motion gate's business. What it leaves is motion in few directions: in the
        others nothing is measured, yet dividing by the forgetting factor goes on, and the
        covariance there grows exponentially, until the first motion that way turns noise into a
        wild Jacobian. Of the usual remedies, scaling the covariance back to a largest trace
        claims to know the moved directions better than one does, and to stop forgetting
        altogether stops following in them. Cutting off the eigenvalues touches only the
        directions that wind up: there, forgetting ends at the initial ignorance or a multiple.
        """
        if covariance.trace() <= self._most:  # the sum of the eigenvalues, all positive
            return covariance
        variances, directions = np.linalg.eigh(covariance)
        if variances[-1] <= self._most:
            return covariance
        return (directions * np.minimum(variances, self._most)) @ directions.T
