"""Hand-eye calibration from motion: the camera to a millimetre, and what is wrong, named."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from fvs_estimator_node.calibration import CalibrationError
from fvs_estimator_node.chain_fit import fit_chain
from fvs_estimator_node.files import DataSet, save_data_set
from fvs_estimator_node.hand_eye import calibrate
from fvs_estimator_node.hand_eye_checks import ordered
from fvs_estimator_node.hand_eye_model import HandEyeModel
from fvs_estimator_node.motion import MotionConfig, RandomMotion
from fvs_ros.camera import CameraModel, Intrinsics
from fvs_ros.kinds.pose import Pose
from fvs_ros.paths import find_file
from fvs_ros.rotations import rotation_angle_rad
from fvs_ros.urdf import kinematics, read_joints
from fvs_sim_node.camera import CAMERAS
from fvs_sim_node.robot import HOME_JOINTS_RAD
from fvs_tools import calibrate as program
from fvs_tools.overlay import Photograph, draw

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
    asked = MotionConfig(duration_s=3600.0, joint_range_rad=wide, max_joint_velocity_rad_s=0.65)
    motion = RandomMotion(np.array(HOME_JOINTS_RAD), asked, rng)
    joints, reported = (
        np.array([motion.path(one)[0] for one in time_s - late_s]) for late_s in (delay_s, 0.0)
    )
    chain = ARM.reversed() if on_arm else ARM
    place_m, turn = TAG
    pose = Pose(0.3)
    tip = chain.tip_rotation, chain.tip_m
    at_zero = pose.of_body(tip[0] @ place_m + tip[1], tip[0] @ turn)
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


def off_in_deviations(found, camera=CAMERA):
    """Squared error of the pose in its deviations: chi squared of six degrees of freedom."""
    turn_rad = Rotation.from_matrix(found.rotation @ camera.rotation.T).as_rotvec()
    off = np.append(found.translation_m - camera.position_m, turn_rad)
    return off @ np.linalg.solve(found.covariance, off)


def errors(found, camera=CAMERA):
    turn_rad = rotation_angle_rad(found.rotation.T @ camera.rotation)
    return float(np.linalg.norm(found.translation_m - camera.position_m)), float(turn_rad)


@pytest.mark.parametrize("feature", ["ball", "pose"])
@pytest.mark.parametrize("on_arm", [False, True])
def test_camera_tag_delay_and_covariance(feature, on_arm):
    """Eye-to-hand, and eye-in-hand: the same chain from the other end."""
    found = calibrate(collected(feature, on_arm=on_arm, delay_s=0.02), ARM, on_arm)
    off_m, off_rad = errors(found)
    assert off_m < 1e-3
    assert off_rad < np.radians(0.1)
    assert off_m < 3.0 * found.deviation_m
    assert found.arm.root == ("tool0" if on_arm else "base_link")
    assert found.verdict[0] == "good"
    assert found.delay_s == pytest.approx(0.02, abs=2e-3)
    np.testing.assert_allclose(found.carried_m, TAG[0], atol=1e-3)
    if feature == "pose":
        assert rotation_angle_rad(found.carried_rotation.T @ TAG[1]) < 5e-3
    assert found.displaced is None


def test_zeros_of_the_joints_are_found_where_a_camera_can_tell_them():
    zeros = np.radians([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
    data = collected()
    found = calibrate(replace(data, joints_rad=data.joints_rad - zeros), ARM)
    np.testing.assert_allclose(found.zeros_rad[1:-1], zeros[1:-1], atol=np.radians(0.1))
    assert np.isinf(found.zeros_deviation_rad[[0, -1]]).all()
    # The first joint's zero turns the arm's base before the camera.
    turn = Rotation.from_rotvec(-zeros[0] * ARM.axes[0]).as_matrix()
    moved = replace(CAMERA, position_m=turn @ CAMERA.position_m, rotation=turn @ CAMERA.rotation)
    off_m, off_rad = errors(found, moved)
    assert off_m < 3e-3
    assert off_rad < np.radians(0.3)
    notes = " ".join(found.notes())
    assert "the zero of wrist_2_joint is off by +" in notes
    assert "no camera can tell the zeros of shoulder_pan_joint and wrist_3_joint" in notes


@pytest.mark.parametrize(
    ("on_arm", "shift_m", "words"),
    [
        (False, (0.005, 0.0, 0.0), "elbow_joint"),
        (True, (0.0, 0.005, 0.0), "shoulder_lift_joint or elbow_joint"),
    ],
)
def test_a_wrong_length_of_a_link_is_named(on_arm, shift_m, words):
    """With all joints that it cannot be told from: axes 2 to 4 are parallel to y."""
    points_m = ARM.points_m.copy()
    points_m[2:] += shift_m
    wrong = replace(ARM, points_m=points_m, tip_m=ARM.tip_m + shift_m)
    found = calibrate(collected("pose", 1e-4, on_arm=on_arm), wrong, on_arm)
    assert found.verdict[0] == "poor"
    assert found.verdict[1].startswith(words)
    assert "is about 5" in found.verdict[1]


def lens(data, focal):
    """Balls where a lens shows them that camera_info describes wrongly."""
    return replace(data, ball_m=data.ball_m * [focal, focal, 1.0])


def tags(data, k1):
    """The poses of tags of 10 cm by their corners in such images, half a pixel off."""
    pose, camera, rng = Pose(0.3), np.diag([600.0, 600.0, 1.0]), np.random.default_rng(4)
    corners = 0.05 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    seen = []
    for one in data.ball_m:
        points = corners @ pose.rotation(one).T + one[:3]
        tangent = points[:, :2] / points[:, 2:]
        factor = 1.0 + k1 * np.sum(tangent**2, axis=1, keepdims=True)
        image = 600.0 * factor * tangent + rng.normal(0.0, 0.1, (4, 2))
        about = cv2.Rodrigues(pose.rotation(one))[0], one[:3].reshape(3, 1).copy()
        turn, place = cv2.solvePnPRefineLM(corners, image, camera, None, *about)
        seen.append(pose.of_body(place.ravel(), cv2.Rodrigues(turn)[0]))
    return replace(data, ball_m=np.array(seen))


def geared(data):
    """The elbow's encoder reports half a percent too little."""
    return replace(data, joints_rad=data.joints_rad / [1.0, 1.0, 1.005, 1.0, 1.0, 1.0])


