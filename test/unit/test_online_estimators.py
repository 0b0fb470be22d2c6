"""Kalman filters and recursive least squares."""

import math

import numpy as np
import pytest
from cases import each
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings import random_networks

from fvs_estimator_node.base import MotionStep
from fvs_estimator_node.online import OnlineConfig, RlsEstimator
from fvs_estimator_node.registry import ESTIMATORS, create_estimator

ONLINE = ("lkf", "ukf", "rls")
HOME = np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0])
ZERO = {"online.initial": "zero"}


def random_steps(rng, count, jacobian=None, noise_m=0.0, joints=6):
    """Steps of a linear plant, or of no plant at all."""
    steps = []
    for _ in range(count):
        d_joints = np.zeros(6)
        d_joints[:joints] = 0.05 * rng.uniform(-1.0, 1.0, joints)
        d_ball = 0.02 * rng.normal(size=3) if jacobian is None else jacobian @ d_joints
        d_ball = d_ball + noise_m * rng.normal(size=3)
        steps.append(MotionStep(1.0, rng.uniform(0.02, 0.1), HOME, d_joints, d_ball))
    return steps


def learn(estimator, steps):
    for step in steps:
        estimator.update(step)
    return estimator.jacobian(HOME)


# --- what each method is ---


@each("joints", [6, 2])
def test_the_unscented_filter_is_the_linear_one(joints):
    linear, unscented = (create_estimator(method, ZERO) for method in ("lkf", "ukf"))
    config = linear.config
    mean, covariance = np.zeros(18), config.initial_variance * np.eye(18)
    for step in random_steps(np.random.default_rng(2), 500, joints=joints):
        linear.update(step)
        unscented.update(step)
        covariance = covariance + config.process_noise * step.dt_s * np.eye(18)
        seen = np.kron(np.eye(3), step.d_joints_rad)
        innovation = seen @ covariance @ seen.T + config.step_variance_m2 * np.eye(3)
        gain = covariance @ seen.T @ np.linalg.inv(innovation)
        mean = mean + gain @ (step.d_feature_m - seen @ mean)
        covariance = (np.eye(18) - gain @ seen) @ covariance
    for estimator in (linear, unscented):
        np.testing.assert_allclose(estimator.jacobian(HOME).reshape(18), mean, atol=1e-9)
        # Of the linear filter the rows share one.
        rows = np.eye(3 if len(estimator.covariance) == 6 else 1)
        np.testing.assert_allclose(np.kron(rows, estimator.covariance), covariance, atol=1e-11)
        shown = estimator.status_values()["entry_deviation_m_rad"]
        assert shown == pytest.approx(math.sqrt(np.diag(covariance).mean()))


@each("forgetting", [1.0, 0.98])
def test_recursive_least_squares_are_the_batch_ones(forgetting):
    config = OnlineConfig(
        forgetting=forgetting, measurement_noise_m=2e-3, initial_deviation_m_rad=0.3
    )
    model = random_networks()
    estimator = RlsEstimator(model, config)
    steps = random_steps(np.random.default_rng(6), 40)
    learn(estimator, steps)
    weights = forgetting ** np.arange(len(steps) - 1, -1, -1) / config.step_variance_m2
    start_weight = forgetting ** len(steps) / config.initial_variance
    motions, balls = (
        np.array([getattr(s, n) for s in steps]) for n in ("d_joints_rad", "d_feature_m")
    )
    normal = motions.T @ (weights[:, None] * motions) + start_weight * np.eye(6)
    right = balls.T @ (weights[:, None] * motions) + start_weight * model.jacobian(HOME)
    batch = np.linalg.solve(normal, right.T).T
    # with forgetting, the limit on the covariance cuts a little of the first steps
    atol = 1e-9 if forgetting == 1.0 else 1e-3
    np.testing.assert_allclose(estimator.jacobian(HOME), batch, rtol=1e-6, atol=atol)


# --- wind-up and nonsense ---


def test_least_squares_do_not_wind_up_where_nothing_moves():
    rng = np.random.default_rng(10)
    true = rng.normal(size=(3, 6))
    estimator = RlsEstimator(random_networks(), OnlineConfig(forgetting=0.95))
    learn(estimator, random_steps(rng, 3000, true, noise_m=0.001, joints=2))
    variances = np.linalg.eigvalsh(estimator.covariance)
    assert math.sqrt(variances[-1]) == pytest.approx(0.1)
    assert math.sqrt(variances[1]) < 0.02, "what moves is still known well"
    before = estimator.jacobian(HOME)
    after = learn(estimator, random_steps(rng, 1, before, noise_m=0.001))
    assert np.abs(after - before).max() < 0.1


_NUMBERS = st.lists(st.floats(-1.0, 1.0), min_size=15, max_size=15) | st.lists(
    st.floats(), min_size=15, max_size=15
)
_STEPS = st.lists(
    st.builds(
        lambda dt_s, numbers: MotionStep(1.0, dt_s, *np.split(np.array(numbers), [6, 12])),
        st.floats(0.01, 0.5) | st.floats(),
        _NUMBERS,
    ),
    max_size=12,
)


@settings(deadline=None, max_examples=150)
@given(steps=_STEPS, method=st.sampled_from([*ONLINE, "rbf"]))
def test_no_sequence_of_steps_makes_a_jacobian_that_is_not_finite(method, steps):
    estimator = ESTIMATORS[method](random_networks())
    for step in steps:
        estimator.update(step)
        assert np.all(np.isfinite(estimator.jacobian(HOME)))
        if method != "rbf" and estimator.covariance.size:
            np.linalg.cholesky(estimator.covariance)
    assert all(math.isfinite(value) for value in estimator.status_values().values())


# --- beginning and ending ---


@each("method", ONLINE)
def test_it_starts_from_the_model_at_the_first_joints_and_reset_starts_again(method):
    rng = np.random.default_rng(13)
    model = random_networks()
    asked = ESTIMATORS[method](model)
    first, later = HOME + 0.1, HOME - 0.2
    assert asked.problem == ""
    np.testing.assert_allclose(asked.jacobian(first), model.jacobian(first))
    np.testing.assert_allclose(asked.jacobian(later), model.jacobian(first))
    learn(asked, random_steps(rng, 30))
    asked.reset()
    assert (asked.updates, asked.refused, asked.covariance.size) == (0, 0, 0)
    np.testing.assert_allclose(asked.jacobian(later), model.jacobian(later))
