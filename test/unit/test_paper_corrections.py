"""The corrections of docs/corrections.md, each by numbers: the corrected form holds, the printed
one does not. Equation numbers are the paper's."""

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from cases import each

from fvs_controller_node.base import ControlInput
from fvs_controller_node.proportional import ProportionalGains, ProportionalLaw
from fvs_controller_node.redundancy import DampedInverse
from fvs_controller_node.surface import ReachingLaw, SlidingSurface
from fvs_estimator_node.base import MotionStep
from fvs_estimator_node.rbf import RbfConfig, RbfEstimator, RbfModel

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "corrections.md"
NEURONS = 5


# --- the closed loop of (14)-(17) in continuous time, without any approximation ---


@dataclass(frozen=True)
class State:
    """Joints (rad), error Dx (m), sliding variable and estimated weights."""

    joints: np.ndarray
    error: np.ndarray
    s: np.ndarray
    weights: np.ndarray


@dataclass(frozen=True)
class Loop:
    """A plant that is linear in unknown weights, under the law (16) and the update (17).

    (16) and (14) are an implicit system: they hold for the one joint velocity ``Jh^+ v`` that
    gives the ball the velocity which s asks for, ``J Jh^+ v = x_dot``. Solved for v, it is an
    ordinary differential equation, and (16) then says what the derivative of s is.
    """

    model: RbfModel
    true_weights: np.ndarray
    surface: SlidingSurface
    reaching: ReachingLaw
    n1: float = 0.5
    alpha2_sign: float = 1.0
    gamma: float = 1.0
    k3: float = 0.0
    rest_weights: np.ndarray | float = 0.0
    approximation_error: np.ndarray | float = 0.0
    target_velocity: np.ndarray | float = 0.0
    feed_forward: bool = False

    def reaching_terms(self, s: np.ndarray) -> np.ndarray:
        """k1 s + k2 abs(s)^(2 sigma - 1) sgn s."""
        law = self.reaching
        return law.k1 * s + law.k2 * np.abs(s) ** (2.0 * law.sigma - 1.0) * np.sign(s)

    def rates(self, z: State) -> tuple[State, np.ndarray, np.ndarray]:
        """Derivative of the state, estimation error e (m/s), and r_dot (rad/s)."""
        surface, k4 = self.surface, self.reaching.k4
        theta = self.model.features(z.joints)
        jacobian = np.einsum("ikm,im->ki", self.true_weights, theta) + self.approximation_error
        estimate = np.einsum("ikm,im->ki", z.weights, theta)
        psi = np.array([surface.psi(y) for y in z.error])
        error_rate = (z.s - surface.alpha2 * z.error - surface.alpha3 * psi) / surface.alpha1
        x_dot = error_rate + self.target_velocity
        inverse = np.linalg.pinv(estimate)
        v = np.linalg.solve(jacobian @ inverse, x_dot)
        wanted = error_rate + (self.target_velocity if self.feed_forward else 0.0)
        s_dot = (surface.alpha2 * (wanted - v) - self.reaching_terms(z.s)) / k4
        e = x_dot - v
        drive = self.n1 * e + self.alpha2_sign * surface.alpha2 * z.s
        joints_rate = inverse @ v
        weights_rate = self.gamma * np.einsum("i,im,k->ikm", joints_rate, theta, drive)
        weights_rate -= self.k3 * (z.weights - self.rest_weights)
        return State(joints_rate, error_rate, s_dot, weights_rate), e, joints_rate

    def lyapunov(self, z: State) -> float:
        """V of (21), with the adaptation gain."""
        missing = self.true_weights - z.weights
        return 0.5 * self.reaching.k4 * float(z.s @ z.s) + 0.5 / self.gamma * np.sum(missing**2)

    def lyapunov_rate(self, z: State) -> float:
        """V_dot by the chain rule."""
        rate, _, _ = self.rates(z)
        missing = self.true_weights - z.weights
        return self.reaching.k4 * float(z.s @ rate.s) - np.sum(missing * rate.weights) / self.gamma

    def equation_22(self, z: State) -> float:
        """The right side of (22), with the sum of powers and, where it is given, W0 and Gamma."""
        _, e, _ = self.rates(z)
        missing = self.true_weights - z.weights
        leak = self.k3 / self.gamma * np.sum(missing * (z.weights - self.rest_weights))
        return float(-z.s @ self.reaching_terms(z.s) - self.n1 * e @ e + leak)


