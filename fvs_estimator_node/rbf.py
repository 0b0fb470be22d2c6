"""Six radial basis function networks, one a Jacobian column, and their online update.

The paper's equations: features (8), columns (9), update law (17) with the corrections that make
its stability proof hold: the sliding term enters with a plus, and the leak pulls toward the
offline weights rather than toward zero.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from fvs_estimator_node.base import Estimator, MotionStep
from fvs_ros.joints import N_JOINTS
from fvs_ros.params import Parameter

N_FEATURES = 3


@dataclass(frozen=True)
class RbfModel:
    """Centres, widths and weights of the six networks.

    Parameters
    ----------
    centres : ndarray, shape (6, m, 6)
        u_it: neuron t of network i, rad.
    widths : ndarray, shape (6, m)
        delta_it, rad, positive.
    weights : ndarray, shape (6, 3, m)
        W_i, m/rad.

    Raises
    ------
    ValueError
        If shapes do not fit, something is not finite, or a width is not positive.
    """

    centres: np.ndarray
    widths: np.ndarray
    weights: np.ndarray

    def __post_init__(self) -> None:
        for name in ("centres", "widths", "weights"):
            value = np.array(getattr(self, name), dtype=float)
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        m = self.widths.shape[1] if self.widths.ndim == 2 else 0
        wanted = {
            "centres": (N_JOINTS, m, N_JOINTS),
            "widths": (N_JOINTS, m),
            "weights": (N_JOINTS, N_FEATURES, m),
        }
        for name, shape in wanted.items():
            value = getattr(self, name)
            if m < 1 or value.shape != shape:
                raise ValueError(
                    f"{name} has shape {value.shape}, expected {shape} with m >= 1 neurons"
                )
            if not np.all(np.isfinite(value)):
                raise ValueError(f"{name} holds a number that is not finite")
        if self.widths.min() <= 0.0:
            raise ValueError(f"widths must be positive, the smallest is {self.widths.min():g}")

    @property
    def neurons(self) -> int:
        """Number of neurons of one network, m."""
        return self.widths.shape[1]

    def features(self, joints_rad: np.ndarray) -> np.ndarray:
        """Neuron values theta_it(r), eq (8).

        Parameters
        ----------
        joints_rad : ndarray, shape (..., 6)
            Joint positions, rad.

        Returns
        -------
        ndarray, shape (..., 6, m)
        """
        return rbf_features(self.centres, self.widths, joints_rad)

    def jacobian(self, joints_rad: np.ndarray) -> np.ndarray:
        """Columns J_i = W_i theta_i, eq (9), m/rad.

        Parameters
        ----------
        joints_rad : ndarray, shape (..., 6)
            Joint positions, rad.

        Returns
        -------
        ndarray, shape (..., 3, 6)
        """
        return np.einsum("ikm,...im->...ki", self.weights, self.features(joints_rad))


def rbf_features(centres: np.ndarray, widths: np.ndarray, joints_rad: np.ndarray) -> np.ndarray:
    """Neuron values for many joint vectors at once.

    Parameters
    ----------
    centres : ndarray, shape (n, m, 6)
        Centres of n networks, rad.
    widths : ndarray, shape (n, m)
        Widths, rad.
    joints_rad : ndarray, shape (..., 6)
        Joint positions, rad.

    Returns
    -------
    ndarray, shape (..., n, m)
    """
    joints = np.asarray(joints_rad, dtype=float)
    n, m = widths.shape
    offset, slope, curvature = _exponent_terms(centres, widths)
    exponent = joints.reshape(-1, joints.shape[-1]) @ slope.T
    exponent += offset
    exponent += np.sum(joints * joints, axis=-1).reshape(-1, 1) * curvature
    np.exp(exponent, out=exponent)
    return exponent.reshape(*joints.shape[:-1], n, m)


def _exponent_terms(
    centres: np.ndarray, widths: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Terms of -(|r - u| / delta)^2 = offset + slope r + curvature |r|^2, neurons in a row."""
    curvature = -1.0 / np.square(widths.reshape(-1))
    flat = centres.reshape(curvature.size, -1)
    return curvature * np.sum(flat * flat, axis=1), -2.0 * curvature[:, None] * flat, curvature


