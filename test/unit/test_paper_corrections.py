"""The corrections of docs/corrections.md, each by numbers: the corrected form holds, the printed
one does not. Equation numbers are the paper's."""

import math
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from recordings import random_networks

from fvs_controller_node.base import ControlInput
from fvs_controller_node.proportional import ProportionalGains, ProportionalLaw
from fvs_controller_node.redundancy import DampedInverse
from fvs_controller_node.surface import ReachingLaw, SlidingSurface
from fvs_estimator_node.base import MotionStep
from fvs_estimator_node.rbf import RbfConfig, RbfEstimator, RbfModel, rbf_features

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "corrections.md"


def weights_of():
    """Networks, and the true weights that theirs should have."""
    model = random_networks()
    return model, model.weights + 0.3 * np.random.default_rng(0).normal(size=model.weights.shape)


# --- (16), (17) ---


def leaked(k3: float, seconds: float, target: str) -> float:
    """Relative error of a Jacobian that was exact, after a rest at one place."""
    model, _ = weights_of()
    config = RbfConfig(k3=k3, leak_target=target)
    estimator, joints = RbfEstimator(model, config), np.full(6, 0.2)
    wanted = estimator.jacobian(joints)
    for k in range(round(seconds * 25.0)):
        estimator.update(MotionStep(0.04 * k, 0.04, joints, np.zeros(6), np.zeros(3)))
    return float(np.linalg.norm(estimator.jacobian(joints) - wanted) / np.linalg.norm(wanted))


def test_a_leak_to_zero_forgets_the_training_at_rest_and_one_to_w0_does_not():
    assert leaked(0.01, 10.0, "zero") == pytest.approx(1.0 - math.exp(-0.1), abs=1e-6)
    assert leaked(0.01, 60.0, "zero") == pytest.approx(1.0 - math.exp(-0.6), abs=1e-6)
    assert leaked(0.01, 60.0, "offline") < 1e-12


def test_below_a_half_sigma_makes_the_command_of_16_grow_at_the_surface():
    def pull(s: float, sigma: float) -> float:
        return 0.067 * s ** (2.0 * sigma - 1.0)

    assert pull(1e-9, 0.45) > 5.0 * pull(0.1, 0.45)
    assert pull(1e-9, 0.75) < 2e-4 * pull(0.1, 0.75)
    for sigma in (0.3, 0.5, 1.0):
        with pytest.raises(ValueError, match=r"sigma must be number from 0\.51"):
            ReachingLaw(sigma=sigma)


# --- (32) ---


def printed_32(surface: SlidingSurface, y: float, velocity: float, acceleration: float) -> float:
    h = 1e-6 * abs(y)
    gamma_dot = (surface.exponent(y + h) - surface.exponent(y - h)) / (2.0 * h) * velocity
    gamma, a = surface.exponent(y), abs(y)
    bracket = a ** (gamma - 1.0) * gamma + a**gamma * gamma_dot * math.log(a)
    return (
        surface.alpha1 * acceleration
        + surface.alpha2 * velocity
        + surface.alpha3 * bracket * math.copysign(1.0, y)
    )


def test_the_derivative_of_s_in_32_needs_the_velocity_in_its_first_term():
    surface, h = SlidingSurface(), 1e-7

    def at(t: float) -> tuple[float, float, float]:
        return 0.1 * math.cos(3.0 * t), -0.3 * math.sin(3.0 * t), -0.9 * math.cos(3.0 * t)

    times_s = np.linspace(0.013, 2.0, 201)
    later, sooner = (
        np.array([surface.value(*at(t + side)[:2]) for t in times_s]) for side in (h, -h)
    )
    rates = (later - sooner) / (2.0 * h)
    right, printed = (
        np.abs([form(*at(t)) for t in times_s] - rates).max() / np.abs(rates).max()
        for form in (surface.derivative, partial(printed_32, surface))
    )
    assert right < 1e-5
    assert printed > 0.3


