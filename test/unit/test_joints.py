import numpy as np
import pytest

from fvs_ros.joints import UR_JOINT_NAMES, ForeignJointsError, JointMap, JointStateError


def test_joints_come_out_in_kinematic_order_from_any_order_with_extra_joints():
    names = [*np.random.default_rng(1).permutation(UR_JOINT_NAMES), "gripper"]
    values = [
        float(UR_JOINT_NAMES.index(name)) if name in UR_JOINT_NAMES else np.nan for name in names
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


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_goes_on_where_the_driver_wraps_it(sign):
    joint_map, times_s = JointMap(["a", "b"]), 1e9 + 0.1 * np.arange(100)
    for time_s in times_s:
        true = np.array([sign * 2.0 * (time_s - times_s[0]), 0.3])  # three turns
        got = joint_map.positions("ab", np.arctan2(np.sin(true), np.cos(true)), time_s)
        np.testing.assert_allclose(got, true, atol=1e-6)
    # Two that publish are no wrap; what may be motion, after a long silence, is.
    wrapped = true[0] - 6 * sign * np.pi
    for count, joint in enumerate((4.0, 0.3), 1):
        with pytest.raises(
            JointStateError, match=r"b jumped by 3\.70 rad \(m\) in 0\.008 s; do two"
        ):
            joint_map.positions("ab", [wrapped, joint], times_s[-1] + 0.008 * count)
    got = joint_map.positions("ab", [wrapped, 5.3], times_s[-1] + 1.1)
    np.testing.assert_allclose(got, [true[0], 5.3])
    # A joint that is held near its wrap meanwhile stays where it is, but not for ever.
    for after_s, joint in ((9.0, 5.2), (39.0, 5.2 - 2 * np.pi)):
        wrapped_b = joint_map.positions("ab", [wrapped, 5.2 - 2 * np.pi], times_s[-1] + after_s)[1]
        assert wrapped_b == pytest.approx(joint)
        joint_map.positions("ab", [wrapped, 5.3], times_s[-1] + after_s + 1.0)


def test_positions_begin_within_half_a_turn_of_what_is_expected():
    joint_map = JointMap(["a", "b"])
    joint_map.middle_rad = np.array([3.2, -0.1])
    np.testing.assert_allclose(joint_map.positions("ab", [-3.0, 0.2], 1.0), [2 * np.pi - 3.0, 0.2])
    np.testing.assert_array_equal(JointMap(["a"]).positions("a", [-3.0], 1.0), [-3.0])
