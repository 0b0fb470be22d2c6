import numpy as np
import pytest

from fvs_ros.joints import UR_JOINT_NAMES, ForeignJointsError, JointMap, JointStateError


def test_joints_come_out_in_kinematic_order_from_any_order_with_extra_joints():
    names = [*np.random.default_rng(1).permutation(UR_JOINT_NAMES), "gripper"]
    values = [
        float(UR_JOINT_NAMES.index(one)) if one in UR_JOINT_NAMES else np.nan for one in names
    ]
    np.testing.assert_array_equal(JointMap().positions(names, values), np.arange(6.0))


@pytest.mark.parametrize(
    ("names", "values", "error", "text"),
    [
        (["finger"], [0.0], ForeignJointsError, "none of the wanted"),
        (UR_JOINT_NAMES[:5], [0.0] * 5, JointStateError, "lacks .*wrist_3_joint"),
        ((*UR_JOINT_NAMES, UR_JOINT_NAMES[0]), [0.0] * 7, JointStateError, "shoulder_pan"),
        (UR_JOINT_NAMES, [0.0] * 5, JointStateError, "5 positions for 6 names"),
        (UR_JOINT_NAMES, [0.0] * 5 + [np.nan], JointStateError, "not finite for .*wrist_3"),
    ],
)
def test_what_cannot_be_used_is_refused_in_words(names, values, error, text):
    with pytest.raises(error, match=text):
        JointMap().positions(names, values)
