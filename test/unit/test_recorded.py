"""A rosbag2 of any arm becomes a data set."""

import numpy as np
import pytest
from test_calibration import ARM, CAMERA, collected

from fvs_estimator_node.calibration import calibrate
from fvs_tools.bag import TYPES, Bag, Message
from fvs_tools.recorded import read_data_set

T = TYPES.types


def message(topic, kind, stamp_s, *fields):
    stamp = T["builtin_interfaces/msg/Time"](*divmod(round(1e9 * stamp_s), 10**9))
    header = T["std_msgs/msg/Header"](stamp, "camera")
    data = bytes(TYPES.serialize_cdr(T[kind](header, *fields), kind))
    return Message(topic, kind, round(1e9 * stamp_s), data)


@pytest.fixture
def bag(tmp_path):
    """Joints in another order, with one more, and a ball; and joints of a gripper."""
    data, folder = collected(seconds=30.0), tmp_path / "bag"
    one, point = Bag(folder, {}), T["geometry_msgs/msg/Point"]
    names, nothing = [*ARM.names[::-1], "finger"], np.empty(0)
    for stamp_s, joints, ball in zip(data.stamps_s, data.joints_rad, data.ball_m, strict=True):
        angles = np.append(joints[::-1], 0.5)
        kind = "sensor_msgs/msg/JointState"
        one.write(message("/arm/joint_states", kind, stamp_s, names, angles, nothing, nothing))
        one.write(message("/gripper", kind, stamp_s, ["finger"], np.zeros(1), nothing, nothing))
        kind = "geometry_msgs/msg/PointStamped"
        one.write(message("/arm/ball_position", kind, stamp_s, point(*ball)))
    one.close()
    return folder


def test_a_bag_of_any_arm_calibrates_its_camera(bag):
    data = read_data_set(bag)
    assert len(data) > 800
    assert set(data.joint_names) == {*ARM.names, "finger"}
    found = calibrate(data, ARM)
    assert found.camera == "camera"
    assert np.linalg.norm(found.translation_m - CAMERA.position_m) < 2e-3


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"seen": "/nowhere"}, "0 topics of PointStamped or PoseStamped called /nowhere"),
        ({"joint_states": "/gripper"}, None),
    ],
)
def test_topics_are_chosen_or_named(bag, given, words):
    if words:
        with pytest.raises(ValueError, match=words):
            read_data_set(bag, **given)
    else:
        assert read_data_set(bag, **given).joint_names == ("finger",)


def test_what_is_no_bag_is_refused(tmp_path):
    with pytest.raises(ValueError, match="there is no file or folder"):
        read_data_set(tmp_path / "nothing")
    (tmp_path / "text.mcap").write_text("no bag")
    with pytest.raises(ValueError, match="cannot read"):
        read_data_set(tmp_path / "text.mcap")
