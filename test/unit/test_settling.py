"""Settling times, (36) to (39) corrected, against integration of the differential equations."""

import numpy as np
import pytest
from cases import each
from scipy.integrate import quad, solve_ivp

from fvs_controller_node.ftsm import ReachingLaw
from fvs_controller_node.surface import SlidingSurface
from fvs_lab.settling import (
    printed_sliding_time_s,
    printed_time_s,
    reaching_time_s,
    sliding_time_s,
)

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


SLIDES = [
    (0.3, SlidingSurface(1.0, 3.0, 2.0)),
    (0.3, SlidingSurface(1.0, 2.0, 1.3)),
    (0.25, PAPER),
]


@each(("y0", "surface"), SLIDES)
def test_the_printed_36_to_39_are_no_sliding_time(y0: float, surface: SlidingSurface):
    switch, near = surface.switch_error_m, surface.exponent(0.0)
    far = surface.lambda1 - surface.lambda2
    wanted = integrated_s(y0, switch, surface, far) + integrated_s(switch, 0.0, surface, near)
    printed = printed_sliding_time_s(y0, surface)
    assert abs(printed / wanted - 1.0) > 1.0
    assert (printed < 0.0) is (surface.alpha2 < surface.alpha3)
    assert sliding_time_s(y0, surface) == pytest.approx(wanted, rel=0.06)


def test_36_runs_to_zero_even_with_its_denominator_corrected():
    y0, surface = SLIDES[0]
    far = surface.lambda1 - surface.lambda2
    a2, a3 = surface.alpha2, surface.alpha3
    repaired = printed_time_s(y0, far, surface) * (a2 - a3) / a2
    assert repaired == pytest.approx(integrated_s(y0, 0.0, surface, far), rel=1e-5)
    assert repaired > 1.04 * integrated_s(y0, surface.switch_error_m, surface, far)


@each("surface", [REALISTIC, PAPER])
@each("y0", [0.9, 0.3, 0.02, 0.003])
def test_the_sliding_time_is_that_of_the_differential_equation(y0: float, surface: SlidingSurface):
    wanted = integrated_s(y0, 0.0, surface)
    assert sliding_time_s(y0, surface) == pytest.approx(wanted, rel=1e-6)


@each("law", [ReachingLaw(), ReachingLaw(1.63, 0.067, 0.125, 0.82)])
def test_the_surface_is_reached_when_promised(law: ReachingLaw):
    end = reaching_time_s(-0.8, law)
    sides = [0.0, 0.95 * end, 1.001 * end]

    def rate(_t, s):
        return -(law.k1 * s + law.k2 * np.abs(s) ** (2 * law.sigma - 1) * np.sign(s)) / law.k4

    run = solve_ivp(rate, (0.0, sides[-1]), [-0.8], t_eval=sides, rtol=1e-9, atol=1e-12)
    assert run.y[0, 1] < -1e-6
    assert abs(run.y[0, 2]) < 1e-7
