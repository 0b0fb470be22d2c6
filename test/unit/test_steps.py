"""Steps: ball and joint motion between the same two exposures, of one continuous run."""

import numpy as np
from cases import each

from fvs_estimator_node.steps import StepPairing
from fvs_ros.kinds.ball import Ball
from fvs_ros.track import Track

VELOCITY = np.array([0.3, -0.2, 0.1, 0.4, 0.0, 0.05])
JACOBIAN = np.arange(18.0).reshape(3, 6) / 10.0


def feed(
    pairing, track, start, stop, late_s=0.0, ahead_s=0.0, stamp=lambda t: t, joints=lambda t: True
):
    """Steps of joint states and ball positions in the order in which they arrive."""
    events = [(t, 0, t) for t in np.arange(start, stop, 0.008) if joints(t)]
    events += [(t + late_s, 1, t) for t in np.arange(start, stop, 1.0 / 30.0)]
    steps = []
    for _, kind, t in sorted(events):
        if kind == 0:
            images = track.add_joints(t + ahead_s, VELOCITY * t, None)
        else:
            images = track.add_image(stamp(t), JACOBIAN @ VELOCITY * t)
        steps += [step for step in map(pairing.step, images) if step is not None]
    return steps


@each("late_s", [0.0, 0.2])
def test_ball_and_joint_motion_belong_to_the_same_exposures(late_s):
    steps = feed(StepPairing(), Track(Ball()), 0.0, 2.0, late_s)
    assert len(steps) > 40
    for step in steps:
        np.testing.assert_allclose(step.d_feature_m, JACOBIAN @ step.d_joints_rad, atol=1e-12)
        np.testing.assert_allclose(step.joint_velocity, VELOCITY, atol=1e-9)
        np.testing.assert_allclose(step.feature_velocity, JACOBIAN @ VELOCITY, atol=1e-9)
        middle = VELOCITY * (step.stamp_s - step.dt_s / 2)
        np.testing.assert_allclose(step.joints_rad, middle, atol=1e-12)


def test_no_step_across_a_rest_a_gap_a_jump_of_the_joints_or_of_the_clock():
    pairing, track = StepPairing(), Track(Ball())
    feed(pairing, track, 0.0, 1.0)
    for t in np.arange(1.0, 3.0, 0.008):
        track.add_joints(t, VELOCITY, None)
    steps = feed(pairing, track, 3.0, 5.0, joints=lambda t: not 3.6 < t < 3.9)
    steps += feed(pairing, track, 5.0, 6.0, ahead_s=-100.0, stamp=lambda t: t - 100.0)
    assert len(steps) > 50
    assert not [s for s in steps if s.start_stamp_s < 3.61 and s.stamp_s > 3.89]
    for step in steps:
        assert 0.0 < step.dt_s <= 0.5
        np.testing.assert_allclose(step.joint_velocity, VELOCITY, atol=1e-9)


def test_a_fresh_sliding_variable_goes_into_steps_and_a_stale_one_does_not():
    pairing = StepPairing()
    pairing.add_sliding_variable(0.0, np.array([1.0, 2.0, 3.0]))
    steps = feed(pairing, Track(Ball()), 0.0, 1.0)
    np.testing.assert_array_equal(steps[0].sliding_variable, [1.0, 2.0, 3.0])
    assert np.all(steps[-1].sliding_variable == 0.0)


@each(
    ("stamp", "words"),
    [
        (lambda t: t - 0.6, "clocks agree"),
        (lambda t: t - 3600.0, "clocks agree"),
        (lambda _: 0.5, "repeated"),
    ],
)
def test_images_of_a_clock_that_is_behind_or_stands_make_no_step_and_it_says_so(stamp, words):
    track = Track(Ball())
    assert feed(StepPairing(), track, 0.0, 4.0, stamp=stamp) == []
    assert track.timeline.dropped > 100
    assert words in track.timeline.last_reason
