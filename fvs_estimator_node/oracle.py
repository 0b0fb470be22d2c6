"""The true Jacobian, which only a simulator knows: the yardstick of all estimates."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fvs_estimator_node.base import Estimator, MotionStep
from fvs_estimator_node.rbf import N_FEATURES
from fvs_ros.joints import N_JOINTS


class OracleEstimator(Estimator):
    """Hands on the true Jacobian.

    Parameters
    ----------
    true_jacobian : callable, optional
        Joints, rad, shape (6,), to the true Jacobian, m/rad, shape (3, 6). Without it the Jacobian
        is the one last told, wherever it is asked for; before the first, it is not a number.
    """

    learns = False

    def __init__(self, true_jacobian: Callable[[np.ndarray], np.ndarray] | None = None) -> None:
        self._true_jacobian = true_jacobian
        self._told: np.ndarray | None = None

    @property
    def problem(self) -> str:
        """Why there is no estimate, in words; empty if there is one."""
        if self._true_jacobian is not None or self._told is not None:
            return ""
        return "only a simulator knows the true Jacobian, and none tells it"

    def tell(self, jacobian: np.ndarray) -> None:
        """Take the present true Jacobian, m/rad, shape (3, 6).

        Raises
        ------
        ValueError
            If it is of another shape or not finite.
        """
        told = np.array(jacobian, dtype=float)
        if told.shape != (N_FEATURES, N_JOINTS) or not np.all(np.isfinite(told)):
            raise ValueError(
                f"a true Jacobian must be finite and of shape ({N_FEATURES}, {N_JOINTS}), "
                f"got shape {told.shape}"
            )
        self._told = told

    def jacobian(self, joints_rad: np.ndarray) -> np.ndarray:
        """The true Jacobian, m/rad, shape (3, 6); not a number before it was told."""
        if self._true_jacobian is not None:
            return np.array(self._true_jacobian(joints_rad), dtype=float)
        if self._told is None:
            return np.full((N_FEATURES, N_JOINTS), np.nan)
        return self._told.copy()

    def update(self, step: MotionStep) -> None:
        """Learn nothing."""

    def reset(self) -> None:
        """Forget what was told."""
        self._told = None
