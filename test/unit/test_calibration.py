"""Hand-eye calibration from motion: the camera to a millimetre, and what is wrong, named."""

import re
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from fvs_estimator_node.files import DataSet, save_data_set
from fvs_estimator_node.joint_path import Path
from fvs_estimator_node.motion import MotionConfig, RandomMotion
from fvs_ros.kinds.pose import Pose
from fvs_ros.paths import find_file
from fvs_ros.rotations import rotation_angle_rad
from fvs_ros.urdf import read_joints
from fvs_sim_node.camera import CAMERAS
from fvs_sim_node.robot import HOME_JOINTS_RAD
from fvs_tools import calibrate as program
from fvs_tools.calibration import calibrate, notes, static_transform
from fvs_tools.calibration import verdict as verdict_of
from fvs_tools.hand_eye_model import HandEyeModel, registration
from fvs_tools.kinematics import kinematics

URDF = find_file("robots/ur5.urdf")
ARM = kinematics(read_joints(URDF.read_text("utf-8")))
CAMERA = CAMERAS["front"]
TAG = np.array([0.02, 0.01, 0.1]), Rotation.from_rotvec([0.3, 1.2, 0.4]).as_matrix()


@cache
def collected(
    feature="ball", noise_m=2e-4, on_arm=False, delay_s=0.0, seconds=30.0, wide=(0.5,) * 6
):
    """Motion at 30 Hz, seen by a camera; joints in the URDF's order."""
    rng = np.random.default_rng(3)
    time_s = 0.5 + np.arange(0.0, seconds, 1.0 / 30.0)
    config = MotionConfig(duration_s=3600.0, joint_range_rad=wide, max_joint_velocity_rad_s=0.65)
    motion = RandomMotion(np.array(HOME_JOINTS_RAD), config, rng)
    joints, reported = (
        np.array([motion.path(t)[0] for t in time_s - late_s]) for late_s in (delay_s, 0.0)
    )
    chain, pose = ARM.reversed() if on_arm else ARM, Pose(0.3)
    tag_m, tag_rotation = TAG
    at_zero = pose.of_body(
        chain.tip_rotation @ tag_m + chain.tip_m, chain.tip_rotation @ tag_rotation
    )
    order = slice(None, None, -1) if on_arm else slice(None)
    seen = chain.chain(at_zero).moved(CAMERA.rotation.T, -CAMERA.rotation.T @ CAMERA.position_m)
    feature_m = seen.position(joints[:, order])
    if feature == "ball":
        feature_m = feature_m[:, :3] + rng.normal(0.0, noise_m, (len(time_s), 3))
    else:
        step = rng.normal(0.0, noise_m, (len(time_s), 6))
        feature_m = np.array([pose.retract(a, b) for a, b in zip(feature_m, step, strict=True)])
    return DataSet(
        time_s, reported, feature_m, np.zeros(len(time_s), int), ARM.names, feature=feature,
    )  # fmt: skip


def errors(estimate, camera=CAMERA):
    """Of the camera's place, m, and turn, rad; and squared, in their deviations."""
    pose = estimate.base_from_camera
    turn_rad = Rotation.from_matrix(pose[:3, :3] @ camera.rotation.T).as_rotvec()
    off = np.append(pose[:3, 3] - camera.position_m, turn_rad)
    return *np.linalg.norm(off.reshape(2, 3), axis=1), off @ np.linalg.solve(
        estimate.covariance, off
    )


@pytest.mark.parametrize("feature", ["ball", "pose"])
@pytest.mark.parametrize("on_arm", [False, True])
def test_camera_target_delay_and_covariance(feature, on_arm):
    """Eye-to-hand, and eye-in-hand: the same chain from the other end."""
    estimate = calibrate(collected(feature, on_arm=on_arm, delay_s=0.02), ARM, on_arm)
    off_m, off_rad, squared = errors(estimate)
    assert off_m < 1e-3
    assert off_rad < np.radians(0.1)
    assert squared < 16.8  # all but 1 %
    assert verdict_of(estimate)[0] == "good"
    assert estimate.mean.delay_s.item() == pytest.approx(0.02, abs=2e-3)
    np.testing.assert_allclose(estimate.target[:3], TAG[0], atol=1e-3)
    np.testing.assert_allclose(
        estimate.target[3:], TAG[1].T.ravel()[: estimate.target.size - 3], atol=5e-3
    )
    assert not list(notes(estimate))