@pytest.mark.parametrize(
    ("feature", "noise_m", "change", "words"),
    [
        ("ball", 1e-3, lambda data: data, None),
        ("ball", 2e-4, lambda data: lens(data, 1.01), "the focal length is +1.0"),
        ("pose", 0.0, lambda data: tags(data, -0.05), "a distortion of k1 = -0.0"),
        ("ball", 2e-4, lambda data: replace(data, ball_m=1.01 * data.ball_m), "lengths +1.0"),
        ("ball", 2e-4, geared, "elbow_joint moves +0.50 % further than it reports"),
    ],
)
def test_what_is_off_is_named_and_the_camera_known_as_well_as_stated(
    feature, noise_m, change, words
):
    found = calibrate(change(collected(feature, noise_m)), ARM)
    assert found.verdict[0] == "good"
    assert 0.3 < off_in_deviations(found) < 16.8  # all but 1 %
    notes = [one for one in found.notes() if "no camera can tell" not in one]
    assert (not notes) if words is None else (len(notes) == 1 and words in notes[0])


@pytest.mark.parametrize("feature", ["ball", "pose"])
def test_the_slopes_are_those_of_what_is_seen(feature):
    data = ordered(collected(feature, seconds=10.0), ARM)
    model, rng = HandEyeModel(data, ARM, fit_chain(data)), np.random.default_rng(0)
    values, wider = 0.05 * rng.normal(size=model.at.size), np.array([1.0, 2.0, 1.0, 1.5, 1.0, 1.0])
    numeric = [
        (
            model.seen_and_slopes(values + one, wider)[0]
            - model.seen_and_slopes(values - one, wider)[0]
        )
        for one in 1e-6 * np.eye(model.at.size)
    ]
    slopes = model.seen_and_slopes(values, wider)[1]
    np.testing.assert_allclose(slopes, np.stack(numeric, axis=-1) / 2e-6, atol=1e-8)


def test_links_that_are_all_off_widen_what_is_stated():
    points_m, tip_m = ARM.points_m.copy(), ARM.tip_m.copy()
    for i, shift_m in enumerate(np.random.default_rng(0).normal(0.0, 2e-3, (5, 3)), 1):
        points_m[i:] += shift_m
        tip_m += shift_m
    found = calibrate(collected(), replace(ARM, points_m=points_m, tip_m=tip_m))
    assert found.verdict[0] != "good"
    assert found.deviation_m > 2e-3
    assert off_in_deviations(found) < 28.0  # all but 0.01 %


