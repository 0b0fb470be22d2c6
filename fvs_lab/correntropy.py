"""A Kalman filter of the Jacobian that is robust to heavy tails, as published beside others.

Maximum correntropy: B. Chen, X. Liu, H. Zhao and J. Principe, Maximum correntropy Kalman filter,
Automatica 76 (2017); for uncalibrated visual servoing under alpha-stable noise G. Leite, I. Araujo
and A. Martins, Sensors 23 (2023) 8518 (github.com/AI-SPARC/uncalibrated-visual-servoing).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fvs_estimator_node.base import MotionStep
from fvs_estimator_node.online import LkfEstimator, OnlineConfig


@dataclass(frozen=True)
class CorrentropyConfig(OnlineConfig):
    """Settings of the filter."""

    #: Width of the Gaussian kernel, in standard deviations: infinitely wide, it is the LKF.
    bandwidth: float = 4.0
    #: Least change of the Jacobian that is iterated for, relative, and most iterations.
    change: float = 1e-4
    iterations: int = 20


class CorrentropyEstimator(LkfEstimator):
    """Errors that are far off count less: the prior's, and the measurement's, of each row.

    A step's entries j of a row are those that maximise the sum of ``exp(-e^2 / (2 d^2))`` over the
    normalised errors e of the n entries from the prior and of the measurement; by fixed-point
    iterations of Kalman gains. Unlike in the LKF, each row has a covariance of its own.
    """

    def _learned(
        self, jacobian: np.ndarray, covariance: np.ndarray, step: MotionStep
    ) -> tuple[np.ndarray, np.ndarray]:
        config, moved = self.config, step.d_joints_rad
        assert isinstance(config, CorrentropyConfig)
        rows, joints = jacobian.shape
        variance_m2 = config.step_variance_m2
        drift = config.process_noise * step.dt_s * np.eye(joints)
        prior = np.broadcast_to(covariance, (rows, joints, joints)) + drift
        root = np.linalg.cholesky(prior)
        error_m = step.d_feature_m - jacobian @ moved
        after = jacobian
        for _ in range(config.iterations):
            off = np.linalg.solve(root, (after - jacobian)[..., None])[..., 0]
            missed = (step.d_feature_m - after @ moved) / np.sqrt(variance_m2)
            counted, heard = (  # not below what can be divided by
                np.exp(-np.minimum(0.5 * (errors / config.bandwidth) ** 2, 300.0))
                for errors in (off, missed)
            )
            # A prior and a measurement that count less vary more.
            covaried = (root / counted[:, None, :]) @ np.swapaxes(root, 1, 2) @ moved
            gain = covaried / (covaried @ moved + variance_m2 / heard)[:, None]
            before, after = after, jacobian + gain * error_m[:, None]
            if np.linalg.norm(after - before) <= config.change * np.linalg.norm(before):
                break
        left = np.eye(joints) - gain[:, :, None] * moved
        spread = left @ prior @ np.swapaxes(left, 1, 2)
        spread = spread + variance_m2 * gain[:, :, None] * gain[:, None, :]
        return after, 0.5 * (spread + np.swapaxes(spread, 1, 2))
