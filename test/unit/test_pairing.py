import numpy as np
import pytest

from fvs_estimator_node.loop import StepPairing

VELOCITY = np.array([0.3, -0.2, 0.1, 0.4, 0.0, 0.05])
JACOBIAN = np.arange(18.0).reshape(3, 6) / 10.0


def joints_at(t):
    return VELOCITY * t


def ball_at(t):
    return JACOBIAN @ joints_at(t)


def feed(pairing, start, stop, camera_hz=30.0, joint_hz=125.0, late_s=0.0):
    """Joint states and ball positions in the order in which they would arrive."""
    events = [(t, 0, t) for t in np.arange(start, stop, 1.0 / joint_hz)]
    events += [(t + late_s, 1, t) for t in np.arange(start, stop, 1.0 / camera_hz)]
    steps = []
    for _, kind, t in sorted(events):
        if kind == 0:
            steps += pairing.add_joints(t, joints_at(t))
        else:
            steps += pairing.add_ball(t, ball_at(t))
    return steps


@pytest.mark.parametrize("late_s", [0.0, 0.2])
def test_ball_and_joint_motion_belong_to_the_same_exposures(late_s):
    steps = feed(StepPairing(), 0.0, 2.0, late_s=late_s)
    assert len(steps) > 40
    for step in steps:
        np.testing.assert_allclose(step.d_ball_m, JACOBIAN @ step.d_joints_rad, atol=1e-12)
        np.testing.assert_allclose(step.joint_velocity, VELOCITY, atol=1e-9)
        np.testing.assert_allclose(step.ball_velocity, JACOBIAN @ VELOCITY, atol=1e-9)
        middle = joints_at(step.stamp_s - step.dt_s / 2)
        np.testing.assert_allclose(step.joints_rad, middle, atol=1e-12)


def test_a_still_arm_makes_no_steps_and_the_anchor_moves_on():
    pairing = StepPairing()
    for t in np.arange(0.0, 3.0, 0.01):
        assert pairing.add_joints(t, np.zeros(6)) == []
        assert pairing.add_ball(t, np.array([0.0, 0.0, 1.0 + 1e-3 * np.sin(99 * t)])) == []
    steps = []
    for t in np.arange(3.0, 3.3, 0.01):
        steps += pairing.add_joints(t, joints_at(t - 3.0))
        steps += pairing.add_ball(t, ball_at(t - 3.0))
    assert steps
    assert all(s.dt_s <= 0.5 for s in steps)


def test_no_step_across_a_lost_ball_a_gap_of_the_joint_states_or_their_jump():
    pairing, steps = StepPairing(), []
    for k in range(500):
        t = 0.01 * k
        if not 160 <= k < 190:
            steps += pairing.add_joints(t, joints_at(t) + (k >= 300))
        if k % 3 == 0 and not 60 <= k < 100:
            steps += pairing.add_ball(t, ball_at(t))
    assert len(steps) > 50
    assert pairing.timeline.dropped > 0
    for start_s, end_s in ((0.61, 0.99), (1.6, 1.89), (2.99, 3.0)):
        assert not [s for s in steps if s.start_stamp_s < start_s and s.stamp_s > end_s]
    for step in steps:
        np.testing.assert_allclose(step.joint_velocity, VELOCITY, atol=1e-9)


def test_frozen_stamps_never_make_a_step():
    pairing = StepPairing()
    steps = []
    for t in np.arange(0.0, 2.0, 0.02):
        steps += pairing.add_joints(t, joints_at(t))
        steps += pairing.add_ball(0.5, ball_at(t))
    assert steps == []


@pytest.mark.parametrize("jump_s", [-100.0, 100.0])
def test_no_step_across_a_clock_jump_and_recovery_after_it(jump_s):
    pairing = StepPairing()
    feed(pairing, 200.0, 201.0)
    steps = []
    for t in np.arange(0.0, 1.0, 0.01):
        stamp = 201.0 + jump_s + t
        steps += pairing.add_joints(stamp, joints_at(t))
        steps += pairing.add_ball(stamp, ball_at(t))
    assert len(steps) > 20
    assert all(s.dt_s <= 0.5 and s.start_stamp_s >= 201.0 + jump_s for s in steps)


def test_not_finite_input_makes_no_step():
    pairing = StepPairing()
    feed(pairing, 0.0, 0.5)
    assert pairing.add_ball(0.51, np.array([np.nan, 0.0, 1.0])) == []
    assert pairing.add_joints(0.52, np.full(6, np.inf)) == []
    assert pairing.add_ball(np.nan, ball_at(0.5)) == []
    steps = feed(pairing, 0.53, 1.0)
    assert steps
    assert all(np.all(np.isfinite(s.d_joints_rad)) for s in steps)


def test_a_fresh_sliding_variable_goes_into_steps_and_a_stale_one_does_not():
    pairing = StepPairing()
    pairing.add_sliding_variable(0.0, np.array([1.0, 2.0, 3.0]))
    steps = feed(pairing, 0.0, 1.0)
    np.testing.assert_array_equal(steps[0].sliding_variable, [1.0, 2.0, 3.0])
    assert np.all(steps[-1].sliding_variable == 0.0)


@pytest.mark.parametrize("behind_s", [0.6, 3600.0])
def test_images_of_a_clock_that_is_behind_make_no_step_and_it_says_so(behind_s):
    pairing = StepPairing()
    steps = []
    for k in range(500):
        t = 100.0 + 0.008 * k
        steps += pairing.add_joints(t, joints_at(t))
        if k % 4 == 0:
            steps += pairing.add_ball(t - behind_s, ball_at(t))
    assert steps == []
    assert pairing.timeline.dropped > 100
    assert "clocks agree" in pairing.timeline.last_reason
