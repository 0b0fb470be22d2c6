"""The sliding-mode law: its two scalar equations, and the loop closed over an exact plant."""

import math

import numpy as np
import pytest
from cases import each
from scipy.optimize import brentq

from fvs_controller_node.base import ControlInput
from fvs_controller_node.ftsm import FtsmGains, FtsmLaw, ReachingLaw, next_error, next_sliding_value
from fvs_controller_node.redundancy import DampedInverse
from fvs_controller_node.surface import SlidingSurface

RNG = np.random.default_rng(3)
JACOBIAN = 0.4 * RNG.normal(size=(3, 6))
DT_S = 0.008


def signed(rng, most=1.0):
    """Zero, or a number of any sign and magnitude."""
    return float(rng.choice([-1.0, -1.0, 0.0, 1.0, 1.0])) * 10.0 ** rng.uniform(-12.0, most)


@each("seed", range(200))
def test_the_next_sliding_value_solves_its_equation(seed):
    rng = np.random.default_rng(seed)
    s, k1, k4 = signed(rng), 10.0 ** rng.uniform(-2.0, 2.0), 10.0 ** rng.uniform(-3.0, 1.0)
    k2, sigma = float(rng.choice([0.0, 1e-3, 0.05, 1.0, 50.0])), rng.uniform(0.55, 0.95)
    law, dt_s = ReachingLaw(k1, k2, k4, sigma), float(rng.choice([0.002, 0.008, 0.04]))
    p = abs(next_sliding_value(s, law, dt_s))

    def residual(p):
        return (k4 / dt_s + k1) * p + k2 * p ** (2 * sigma - 1) - k4 / dt_s * abs(s)

    wanted = brentq(residual, 0.0, abs(s), xtol=1e-300, rtol=1e-14) if s else 0.0
    assert p == pytest.approx(wanted, rel=1e-10)
    assert next_sliding_value(-s, law, dt_s) == -next_sliding_value(s, law, dt_s)
    assert p <= abs(s)


@each("seed", range(200))
def test_the_next_error_solves_its_equation(seed):
    rng = np.random.default_rng(seed)
    far, near = rng.choice([(0.1, 0.5), (0.375, 0.9), (0.6, 1.0), (0.05, 0.05)])
    alphas = 1.0, 10.0 ** rng.uniform(-1.0, 1.3), float(rng.choice([0.0, 0.1, 1.3, 20.0]))
    exponents = 0.5 * (near + far), 0.5 * (near - far), float(rng.choice([1e-3, 5e-3, 0.05]))
    surface, y = SlidingSurface(*alphas, *exponents), signed(rng, 0.0)
    dt_s = float(rng.choice([0.002, 0.008, 0.04]))
    right = signed(rng) + y / dt_s

    def residual(z):
        return (1.0 / dt_s + alphas[1]) * z + alphas[2] * surface.psi(z) - right

    wanted = brentq(residual, *sorted((0.0, right * dt_s)), xtol=1e-16) if right else 0.0
    assert next_error(right, y, surface, dt_s) == pytest.approx(wanted, rel=1e-9, abs=1e-11)


def closed_loop(gains: FtsmGains, seconds: float, dt_s: float = DT_S, fastest: float = math.inf):
    """Errors (m) and joint velocities (rad/s) on the exact plant x' = J rdot."""
    law = FtsmLaw(gains, DampedInverse(damping=1e-10))
    error, applied = np.array([0.3, -0.2, 0.1]), np.zeros(6)
    errors, velocities = [error], []
    for _ in range(round(seconds / dt_s)):
        out = law.command(ControlInput(error, JACOBIAN, applied, np.zeros(6), dt_s))
        applied = np.clip(out.velocity_rad_s, -fastest, fastest)
        error = error + JACOBIAN @ applied * dt_s
        errors.append(error)
        velocities.append(applied)
    return np.array(errors), np.array(velocities)


@each("gain", [1.0, 10.0, 50.0])
def test_the_implicit_law_is_stable_at_any_gain(gain: float):
    surface = SlidingSurface(1.0, 2.0 * gain, 1.3 * gain)
    errors, _ = closed_loop(FtsmGains(surface, ReachingLaw(3.0 * gain, gain)), 4.0, 0.04)
    assert np.all(np.diff(np.abs(errors), axis=0) <= 1e-12)
    assert np.all(np.abs(errors[-1]) < 1e-9)


K4_BOUND, K1_BOUND = 2.0 * 2.0 * DT_S / (2.0 + 2.0 * DT_S), 2.0 * 2.0 / (1.0 + DT_S)


@each(
    ("k1", "k4", "stable"),
    [(0.1, 0.9 * K4_BOUND, True), (0.1, 1.1 * K4_BOUND, False), (1.05 * K1_BOUND, 0.0, False)],
)
def test_the_literal_law_is_stable_up_to_its_bounds_on_a_linear_surface(k1, k4, stable):
    surface, reaching = SlidingSurface(1.0, 2.0, 0.0), ReachingLaw(k1, 0.0, k4)
    errors, _ = closed_loop(FtsmGains(surface, reaching, discretisation="literal"), 3.0)
    end = np.abs(errors[-1]).max()
    assert end < 0.3 if stable else np.abs(errors).max() > 10.0


@each(("discretisation", "unrest"), [("implicit", 0.0), ("literal", 1.0)])
def test_the_literal_law_chatters_where_the_implicit_one_does_not(discretisation, unrest):
    paper = {"lambda1": 0.3, "lambda2": 0.2, "switch_error_m": 0.02}
    surface, reaching = SlidingSurface(1.0, 2.0, 1.3, **paper), ReachingLaw(1.63, 0.067, 0.01, 0.82)
    gains = FtsmGains(surface, reaching, discretisation=discretisation)
    _, speeds = closed_loop(gains, 4.0, fastest=1.0)
    step = np.abs(np.diff(speeds[-100:], axis=0)).mean()
    assert step == pytest.approx(unrest, abs=1e-6 if unrest == 0.0 else 0.5)  # rad/s each tick


# ---- the surface: (29), and (32) against finite differences ---------------------------------


ERRORS_M = [1e-4, 1e-3, 4e-3, 4.9e-3, 5.1e-3, 6e-3, 0.02, 0.1, 0.5, 0.99]


def test_lambda3_is_three_over_delta():
    paper = {"lambda1": 0.3, "lambda2": 0.2, "switch_error_m": 0.02}
    assert SlidingSurface(**paper).lambda3 == pytest.approx(7500.0)
    assert SlidingSurface(**paper).exponent(0.0) == pytest.approx(0.5, abs=0.002)
    # The paper's "lambda3 >> 1" is not enough where Delta is small.
    assert 0.3 + 0.2 * math.tanh(100.0 * 0.02**2) == pytest.approx(0.308, abs=0.001)


@each("y", [*ERRORS_M, *(-y for y in ERRORS_M)])
@each("surface", [SlidingSurface(), SlidingSurface(lambda1=0.5, lambda2=0.0)])
def test_slopes_match_finite_differences(surface: SlidingSurface, y: float):
    h = 1e-7 * abs(y)
    slope = (surface.psi(y + h) - surface.psi(y - h)) / (2 * h)
    psi, own_slope = surface.psi_and_slope(y)
    assert psi == surface.psi(y)
    assert own_slope == pytest.approx(slope, rel=1e-5)
