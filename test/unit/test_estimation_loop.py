"""What an estimator is told: steps of one continuous run, without outliers, of right stamps."""

import numpy as np

from fvs_estimator_node.base import Estimator
from fvs_estimator_node.loop import EstimationLoop

JACOBIAN = np.random.default_rng(0).normal(0.0, 0.3, (3, 6))
IMAGE_S, STATE_S = 1.0 / 30.0, 0.008
AWAY_M = np.array([0.0, 0.1, 0.05])


LEGS = np.cumsum(np.random.default_rng(2).normal(0.0, 0.2, (30, 6)), axis=0)


def joints(time_s):
    """From place to place, with a rest at each."""
    leg = int(time_s // 1.2)
    share = min(1.0, (time_s % 1.2) / 0.6)
    share *= share * (3.0 - 2.0 * share)
    return LEGS[leg] + share * (LEGS[leg + 1] - LEGS[leg])


class Told(Estimator):
    """Knows the Jacobian, and notes what it is told."""

    def __init__(self):
        super().__init__()
        self.why = ""
        self.balls, self.steps, self.resets = [], [], 0

    @property
    def problem(self):
        return self.why

    def jacobian(self, joints_rad, z=None):
        return JACOBIAN

    def observe(self, joints_rad, ball_m, noise_m):
        self.balls.append(ball_m - JACOBIAN @ joints_rad)

    def update(self, step):
        self.steps.append(step)

    def reset(self):
        self.resets += 1


def play(loop, start_s, end_s, off=lambda time_s: 0.0, late_s=0.0):
    """Joint states, and images of which some are off, from a time on."""
    image = int(np.ceil(start_s / IMAGE_S))
    for time_s in np.arange(start_s, end_s, STATE_S):
        loop.add_joints(time_s, joints(time_s))
        loop.jacobian(joints(time_s))
        while image * IMAGE_S + max(late_s, 0.0) < time_s:
            seen_s = image * IMAGE_S
            loop.add_image(seen_s + late_s, JACOBIAN @ joints(seen_s) + off(seen_s))
            image += 1


def test_nothing_learns_from_outliers():
    loop, rng = EstimationLoop(Told()), np.random.default_rng(1)
    play(loop, 0.0, 20.0, lambda _time_s: 0.1 * rng.normal(size=3) * (rng.random() < 0.15))
    off_m = np.linalg.norm(loop.estimator.balls, axis=1)
    assert len(off_m) > 400
    assert np.mean(off_m > 0.02) < 0.01  # two that happen to agree
    assert loop.steps > 50


def test_a_camera_that_was_moved_is_told_from_its_first_image_on():
    loop = EstimationLoop(Told())
    play(loop, 0.0, 4.0, lambda time_s: AWAY_M * (time_s > 2.0))
    off_m = np.linalg.norm(loop.estimator.balls, axis=1)
    moved = np.arange(off_m.size) * IMAGE_S > 2.0
    np.testing.assert_allclose(off_m, np.linalg.norm(AWAY_M) * moved, atol=2e-3)
    # No step spans the jump, which no joint made.
    assert len(loop.estimator.steps) > 40
    for step in loop.estimator.steps:
        np.testing.assert_allclose(step.d_feature_m, JACOBIAN @ step.d_joints_rad, atol=1e-4)


def test_a_gap_makes_no_outlier_true():
    loop = EstimationLoop(Told())
    play(loop, 0.0, 2.0)
    told = len(loop.estimator.balls)
    play(loop, 3.0, 4.0, lambda time_s: AWAY_M * (time_s < 3.01))
    away = np.array(loop.estimator.balls[told:]) @ AWAY_M > 0.5 * AWAY_M @ AWAY_M
    assert away.size > 20
    assert not away.any()
