"""The damped pseudo inverse against numpy's, the least largest speed against a linear programme."""

import numpy as np
import pytest
from cases import each
from scipy.optimize import linprog

from fvs_controller_node.redundancy import (
    DampedInverse,
    LeastSpeedInverse,
)
from fvs_ros.limits import JointLimits

RNG = np.random.default_rng(7)
CASES = [(RNG.normal(size=(3, 6)), RNG.normal(size=3)) for _ in range(40)]
WIDE = JointLimits(joint_min_rad=(-3.0,) * 6, joint_max_rad=(3.0,) * 6, joint_limit_margin_rad=0.5)


def least_largest(jacobian, velocity):
    """By linear programming: u and t with |u_i| <= t, J u = v, least t."""
    eye = np.eye(6)
    ones = -np.ones((6, 1))
    found = linprog(
        np.append(np.zeros(6), 1.0),
        A_ub=np.vstack([np.hstack([eye, ones]), np.hstack([-eye, ones])]),
        b_ub=np.zeros(12),
        A_eq=np.hstack([jacobian, np.zeros((3, 1))]),
        b_eq=velocity,
        bounds=[(None, None)] * 7,
    )
    assert found.success
    return found.x[6]


@each(("jacobian", "velocity"), CASES)
def test_the_ball_moves_as_wanted_and_the_fastest_joint_is_as_slow_as_can_be(jacobian, velocity):
    found = LeastSpeedInverse(damping=1e-12).joint_velocity(jacobian, velocity)
    np.testing.assert_allclose(jacobian @ found, velocity, atol=1e-8)
    least = least_largest(jacobian, velocity)
    assert least - 1e-9 <= np.abs(found).max() < 1.03 * least


def test_a_joint_near_its_end_leaves_the_work_to_the_others_but_not_on_the_way_back():
    jacobian = np.hstack([np.eye(3), np.eye(3)])  # joints 0 and 3 do the same
    inverse = LeastSpeedInverse(1e-12, WIDE)
    near = np.array([2.95, 0.0, 0.0, 0.0, 0.0, 0.0])
    outward = inverse.joint_velocity(jacobian, np.array([1.0, 0.0, 0.0]), near)
    assert 0.9 < outward[0] + outward[3] < 1.0
    assert outward[0] < 0.3 * outward[3]
    inward = inverse.joint_velocity(jacobian, np.array([-1.0, 0.0, 0.0]), near)
    assert inward[0] == pytest.approx(inward[3])


def test_a_joint_at_its_end_goes_no_further_and_the_others_are_not_overworked():
    inverse = LeastSpeedInverse(1e-4, WIDE)
    for jacobian, velocity in CASES:
        for weak in (1.0, 1e-2, 1e-4, 0.0):
            # Along the first axis hardly anything but joint 0 moves the ball.
            edge = jacobian * np.append(1.0, [weak] * 5) if weak < 1.0 else jacobian
            edge = np.vstack([edge[0], jacobian[1:]])
            free = inverse.joint_velocity(edge, velocity, np.zeros(6))
            sign = np.sign(free[0])
            at_end = np.append(3.0 * sign, np.zeros(5))
            found = inverse.joint_velocity(edge, velocity, at_end)
            assert sign * found[0] < 0.07 * np.abs(found).max() + 1e-9  # the limiter stops it
            assert np.abs(found).max() < 8.0 * np.linalg.norm(velocity) / np.abs(edge[0, 0])


def test_the_way_back_to_a_posture_moves_no_ball_and_costs_little_speed():
    inverse, costs, gains = LeastSpeedInverse(1e-12), [], []
    rng = np.random.default_rng(1)
    for jacobian, velocity in CASES:
        joints, way = rng.normal(size=6), 0.5 * rng.normal(size=6)
        plain = inverse.joint_velocity(jacobian, velocity, joints)
        for factor in (0.1, 1.0, 10.0):
            home = joints + factor * way
            homing = inverse.joint_velocity(jacobian, velocity, joints, home)
            np.testing.assert_allclose(jacobian @ homing, velocity, atol=1e-8)
            gains.append((homing - plain) @ way)
            costs.append(np.abs(homing).max() / np.abs(plain).max())
            slow = inverse.joint_velocity(jacobian, 1e-3 * velocity, joints, home)
            np.testing.assert_allclose(slow, 1e-3 * homing, rtol=1e-5, atol=1e-9)
        assert not inverse.joint_velocity(jacobian, np.zeros(3), joints, joints + way).any()
    assert np.mean(gains) > 0.1
    assert np.mean(costs) < 1.2
    assert max(costs) < 1.5


VELOCITY = np.array([0.1, -0.2, 0.05])


def test_damping_slows_each_direction_by_its_singular_value():
    jacobian, mu = RNG.normal(size=(3, 6)), 0.01
    u, w, vt = np.linalg.svd(jacobian, full_matrices=False)
    wanted = vt.T @ (w / (w**2 + mu) * (u.T @ VELOCITY))
    got = DampedInverse(damping=mu).joint_velocity(jacobian, VELOCITY)
    np.testing.assert_allclose(got, wanted, atol=1e-12)
