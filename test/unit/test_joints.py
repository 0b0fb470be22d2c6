import numpy as np
import pytest

from fvs_ros.joints import (
    UR_JOINT_NAMES,
    ForeignJointsError,
    JointMap,
    JointStateError,
)


def test_joints_come_out_in_kinematic_order_from_any_order_with_extra_joints():
    rng = np.random.default_rng(1)
    wanted = dict(zip(UR_JOINT_NAMES, range(6), strict=True)) | {"gripper": np.nan}
    joint_map = JointMap()
    for _ in range(20):
        names = list(rng.permutation(list(wanted)))
        positions = joint_map.positions(names, [float(wanted[n]) for n in names])
        np.testing.assert_array_equal(positions, np.arange(6.0))


@pytest.mark.parametrize(
    ("names", "values", "error", "text"),
    [
        (["finger"], [0.0], ForeignJointsError, "none of the wanted"),
        (UR_JOINT_NAMES[:5], [0.0] * 5, JointStateError, "lacks .*wrist_3_joint"),
        ((*UR_JOINT_NAMES, UR_JOINT_NAMES[0]), [0.0] * 7, JointStateError, "shoulder_pan"),
        (UR_JOINT_NAMES, [0.0] * 5, JointStateError, "5 positions for 6 names"),
        (UR_JOINT_NAMES, [0.0] * 5 + [np.nan], JointStateError, "not finite for .*wrist_3"),
        (UR_JOINT_NAMES, [np.inf] + [0.0] * 5, JointStateError, "not finite for .*shoulder_pan"),
    ],
)
def test_what_cannot_be_used_is_refused_in_words(names, values, error, text):
    with pytest.raises(error, match=text):
        JointMap().positions(names, values)


@pytest.mark.parametrize("names", [["a"] * 6, []])
def test_different_names_are_needed(names):
    with pytest.raises(ValueError, match="different names"):
        JointMap(names)
