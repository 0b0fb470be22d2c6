"""Linear Kalman filter of the Jacobian's 18 entries, each a random walk."""

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

_IDENTITY = np.eye(N_JOINTS)


@dataclass(frozen=True)
class KalmanConfig(OnlineConfig):
    """Noise and start of a Kalman filter of the Jacobian.

    Parameters
    ----------
    process_noise : float
        Variance that each entry gains per second of learned motion, (m/rad)^2/s. The default is
        1e-4 a step at 25 steps a second.
    measurement_noise_m : float
        Standard deviation of one coordinate of a ball position, m. A step is the difference of
        two, so that its variance is twice this one's.
    initial_deviation_m_rad : float
        Standard deviation of each entry of the initial Jacobian, m/rad.
    """

    process_noise: float = 2.5e-3
    measurement_noise_m: float = 1e-3
    initial_deviation_m_rad: float = 0.1

    def __post_init__(self) -> None:
        super().__post_init__()
        self._want(self.process_noise >= 0.0, "process_noise", "at least 0")
        self._want(self.measurement_noise_m > 0.0, "measurement_noise_m", "positive")
        self._want(self.initial_deviation_m_rad > 0.0, "initial_deviation_m_rad", "positive")

    @property
    def step_variance_m2(self) -> float:
        """Variance R of one coordinate of a step, m^2."""
        return 2.0 * self.measurement_noise_m**2


def kalman_parameters(method: str) -> tuple[Parameter, ...]:
    """The parameters of :class:`KalmanConfig` as a node declares them."""
    return (
        *online_parameters(method),
        Parameter(
            f"{method}.process_noise",
            KalmanConfig.process_noise,
            "Variance that each entry gains per second of motion, (m/rad)^2/s; larger follows "
            "faster and is noisier.",
            0.0,
            10.0,
        ),
        *deviation_parameters(
            method, KalmanConfig.initial_deviation_m_rad, KalmanConfig.measurement_noise_m
        ),
    )


#: Parameters of the method ``lkf`` as a node declares them.
LKF_PARAMETERS = kalman_parameters("lkf")


class LkfEstimator(OnlineEstimator):
    """Kalman filter with the measurement ``d_ball = (I3 (x) d_joints') vec(J)``, J row-major.

    Initial covariance, process and measurement noise are the same for the three rows of J, and
    each row is measured by one coordinate with the same ``d_joints``. The covariance of the 18
    entries therefore is and stays ``I3 (x) P`` with one P of 6x6: one small filter, not an
    approximation.

    Parameters
    ----------
    model : RbfModel, optional
        The trained networks; needed unless ``config.initial`` is ``zero``.
    config : KalmanConfig, optional
        Noise and start.
    """

    def __init__(self, model: RbfModel | None = None, config: KalmanConfig | None = None) -> None:
        self._config = config if config is not None else KalmanConfig()
        super().__init__(
            model, self._config, self._config.initial_deviation_m_rad**2 * np.eye(N_JOINTS)
        )

    @property
    def config(self) -> KalmanConfig:
        """Noise and start."""
        return self._config

    def _learned(
        self,
        jacobian: np.ndarray,
        covariance: np.ndarray,
        dt_s: float,
        d_joints_rad: np.ndarray,
        d_ball_m: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        predicted = covariance + self._config.process_noise * dt_s * _IDENTITY
        return row_update(
            jacobian, predicted, self._config.step_variance_m2, d_joints_rad, d_ball_m
        )