@dataclass(frozen=True)
class RbfConfig:
    """Numbers of the update law (17), with the paper's symbols.

    Only ``gamma * n1`` and ``gamma * alpha2`` act on the weights.

    Parameters
    ----------
    gamma : float
        Gamma, adaptation gain on both terms.
    n1 : float
        Gain on the velocity prediction error e; n3 of (45).
    alpha2 : float
        Gain on the sliding variable s; n2 of (45) where the control law is the proportional one,
        which publishes the error x - x_d as its s: the two update laws are then the same. The
        stability proof wants it; far from the target, where s is large, it moves the Jacobian by
        about ``gamma alpha2 s |theta|^2 r_dot`` a second, whether that is right or not. 0.005 is
        not noticed, 0.03 costs a seventh of the speed.
        Negative, it is the term with the sign as printed in (17), against which the proof does
        not hold: for comparisons only, a node does not accept it.
    k3 : float
        Leak toward the rest weights, 1/s.
    leak_target : str
        Rest weights: ``offline`` (those of the model) or ``zero`` (the paper's law).
    mu : float
        The part of the prediction error that one step may correct, at most; below 2 the law is
        stable whatever the gains.
    min_motion_rad : float
        No learning from steps in which no joint moved further than this, rad.
    """

    gamma: float = 1.0
    n1: float = 0.3
    alpha2: float = 0.005
    k3: float = 0.0
    leak_target: str = "offline"
    mu: float = 0.5
    min_motion_rad: float = 1e-3

    def __post_init__(self) -> None:
        for name in ("gamma", "n1", "k3", "min_motion_rad"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0):
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")
        if not math.isfinite(self.alpha2):
            raise ValueError(f"alpha2 must be finite, got {self.alpha2}")
        if not 0.0 < self.mu < 2.0:
            raise ValueError(f"mu must lie between 0 and 2, got {self.mu}")
        if self.leak_target not in LEAK_TARGETS:
            raise ValueError(
                f"unknown leak_target {self.leak_target!r}; known are {', '.join(LEAK_TARGETS)}"
            )


LEAK_TARGETS = ("offline", "zero")

#: Parameters of the method ``rbf`` as a node declares them.
RBF_PARAMETERS = (
    Parameter("rbf.gamma", RbfConfig.gamma, "Adaptation gain Gamma.", 0.0, 100.0),
    Parameter("rbf.n1", RbfConfig.n1, "Gain n1 on the prediction error.", 0.0, 100.0),
    Parameter(
        "rbf.alpha2",
        RbfConfig.alpha2,
        "Gain alpha2 on the sliding variable; gamma times alpha2 should stay below 0.03.",
        0.0,
        10.0,
    ),
    Parameter("rbf.k3", RbfConfig.k3, "Leak toward the rest weights, 1/s.", 0.0, 100.0),
    Parameter(
        "rbf.leak_target",
        RbfConfig.leak_target,
        "Rest weights of the leak: those of the model, or zero as in the paper.",
        choices=LEAK_TARGETS,
    ),
    Parameter(
        "rbf.mu",
        RbfConfig.mu,
        "Largest part of the prediction error that one step may correct.",
        1e-3,
        1.9,
    ),
    Parameter(
        "rbf.min_motion_rad",
        RbfConfig.min_motion_rad,
        "No learning from steps with less joint motion than this, rad.",
        0.0,
        1.0,
    ),
)


def rbf_config(values: Mapping[str, Any]) -> RbfConfig:
    """Configuration from parameter values (``rbf.n1`` and so on); others are passed over."""
    names = {field.name for field in fields(RbfConfig)}
    return RbfConfig(**{name: values[f"rbf.{name}"] for name in names if f"rbf.{name}" in values})