def a_loop(seed: int = 0, **more) -> Loop:
    rng = np.random.default_rng(seed)
    model = RbfModel(
        rng.uniform(-1.0, 1.0, (6, NEURONS, 6)),
        rng.uniform(1.5, 2.5, (6, NEURONS)),
        rng.normal(size=(6, 3, NEURONS)),
    )
    true = model.weights + 0.3 * rng.normal(size=model.weights.shape)
    reaching = ReachingLaw(1.63, 0.067, 0.125, 0.82)
    surface = SlidingSurface(1.0, 2.0, 0.45, 0.344, 0.154, 4.74e-5**0.5)
    return replace(Loop(model, true, surface, reaching), **more)


def random_states(loop: Loop, count: int = 200, seed: int = 1) -> list[State]:
    rng = np.random.default_rng(seed)
    return [
        State(
            rng.uniform(-0.5, 0.5, 6),
            rng.uniform(-0.3, 0.3, 3),
            rng.uniform(-0.5, 0.5, 3),
            loop.model.weights + 0.1 * rng.normal(size=loop.model.weights.shape),
        )
        for _ in range(count)
    ]


def surplus(loop: Loop) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """V_dot less (22), s'e and V_dot itself, at random states."""
    rows = []
    for z in random_states(loop):
        e = loop.rates(z)[1]
        rate = loop.lyapunov_rate(z)
        rows.append((rate - loop.equation_22(z), z.s @ e, rate))
    return tuple(np.array(rows).T)


# --- (16), (17), (21), (22) ---


def test_with_plus_the_derivative_of_v_is_22_with_minus_2_alpha2_se_remains():
    excess, _, rate = surplus(a_loop())
    assert np.abs(excess).max() < 1e-9
    assert rate.max() < 0.0
    excess, se, rate = surplus(a_loop(alpha2_sign=-1.0))
    np.testing.assert_allclose(excess, 2.0 * 2.0 * se, atol=1e-9)
    assert np.abs(excess).max() > 0.1
    assert rate.max() > 0.1


def test_an_adaptation_gain_enters_v_by_its_inverse():
    excess, _, rate = surplus(a_loop(gamma=0.02))
    assert np.abs(excess).max() < 1e-9
    assert rate.max() < 0.0
    # with V of (21) as printed, without the gain, the terms in s'e do not cancel
    loop = a_loop(gamma=0.02)
    left = []
    for z in random_states(loop):
        _, e, _ = loop.rates(z)
        wrong = loop.lyapunov_rate(z) + (1.0 / loop.gamma - 1.0) * np.sum(
            (loop.true_weights - z.weights) * loop.rates(z)[0].weights
        )
        gain = (1.0 - loop.gamma) * (loop.surface.alpha2 * z.s + loop.n1 * e) @ e
        left.append((wrong - loop.equation_22(z), gain))
    np.testing.assert_allclose(*np.array(left).T, atol=1e-9)
    assert np.abs(left).max() > 0.01


def test_a_network_that_is_not_exact_adds_its_error_to_11_and_22():
    rng = np.random.default_rng(5)
    loop = a_loop(approximation_error=0.02 * rng.normal(size=(3, 6)))
    for z in random_states(loop):
        _, e, velocity = loop.rates(z)
        theta = loop.model.features(z.joints)
        from_weights = np.einsum("ikm,im,i->k", loop.true_weights - z.weights, theta, velocity)
        epsilon = loop.approximation_error @ velocity
        np.testing.assert_allclose(e, from_weights + epsilon, atol=1e-12)
        wanted = epsilon @ (loop.n1 * e + loop.surface.alpha2 * z.s)
        excess = loop.lyapunov_rate(z) - loop.equation_22(z)
        assert excess == pytest.approx(wanted, abs=1e-9)


def test_a_target_that_moves_needs_its_velocity_in_16():
    moving = np.array([0.1, -0.05, 0.02])
    loop = a_loop(target_velocity=moving)
    for z in random_states(loop):
        excess = loop.lyapunov_rate(z) - loop.equation_22(z)
        assert excess == pytest.approx(-loop.surface.alpha2 * z.s @ moving, abs=1e-9)
    excess, _, _ = surplus(a_loop(target_velocity=moving, feed_forward=True))
    assert np.abs(excess).max() < 1e-9


def leaked(k3: float, seconds: float, target: str) -> float:
    """Relative error of a Jacobian that was exact, after a rest at one place."""
    model = a_loop().model
    config = RbfConfig(k3=k3, leak_target=target)
    estimator, joints = RbfEstimator(model, config), np.full(6, 0.2)
    for k in range(round(seconds * 25.0)):
        estimator.update(MotionStep(0.04 * k, 0.04, joints, np.zeros(6), np.zeros(3)))
    wanted = model.jacobian(joints)
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


# --- (22) as an inequality, (24)-(28) ---


