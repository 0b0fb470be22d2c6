"""The camera's pose from flange poses and ball positions."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fvs_ros.apps.dashboard.registration import Registrar
from fvs_sim_node.kinematics import flange_pose

HOME = np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0])


def path(seconds, rate_hz=30.0):
    t = np.arange(seconds * rate_hz)[:, None] / rate_hz
    return HOME + 0.4 * np.sin(t * np.array([0.7, 0.9, 1.1, 1.3, 1.7, 1.9]))


@pytest.fixture
def camera():
    return Rotation.from_euler("xyz", [2.0, 0.3, -1.1]), np.array([-1.3, 1.0, 0.8])


def tell(registrar, joints, camera, ball, noise_m=0.0):
    rng = np.random.default_rng(0)
    turn, at = camera
    for one in joints:
        flange = flange_pose(one)
        seen = turn.inv().apply(flange[:3, :3] @ ball + flange[:3, 3] - at)
        registrar.add(flange, seen + noise_m * rng.normal(size=3))


def test_without_noise_it_is_exact(camera):
    registrar, ball = Registrar(), np.array([0.01, -0.02, 0.09])
    tell(registrar, path(10.0), camera, ball)
    found = registrar.solve()
    np.testing.assert_allclose(found.rotation, camera[0].as_matrix(), atol=1e-6)
    np.testing.assert_allclose(found.position_m, camera[1], atol=1e-6)
    np.testing.assert_allclose(found.ball_m, ball, atol=1e-6)
    assert found.error_m < 1e-6


def test_noise_and_a_moved_camera(camera):
    registrar, ball = Registrar(), np.array([0.0, 0.0, 0.09])
    tell(registrar, path(20.0), camera, ball, noise_m=0.002)
    found = registrar.solve()
    np.testing.assert_allclose(found.position_m, camera[1], atol=0.02)
    assert (Rotation.from_matrix(found.rotation) * camera[0].inv()).magnitude() < 0.02
    assert 0.001 < found.error_m < 0.005
    moved = (Rotation.from_rotvec([0.0, 0.5, 0.0]) * camera[0], camera[1] + [0.1, 0.0, 0.0])
    tell(registrar, path(3.0), moved, ball)
    assert registrar.solve() is None  # two cameras at once fit none
    registrar.reset()
    tell(registrar, path(10.0), moved, ball)
    np.testing.assert_allclose(registrar.solve().position_m, moved[1], atol=1e-6)


def test_too_little_motion_tells_nothing(camera):
    registrar, ball = Registrar(), np.array([0.0, 0.0, 0.09])
    assert registrar.solve() is None
    tell(registrar, np.repeat(path(1.0)[:1], 50, axis=0), camera, ball)
    assert registrar.solve() is None
    one_joint = np.tile(HOME, (60, 1))
    one_joint[:, 0] += np.linspace(-0.5, 0.5, 60)
    tell(registrar, one_joint, camera, ball)
    assert registrar.solve() is None
