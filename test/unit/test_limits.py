"""Limits on a command: speed, acceleration, joint range, and coming to rest."""

import numpy as np
import pytest
from cases import each
from hypothesis import given
from hypothesis import strategies as st

from fvs_ros.interface import PositionPath
from fvs_ros.limiter import CommandLimiter
from fvs_ros.limits import (
    UNLIMITED,
    JointLimits,
    braking_speed,
    limit_speed,
    with_urdf_limits,
)
from fvs_ros.params import ParameterError
from fvs_ros.urdf import read_joints

SIX = st.lists(st.floats(-10.0, 10.0), min_size=6, max_size=6).map(np.array)
RANGE = JointLimits(joint_min_rad=(-2.0,) * 6, joint_max_rad=(2.0,) * 6)


@given(velocity=SIX, limit=st.floats(0.01, 4.0))
def test_speed_is_limited_by_scaling_the_whole_vector(velocity, limit):
    got = limit_speed(velocity, limit)
    assert np.abs(got).max() < limit
    norms = np.linalg.norm(got) * np.linalg.norm(velocity)
    assert got @ velocity >= (1 - 1e-9) * norms  # the same direction
    if np.abs(velocity).max() <= 0.9999 * limit:
        np.testing.assert_array_equal(got, velocity)


@given(velocity=SIX, joints=st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6).map(np.array))
def test_only_motion_towards_a_near_limit_is_slowed(velocity, joints):
    got, slowed = CommandLimiter(RANGE).slow_down(velocity, joints, 6.0, 0.008, np.zeros(6))
    for i in range(6):
        room = (2.0 - joints[i]) if velocity[i] > 0.0 else (joints[i] + 2.0)
        assert abs(got[i]) <= abs(velocity[i])
        assert got[i] * velocity[i] >= 0.0
        if i not in slowed:
            assert got[i] == velocity[i]
        if room <= 0.0:
            assert got[i] == 0.0
        if room > 4.0:  # beyond the other end: it may come back at any speed up to 1
            assert abs(got[i]) >= min(abs(velocity[i]), 1.0)


NAMES = ("base", "upper", "lift")


def urdf_of(*joints):
    """The joints of a URDF: of each its name, its type, and what stands in it."""
    text = "".join(
        f"<joint name='{name}' type='{kind}'><parent link='{i}'/><child link='{i + 1}'/>{inside}"
        "</joint>"
        for i, (name, kind, inside) in enumerate(joints)
    )
    return read_joints(f"<robot>{text}</robot>")


URDF = urdf_of(
    ("base", "continuous", "<limit velocity='2'/>"),
    ("upper", "revolute", "<limit lower='-1' upper='0.5' velocity='0.5'/>"),
    ("lift", "prismatic", "<limit lower='0' upper='0.3' velocity='0.1'/>"),
    ("fixed", "fixed", ""),
)


def described_limits(**changes):
    values = JointLimits(joint_names=NAMES, **changes)
    return JointLimits.from_values(with_urdf_limits(vars(values), URDF))


def test_limits_that_are_not_given_are_those_of_the_urdf():
    limits = described_limits()
    np.testing.assert_array_equal(limits.lower_rad, [-UNLIMITED, -1.0, 0.0])
    np.testing.assert_array_equal(limits.upper_rad, [UNLIMITED, 0.5, 0.3])
    np.testing.assert_allclose(limits.share, [1.0, 0.5, 0.1])
    assert limits.ranges_known
    own = described_limits(joint_max_rad=(1.0, 1.0, 1.0), joint_velocity_limits_rad_s=(9, 9, 9))
    np.testing.assert_array_equal(own.lower_rad, limits.lower_rad)
    np.testing.assert_array_equal(own.upper_rad, 1.0)
    np.testing.assert_array_equal(own.share, [1.0, 1.0, 0.5])  # the lift's range is 1 m


@each(
    ("changes", "words"),
    [
        ({"joint_min_rad": (0.6, 0.6, 0.1)}, "below that of joint_max_rad"),
        ({"joint_min_rad": (0.0,)}, "needs 3 numbers"),
        ({"joint_velocity_limits_rad_s": (1.0, 0.0, 1.0)}, "from 0.001"),
        ({"max_joint_jerk_rad_s3": 59.0}, "at least 60, 10 times max_joint_acceleration"),
    ],
)
def test_limits_that_contradict_each_other_are_refused(changes, words):
    with pytest.raises(ParameterError, match=words):
        described_limits(**changes)


