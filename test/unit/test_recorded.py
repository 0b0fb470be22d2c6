"""A rosbag2 of any arm becomes a data set."""

import re

import numpy as np
import pytest
import yaml
from test_calibration import ARM, URDF, collected, errors

from fvs_tools.bag import TYPES, Bag, Message
from fvs_tools.calibrate import main
from fvs_tools.calibration import calibrate
from fvs_tools.recorded import read_data_set, read_photograph

T = TYPES.types


def message(topic, kind, stamp_s, *fields):
    stamp = T["builtin_interfaces/msg/Time"](*divmod(round(1e9 * stamp_s), 10**9))
    header = T["std_msgs/msg/Header"](stamp, "camera")
    data = bytes(TYPES.serialize_cdr(T[kind](header, *fields), kind))
    return Message(topic, kind, round(1e9 * stamp_s), data)


def joint_states(stamp_s, names, angles_rad):
    kind, nothing = "sensor_msgs/msg/JointState", np.empty(0)
    return message("/joint_states", kind, stamp_s, list(names), angles_rad, nothing, nothing)


@pytest.fixture
def bag(tmp_path):
    return recorded(tmp_path / "bag")


def recorded(folder, photograph=False):
    """Joints in another order, with one more, and a ball; and joints of a gripper."""
    data = collected(seconds=20.0)
    one, point = Bag(folder, {}), T["geometry_msgs/msg/Point"]
    names, nothing = [*ARM.names[::-1], "finger"], np.empty(0)
    for stamp_s, joints, ball in zip(data.stamps_s, data.joints_rad, data.z, strict=True):
        angles = np.append(joints[::-1], np.nan)
        kind = "sensor_msgs/msg/JointState"
        one.write(message("/arm/joint_states", kind, stamp_s, names, angles, nothing, nothing))
        one.write(message("/gripper", kind, stamp_s, ["finger"], np.zeros(1), nothing, nothing))
        kind = "geometry_msgs/msg/PointStamped"
        one.write(message("/arm/ball_position", kind, stamp_s, point(*ball)))
    if photograph:
        info, image = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/Image"
        nothing, roi = np.empty(0), T["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        depth = np.zeros(2 * 640 * 480, np.uint8)
        k = np.array([600.0, 0, 320, 0, 600, 240, 0, 0, 1])
        model = (480, 640, "plumb_bob", nothing, k, np.eye(3).ravel(), np.zeros(12), 0, 0, roi)
        pixels = np.tile(np.array([10, 20, 200], np.uint8), 640 * 480)
        for stamp_s in data.stamps_s[::30]:
            one.write(message("/eye/depth/camera_info", info, stamp_s, *model))
            one.write(
                message("/eye/depth/image", image, stamp_s, 480, 640, "16UC1", 0, 1280, depth)
            )
            one.write(message("/eye/color/camera_info", info, stamp_s, *model))
            one.write(
                message("/eye/color/image_raw", image, stamp_s, 480, 640, "bgr8", 0, 1920, pixels)
            )
    one.close()
    return folder


def test_a_bag_of_any_arm_calibrates_its_camera(bag):
    data = read_data_set(bag, ARM.names)
    assert len(data) > 500
    assert data.joint_names == ARM.names, "but not the finger's, which are no numbers"
    assert data.feature_frame == "camera"
    assert errors(calibrate(data, ARM))[0] < 2e-3


def test_the_arm_is_drawn_over_an_image_of_the_bag(tmp_path, capsys):
    folder, out = recorded(tmp_path / "bag", photograph=True), tmp_path / "camera.yaml"
    photo = read_photograph(folder, "camera")
    assert photo.rgb[0, 0].tolist() == [200, 20, 10]
    assert photo.camera.fx == 600.0
    assert 5.0 < photo.stamp_s < 15.0
    assert read_photograph(folder, "another") is None
    assert main([str(folder), "--urdf", str(URDF), "-o", str(out)]) == 0
    # The noise of 0.2 mm in each direction, seen from 1.3 m: 600 px * 0.2 / 1300 * 1.18.
    assert 0.05 < yaml.safe_load(out.read_text())["residual_px"] < 0.2
    assert " px (median)" in capsys.readouterr().out


def test_a_bag_that_was_cut_off_says_so(bag):
    (file,) = bag.glob("*.mcap")
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 3 // 4])
    data = read_data_set(file, ARM.names)
    assert 300 < len(data) < 560
    assert data.provenance["left_out"].startswith("the bag was cut off")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"seen": "/nowhere"}, "0 topics of PointStamped or PoseStamped called /nowhere"),
        ({"joint_states": "/gripper"}, r"joint_states names \['finger'\], none of the wanted"),
    ],
)
def test_topics_are_chosen_or_named(bag, given, words):
    with pytest.raises(ValueError, match=words):
        read_data_set(bag, ARM.names, **given)


def in_halves(bag, stamp_s, joints):
    for half in (slice(0, 3), slice(3, 6)):
        bag.write(joint_states(stamp_s, ARM.names[half], joints[half]))


def beside_zeros(bag, stamp_s, joints):
    bag.write(joint_states(stamp_s, ARM.names, joints))
    bag.write(joint_states(stamp_s + 0.003, ARM.names, np.zeros(6)))


@pytest.mark.parametrize(
    ("publish", "words"),
    [
        (beside_zeros, "jumped by .* do two nodes publish joint states"),
        (in_halves, r"joint_states lacks .* it names"),
        (
            lambda bag, stamp_s, joints: bag.write(joint_states(0.0, ARM.names, joints)),
            "joint_states has no stamp",
        ),
        (
            lambda bag, stamp_s, joints: bag.write(
                joint_states(stamp_s, ARM.names, np.degrees(joints))
            ),
            "no degrees|in degrees",
        ),
    ],
    ids=["two publishers", "halves", "no stamps", "degrees"],
)
def test_why_joint_states_cannot_be_used_is_said(tmp_path, capsys, publish, words):
    data, bag = collected(seconds=8.0), Bag(tmp_path / "bag", {})
    for stamp_s, joints, ball in zip(data.stamps_s, data.joints_rad, data.z, strict=True):
        publish(bag, stamp_s, joints)
        point = T["geometry_msgs/msg/Point"](*ball)
        bag.write(message("/ball_position", "geometry_msgs/msg/PointStamped", stamp_s, point))
    bag.close()
    out = ["-o", str(tmp_path / "camera.yaml")]
    assert main([str(tmp_path / "bag"), "--urdf", str(URDF), *out]) == 2
    assert re.search(words, capsys.readouterr().err)


def test_what_is_no_bag_is_refused(tmp_path):
    with pytest.raises(ValueError, match="there is no such file or folder"):
        read_data_set(tmp_path / "nothing", ARM.names)
    (tmp_path / "text.mcap").write_text("no bag")
    with pytest.raises(ValueError, match="cannot read"):
        read_data_set(tmp_path / "text.mcap", ARM.names)