# --- section 4.1, (40)-(42) ---


def test_a_posteriori_t1_is_zero_for_an_estimator_that_believes_anything():
    rng = np.random.default_rng(6)
    model, _ = weights_of()
    eager = RbfEstimator(model, RbfConfig(n1=1e9, alpha2=0.0, mu=1.0))
    before, after = [], []
    for k in range(200):
        nonsense = MotionStep(
            0.04 * k, 0.04, rng.uniform(-0.5, 0.5, 6), 0.02 * rng.normal(size=6),
            0.01 * rng.normal(size=3),
        )  # fmt: skip
        for errors in (before, after):
            predicted = eager.jacobian(nonsense.joints_rad) @ nonsense.d_joints_rad
            errors.append(np.linalg.norm(nonsense.d_feature_m - predicted))
            if errors is before:
                eager.update(nonsense)
    assert max(after) < 1e-12
    assert np.median(before) > 0.01


def test_without_a_target_it_is_the_sliding_term_that_goes_and_n1_that_stays():
    rng = np.random.default_rng(7)
    model, true_weights = weights_of()
    true = RbfModel(model.centres, model.widths, true_weights)
    ends = {}
    for n1 in (0.0, 0.3):
        estimator = RbfEstimator(model, RbfConfig(n1=n1, alpha2=0.3))
        for k in range(400):
            joints, d_joints = rng.uniform(-0.5, 0.5, 6), 0.02 * rng.normal(size=6)
            estimator.update(
                MotionStep(0.04 * k, 0.04, joints, d_joints, true.jacobian(joints) @ d_joints)
            )
        ends[n1] = np.linalg.norm(true_weights - estimator.weights)
    start = np.linalg.norm(true_weights - model.weights)
    assert ends[0.0] == start
    assert ends[0.3] < 0.95 * start


# --- (45)-(47) ---


def excess_of_47(n2: float, n3: float, printed: bool) -> np.ndarray:
    """V_dot less (47) at random states, under (46) and (45)."""
    (model, true_weights), k, rng = weights_of(), 4.0, np.random.default_rng(1)
    law = ProportionalLaw(ProportionalGains(k), DampedInverse(1e-13))
    rows = []
    for _ in range(200):
        joints, error = rng.uniform(-0.5, 0.5, 6), rng.uniform(-0.3, 0.3, 3)
        weights = model.weights + 0.1 * rng.normal(size=model.weights.shape)
        theta = rbf_features(model.centres, model.widths, joints)
        estimate = np.einsum("ikm,im->ki", weights, theta)
        jacobian = np.einsum("ikm,im->ki", true_weights, theta)
        out = law.command(ControlInput(error, estimate, np.zeros(6), joints, 0.008))
        velocity = out.velocity_rad_s
        e = (jacobian - estimate) @ velocity
        # The paper's s is not defined for this scheme; the error is what there is.
        drive = n2 * e + n3 * error if printed else n2 * out.sliding_variable + n3 * e
        weights_rate = np.einsum("i,im,k->ikm", velocity, theta, drive)
        missing = true_weights - weights
        rate = n2 * error @ jacobian @ velocity - np.sum(missing * weights_rate)
        rows.append(rate - (-k * n2 * error @ error - n3 * e @ e))
    return np.array(rows)


def test_45_with_the_error_and_46_give_47():
    assert np.abs(excess_of_47(0.3, 0.5, printed=False)).max() < 1e-9
    assert np.abs(excess_of_47(0.3, 0.5, printed=True)).max() > 1e-3


# --- the page ---


def test_every_test_that_the_page_names_exists():
    named = re.findall(r"`(test/[\w/]+\.py)::(test_\w+)`", PAGE.read_text(encoding="utf-8"))
    assert len(named) > 15
    for file, test in named:
        source = (ROOT / file).read_text(encoding="utf-8")
        assert re.search(rf"^def {test}\(", source, re.MULTILINE), f"{file} has no {test}"
