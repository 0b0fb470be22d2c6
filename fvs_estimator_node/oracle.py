"""The true Jacobian, which only a simulator knows: the yardstick of all estimates."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fvs_estimator_node.base import Estimator


class OracleEstimator(Estimator):
    """Hands on the true Jacobian.

    Parameters
    ----------
    true_jacobian : callable, optional
        Joints, rad, shape (n,), to the true Jacobian, m/rad, shape (m, n). Without it the Jacobian
        is the newest of :meth:`tell`, wherever it is asked for.
    """

    learns = False

    def __init__(
        self,
        true_jacobian: Callable[[np.ndarray], np.ndarray] | None = None,
        _config: object = None,
    ) -> None:
        super().__init__()
        self._true_jacobian = true_jacobian
        self._told: np.ndarray | None = None

    @property
    def problem(self) -> str:
        """Why there is no estimate; empty if there is one."""
        if self._true_jacobian is not None or self._told is not None:
            return ""
        return "only a simulator knows the true Jacobian, and none tells it"

    def tell(self, jacobian: np.ndarray) -> None:
        """Take the present true Jacobian, m/rad, shape (m, n), finite."""
        self._told = np.array(jacobian, dtype=float)

    def jacobian(self, joints_rad: np.ndarray) -> np.ndarray:
        """The true Jacobian, m/rad, shape (m, n).

        Raises
        ------
        ValueError
            If it is not known.
        """
        if self._true_jacobian is not None:
            return np.array(self._true_jacobian(joints_rad), dtype=float)
        if self._told is None:
            raise ValueError(self.problem)
        return self._told.copy()

    def reset(self) -> None:
        """Forget what was told."""
        super().reset()
        self._told = None