class FrozenRbfEstimator(Estimator):
    """The networks as they were trained; it does not learn.

    Evaluation of one joint vector works in buffers of the object (5-10 times faster than
    :meth:`RbfModel.jacobian`), so an object serves one thread.

    Parameters
    ----------
    model : RbfModel
        The trained networks.
    """

    learns = False

    def __init__(self, model: RbfModel) -> None:
        self._model = model
        self._offset, self._slope, self._curvature = _exponent_terms(model.centres, model.widths)
        self._theta = np.empty(self._offset.size)
        self._scratch = np.empty(self._offset.size)
        self._theta_by_network = self._theta.reshape(N_JOINTS, model.neurons)
        self._weights = model.weights.copy()

    @property
    def model(self) -> RbfModel:
        """The trained networks."""
        return self._model

    @property
    def weights(self) -> np.ndarray:
        """Present weights, m/rad, shape (6, 3, m); a copy."""
        return self._weights.copy()

    def _evaluate(self, joints_rad: np.ndarray) -> np.ndarray:
        """Features at one joint vector, shape (6, m), in a buffer that the next call reuses."""
        theta = self._theta
        np.dot(self._slope, joints_rad, out=theta)
        theta += self._offset
        np.multiply(self._curvature, np.dot(joints_rad, joints_rad), out=self._scratch)
        theta += self._scratch
        np.exp(theta, out=theta)
        return self._theta_by_network

    def jacobian(self, joints_rad: np.ndarray) -> np.ndarray:
        """Estimate at given joints, m/rad, shape (3, 6)."""
        theta = self._evaluate(np.asarray(joints_rad, dtype=float))
        return np.matmul(self._weights, theta[:, :, None])[:, :, 0].T.copy()

    def update(self, step: MotionStep) -> None:
        """Learn nothing."""

    def reset(self) -> None:
        """Return to the trained weights."""
        self._weights[:] = self._model.weights


class RbfEstimator(FrozenRbfEstimator):
    """The networks with the paper's online update (17) of their weights.

    With e = x_dot - J r_dot, the weights of feature j of network i change by
    ``Gamma r_dot_i theta_i (n1 e_j + alpha2 s_j) - k3 (W_ij - W0_ij)``, integrated over the step:
    the leak exactly, the rest with Gamma reduced where ``Gamma n1 dt sum_i r_dot_i^2 |theta_i|^2``
    would exceed ``mu``. (Any positive Gamma keeps the proof; a step that overshoots does not.)

    Parameters
    ----------
    model : RbfModel
        The trained networks.
    config : RbfConfig
        Gains.
    """

    learns = True

    def __init__(self, model: RbfModel, config: RbfConfig | None = None) -> None:
        super().__init__(model)
        self._config = config if config is not None else RbfConfig()
        faithful = self._config.leak_target == "zero"
        self._rest_weights = np.zeros_like(model.weights) if faithful else model.weights
        self._updates = 0
        self._refused = 0

    @property
    def config(self) -> RbfConfig:
        """The gains."""
        return self._config

    @property
    def updates(self) -> int:
        """Number of steps learned from."""
        return self._updates

    @property
    def refused(self) -> int:
        """Number of steps that would have made a weight not finite, and so changed nothing."""
        return self._refused

    def update(self, step: MotionStep) -> None:
        """Learn from one step; too little motion or anything not finite changes nothing."""
        config = self._config
        if np.abs(step.d_joints_rad).max() < config.min_motion_rad:
            return
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            velocity = step.d_joints_rad / step.dt_s
            theta = self._evaluate(step.joints_rad)
            columns = np.matmul(self._weights, theta[:, :, None])[:, :, 0]
            error = step.d_ball_m / step.dt_s - velocity @ columns
            regressor = velocity[:, None] * theta
            energy = step.dt_s * float(np.vdot(regressor, regressor))
            gamma = config.gamma
            if gamma * config.n1 * energy > config.mu:
                gamma = config.mu / (config.n1 * energy)
            drive = gamma * step.dt_s * (config.n1 * error + config.alpha2 * step.sliding_variable)
            weights = self._weights + drive[None, :, None] * regressor[:, None, :]
            if config.k3 > 0.0:
                leak = -math.expm1(-config.k3 * step.dt_s)
                weights -= leak * (self._weights - self._rest_weights)
        if not (step.dt_s > 0.0 and np.all(np.isfinite(weights))):
            self._refused += 1
            return
        self._weights = weights
        self._updates += 1

    def reset(self) -> None:
        """Return to the trained weights and forget the counts."""
        super().reset()
        self._updates = 0
        self._refused = 0

    def status_values(self) -> dict[str, float]:
        """Counts, and how far the weights are from the trained ones (Frobenius norm), m/rad."""
        return {
            "updates": float(self._updates),
            "refused": float(self._refused),
            "weight_change_m_rad": float(np.linalg.norm(self._weights - self._model.weights)),
        }
