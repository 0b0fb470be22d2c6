"""The damped pseudo inverse against numpy's, near singularities, and its null space."""

from __future__ import annotations

import numpy as np
import pytest

from fvs_controller_node.redundancy import (
    POSTURE_SPEED_RAD_S,
    DampedInverse,
    conditioning,
)

RNG = np.random.default_rng(11)
VELOCITY = np.array([0.1, -0.2, 0.05])


def test_with_little_damping_it_is_the_pseudo_inverse():
    for _ in range(20):
        jacobian = RNG.normal(size=(3, 6))
        got = DampedInverse(damping=1e-12).joint_velocity(jacobian, VELOCITY)
        np.testing.assert_allclose(got, np.linalg.pinv(jacobian) @ VELOCITY, rtol=1e-7, atol=1e-9)


def test_damping_slows_each_direction_by_its_singular_value():
    jacobian, mu = RNG.normal(size=(3, 6)), 0.01
    u, w, vt = np.linalg.svd(jacobian, full_matrices=False)
    wanted = vt.T @ (w / (w**2 + mu) * (u.T @ VELOCITY))
    got = DampedInverse(damping=mu).joint_velocity(jacobian, VELOCITY)
    np.testing.assert_allclose(got, wanted, atol=1e-12)


@pytest.mark.parametrize("jacobian", [np.zeros((3, 6)), np.ones((3, 6)), np.eye(3, 6) * 1e-9])
def test_a_singular_jacobian_gives_finite_bounded_speeds(jacobian: np.ndarray):
    got = DampedInverse(damping=1e-4).joint_velocity(jacobian, VELOCITY)
    assert np.all(np.isfinite(got))
    assert np.abs(got).max() <= np.linalg.norm(VELOCITY) / (2 * 1e-4**0.5)


def test_conditioning():
    jacobian = RNG.normal(size=(3, 6))
    w = np.linalg.svd(jacobian, compute_uv=False)
    assert conditioning(jacobian).smallest == pytest.approx(w[2])
    assert conditioning(jacobian).condition == pytest.approx(np.linalg.cond(jacobian))
    assert conditioning(np.zeros((3, 6))).condition == np.inf


def test_the_posture_term_moves_the_joints_and_not_the_ball():
    jacobian = RNG.normal(size=(3, 6))
    home = np.array([0.3, -1.0, 1.0, -1.0, -1.5, 0.2])
    joints = home + 0.05 * RNG.normal(size=6)
    plain = DampedInverse(1e-9).joint_velocity(jacobian, VELOCITY, joints, home)
    pulled = DampedInverse(1e-9, 1.0).joint_velocity(jacobian, VELOCITY, joints, home)
    np.testing.assert_allclose(jacobian @ pulled, jacobian @ plain, atol=1e-7)
    assert (pulled - plain) @ (home - joints) > 0.0


def test_the_posture_pull_is_slow_however_far_the_posture():
    inverse = DampedInverse(1e-9, 5.0)
    got = inverse.joint_velocity(RNG.normal(size=(3, 6)), np.zeros(3), np.zeros(6), np.full(6, 3.0))
    assert np.linalg.norm(got) <= np.sqrt(6) * POSTURE_SPEED_RAD_S
