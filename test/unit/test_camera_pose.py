"""Models behind a camera that was moved: how it stands is learned from where the ball goes."""

import numpy as np
import pytest
import ur5_dh
from cases import each
from recordings import Recording, image, relative_error, rotation_about, ur5_chain

from fvs_estimator_node.camera import (
    CameraPose,
    PoeEstimator,
    TurnedRbfEstimator,
    rotation_angle_rad,
)
from fvs_estimator_node.training import distil

NOISE_M = 0.001
BOX = ur5_dh.HOME_RAD + np.array([-1.0, 1.0])[:, None] * ur5_dh.BOX_M_RAD
TURNED = rotation_about([0.3, 0.1, 1.0], np.radians(45.0))


@pytest.fixture(scope="module")
def networks():
    return distil(ur5_chain(), BOX, 60, np.random.default_rng(0))


def path(count, rng):
    """A ball that wanders about, 15 mm at a time, m, shape (count, 3)."""
    direction = np.cumsum(rng.normal(size=(count, 3)), axis=0)
    steps = 0.015 * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return np.array([0.0, 0.0, 1.4]) + np.cumsum(steps, axis=0)


def watch(camera, balls, rotation, translation, rng, noise_m=NOISE_M):
    for ball in balls:
        camera.add(ball, rotation @ ball + translation + noise_m * rng.normal(size=3), noise_m)


def off_deg(camera, rotation):
    return np.degrees(rotation_angle_rad(camera.rotation.T @ rotation))


@each("degrees", [1.0, 20.0, 90.0, 180.0])
def test_any_turn_and_shift_is_found_in_half_a_metre(degrees):
    rng = np.random.default_rng(int(degrees))
    rotation = rotation_about(rng.normal(size=3), np.radians(degrees))
    shift = 0.3 * rng.normal(size=3)
    camera, balls = CameraPose(), path(40, rng)
    watch(camera, balls, rotation, shift, rng)
    assert off_deg(camera, rotation) < 1.5
    assert camera.bumps == 1
    seen = camera.rotation @ balls[-1] + camera.translation_m
    np.testing.assert_allclose(seen, rotation @ balls[-1] + shift, atol=0.002)


@each("noise_m", [NOISE_M, 0.006])
def test_noise_turns_no_camera_that_stands(noise_m):
    rng, camera, off = np.random.default_rng(0), CameraPose(), []
    balls = path(500, rng)
    for ball in balls:
        watch(camera, [ball], np.eye(3), np.zeros(3), rng, noise_m)
        off.append(off_deg(camera, np.eye(3)))
    assert max(off) < 3.0
    assert off[-1] < 0.5
    assert camera.bumps == 0


# --- the estimators ---


def see(estimator, chain, joints, rng):
    """Let it see a ball on a chain at joints, rad, shape (k, n)."""
    balls = chain.position(joints) + NOISE_M * rng.normal(size=(len(joints), 3))
    for angles, ball in zip(joints, balls, strict=True):
        estimator.observe(image(angles, ball), NOISE_M)


@pytest.mark.parametrize(("method", "within"), [("poe", 0.01), ("rbf_left", 0.12)])
def test_the_jacobian_behind_a_turned_camera(networks, method, within):
    estimator = PoeEstimator(ur5_chain()) if method == "poe" else TurnedRbfEstimator(networks)
    rng = np.random.default_rng(0)
    seen = ur5_chain().moved(TURNED, np.array([0.1, -0.2, 0.1]))
    joints, probes = Recording().joints(np.arange(90) / 15.0), Recording().sampled_joints()
    begun = estimator.jacobian(joints[0])
    see(estimator, seen, joints, rng)
    learned = np.array([estimator.jacobian(q) for q in probes])
    assert np.median(relative_error(learned, seen.jacobian(probes))) < within
    values = estimator.status_values()
    assert values["camera_turned_deg"] == pytest.approx(45.0, abs=3.0)
    assert values["updates"] == estimator.updates > 50
    if method == "poe":
        np.testing.assert_allclose(
            estimator.chain.position(probes), seen.position(probes), atol=0.01
        )
        np.testing.assert_allclose(estimator.chain.jacobian(probes), learned, atol=1e-9)
    # A rest forgets nothing, though encoders are noisy.
    see(estimator, seen, joints[-1] + 1e-4 * rng.normal(size=(3000, 6)), rng)
    rested = np.array([estimator.jacobian(q) for q in probes])
    assert np.median(relative_error(rested, seen.jacobian(probes))) < within
    estimator.reset()
    assert estimator.updates == 0
    np.testing.assert_array_equal(estimator.jacobian(joints[0]), begun)


@each("bumped_s", [np.inf, 10.0])
def test_each_bump_is_counted_and_nothing_else(bumped_s):
    recording = Recording(seconds=20.0, outliers=0.0, late_s=0.0)
    turned = rotation_about([0.0, 1.0, 0.0], 0.3)
    data, estimator = recording.data(), PoeEstimator(recording.chain())
    for stamp_s, joints, ball in zip(data.stamps_s, data.joints_rad, data.z, strict=True):
        seen = turned @ ball if stamp_s > bumped_s else ball
        estimator.observe(image(joints, seen), NOISE_M)
    assert estimator.camera.bumps == int(bumped_s < 20.0)


def test_a_loss_in_motion_is_no_bump(networks):
    estimator, rng = TurnedRbfEstimator(networks), np.random.default_rng(0)
    for start_s in (0.0, 4.0, 8.0, 12.0):
        see(estimator, ur5_chain(), Recording().joints(start_s + np.arange(60) / 30.0), rng)
    assert estimator.camera.bumps == 0
