"""Kinds of features against scipy's rotations and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from fvs_estimator_node.camera import PoeEstimator
from fvs_estimator_node.chain_fit import fit_chain
from fvs_estimator_node.files import DataSet
from fvs_ros.chain import SerialChain
from fvs_ros.kinds import BODIES, KINDS, Kind
from fvs_ros.kinds.pose import Pose
from fvs_ros.rotations import (
    nearest_rotation,
    quaternion_from_rotation,
    rotation_from_quaternion,
    rotation_from_vector,
    vector_from_rotation_rad,
)

LEVER_M = 0.3
PIXEL_M = 1e-3


class Corner(Kind):
    """A point of an image, px: in other units than lengths, and of no rigid body."""

    name, what = "corner", "corner"
    columns = axes = ("u", "v")
    unit, rigid = np.full(2, PIXEL_M), False

    def length_text(self, length_m, digits=0):
        return f"{length_m / PIXEL_M:.{digits}f} px"


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(1)


def random_pose(rng: np.random.Generator) -> np.ndarray:
    return Pose(LEVER_M).of_body(rng.normal(size=3), Rotation.random(random_state=rng).as_matrix())


def test_a_pose_is_written_with_a_quaternion_or_a_rotation_vector(rng):
    z = random_pose(rng)
    vector_deg = np.degrees(vector_from_rotation_rad(Pose().rotation(z)))
    for numbers in (Pose().columns_of(z), np.append(z[:3], vector_deg)):
        np.testing.assert_allclose(Pose().parse(numbers), z, atol=1e-9)
    with pytest.raises(ValueError, match="or 7, x y z qx qy qz qw, got 5"):
        Pose().parse(np.ones(5))


@pytest.mark.parametrize("angle_rad", [0.0, 1e-12, 1e-5, 0.7, 2.5, 3.0, np.pi - 1e-9, np.pi])
def test_rotations_agree_with_scipy(rng, angle_rad):
    for _ in range(50):
        axis = rng.normal(size=3)
        vector = angle_rad * axis / np.linalg.norm(axis)
        reference = Rotation.from_rotvec(vector)
        matrix = rotation_from_vector(vector)
        np.testing.assert_allclose(matrix, reference.as_matrix(), atol=1e-12)
        back = Rotation.from_rotvec(vector_from_rotation_rad(matrix))
        assert (back * reference.inv()).magnitude() < 1e-7
        assert np.linalg.norm(vector_from_rotation_rad(matrix)) == pytest.approx(
            angle_rad, abs=1e-7
        )
        quaternion = quaternion_from_rotation(matrix)
        assert np.linalg.norm(quaternion) == pytest.approx(1.0)
        np.testing.assert_allclose(rotation_from_quaternion(quaternion), matrix, atol=1e-7)


def test_error_of_a_pose_is_way_and_turn(rng):
    pose = Pose(LEVER_M)
    target = random_pose(rng)
    step = np.array([0.01, -0.02, 0.03, *(LEVER_M * np.array([0.4, -1.0, 0.2]))])
    moved = pose.retract(target, step)
    np.testing.assert_allclose(pose.minus(moved, target), step, atol=1e-12)
    parts = pose.status_values(step)
    assert parts["angle_rad"] == pytest.approx(np.linalg.norm([0.4, -1.0, 0.2]))
    assert parts["way_m"] == pytest.approx(np.linalg.norm(step[:3]))
    assert parts["error_m"] == pytest.approx(np.linalg.norm(step))
    # As weighted numbers they are the chord apart.
    chord_m = 2.0 * LEVER_M * np.sin(0.5 * parts["angle_rad"])
    apart_m = np.linalg.norm(pose.weights * (moved - target))
    assert apart_m == pytest.approx(np.hypot(parts["way_m"], chord_m))


def test_tangent_vectors_are_derivatives_of_the_weighted_numbers(rng):
    pose = Pose(LEVER_M)
    at = random_pose(rng)
    task = rng.normal(size=6)
    tiny = 1e-6
    motion = (pose.retract(at, tiny * task) - pose.retract(at, -tiny * task)) / (2.0 * tiny)
    motion = pose.weights * motion
    np.testing.assert_allclose(pose.from_tangent(at, task), motion, atol=1e-8)
    np.testing.assert_allclose(pose.to_tangent(at, motion), task, atol=1e-8)
    columns = rng.normal(size=(6, 7))
    back = pose.to_tangent(at, pose.from_tangent(at, columns))
    np.testing.assert_allclose(back, columns, atol=1e-12)


@pytest.mark.parametrize("name", BODIES)
def test_a_kind_moves_with_the_twists_of_a_chain(rng, name):
    kind = KINDS[name]()
    carried = kind.of_body(rng.normal(size=3), Rotation.random(random_state=rng).as_matrix())
    slide = np.array([0.0, 1.0, 0.0, 0.0])
    chain = SerialChain(*rng.normal(size=(2, 4, 3)), carried, rng.normal(size=4), slide)
    joints, tiny = rng.normal(size=4), 1e-6
    motions = [
        kind.minus(chain.position(joints + step), chain.position(joints - step)) / (2.0 * tiny)
        for step in tiny * np.eye(4)
    ]
    np.testing.assert_allclose(
        kind.moved_by(*chain.motion(joints)), np.transpose(motions), atol=1e-8
    )


def test_the_true_lens_shows_a_tag_where_its_corners_say(rng):
    pose, half_m = Pose(LEVER_M), 0.05
    square = half_m * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0.0]])
    for _ in range(10):
        vector = np.array([np.pi, 0.0, 0.0]) + 0.3 * rng.normal(size=3)
        position_m = np.append(0.2 * rng.normal(size=2), 1.2)
        true = pose.of_body(position_m, Rotation.from_rotvec(vector).as_matrix())
        corners = true[:3] + square @ pose.rotation(true).T
        image = 1.05 * corners[:, :2] / corners[:, 2:]

        def missed(motion, true=true, image=image):
            z = pose.retract(true, motion)
            corners = z[:3] + square @ pose.rotation(z).T
            return (corners[:, :2] / corners[:, 2:] - image).ravel()

        measured = pose.retract(true, least_squares(missed, np.zeros(6), xtol=1e-12).x)
        corrected = pose.nearest(pose.without_lens(measured[None], 0.05, 0.0)[0])
        left, before = pose.minus(corrected, true), pose.minus(measured, true)
        assert np.linalg.norm(before) > 0.05
        assert np.linalg.norm(left) < 0.05 * np.linalg.norm(before)


def test_nearest_pose_undoes_small_errors(rng):
    pose = Pose(LEVER_M)
    at = random_pose(rng)
    noisy = at + 1e-3 * rng.normal(size=12)
    nearest = pose.nearest(noisy)
    rotation = pose.rotation(nearest)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert pose.status_values(pose.minus(nearest, at))["angle_rad"] < 0.02
    np.testing.assert_allclose(pose.nearest(at), at, atol=1e-12)
    mirrored = nearest_rotation(np.diag([1.0, 1.0, -0.1]))
    assert np.linalg.det(mirrored) == pytest.approx(1.0)


def test_at_half_a_turn_noise_does_not_change_the_way_round(rng):
    pose = Pose(LEVER_M)
    target, last = random_pose(rng), None
    half = pose.retract(target, np.append(np.zeros(3), LEVER_M * np.pi * np.array([0, 0.6, 0.8])))
    ways = []
    for _ in range(50):
        last = pose.minus(pose.retract(half, 1e-3 * rng.normal(size=6)), target, last)
        ways.append(last)
    assert np.ptp(ways, axis=0).max() < 0.02
    assert np.linalg.norm(ways[-1][3:]) == pytest.approx(LEVER_M * np.pi, abs=0.01)


@pytest.mark.parametrize("name", ["position", "position_x", "position_y", "position_z"])
def test_the_error_of_a_task_leaves_free_what_it_does_not_name(rng, name):
    pose, tiny = Pose(LEVER_M, task_axes=name), 1e-6
    axis = slice(0, 3) if name == "position" else slice(3 + 3 * "xyz".index(name[-1]), None)
    axis = slice(axis.start, axis.start + 3)
    for _ in range(20):
        z, target, motion = random_pose(rng), random_pose(rng), tiny * rng.normal(size=6)
        error = pose.error(z, target)
        done = pose.retract(z, -error)
        np.testing.assert_allclose(done[:3], target[:3], atol=1e-12)
        np.testing.assert_allclose(done[axis], target[axis], atol=1e-9)
        # Nothing turns that need not.
        np.testing.assert_allclose(pose.of_task(z, error), error, atol=1e-12)
        free = motion - pose.of_task(z, motion)
        turned = pose.retract(z, free / tiny)
        assert np.linalg.norm(turned - z) > 1e-4
        left, right = (np.linalg.norm(pose.error(each, target)) for each in (turned, z))
        assert left == pytest.approx(right)


def test_a_tag_that_faces_the_opposite_direction_is_half_a_turn_from_its_task(rng):
    pose, target = Pose(LEVER_M, task_axes="position_z"), random_pose(rng)
    opposite = pose.of_body(target[:3], pose.rotation(target) @ np.diag([1.0, -1.0, -1.0]))
    error = pose.error(opposite, target)
    assert np.linalg.norm(error) == pytest.approx(LEVER_M * np.pi)
    np.testing.assert_allclose(pose.retract(opposite, -error)[9:], target[9:], atol=1e-6)


def test_a_message_is_read_as_it_was_written_and_refused_if_it_is_no_pose(rng):
    pose, message = Pose(LEVER_M), PoseStamped()
    at = random_pose(rng)
    pose.write(message, at)
    np.testing.assert_allclose(pose.read(message), at, atol=1e-12)
    message.pose.orientation.w += 0.5
    with pytest.raises(ValueError, match="is no pose"):
        pose.read(message)


@pytest.mark.parametrize("kind", [KINDS["ball"](), Pose(LEVER_M), Corner()])
def test_what_a_person_writes_is_refused_if_it_is_not_finite_or_too_far(kind):
    numbers = np.zeros(len(kind.columns))
    numbers[-1] = 1.0
    np.testing.assert_allclose(kind.columns_of(kind.parse(numbers)), numbers)
    for wrong in (np.nan, np.inf, 1e9):
        numbers[0] = wrong
        with pytest.raises(ValueError, match=r"than 100 m: \[") as refusal:
            kind.parse(numbers)
        assert refusal.value.args[0].count(",") == len(numbers)


def test_a_kind_may_have_other_units_than_lengths():
    kind, z = Corner(), np.array([320.0, 240.0])
    moved = kind.retract(z, np.array([0.01, -0.02]))
    np.testing.assert_allclose(moved, [330.0, 220.0])
    np.testing.assert_allclose(kind.minus(moved, z), [0.01, -0.02])
    assert kind.parse(z) is z
    assert kind.text(z) == "(320.0 px, 240.0 px)"
    assert kind.error_text(np.array([0.003, 0.004])) == "5.0 px"


def test_a_chain_refuses_what_is_no_rigid_body(monkeypatch):
    monkeypatch.setitem(KINDS, "corner", Corner)
    data = DataSet(np.zeros(1), np.zeros((1, 6)), np.zeros((1, 2)), np.zeros(1), feature="corner")
    with pytest.raises(ValueError, match="a corner is no rigid body"):
        fit_chain(data)
    chain = SerialChain(*np.ones((2, 6, 3)), np.ones(3), np.zeros(6), np.zeros(6))
    with pytest.raises(ValueError, match="a corner does not turn with the camera"):
        PoeEstimator(chain, kind=Corner())
