"""Settling times, (36) to (39) corrected, against integration of the differential equations."""

import math

import numpy as np
import pytest
from cases import each
from scipy.integrate import quad, solve_ivp

from fvs_controller_node.ftsm import ReachingLaw
from fvs_controller_node.settling import (
    constant_exponent_time_s,
    reaching_time_s,
    settling_time_s,
    sliding_time_s,
    sliding_value_after,
)
from fvs_controller_node.surface import SlidingSurface

REALISTIC = SlidingSurface()
PAPER = SlidingSurface(1.0, 0.3, 0.45, 0.344, 0.154, 4.74e-5**0.5)


def integrated_s(y_from: float, y_to: float, surface: SlidingSurface, gamma=None) -> float:
    """Time on the surface, with a constant exponent if given: by quadrature of
    dt = a1 dy / (a2 y + a3 psi(y))."""

    def pace(u: float) -> float:
        y = u**10  # tames the singularity at 0
        psi = surface.psi(y) if gamma is None else y**gamma
        return 10.0 * u**9 * surface.alpha1 / (surface.alpha2 * y + surface.alpha3 * psi)

    ends = y_to**0.1, y_from**0.1
    points = [p for p in [surface.switch_error_m**0.1] if gamma is None and ends[0] < p < ends[1]]
    return quad(pace, *ends, points=points or None, limit=500, epsabs=1e-10)[0]


def printed_36(y0: float, gamma: float, surface: SlidingSurface) -> float:
    """The right side of (36), (37) and (39)."""
    a1, a2, a3 = surface.alpha1, surface.alpha2, surface.alpha3
    power = y0 ** (gamma - 1.0)
    return a1 * math.log(power / (power + a2 / a3)) / ((gamma - 1.0) * (a2 - a3))


SLIDES = [
    (0.3, SlidingSurface(1.0, 3.0, 2.0)),
    (0.3, SlidingSurface(1.0, 2.0, 1.3)),
    (0.25, PAPER),
]


@each(("y0", "surface"), SLIDES)
def test_the_sliding_time_is_the_corrected_36_to_39(y0: float, surface: SlidingSurface):
    switch, near = surface.switch_error_m, surface.exponent(0.0)
    far = surface.lambda1 - surface.lambda2
    wanted = 0.0
    for y_from, y_to, gamma in ((y0, switch, far), (switch, 0.0, near)):
        integrated = integrated_s(y_from, y_to, surface, gamma)
        found = constant_exponent_time_s(y_from, y_to, gamma, surface)
        assert found == pytest.approx(integrated, rel=1e-5)
        wanted += integrated
    printed = printed_36(y0, far, surface) + printed_36(switch, near, surface)
    assert abs(printed / wanted - 1.0) > 1.0
    assert (printed < 0.0) is (surface.alpha2 < surface.alpha3)


def test_36_runs_to_zero_even_with_its_denominator_corrected():
    y0, surface = SLIDES[0]
    far = surface.lambda1 - surface.lambda2
    a2, a3 = surface.alpha2, surface.alpha3
    repaired = printed_36(y0, far, surface) * (a2 - a3) / a2
    assert repaired == pytest.approx(constant_exponent_time_s(y0, 0.0, far, surface))
    to_switch = constant_exponent_time_s(y0, surface.switch_error_m, far, surface)
    assert repaired > 1.04 * to_switch


@each("surface", [REALISTIC, PAPER])
@each("y0", [0.9, 0.3, 0.02, 0.003])
def test_the_switched_form_is_close_to_the_sliding_time(surface: SlidingSurface, y0: float):
    wanted = integrated_s(y0, 0.0, surface)
    switch = min(y0, surface.switch_error_m)
    switched = constant_exponent_time_s(
        y0, switch, surface.lambda1 - surface.lambda2, surface
    ) + constant_exponent_time_s(switch, 0.0, surface.exponent(0.0), surface)
    assert switched == pytest.approx(wanted, rel=0.06)
    assert sliding_time_s(y0, surface) == pytest.approx(wanted, rel=1e-6)
    assert sliding_time_s(y0, SlidingSurface(1.0, 3.0, 0.0)) == math.inf


@each("law", [ReachingLaw(), ReachingLaw(1.63, 0.067, 0.125, 0.82)])
def test_reaching_has_a_closed_form(law: ReachingLaw):
    def rate(_t, s):
        power = np.abs(s) ** (2 * law.sigma - 1)
        return -(law.k1 * s + law.k2 * power * np.sign(s)) / law.k4

    end = reaching_time_s(-0.8, law)
    t = np.linspace(0.0, 0.95 * end, 20)
    s = solve_ivp(rate, (0.0, end), [-0.8], t_eval=t, rtol=1e-10, atol=1e-13).y[0]
    np.testing.assert_allclose([sliding_value_after(-0.8, at, law) for at in t], s, atol=1e-8)
    assert -1e-3 < sliding_value_after(-0.8, 0.999 * end, law) < 0.0
    assert sliding_value_after(-0.8, 1.001 * end, law) == 0.0


def test_the_total_bounds_the_real_thing():
    surface, law, y0 = PAPER, ReachingLaw(1.63, 0.067, 0.125, 0.82), 0.25
    bound_s = settling_time_s(y0, surface, law)
    s0 = surface.value(y0, 0.0)

    def rate(t, y):
        s = sliding_value_after(s0, t, law)
        return (s - surface.alpha2 * y - surface.alpha3 * surface.psi(float(y[0]))) / surface.alpha1

    def arrived(_t, y):
        return y[0] - 1e-7

    arrived.terminal = True  # type: ignore[attr-defined]
    run = solve_ivp(rate, (0.0, 20.0), [y0], events=arrived, rtol=1e-8, atol=1e-10, max_step=0.01)
    assert run.t[-1] <= bound_s < 1.6 * run.t[-1]
