"""A rosbag2 of any arm becomes a data set."""

import re

import numpy as np
import pytest
from replayed_bags import joint_states, point
from test_calibration import ARM, URDF, collected, errors

from fvs_tools.bag import Bag
from fvs_tools.calibrate import main
from fvs_tools.calibration import calibrate
from fvs_tools.recorded import read_data_set


@pytest.fixture
def bag(tmp_path):
    """Joints in another order, with one more, and a ball; and joints of a gripper."""
    data, bag = collected(seconds=20.0), Bag(tmp_path / "bag", {})
    names = [*ARM.names[::-1], "finger"]
    for stamp_s, joints, ball in zip(data.stamps_s, data.joints_rad, data.z, strict=True):
        at = stamp_s, stamp_s
        angles = np.append(joints[::-1], np.nan)
        bag.write(joint_states(*at, names, angles, topic="arm/joint_states"))
        bag.write(joint_states(*at, ["finger"], [0.0], topic="gripper"))
        bag.write(point("arm/ball_position", *at, ball))
    bag.close()
    return tmp_path / "bag"


def test_a_bag_of_any_arm_calibrates_its_camera(bag):
    data = read_data_set(bag, ARM.names)
    assert len(data) > 500
    assert data.joint_names == ARM.names, "but not the finger's, which are no numbers"
    assert data.feature_frame == "camera"
    assert errors(calibrate(data, ARM))[0] < 2e-3


@pytest.mark.parametrize(
    ("topics", "words"),
    [
        ({"feature": "/nowhere"}, "0 topics of PointStamped or .* called /nowhere"),
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


@pytest.mark.parametrize(
    ("published", "words"),
    [
        (beside_zeros, "jumped by .* do two nodes publish joint states"),
        (in_halves, r"joint_states lacks .* it names"),
        (lambda _, q: [joint_states(1.0, None, ARM.names, q)], "joint_states has no stamp"),
        (lambda t, q: [joint_states(t, t, ARM.names, np.degrees(q))], "no degrees|in degrees"),
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
