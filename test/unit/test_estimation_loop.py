"""What an estimator learns from: steps of one continuous run, without outliers, of right stamps."""

import numpy as np
from cases import each

from fvs_estimator_node.base import Estimator
from fvs_estimator_node.loop import EstimationLoop

JACOBIAN = np.random.default_rng(0).normal(0.0, 0.3, (3, 6))
IMAGE_S, STATE_S = 1.0 / 30.0, 0.008
AWAY_M = np.array([0.0, 0.1, 0.05])
VELOCITY = np.array([0.3, -0.2, 0.1, 0.4, 0.0, 0.05])
LEGS = np.cumsum(np.random.default_rng(2).normal(0.0, 0.2, (30, 6)), axis=0)


def along_legs(time_s):
    """From place to place, with a rest at each."""
    leg = int(time_s // 1.2)
    share = min(1.0, (time_s % 1.2) / 0.6)
    share *= share * (3.0 - 2.0 * share)
    return LEGS[leg] + share * (LEGS[leg + 1] - LEGS[leg])


def steadily(time_s):
    return VELOCITY * time_s


class Recorder(Estimator):
    """Knows the Jacobian, and notes what it learns from."""

    problem = ""

    def __init__(self):
        super().__init__()
        self.balls, self.steps = [], []

    def jacobian(self, joints_rad, z=None):
        return JACOBIAN

    def observe(self, image, noise_m):
        self.balls.append(image.z - JACOBIAN @ image.joints_rad)

    def update(self, step):
        self.steps.append(step)


def play(
    loop, start_s, end_s, path=along_legs, off=lambda t: 0.0, late_s=0.0,
    joint_stamp=lambda t: t, image_stamp=lambda t: t, joints_come=lambda t: True,
):  # fmt: skip
    """Joint states and images in the order in which they arrive, and the steps from them."""
    known = len(loop.estimator.steps)
    events = [(t, False, t) for t in np.arange(start_s, end_s, STATE_S) if joints_come(t)]
    images_s = IMAGE_S * np.arange(np.ceil(start_s / IMAGE_S), end_s / IMAGE_S)
    events += [(t + late_s, True, t) for t in images_s]
    for _, is_image, time_s in sorted(events):
        joints = path(time_s)
        if is_image:
            loop.add_image(image_stamp(time_s), JACOBIAN @ joints + off(time_s))
        else:
            loop.add_joints(joint_stamp(time_s), joints)
            if path is along_legs:
                loop.jacobian(joints)
    return loop.estimator.steps[known:]


# ---- outliers ------------------------------------------------------------------------------


def test_a_camera_that_was_moved_is_learned_from_its_first_image_on():
    loop = EstimationLoop(Recorder())
    steps = play(loop, 0.0, 4.0, off=lambda time_s: AWAY_M * (time_s > 2.0))
    off_m = np.linalg.norm(loop.estimator.balls, axis=1)
    moved = np.arange(off_m.size) * IMAGE_S > 2.0
    np.testing.assert_allclose(off_m, np.linalg.norm(AWAY_M) * moved, atol=2e-3)
    # No step spans the jump, which no joint made.
    assert len(steps) > 40
    for step in steps:
        np.testing.assert_allclose(step.d_feature_m, JACOBIAN @ step.d_joints_rad, atol=1e-4)


def test_a_gap_makes_no_outlier_true():
    loop = EstimationLoop(Recorder())
    play(loop, 0.0, 2.0)
    known = len(loop.estimator.balls)
    play(loop, 3.0, 4.0, off=lambda time_s: AWAY_M * (time_s < 3.01))
    away = np.array(loop.estimator.balls[known:]) @ AWAY_M > 0.5 * AWAY_M @ AWAY_M
    assert away.size > 20
    assert not away.any()


# ---- steps ---------------------------------------------------------------------------------


@each("late_s", [0.0, 0.2])
def test_ball_and_joint_motion_belong_to_the_same_exposures(late_s):
    loop = EstimationLoop(Recorder())
    loop.add_sliding_variable(0.0, np.array([1.0, 2.0, 3.0]))
    steps = play(loop, 0.0, 2.0, steadily, late_s=late_s)
    assert len(steps) > 40
    for step in steps:
        np.testing.assert_allclose(step.d_feature_m, JACOBIAN @ step.d_joints_rad, atol=1e-12)
        np.testing.assert_allclose(step.d_joints_rad / step.dt_s, VELOCITY, atol=1e-9)
        middle = VELOCITY * (step.stamp_s - step.dt_s / 2)
        np.testing.assert_allclose(step.joints_rad, middle, atol=1e-12)
    # A sliding variable that is fresh goes into steps.
    np.testing.assert_array_equal(steps[0].sliding_variable, [1.0, 2.0, 3.0])
    assert not steps[-1].sliding_variable


def test_no_step_across_a_rest_a_gap_a_jump_of_the_joints_or_of_the_clock():
    loop = EstimationLoop(Recorder())
    play(loop, 0.0, 1.0, steadily)
    for t in np.arange(1.0, 3.0, STATE_S):
        loop.add_joints(t, VELOCITY)

    def earlier(time_s):
        return time_s - 100.0

    steps = play(loop, 3.0, 5.0, steadily, joints_come=lambda t: not 3.6 < t < 3.9)
    steps += play(loop, 5.0, 6.0, steadily, joint_stamp=earlier, image_stamp=earlier)
    assert len(steps) > 50
    assert not [s for s in steps if s.stamp_s - s.dt_s < 3.61 and s.stamp_s > 3.89]
    for step in steps:
        assert 0.0 < step.dt_s <= 0.5
        np.testing.assert_allclose(step.d_joints_rad / step.dt_s, VELOCITY, atol=1e-9)


@each(
    ("stamp", "words"),
    [
        (lambda t: t - 0.6, "clocks agree"),
        (lambda t: t - 3600.0, "clocks agree"),
        (lambda _: 0.5, "repeated"),
    ],
)
def test_images_of_a_clock_that_is_behind_or_stands_make_no_step_and_it_says_so(stamp, words):
    loop = EstimationLoop(Recorder())
    assert play(loop, 0.0, 4.0, steadily, image_stamp=stamp) == []
    assert loop.tracks[0].timeline.dropped > 100
    assert words in loop.tracks[0].timeline.last_reason
