"""Quaternions against scipy's."""

import numpy as np
import pytest

from fvs_ros.quaternions import about, product, quaternion_of, rotation_of

Rotation = pytest.importorskip("scipy.spatial.transform").Rotation


def same(one, other):
    """Two quaternions of one rotation: alike but for their sign."""
    np.testing.assert_allclose(one * np.sign(one @ other), other, atol=1e-12)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-9, 0.3, 2.0, np.pi - 1e-9, np.pi, -1.7])
def test_rotations_and_back(angle_rad):
    rng = np.random.default_rng(3)
    for way in (np.eye(3)[0], *rng.normal(size=(5, 3))):
        axis = way / np.linalg.norm(way)
        truth = Rotation.from_rotvec(angle_rad * axis)
        same(about(axis, angle_rad), truth.as_quat())
        same(quaternion_of(truth.as_matrix()), truth.as_quat())
        assert quaternion_of(truth.as_matrix())[3] >= 0.0
        np.testing.assert_allclose(rotation_of(truth.as_quat()), truth.as_matrix(), atol=1e-12)


def test_a_product_turns_by_the_right_one_first():
    one, other = Rotation.random(2, random_state=1)
    same(product(one.as_quat(), other.as_quat()), (one * other).as_quat())
