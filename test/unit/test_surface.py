"""The sliding surface: (29) and its limits, (31), and (32) against finite differences."""

import math

import pytest
from cases import each

from fvs_controller_node.surface import SlidingSurface

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
    psi, given = surface.psi_and_slope(y)
    assert psi == surface.psi(y)
    assert given == pytest.approx(slope, rel=1e-5)
