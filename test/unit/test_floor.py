"""The floor: no motion brings the ball near its target for good in less time."""

from types import SimpleNamespace

import numpy as np
import pytest
from cases import each

pytest.importorskip("pybullet")

from fvs_lab.floor import Limits, least_time_s
from fvs_lab.trials import Case, make_cases

LIMITS = Limits(1.0, 6.0)


def _rest_s(travel_rad):
    return LIMITS.least_s(np.array([travel_rad]), np.zeros(1))


def test_from_rest_to_rest_the_time_is_that_of_a_trapezium():
    assert _rest_s(0.7) == pytest.approx(0.7 + 1.0 / 6.0)
    assert _rest_s(0.05) == pytest.approx(2.0 * np.sqrt(0.05 / 6.0))


@each("tolerance_m", [0.005, 0.001])
def test_a_single_joint_enters_at_the_near_edge_and_brakes_at_the_far_one(tolerance_m):
    # Three joints along three axes, a target on the first: a metre is a radian.
    slopes = np.eye(3, 6)
    gantry = SimpleNamespace(
        position=lambda joints: joints[..., :3],
        jacobian=lambda joints: np.broadcast_to(slopes, (*joints.shape[:-1], 3, 6)),
    )
    case = Case("", (0.0,) * 6, (0.4, 0.0, 0.0, 0.0, 0.0, 0.0), 1)
    known_s = _rest_s(0.4 + tolerance_m) - np.sqrt(4.0 * tolerance_m / 6.0)
    assert least_time_s(case, LIMITS, tolerance_m, gantry) == pytest.approx(known_s, rel=1e-3)
    # With a share of the limits it takes as long as a way that is so much longer.
    longer_s = _rest_s(0.8 + 2.0 * tolerance_m) - np.sqrt(8.0 * tolerance_m / 6.0)
    share_s = least_time_s(case, LIMITS, tolerance_m, gantry, np.full(6, 0.5))
    assert share_s == pytest.approx(longer_s, rel=1e-3)


def test_an_arm_needs_less_time_than_to_rest_on_the_target():
    (case,) = make_cases("B", 1, 410)
    travel_rad = np.abs(np.subtract(case.goal_rad, case.start_rad)).max()
    floors_s = [least_time_s(case, LIMITS, tolerance_m) for tolerance_m in (0.005, 0.001)]
    assert 0.3 < floors_s[0] < floors_s[1] < _rest_s(travel_rad)