def delta_of_28(loop: Loop) -> float:
    """delta of (28); iota of Lemma 1 stands once for every row of every network."""
    sigma = loop.reaching.sigma
    iota = sigma ** (sigma / (1.0 - sigma))
    far = np.sum((loop.true_weights - loop.rest_weights) ** 2, axis=2)
    return 0.5 * loop.k3 * float(np.sum((1.0 - sigma) * iota + far))


@each("target", ["zero", "offline"])
def test_the_bound_28_holds_with_the_k_of_27_corrected(target: str):
    loop = a_loop(k3=0.4)
    if target == "offline":
        loop = replace(loop, rest_weights=loop.model.weights)
    law = loop.reaching
    terminal = law.k2 / law.k4**law.sigma
    k, delta = min(terminal, 0.5 * loop.k3), delta_of_28(loop)
    assert min(-terminal, 0.5 * loop.k3) < 0.0  # as printed: no bound at all
    rng = np.random.default_rng(3)
    for z in random_states(loop):
        # from next to nothing to far more than the bound needs
        scaled = replace(z, s=10.0 ** rng.uniform(-3.0, 1.5) * z.s)
        bound = -k * loop.lyapunov(scaled) ** law.sigma + delta
        assert loop.lyapunov_rate(scaled) <= bound


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


def errors_of_32() -> tuple[float, float]:
    """Largest relative errors of ds/dt along a motion: corrected, printed."""
    surface, h = SlidingSurface(), 1e-7

    def at(t: float) -> tuple[float, float, float]:
        return 0.1 * math.cos(3.0 * t), -0.3 * math.sin(3.0 * t), -0.9 * math.cos(3.0 * t)

    right, printed, size = [], [], []
    for t in np.linspace(0.013, 2.0, 201):
        rate = (surface.value(*at(t + h)[:2]) - surface.value(*at(t - h)[:2])) / (2.0 * h)
        right.append(surface.derivative(*at(t)) - rate)
        printed.append(printed_32(surface, *at(t)) - rate)
        size.append(rate)
    largest = float(np.abs(size).max())
    return float(np.abs(right).max()) / largest, float(np.abs(printed).max()) / largest


def test_the_derivative_of_s_in_32_needs_the_velocity_in_its_first_term():
    right, printed = errors_of_32()
    assert right < 1e-5
    assert printed > 0.3


# --- section 4.1, (40)-(42) ---


def test_a_posteriori_t1_is_zero_for_an_estimator_that_believes_anything():
    rng = np.random.default_rng(6)
    model = a_loop().model
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
    loop = a_loop()
    true = RbfModel(loop.model.centres, loop.model.widths, loop.true_weights)
    ends = {}
    for n1 in (0.0, 0.3):
        estimator = RbfEstimator(loop.model, RbfConfig(n1=n1, alpha2=0.3))
        for k in range(400):
            joints, d_joints = rng.uniform(-0.5, 0.5, 6), 0.02 * rng.normal(size=6)
            estimator.update(
                MotionStep(0.04 * k, 0.04, joints, d_joints, true.jacobian(joints) @ d_joints)
            )
        ends[n1] = np.linalg.norm(loop.true_weights - estimator.weights)
    start = np.linalg.norm(loop.true_weights - loop.model.weights)
    assert ends[0.0] == start
    assert ends[0.3] < 0.95 * start


# --- (45)-(47) ---


def excess_of_47(n2: float, n3: float, printed: bool) -> np.ndarray:
    """V_dot less (47) at random states, under (46) and (45)."""
    loop, k = a_loop(), 4.0
    law = ProportionalLaw(ProportionalGains(k), DampedInverse(1e-13))
    rows = []
    for z in random_states(loop):
        theta = loop.model.features(z.joints)
        estimate = np.einsum("ikm,im->ki", z.weights, theta)
        jacobian = np.einsum("ikm,im->ki", loop.true_weights, theta)
        out = law.command(ControlInput(z.error, estimate, np.zeros(6), z.joints, 0.008))
        velocity = out.velocity_rad_s
        e = (jacobian - estimate) @ velocity
        # The paper's s is not defined for this scheme; the error is what there is.
        drive = n2 * e + n3 * z.error if printed else n2 * out.sliding_variable + n3 * e
        weights_rate = np.einsum("i,im,k->ikm", velocity, theta, drive)
        missing = loop.true_weights - z.weights
        rate = n2 * z.error @ jacobian @ velocity - np.sum(missing * weights_rate)
        rows.append(rate - (-k * n2 * z.error @ z.error - n3 * e @ e))
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


def test_the_page_names_every_test_of_this_file():
    own = re.findall(r"^def (test_\w+)\(", Path(__file__).read_text("utf-8"), re.MULTILINE)
    page = PAGE.read_text(encoding="utf-8")
    missing = [name for name in own if name not in page and "page" not in name]
    assert not missing
