"""The least largest speed against a linear programme, and near the ends of joints."""

import numpy as np
import pytest
from cases import each
from scipy.optimize import linprog

from fvs_controller_node.redundancy import (
    LeastSpeedInverse,
)
from fvs_ros.limits import JointLimits

RNG = np.random.default_rng(7)
CASES = [(RNG.normal(size=(3, 6)), RNG.normal(size=3)) for _ in range(40)]
WIDE = JointLimits(joint_min_rad=(-3.0,) * 6, joint_max_rad=(3.0,) * 6, joint_limit_margin_rad=0.5)


def least_largest(jacobian, velocity):
    """By linear programming: u and t with |u_i| <= t, J u = v, least t."""
    eye = np.eye(6)
    minus_one = -np.ones((6, 1))
    result = linprog(
        np.append(np.zeros(6), 1.0),
        A_ub=np.vstack([np.hstack([eye, minus_one]), np.hstack([-eye, minus_one])]),
        b_ub=np.zeros(12),
        A_eq=np.hstack([jacobian, np.zeros((3, 1))]),
        b_eq=velocity,
        bounds=[(None, None)] * 7,
    )
    assert result.success
    return result.x[6]


@each(("jacobian", "velocity"), CASES)
def test_the_ball_moves_as_wanted_and_the_fastest_joint_is_as_slow_as_can_be(jacobian, velocity):
    speeds = LeastSpeedInverse(damping=1e-12).joint_velocity(jacobian, velocity)
    np.testing.assert_allclose(jacobian @ speeds, velocity, atol=1e-8)
    least = least_largest(jacobian, velocity)
    assert least - 1e-9 <= np.abs(speeds).max() < 1.03 * least


def test_a_joint_near_its_end_leaves_the_work_to_the_others_but_not_on_the_way_back():
    jacobian = np.hstack([np.eye(3), np.eye(3)])  # joints 0 and 3 do the same
    inverse = LeastSpeedInverse(1e-12, WIDE)
    near = np.array([2.95, 0.0, 0.0, 0.0, 0.0, 0.0])
    outward = inverse.joint_velocity(jacobian, np.array([1.0, 0.0, 0.0]), near)
    assert 0.9 < outward[0] + outward[3] < 1.0
    assert outward[0] < 0.3 * outward[3]
    inward = inverse.joint_velocity(jacobian, np.array([-1.0, 0.0, 0.0]), near)
    assert inward[0] == pytest.approx(inward[3])


@pytest.mark.parametrize("rows", [4, 8])
def test_rows_that_depend_on_each_other_leave_as_much_free(rows):
    """As those of two webcams before one point."""
    inverse, mix = LeastSpeedInverse(1e-12), np.random.default_rng(1).normal(size=(rows, 3))
    for jacobian, velocity in CASES[:10]:
        mixed = inverse.joint_velocity(mix @ jacobian, mix @ velocity)
        assert mixed == pytest.approx(inverse.joint_velocity(jacobian, velocity), abs=1e-5)