def mirrored(data):
    return data, replace(ARM, axes=ARM.axes * [[1], [1], [1], [-1], [1], [1]])


def late(data):
    return collected(delay_s=0.4, seconds=15.0), ARM


def in_mm(data):
    return replace(data, ball_m=1e3 * data.ball_m), ARM


def swapped(data):
    return replace(data, joints_rad=data.joints_rad[:, [0, 2, 1, 3, 4, 5]]), ARM


def too_short(data):
    return data, kinematics(read_joints(URDF.read_text("utf-8")), "forearm_link")


def still(data):
    joints = data.joints_rad.copy()
    joints[:, 4] = 1.0
    return replace(data, joints_rad=joints), ARM


def bumped(data):
    moved = data.ball_m.copy()
    moved[300:] += [0.004, 0.002, 0.0]
    return replace(data, ball_m=moved), ARM


def renamed(data):
    return replace(data, joint_names=("a", *data.joint_names[1:])), ARM


def short(data):
    part = slice(0, 150)
    columns = ("stamps_s", "joints_rad", "ball_m", "segment")
    return replace(data, **{name: getattr(data, name)[part] for name in columns}), ARM


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (mirrored, "wrist_1_joint turns the other way than in the URDF"),
        (too_short, "moves like that. wrist_1_joint, wrist_2_joint, wrist_3_joint moved, too"),
        (still, "wrist_2_joint never moved"),
        (bumped, r"the camera moved, or .* by about \d.\d mm and .* some (9|10|11) s after"),
        (renamed, "the data lack shoulder_pan_joint"),
        (short, "a chain needs at least 200 images"),
        (late, "the images are stamped .0.20 s late, or more"),
        (in_mm, "ball or tag has places 1... m away: expected metres"),
        (swapped, "are the joints in rad, and under their own names"),
    ],
)
def test_what_cannot_be_calibrated_is_named(change, words):
    with pytest.raises(ValueError, match=words):
        calibrate(*change(collected(seconds=20.0)))
    assert issubclass(CalibrationError, ValueError)


def test_an_arm_of_parallel_axes_says_what_it_cannot_tell():
    path = find_file("robots/scara.urdf")
    arm = kinematics(read_joints(path.read_text("utf-8")))
    rng, time_s = np.random.default_rng(1), np.arange(0.0, 60.0, 1.0 / 30.0)
    joints = 0.4 * np.sin(np.outer(time_s, [0.5, 0.7, 0.9, 1.1]) + [0.0, 1.0, 2.0, 3.0])
    joints[:, arm.prismatic > 0.0] *= 0.1
    seen = arm.chain(arm.tip_m + [0.05, 0.0, -0.1])
    seen = seen.moved(CAMERA.rotation.T, -CAMERA.rotation.T @ CAMERA.position_m)
    ball_m = seen.position(joints) + rng.normal(0.0, 2e-4, (len(time_s), 3))
    found = calibrate(DataSet(time_s, joints, ball_m, np.zeros(len(time_s), int), arm.names), arm)
    word, reason = found.verdict
    assert word == "unusable"
    assert "no motion of these joints tells the place along (" in reason
    assert ", 1.00) of base_link" in reason


def test_too_little_motion_says_which_would_do():
    wide = (0.05, *(0.5,) * 5)
    found = calibrate(collected(noise_m=2e-3, wide=wide), ARM)
    word, reason = found.verdict
    assert word != "good"
    assert "move shoulder_pan_joint 10 times as far to know it to" in reason
    promised_m = next(one.deviation_m for one in found.remedies if one.words in reason)
    assert promised_m < 0.9 * found.deviation_m


