"""A rosbag2 of any arm becomes a data set."""

import re

import numpy as np
import pytest
import yaml
from replayed_bags import BEGIN_S, T, header, joint_states, message, point
from test_calibration import ARM, URDF, collected, errors

from fvs_tools.bag import Bag
from fvs_tools.calibrate import main
from fvs_tools.calibration import calibrate
from fvs_tools.recorded import read_data_set, read_photograph


@pytest.fixture
def bag(tmp_path):
    return recorded(tmp_path / "bag")


def recorded(folder, photograph=False):
    """Joints in another order, with one more, and a ball; and joints of a gripper."""
    data, bag = collected(seconds=20.0), Bag(folder, {})
    names = [*ARM.names[::-1], "finger"]
    for stamp_s, joints, ball in zip(data.stamps_s, data.joints_rad, data.z, strict=True):
        at = stamp_s, stamp_s
        angles = np.append(joints[::-1], np.nan)
        bag.write(joint_states(*at, names, angles, topic="arm/joint_states"))
        bag.write(joint_states(*at, ["finger"], [0.0], topic="gripper"))
        bag.write(point("arm/ball_position", *at, ball))
    if photograph:
        info, image = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/Image"
        roi = T["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        k = np.array([600.0, 0, 320, 0, 600, 240, 0, 0, 1])
        numbers = np.empty(0), k, np.eye(3).ravel(), np.zeros(12)
        model = 480, 640, "plumb_bob", *numbers, 0, 0, roi
        depth = 480, 640, "16UC1", 0, 1280, np.zeros(2 * 640 * 480, np.uint8)
        pixels = np.tile(np.array([10, 20, 200], np.uint8), 640 * 480)
        color = 480, 640, "bgr8", 0, 1920, pixels
        for stamp_s in data.stamps_s[::30]:
            for camera, content in (("depth/image", depth), ("color/image_raw", color)):
                info_topic = f"eye/{camera.split('/')[0]}/camera_info"
                bag.write(message(info_topic, info, stamp_s, header(stamp_s), *model))
                bag.write(message(f"eye/{camera}", image, stamp_s, header(stamp_s), *content))
    bag.close()
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
    assert 5.0 < photo.stamp_s - BEGIN_S < 15.0
    assert read_photograph(folder, "another") is None
    assert main([str(folder), "--urdf", str(URDF), "-o", str(out)]) == 0
    # The noise of 0.2 mm in each direction, seen from 1.3 m: 600 px * 0.2 / 1300 * 1.18.
    assert 0.05 < yaml.safe_load(out.read_text())["residual_px"] < 0.2
    assert " px (median)" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("topics", "words"),
    [
        ({"seen": "/nowhere"}, "0 topics of PointStamped or PoseStamped called /nowhere"),
        ({"joint_states": "/gripper"}, r"joint_states names \['finger'\], none of the wanted"),
    ],
)
def test_topics_are_chosen_or_named(bag, topics, words):
    with pytest.raises(ValueError, match=words):
        read_data_set(bag, ARM.names, **topics)


def in_halves(stamp_s, joints):
    halves = slice(0, 3), slice(3, 6)
    return [joint_states(stamp_s, stamp_s, ARM.names[half], joints[half]) for half in halves]


def beside_zeros(stamp_s, joints):
    later_s = stamp_s + 0.003
    zeros = joint_states(later_s, later_s, ARM.names, np.zeros(6))
    return [joint_states(stamp_s, stamp_s, ARM.names, joints), zeros]


def unstamped(stamp_s, joints):
    return [joint_states(stamp_s, None, ARM.names, joints)]


def in_degrees(stamp_s, joints):
    return [joint_states(stamp_s, stamp_s, ARM.names, np.degrees(joints))]


@pytest.mark.parametrize(
    ("published", "words"),
    [
        (beside_zeros, "jumped by .* do two nodes publish joint states"),
        (in_halves, r"joint_states lacks .* it names"),
        (unstamped, "joint_states has no stamp"),
        (in_degrees, "no degrees|in degrees"),
    ],
)
def test_why_joint_states_cannot_be_used_is_said(tmp_path, capsys, published, words):
    data, bag = collected(seconds=8.0), Bag(tmp_path / "bag", {})
    for stamp_s, joints, ball in zip(data.stamps_s, data.joints_rad, data.z, strict=True):
        for sent in (*published(stamp_s, joints), point("ball_position", stamp_s, stamp_s, ball)):
            bag.write(sent)
    bag.close()
    out = ["-o", str(tmp_path / "camera.yaml")]
    assert main([str(tmp_path / "bag"), "--urdf", str(URDF), *out]) == 2
    assert re.search(words, capsys.readouterr().err)
