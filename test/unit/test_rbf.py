"""The networks' update law, (17), by hand and by its Lyapunov function."""

import math

import numpy as np
import pytest
from cases import each
from recordings import random_networks

from fvs_estimator_node.base import MotionStep
from fvs_estimator_node.rbf import RbfConfig, RbfEstimator, RbfModel


def random_step(rng, dt_s=0.04, true=None):
    """Any motion, seen by a camera as it is or through the true networks."""
    joints, velocity = rng.uniform(-1.0, 1.0, 6), 0.75 * rng.uniform(-1.0, 1.0, 6)
    seen = 0.5 * rng.normal(size=3) if true is None else true.jacobian(joints) @ velocity
    return MotionStep(1.0, dt_s, joints, dt_s * velocity, dt_s * seen, 0.1 * rng.normal(size=3))


@each("target", ["offline", "zero"])
def test_the_update_is_equation_17_by_hand(target):
    model, rng = random_networks(), np.random.default_rng(2)
    config = RbfConfig(n1=0.4, alpha2=0.2, k3=0.05, leak_target=target, mu=1.9)
    estimator = RbfEstimator(model, config)
    for _ in range(3):
        step = random_step(rng)
        before = estimator.weights
        distances = np.linalg.norm(step.joints_rad - model.centres, axis=2)
        theta = np.exp(-((distances / model.widths) ** 2))  # (8)
        columns = np.stack([before[i] @ theta[i] for i in range(6)], axis=1)  # (9)
        np.testing.assert_allclose(estimator.jacobian(step.joints_rad), columns, rtol=1e-12)
        v = step.d_joints_rad / step.dt_s
        e = step.d_feature_m / step.dt_s - columns @ v
        expected = np.empty_like(before)
        for i in range(6):
            for j in range(3):
                drive = config.n1 * e[j] + config.alpha2 * step.sliding_variable[j]
                rest = model.weights[i, j] if target == "offline" else 0.0
                kept = math.exp(-config.k3 * step.dt_s)
                expected[i, j] = rest + kept * (before[i, j] - rest)
                expected[i, j] += step.dt_s * v[i] * theta[i] * drive
        estimator.update(step)
        np.testing.assert_allclose(estimator.weights, expected, rtol=1e-9, atol=1e-12)


def test_the_lyapunov_function_gains_what_the_sliding_term_must_cancel():
    # d/dt tr(dW dW') / 2 = -(n1 |e|^2 + alpha2 s'e): with plus, as in the corrected law
    model, rng = random_networks(), np.random.default_rng(4)
    true = model.weights + 0.3 * rng.normal(size=model.weights.shape)
    config, dt_s = RbfConfig(n1=0.5, alpha2=0.3), 1e-6
    step = random_step(rng, dt_s, RbfModel(model.centres, model.widths, true))
    estimator = RbfEstimator(model, config)
    e = (step.d_feature_m - estimator.jacobian(step.joints_rad) @ step.d_joints_rad) / dt_s
    before = np.sum((true - estimator.weights) ** 2) / 2.0
    estimator.update(step)
    slope = (np.sum((true - estimator.weights) ** 2) / 2.0 - before) / dt_s
    wanted = -(config.n1 * e @ e + config.alpha2 * step.sliding_variable @ e)
    assert slope == pytest.approx(wanted, rel=1e-3)