def test_the_arm_is_drawn_where_the_image_shows_it():
    """Through delay, zeros and focal length, at the joints of the exposure."""
    delay_s, at = 0.05, 300
    data = lens(collected(delay_s=delay_s, seconds=15.0), 1.005)
    reported = replace(data, joints_rad=data.joints_rad - [0, 0, 0.02, 0, 0, 0])
    found = calibrate(reported, ARM)
    camera = Intrinsics(640, 480, 600.0, 600.0, 320.0, 240.0)
    photo = Photograph.of(np.zeros((480, 640, 3), np.uint8), CameraModel(camera), data.stamps_s[at])
    drawn = draw(found, reported, photo).axes[0].lines[-1].get_xydata()
    joints = np.array(
        [np.interp(photo.stamp_s - delay_s, data.stamps_s, one) for one in data.joints_rad.T]
    )
    axes, tip_m = ARM.tip_at(joints)
    points_m = np.vstack([ARM.at(joints)[0], tip_m, tip_m + TAG[0] @ axes])
    seen_m = (points_m - CAMERA.position_m) @ CAMERA.rotation
    true = Intrinsics(640, 480, 603.0, 603.0, 320.0, 240.0).project(seen_m)
    np.testing.assert_allclose(drawn, true, atol=0.5)
    with pytest.raises(ValueError, match="the image has 320x240 pixels, its camera_info 640x480"):
        Photograph.of(np.zeros((240, 320, 3), np.uint8), CameraModel(camera), 0.0)


# --- the program ---


def test_the_program_writes_transform_picture_and_command(tmp_path, capsys):
    data, out = tmp_path / "data.npz", tmp_path / "camera.yaml"
    save_data_set(data, collected("pose"))
    assert program.main([str(data), "--urdf", str(URDF), "-o", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "good: the camera is known to" in printed
    content = yaml.safe_load(out.read_text())
    np.testing.assert_allclose(content["translation_m"], CAMERA.position_m, atol=1e-3)
    turn = Rotation.from_quat(content["rotation_xyzw"]).as_matrix()
    assert rotation_angle_rad(turn.T @ CAMERA.rotation) < 2e-3
    assert content["static_transform"] in printed
    assert "--frame-id base_link --child-frame-id" in printed
    assert '<parent link="base_link"/>' in content["urdf"]
    assert np.array(content["covariance"]).shape == (6, 6)
    assert out.with_suffix(".png").read_bytes().startswith(b"\x89PNG")


def test_names_of_frames_do_no_harm(tmp_path):
    found = calibrate(replace(collected(seconds=10.0), feature_frame='cam"; touch x; <b>'), ARM)
    assert "--child-frame-id 'cam\"; touch x; <b>'" in program.static_transform(found)
    assert "&lt;b&gt;" in program.urdf_joint(found)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["--tip", "nowhere"], "has the link 'nowhere'"),
        (["--urdf", "/nowhere.urdf"], "/nowhere.urdf"),
        (["-o", "/nowhere/camera.yaml"], "the folder /nowhere does not exist"),
        (["-o", "/tmp/camera.png"], "the picture is written beside it"),
    ],
)
def test_bad_arguments_are_refused(tmp_path, capsys, given, words):
    data = tmp_path / "data.npz"
    save_data_set(data, collected(seconds=10.0))
    arguments = [str(data), "--urdf", str(URDF), "-o", str(tmp_path / "camera.yaml"), *given]
    assert program.main(arguments) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "camera.yaml").exists()


def test_a_urdf_of_joints_in_a_ring_ends():
    ring = (
        '<robot name="r"><joint name="a" type="revolute"><parent link="l1"/><child link="l2"/>'
        '<limit velocity="1"/></joint><joint name="b" type="revolute"><parent link="l2"/>'
        '<child link="l1"/><limit velocity="1"/></joint></robot>'
    )
    assert len(kinematics(read_joints(ring), "l1").names) == 2
    with pytest.raises(ValueError, match="no joints: is it a xacro"):
        kinematics(read_joints('<robot name="r"/>'))


def test_what_the_robot_says_of_its_tool_is_no_tag():
    text = URDF.read_text("utf-8").replace(
        "</robot>",
        '<joint name="stands" type="fixed"><parent link="world"/><child link="base_link"/>'
        '<origin xyz="0.5 0 0.8"/></joint></robot>',
    )
    arm, data, pose = kinematics(read_joints(text)), collected(seconds=20.0), Pose(0.3)
    turns, places_m = arm.tip_at(data.joints_rad)
    base_m = np.array([0.5, 0.0, 0.8])
    half = np.diag([-1.0, -1.0, 1.0])  # as a UR's "base" to its "base_link"
    told = [
        pose.of_body(half @ (place_m - base_m), half @ turn.T)
        for place_m, turn in zip(places_m, turns, strict=True)
    ]
    data = replace(data, ball_m=np.array(told), feature="pose", feature_frame="base")
    word, reason = calibrate(data, arm).verdict
    assert word == "unusable"
    assert "base is where the arm's base is" in reason
