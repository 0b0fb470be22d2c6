"""Limits on a command: speed, acceleration, joint range, and coming to rest."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fvs_ros.limits import (
    JointLimits,
    braking_speed,
    limit_acceleration,
    limit_speed,
    ramp_to_zero,
)

SIX = st.lists(st.floats(-10.0, 10.0), min_size=6, max_size=6).map(np.array)
RANGE = JointLimits(joint_min_rad=(-2.0,) * 6, joint_max_rad=(2.0,) * 6)


def parallel(a: np.ndarray, b: np.ndarray) -> bool:
    return abs(a @ b) >= (1 - 1e-9) * np.linalg.norm(a) * np.linalg.norm(b)


@given(velocity=SIX, limit=st.floats(0.01, 4.0))
def test_speed_is_limited_by_scaling_the_whole_vector(velocity, limit):
    got = limit_speed(velocity, limit)
    assert np.abs(got).max() <= limit
    assert parallel(got, velocity)
    if np.abs(velocity).max() <= limit:
        np.testing.assert_array_equal(got, velocity)


@given(velocity=SIX, last=SIX, step=st.floats(0.0, 2.0))
def test_no_joint_ever_steps_further_than_allowed(velocity, last, step):
    got = limit_acceleration(velocity, last, step)
    assert np.all(np.abs(got - last) <= step + 1e-12)
    # Never away from what was wanted.
    assert np.all(np.abs(got - velocity) <= np.abs(last - velocity) + step + 1e-12)


@given(last=SIX, step=st.floats(0.01, 2.0))
def test_the_ramp_keeps_its_direction_and_ends_at_exactly_zero(last, step):
    velocity = last
    for _ in range(int(np.abs(last).max() / step) + 2):
        after = ramp_to_zero(velocity, step)
        assert np.all(np.abs(after - velocity) <= step + 1e-12)
        assert parallel(after, last)
        velocity = after
    np.testing.assert_array_equal(velocity, np.zeros(6))


@given(velocity=SIX, joints=st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6).map(np.array))
def test_only_motion_towards_a_near_limit_is_slowed(velocity, joints):
    got, slowed = RANGE.slow_down(velocity, joints, 6.0, 0.008, np.zeros(6))
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


def test_one_can_brake_from_the_braking_speed_tick_by_tick():
    for travel in (1e-4, 1e-2, 0.3):
        speed, way = braking_speed(travel, 6.0, 0.008), 0.0
        while speed > 0.0:
            way += speed * 0.008
            speed -= 6.0 * 0.008
        assert way <= travel
