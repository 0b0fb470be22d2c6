"""Broyden's rank-one update: the smallest change of J that explains the last step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fvs_estimator_node.online import OnlineConfig, OnlineEstimator, online_parameters
from fvs_estimator_node.rbf import RbfModel
from fvs_ros.params import Parameter


@dataclass(frozen=True)
class BroydenConfig(OnlineConfig):
    """Gain of the update.

    Parameters
    ----------
    gain : float
        Share of a step's prediction error that is corrected, above 0 and below 2; at 1 the new
        Jacobian explains the step exactly, noise and all.
    """

    gain: float = 0.3

    def __post_init__(self) -> None:
        super().__post_init__()
        self._want(0.0 < self.gain < 2.0, "gain", "above 0 and below 2")


#: Parameters of the method ``broyden`` as a node declares them.
BROYDEN_PARAMETERS = (
    *online_parameters("broyden"),
    Parameter(
        "broyden.gain",
        BroydenConfig.gain,
        "Share of a step's prediction error that is corrected.",
        1e-3,
        1.9,
    ),
)


class BroydenEstimator(OnlineEstimator):
    """``J += gain (d_ball - J d_joints) d_joints' / (d_joints' d_joints)``.

    It has no notion of noise: the shorter a step, the more of a position's noise goes into J.

    Parameters
    ----------
    model : RbfModel, optional
        The trained networks; needed unless ``config.initial`` is ``zero``.
    config : BroydenConfig, optional
        Gain.
    """

    def __init__(self, model: RbfModel | None = None, config: BroydenConfig | None = None) -> None:
        self._config = config if config is not None else BroydenConfig()
        super().__init__(model, self._config)

    @property
    def config(self) -> BroydenConfig:
        """The gain."""
        return self._config

    def _learned(
        self,
        jacobian: np.ndarray,
        covariance: np.ndarray,
        dt_s: float,
        d_joints_rad: np.ndarray,
        d_ball_m: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        error_m = d_ball_m - jacobian @ d_joints_rad
        share = self._config.gain * d_joints_rad / (d_joints_rad @ d_joints_rad)
        return jacobian + np.multiply.outer(error_m, share), covariance
