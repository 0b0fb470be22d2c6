"""Features against scipy's rotations and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fvs_ros.feature import Feature, PoseFeature
from fvs_ros.rotations import (
    nearest_rotation,
    quaternion_from_rotation,
    rotation_from_quaternion,
    rotation_from_vector,
    vector_from_rotation_rad,
)

LEVER_M = 0.3


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(1)


def random_pose(rng: np.random.Generator) -> np.ndarray:
    return PoseFeature(LEVER_M).of(
        rng.normal(size=3), Rotation.random(random_state=rng).as_matrix()
    )


@pytest.mark.parametrize("angle_rad", [0.0, 1e-12, 1e-5, 0.7, 2.5, 3.0, np.pi - 1e-9, np.pi])
def test_rotations_agree_with_scipy(rng, angle_rad):
    for _ in range(50):
        axis = rng.normal(size=3)
        vector = angle_rad * axis / np.linalg.norm(axis)
        reference = Rotation.from_rotvec(vector)
        matrix = rotation_from_vector(vector)
        np.testing.assert_allclose(matrix, reference.as_matrix(), atol=1e-12)
        found = Rotation.from_rotvec(vector_from_rotation_rad(matrix))
        assert (found * reference.inv()).magnitude() < 1e-7
        assert np.linalg.norm(vector_from_rotation_rad(matrix)) == pytest.approx(
            angle_rad, abs=1e-7
        )
        quaternion = quaternion_from_rotation(matrix)
        assert np.linalg.norm(quaternion) == pytest.approx(1.0)
        np.testing.assert_allclose(rotation_from_quaternion(quaternion), matrix, atol=1e-7)


def test_error_of_a_pose_is_way_and_turn(rng):
    pose = PoseFeature(LEVER_M)
    target = random_pose(rng)
    step = np.array([0.01, -0.02, 0.03, *(LEVER_M * np.array([0.4, -1.0, 0.2]))])
    moved = pose.displaced(target, step)
    np.testing.assert_allclose(pose.error(moved, target), step, atol=1e-12)
    parts = pose.parts(step)
    assert parts["angle_rad"] == pytest.approx(np.linalg.norm([0.4, -1.0, 0.2]))
    assert parts["way_m"] == pytest.approx(np.linalg.norm(step[:3]))
    assert parts["error_m"] == pytest.approx(np.linalg.norm(step))
    assert pose.distance(step) == "37.4 mm and 62.76 degrees"
    # As vectors they are the chord apart.
    chord_m = 2.0 * LEVER_M * np.sin(0.5 * parts["angle_rad"])
    assert np.linalg.norm(moved - target) == pytest.approx(np.hypot(parts["way_m"], chord_m))


def test_task_motion_is_the_derivative_of_the_error(rng):
    pose = PoseFeature(LEVER_M)
    at = random_pose(rng)
    task = rng.normal(size=6)
    tiny = 1e-6
    motion = (pose.displaced(at, tiny * task) - pose.displaced(at, -tiny * task)) / (2.0 * tiny)
    np.testing.assert_allclose(pose.from_task(at, task), motion, atol=1e-8)
    np.testing.assert_allclose(pose.to_task(at, motion), task, atol=1e-8)
    columns = rng.normal(size=(6, 7))
    np.testing.assert_allclose(pose.to_task(at, pose.from_task(at, columns)), columns, atol=1e-12)


def test_nearest_pose_undoes_small_errors(rng):
    pose = PoseFeature(LEVER_M)
    at = random_pose(rng)
    noisy = at + 1e-3 * rng.normal(size=12)
    found = pose.nearest(noisy)
    rotation = pose.rotation(found)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert pose.parts(pose.error(found, at))["angle_rad"] < 0.02
    np.testing.assert_allclose(pose.nearest(at), at, atol=1e-12)
    mirrored = nearest_rotation(np.diag([1.0, 1.0, -0.1]))
    assert np.linalg.det(mirrored) == pytest.approx(1.0)


def test_a_vector_is_its_own_task(rng):
    ball, one, other = Feature(), rng.normal(size=3), rng.normal(size=3)
    np.testing.assert_array_equal(ball.error(one, other), one - other)
    np.testing.assert_array_equal(ball.displaced(one, other), one + other)
    assert ball.to_task(one, other) is ball.from_task(one, other) is other
    assert ball.nearest(one) is one
    assert ball.axes == ("x", "y", "z")
    assert Feature(2).axes == ("1", "2")
    assert ball.distance(np.array([3e-3, 0.0, 4e-3])) == "5.0 mm"


def test_at_half_a_turn_noise_does_not_change_the_way_round(rng):
    pose = PoseFeature(LEVER_M)
    target, last = random_pose(rng), None
    half = pose.displaced(target, np.append(np.zeros(3), LEVER_M * np.pi * np.array([0, 0.6, 0.8])))
    ways = []
    for _ in range(50):
        last = pose.error(pose.displaced(half, 1e-3 * rng.normal(size=6)), target, last)
        ways.append(last)
    assert np.ptp(ways, axis=0).max() < 0.02
    assert np.linalg.norm(ways[-1][3:]) == pytest.approx(LEVER_M * np.pi, abs=0.01)


def test_what_is_no_pose_is_told(rng):
    pose, at = PoseFeature(LEVER_M), random_pose(rng)
    assert pose.is_one(at)
    for wrong in (np.zeros(12), np.ones(12), at * np.repeat([1.0, -1.0], [3, 9])):
        assert not pose.is_one(wrong)
    for quaternion in (np.zeros(4), np.full(4, np.nan), np.array([0.0, 0.0, 0.0, 9.0])):
        with pytest.raises(ValueError, match="unit quaternion"):
            rotation_from_quaternion(quaternion)
