"""Settling times in closed form against integration of the differential equations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from fvs_controller_node.ftsm import ReachingLaw
from fvs_controller_node.settling import (
    constant_exponent_time_s,
    reaching_time_s,
    settling_times,
    sliding_time_bounds_s,
    sliding_value_after,
)
from fvs_controller_node.surface import SlidingSurface

REALISTIC = SlidingSurface()
PAPER = SlidingSurface(1.0, 0.3, 0.45, 0.344, 0.154, 4.74e-5**0.5)


def integrated_s(y0: float, y1: float, surface: SlidingSurface) -> float:
    """Time on the surface, by quadrature of dt = a1 dy / (a2 y + a3 psi(y))."""

    def pace(u: float) -> float:
        y = u**10  # tames the singularity at 0
        return 10 * u**9 * surface.alpha1 / (surface.alpha2 * y + surface.alpha3 * surface.psi(y))

    switch = surface.switch_error_m**0.1
    points = [switch] if y1**0.1 < switch < y0**0.1 else None
    return quad(pace, y1**0.1, y0**0.1, points=points, limit=500, epsabs=1e-10)[0]


@pytest.mark.parametrize("gamma", [0.2, 0.5, 0.9])
def test_a_constant_exponent_has_a_closed_form(gamma: float):
    surface = SlidingSurface(1.0, 1.0, 2.0, gamma, 0.0)
    for y1 in (0.0, 0.05):
        wanted = integrated_s(0.5, y1, surface)
        assert constant_exponent_time_s(0.5, y1, gamma, surface) == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize("surface", [REALISTIC, PAPER])
@pytest.mark.parametrize("y0", [0.9, 0.3, 0.02, 0.003])
def test_the_switched_form_is_close_and_the_bounds_enclose(surface: SlidingSurface, y0: float):
    wanted = integrated_s(y0, 0.0, surface)
    switch = min(y0, surface.switch_error_m)
    switched = constant_exponent_time_s(
        y0, switch, surface.lambda1 - surface.lambda2, surface
    ) + constant_exponent_time_s(switch, 0.0, surface.exponent(0.0), surface)
    assert switched == pytest.approx(wanted, rel=0.06)
    lower, upper = sliding_time_bounds_s(y0, surface)
    assert lower <= wanted <= upper
    assert upper - lower < 0.08 * wanted


@pytest.mark.parametrize("law", [ReachingLaw(), ReachingLaw(1.63, 0.067, 0.125, 0.82)])
def test_reaching_has_a_closed_form(law: ReachingLaw):
    def rate(_t, s):
        power = np.abs(s) ** (2 * law.sigma - 1)
        return -(law.k1 * s + law.k2 * power * np.sign(s)) / law.k4

    end = reaching_time_s(-0.8, law)
    t = np.linspace(0.0, 0.95 * end, 20)
    s = solve_ivp(rate, (0.0, end), [-0.8], t_eval=t, rtol=1e-10, atol=1e-13).y[0]
    np.testing.assert_allclose([sliding_value_after(-0.8, at, law) for at in t], s, atol=1e-8)
    assert sliding_value_after(-0.8, 0.999 * end, law) < 0.0
    assert sliding_value_after(-0.8, 1.001 * end, law) == 0.0


@pytest.mark.parametrize("velocity", [0.0, 0.5, -0.4])
def test_the_total_bounds_the_real_thing(velocity: float):
    surface, law, y0 = PAPER, ReachingLaw(1.63, 0.067, 0.125, 0.82), 0.25
    bound = settling_times([y0], [velocity], surface, law)[0]
    s0 = surface.value(y0, velocity)

    def rate(t, y):
        s = sliding_value_after(s0, t, law)
        return (s - surface.alpha2 * y - surface.alpha3 * surface.psi(float(y[0]))) / surface.alpha1

    def arrived(_t, y):
        return y[0] - 1e-7

    arrived.terminal = True  # type: ignore[attr-defined]
    run = solve_ivp(rate, (0.0, 20.0), [y0], events=arrived, rtol=1e-8, atol=1e-10, max_step=0.01)
    assert run.t[-1] <= bound.total_s
    if velocity == 0.0:
        assert bound.total_s < 1.6 * run.t[-1]