def test_zeros_of_the_joints_are_found_where_a_camera_can_tell_them():
    zeros = np.radians([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
    data = collected()
    estimate = calibrate(replace(data, joints_rad=data.joints_rad - zeros), ARM)
    np.testing.assert_allclose(estimate.mean.zeros[1:-1], zeros[1:-1], atol=np.radians(0.1))
    assert np.isinf(estimate.deviation.zeros[[0, -1]]).all()
    # The first joint's zero turns the arm's base before the camera.
    rotation = Rotation.from_rotvec(-zeros[0] * ARM.axes[0]).as_matrix()
    moved = replace(
        CAMERA, position_m=rotation @ CAMERA.position_m, rotation=rotation @ CAMERA.rotation
    )
    off_m, off_rad, _ = errors(estimate, moved)
    assert off_m < 3e-3
    assert off_rad < np.radians(0.3)
    assert any("the zero of wrist_2_joint is off by +" in note for note in notes(estimate))


def lens(data, focal):
    """Balls where a lens shows them that camera_info describes wrongly."""
    return replace(data, z=data.z * [focal, focal, 1.0])


def tags(data, k1):
    """The poses of tags of 10 cm by their corners in such images, half a pixel off."""
    pose, camera, rng = Pose(0.3), np.diag([600.0, 600.0, 1.0]), np.random.default_rng(4)
    corners = 0.05 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    seen = []
    for z in data.z:
        points = corners @ pose.rotation(z).T + z[:3]
        tangent = points[:, :2] / points[:, 2:]
        factor = 1.0 + k1 * np.sum(tangent**2, axis=1, keepdims=True)
        image = 600.0 * factor * tangent + rng.normal(0.0, 0.1, (4, 2))
        about = cv2.Rodrigues(pose.rotation(z))[0], z[:3].reshape(3, 1).copy()
        rotation, position = cv2.solvePnPRefineLM(corners, image, camera, None, *about)
        seen.append(pose.of_body(position.ravel(), cv2.Rodrigues(rotation)[0]))
    return replace(data, z=np.array(seen))


def geared(data):
    """The elbow's encoder reports half a percent too little."""
    return replace(data, joints_rad=data.joints_rad / [1.0, 1.0, 1.005, 1.0, 1.0, 1.0])


@pytest.mark.parametrize(
    ("feature", "noise_m", "change", "words"),
    [
        ("ball", 1e-3, lambda data: data, []),
        ("ball", 2e-4, lambda data: lens(data, 1.01), [r"the focal length is \+(0.9|1.0)"]),
        ("pose", 0.0, lambda data: tags(data, -0.05), [".* a distortion of k1 = -0.0"]),
        (
            "ball",
            2e-4,
            lambda data: replace(data, z=1.01 * data.z),
            [r"lengths \+(0.9|1.0)"],
        ),
        ("ball", 2e-4, geared, [r"elbow_joint moves \+0.(4|5)"]),
    ],
)
def test_what_is_off_is_named_and_the_camera_known_as_well_as_stated(
    feature, noise_m, change, words
):
    estimate = calibrate(change(collected(feature, noise_m)), ARM)
    assert verdict_of(estimate)[0] == "good"
    assert 0.1 < errors(estimate)[2] < 16.8  # all but 1 %
    for note, expected in zip(notes(estimate), words, strict=True):
        assert re.match(expected, note)


@pytest.mark.parametrize("on_arm", [False, True])
def test_a_link_that_is_off_is_named_and_widens_what_is_stated(on_arm):
    points_m, shift_m = ARM.points_m.copy(), np.array([0.005, 0.0, 0.0])
    points_m[2:] += shift_m
    wrong = replace(ARM, points_m=points_m, tip_m=ARM.tip_m + shift_m)
    estimate = calibrate(collected("pose", 1e-4, on_arm=on_arm), wrong, on_arm)
    word, reason = verdict_of(estimate)
    assert word == "poor"
    assert estimate.deviation_m > 2e-3
    link = "elbow_joint to shoulder_lift" if on_arm else "shoulder_lift_joint to elbow"
    assert re.search(f"from {link}_joint the URDF is off by some (4|5)", reason)


@pytest.mark.parametrize("feature", ["ball", "pose"])
def test_slopes_are_those_of_the_features(feature):
    data, size = collected(feature, seconds=2.0), 1e-5
    model = HandEyeModel(data, Path(data), ARM, *registration(ARM, data.joints_rad, data.z))
    values = np.random.default_rng(1).normal(0.0, 0.05, sum(model.sizes))
    steps = size * np.eye(values.size)
    changes = [model.features(values + step) - model.features(values - step) for step in steps]
    expected = np.stack(changes, axis=-1) / (2.0 * size)
    np.testing.assert_allclose(model.slopes(values), expected, atol=1e-3)


def spoiled(field, change):
    data = collected(seconds=20.0)
    return replace(data, **{field: change(getattr(data, field))})


FOREARM = kinematics(read_joints(URDF.read_text("utf-8")), "forearm_link")
MIRRORED = replace(ARM, axes=ARM.axes * [[1], [1], [1], [-1], [1], [1]])


@pytest.mark.parametrize(
    ("data", "arm", "words"),
    [
        (lambda: spoiled("segment", lambda s: np.arange(s.size)), ARM, "follow each other by more"),
        (lambda: spoiled("joint_names", lambda n: ("a", *n[1:])), ARM, "lack shoulder_pan_joint"),
        (lambda: spoiled("z", lambda z: 1e3 * z), ARM, "positions above 100 m: metres?"),
        (lambda: collected(seconds=20.0), FOREARM, "explains the images: check tip link"),
        (lambda: collected(delay_s=0.4, seconds=15.0), ARM, "are stamped .0.20 s late, or more"),
    ],
)
def test_what_cannot_be_calibrated_is_refused(data, arm, words):
    with pytest.raises(ValueError, match=words):
        calibrate(data(), arm)


@pytest.mark.parametrize(
    ("change", "arm", "words"),
    [
        (np.copy, MIRRORED, "from elbow_joint to wrist_1_joint .* are joints swapped or mirrored"),
        (lambda q: q[:, [0, 2, 1, 3, 4, 5]], ARM, "more than 10 degrees: are joints swapped"),
        (lambda q: np.where(np.arange(6) == 4, q[0], q), ARM, "wrist_2_joint never moved"),
    ],
)
def test_what_is_unusable_is_named(change, arm, words):
    word, reason = verdict_of(calibrate(spoiled("joints_rad", change), arm))
    assert word == "unusable"
    assert re.search(words, reason)


def test_poses_that_the_robot_computed_are_no_images():
    data = spoiled("z", lambda z: ARM.tip_at(collected(seconds=20.0).joints_rad)[1].round(4))
    reason = verdict_of(calibrate(data, ARM))[1]
    assert "better than any camera sees it: are these poses that the robot computed" in reason


def test_a_camera_that_the_motion_does_not_tell_is_unusable():
    """Parallel axes hide the height; little motion of a joint is named."""
    arm = kinematics(read_joints(find_file("robots/scara.urdf").read_text("utf-8")))
    rng, time_s = np.random.default_rng(1), np.arange(0.0, 60.0, 1.0 / 30.0)
    joints = 0.4 * np.sin(np.outer(time_s, [0.5, 0.7, 0.9, 1.1]) + [0.0, 1.0, 2.0, 3.0])
    joints[:, arm.prismatic > 0.0] *= 0.1
    seen = arm.chain(arm.tip_m + [0.05, 0.0, -0.1])
    seen = seen.moved(CAMERA.rotation.T, -CAMERA.rotation.T @ CAMERA.position_m)
    ball_m = seen.position(joints) + rng.normal(0.0, 2e-4, (len(time_s), 3))
    data = DataSet(time_s, joints, ball_m, np.zeros(len(time_s), int), arm.names)
    assert verdict_of(calibrate(data, arm))[0] == "unusable"
    word, reason = verdict_of(calibrate(collected(noise_m=2e-3, wide=(0.02, *(0.5,) * 5)), ARM))
    assert word != "good"
    assert "move all joints further, shoulder_pan_joint first" in reason


# --- the program ---


def test_the_program_writes_transform_picture_and_command(tmp_path, capsys):
    data, out = tmp_path / "data.npz", tmp_path / "camera.yaml"
    save_data_set(data, collected("pose"))
    assert program.main([str(data), "--urdf", str(URDF), "-o", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "good: the camera is known to" in printed
    content = yaml.safe_load(out.read_text())
    np.testing.assert_allclose(content["translation_m"], CAMERA.position_m, atol=1e-3)
    rotation = Rotation.from_quat(content["rotation_xyzw"]).as_matrix()
    assert rotation_angle_rad(rotation.T @ CAMERA.rotation) < 2e-3
    assert content["static_transform"] in printed
    assert "--frame-id base_link --child-frame-id" in printed
    assert np.array(content["covariance"]).shape == (6, 6)
    assert out.with_suffix(".png").read_bytes().startswith(b"\x89PNG")


def test_names_of_frames_do_no_harm(tmp_path):
    data = replace(collected(seconds=10.0), feature_frame='cam"; touch x; <b>')
    estimate = calibrate(data, ARM)
    assert "--child-frame-id 'cam\"; touch x; <b>'" in static_transform(estimate)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--tip", "nowhere"], "has the link 'nowhere'"),
        (["--urdf", "/nowhere.urdf"], "/nowhere.urdf"),
        (["-o", "/proc/no/camera.yaml"], "/proc/no/camera.yaml cannot be written"),
        (["-o", "/tmp/camera.png"], "expected a file that ends in .yaml"),
    ],
)
def test_bad_arguments_are_refused(tmp_path, capsys, options, words):
    data = tmp_path / "data.npz"
    save_data_set(data, collected(seconds=10.0))
    arguments = [str(data), "--urdf", str(URDF), "-o", str(tmp_path / "camera.yaml"), *options]
    assert program.main(arguments) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "camera.yaml").exists()
