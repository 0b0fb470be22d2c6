"""Radial basis function networks, one per Jacobian column, and their online update.

The paper's equations: features (8), columns (9), update law (17) with the corrections that make
its stability proof hold: the sliding term enters with a plus, and the leak pulls toward the
offline weights rather than toward zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from fvs_estimator_node.base import NETWORKS, Estimator, MotionStep
from fvs_ros.kinds import Kind
from fvs_ros.params import Parameters, parameter
from fvs_ros.vectors import check_arrays


@dataclass(frozen=True)
class RbfModel:
    """Centres, widths and weights of n networks of k neurons, finite; a ``ValueError`` if not."""

    centres: np.ndarray  #: u_it of neuron t of network i, rad, (n, k, n)
    widths: np.ndarray  #: delta_it, rad, positive, (n, k)
    #: W_i, per rad, (n, m, k): of the feature's m numbers, or of a twist for a camera on the arm.
    weights: np.ndarray

    def __post_init__(self) -> None:
        shapes = {"centres": ("n", "k", "n"), "widths": ("n", "k"), "weights": ("n", "m", "k")}
        if min(check_arrays(self, shapes).values()) < 1:
            raise ValueError("the networks have no neurons")
        if self.widths.min() <= 0.0:
            raise ValueError(f"widths must be positive, the smallest is {self.widths.min():g}")

    def jacobian(self, joints_rad: np.ndarray) -> np.ndarray:
        """Columns J_i = W_i theta_i, eq (9), per rad, (..., m, n), at joints, rad, (..., n)."""
        theta = rbf_features(self.centres, self.widths, joints_rad)
        return np.einsum("ijk,...ik->...ji", self.weights, theta)


def rbf_features(centres: np.ndarray, widths: np.ndarray, joints_rad: np.ndarray) -> np.ndarray:
    """Neuron values, eq (8), shape (..., n, k), of networks at joints, rad, shape (..., n)."""
    joints = np.asarray(joints_rad, dtype=float)
    offset, slope, curvature = _exponent_terms(centres, widths)
    exponent = joints.reshape(-1, joints.shape[-1]) @ slope.T
    exponent += offset
    exponent += np.sum(joints * joints, axis=-1).reshape(-1, 1) * curvature
    np.exp(exponent, out=exponent)
    return exponent.reshape(*joints.shape[:-1], *widths.shape)


def _exponent_terms(
    centres: np.ndarray, widths: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Terms of -(|r - u| / delta)^2 = offset + slope r + curvature |r|^2, neurons in a row."""
    curvature = -1.0 / np.square(widths.reshape(-1))
    flat = centres.reshape(curvature.size, -1)
    return curvature * np.sum(flat * flat, axis=1), -2.0 * curvature[:, None] * flat, curvature


@dataclass(frozen=True)
class RbfConfig(Parameters):
    """Numbers of the update law (17), with the paper's symbols.

    The adaptation gain Gamma is a factor of ``n1`` and ``alpha2``. ``n1`` is n3 of (45), and
    ``alpha2`` n2 where the control law is the proportional one, which publishes the error as its s.
    """

    n1: float = parameter(0.3, "Gain n1 on the velocity prediction error.", 0.0)
    #: 0.005 has no visible effect, 0.03 costs a seventh of the speed. Far from the target the term
    #: moves the Jacobian by about ``alpha2 s |theta|^2 r_dot`` per second, even if it is right.
    alpha2: float = parameter(
        0.005,
        "Gain alpha2 on the sliding variable; it should stay below 0.03. Negative values give "
        "the sign printed in (17), for which the stability proof does not hold.",
        -10.0,
        10.0,
    )
    k3: float = parameter(0.0, "Leak toward the rest weights, 1/s.", 0.0, 100.0)
    leak_target: str = parameter(
        "offline",
        "Rest weights of the leak: those of the model, or zero as in the paper.",
        choices=("offline", "zero"),
    )
    mu: float = parameter(
        0.5,
        "Largest share of the prediction error that one step may correct; stable below 2.",
        1e-3,
        1.9,
    )


class FrozenRbfEstimator(Estimator):
    """The networks as they were trained; it does not learn."""

    learns = False
    made_from = NETWORKS

    def __init__(self, model: RbfModel, config: Any = None, kind: Kind | None = None) -> None:
        super().__init__(kind)
        self.config: Any = config or self.config_type()
        self.model, self._offline = model, model.weights * self.kind.learned[:, None]
        self._offset, self._slope, self._curvature = _exponent_terms(model.centres, model.widths)
        self.reset()

    def _evaluate(self, joints_rad: np.ndarray) -> np.ndarray:
        """Features at one joint vector, (n, k), in a fifth of the time of :func:`rbf_features`."""
        square = joints_rad.dot(joints_rad)
        exponent = self._slope.dot(joints_rad) + self._offset + square * self._curvature
        return np.asarray(np.exp(exponent).reshape(self.model.widths.shape))

    def jacobian(self, joints_rad: np.ndarray, z: np.ndarray | None = None) -> np.ndarray:
        """Estimate at joints, rad, (n,), and the feature there, (m,): m/rad, shape (d, n)."""
        theta = self._evaluate(np.asarray(joints_rad, dtype=float))
        columns = np.matmul(self.weights, theta[:, :, None])[:, :, 0].T.copy()
        return columns if z is None else self.kind.to_tangent(z, columns)

    def reset(self) -> None:
        """Return to the trained weights and forget the counts."""
        super().reset()
        #: Present weights of the weighted numbers, m/rad, shape (n, m, k).
        self.weights = self._offline.copy()


class RbfEstimator(FrozenRbfEstimator):
    """The networks with the paper's online update (17) of their weights.

    With e = x_dot - J r_dot, the weights of feature j of network i change by
    ``Gamma r_dot_i theta_i (n1 e_j + alpha2 s_j) - k3 (W_ij - W0_ij)``, integrated over the step:
    the leak exactly, the rest with Gamma reduced where ``Gamma n1 dt sum_i r_dot_i^2 |theta_i|^2``
    would exceed ``mu``. (The proof holds for any positive Gamma, but not for an overshooting step.)
    """

    learns = True
    config_type = RbfConfig
    group = "rbf"

    def update(self, step: MotionStep) -> None:
        """Learn from one step; what is not finite changes nothing."""
        config = self.config
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            velocity = step.d_joints_rad / step.dt_s
            theta = self._evaluate(step.joints_rad)
            columns = np.matmul(self.weights, theta[:, :, None])[:, :, 0]
            predicted = self.kind.to_tangent(step.z, velocity @ columns)
            regressor = velocity[:, None] * theta
            energy = step.dt_s * float(np.vdot(regressor, regressor))
            share = config.mu / max(config.mu, config.n1 * energy)
            error = step.d_feature_m / step.dt_s - predicted
            drive = share * step.dt_s * (config.n1 * error + config.alpha2 * step.sliding_variable)
            drive = self.kind.from_tangent(step.z, drive)
            weights = self.weights + drive[None, :, None] * regressor[:, None, :]
            if config.k3 > 0.0:
                rest = 0.0 if config.leak_target == "zero" else self._offline
                weights -= -math.expm1(-config.k3 * step.dt_s) * (self.weights - rest)
        if not (step.dt_s > 0.0 and math.isfinite(np.vdot(weights, weights))):
            self.refused += 1
            return
        self.weights = weights
        self.updates += 1