def test_slower_joints_are_limited_in_proportion():
    limits = described_limits()
    velocity = np.array([1.0, 1.0, 0.05])
    np.testing.assert_allclose(limit_speed(velocity, 1.0, limits.share), 0.5 * velocity, 1e-3)
    limiter = CommandLimiter(limits)
    limiter.velocity_rad_s = limits.share
    np.testing.assert_allclose(limiter.rest(None, 0.01, np.zeros(3)), 0.94 * limits.share, 1e-3)
    # Within half of its margin, which is a tenth of the others', the lift is at half of its speed.
    joints = np.array([0.0, 0.0, 0.3 - 0.5 * 0.1 * 0.2])
    assert limits.near_end(joints)
    got, slowed = limiter.slow_down(np.array([0.0, 0.0, 0.1]), joints, 6.0, 0.008, np.zeros(3))
    assert slowed == [2]
    assert got[2] == pytest.approx(0.05)


def test_positions_follow_velocities_and_never_run_away_from_joints_that_do_not():
    limits, path, joints = described_limits(), PositionPath(), np.array([0.3, -0.2, 0.1])
    velocity = np.array([1.0, -0.5, 0.0])
    position = path.advance(velocity, joints, 0.01, limits)
    np.testing.assert_allclose(position, joints + 0.01 * velocity)
    for _ in range(100):
        position = path.advance(velocity, joints, 0.01, limits)
    np.testing.assert_allclose(position - joints, 0.2 * velocity)
    # Joints that jump away, or a lower limit, pull it back in steps of full speed.
    assert path.follow(0.0 * velocity, joints, 0.01, limits, active=False) is None
    path.advance(0.0 * velocity, joints, 0.01, limits)
    back = path.advance(velocity, joints - 1.0, 0.01, limits)
    np.testing.assert_allclose(back - joints, [-0.01, -0.005, -0.001])


def test_with_a_jerk_limit_braking_takes_the_travel_of_an_s_curve():
    acceleration, jerk = 6.0, 100.0
    for speed in (0.05, 0.5, 2.0):
        full = acceleration**2 / jerk
        travel = speed**1.5 / jerk**0.5
        if speed > full:
            travel = speed**2 / (2.0 * acceleration) + 0.5 * speed * acceleration / jerk
        assert braking_speed(travel, acceleration, 0.0, jerk) == pytest.approx(speed)
        assert braking_speed(travel, acceleration, 0.008, jerk) < speed


FR3 = urdf_of(
    *(
        (
            f"fr3_joint{i}",
            "revolute",
            f"<limit lower='-{end}' upper='{end}' velocity='{fast}'/>"
            f"<position_based_velocity_limits velocity_offset='{offset}' "
            f"deceleration_limit='{brakes}'/>",
        )
        for i, (end, fast, offset, brakes) in enumerate(
            [(2.7501, 2.62, 0.3, 6.0), (1.7918, 2.62, 0.2, 2.585), (2.8101, 5.26, 0.35, 17.0)], 1
        )
    )
)


@each("most", [2.0, 9.9])
@each("side", [-1.0, 1.0])
def test_near_its_end_a_joint_is_as_fast_as_its_driver_allows_there(side, most):
    values = JointLimits(
        joint_names=tuple(FR3),
        max_joint_velocity_rad_s=2.5,
        max_joint_acceleration_rad_s2=most,
        max_joint_jerk_rad_s3=4000.0,
        joint_limit_margin_rad=0.35,
    )
    limits = JointLimits.from_values(with_urdf_limits(vars(values), FR3))
    offset, allowed = np.array([(0.3, 6.0), (0.2, 2.585), (0.35, 17.0)]).T
    dt_s, q, limiter = 0.001, np.zeros(3), CommandLimiter(limits)
    for _ in range(4000):
        limiter.move(np.full(3, side * 2.5), q, dt_s, np.zeros(3))
        v = limiter.velocity_rad_s
        room = limits.upper_rad - np.abs(q)
        assert np.all(np.abs(v) <= np.maximum(0.0, np.sqrt(2.0 * allowed * room) - offset) + 1e-3)
        q = q + dt_s * v
    assert np.all(limits.upper_rad - np.abs(q) < 0.05)
