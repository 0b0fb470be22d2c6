"""The law that arrives: which of the joints that put the ball on the target it goes to."""

from __future__ import annotations

import numpy as np
import pytest
from recordings import ur5_chain
from ur5_dh import HOME_RAD

from fvs_controller_node.base import Change, ControlInput
from fvs_controller_node.minimum_time import MinimumTimeLaw

DT_S = 0.008
CHAIN = ur5_chain()


def away_from_home():
    """Joints off the posture that have the ball where the posture has it, rad, (6,)."""
    joints = HOME_RAD + np.array([0.0, 0.2, -0.3, 0.2, 0.4, 0.0])
    for _ in range(50):
        missing = CHAIN.position(HOME_RAD) - CHAIN.position(joints)
        joints = joints + np.linalg.pinv(CHAIN.jacobian(joints)) @ missing
    assert np.abs(joints - HOME_RAD).max() > 0.2
    return joints


class Following:
    """The law, and drives that do as they are told; the model is exact."""

    def __init__(self, joints):
        self.law, self.joints = MinimumTimeLaw(), joints
        self.target, self.change = CHAIN.position(joints), Change.TARGET
        self.run(20)

    def run(self, ticks, feed_forward_rad_s=None):
        for k in range(ticks):
            if k % 4 == 0 and self.change is Change.NOTHING:
                self.change = Change.MEASUREMENT
            told = ControlInput(
                error_m=CHAIN.position(self.joints) - self.target,
                jacobian=CHAIN.jacobian(self.joints),
                applied_rad_s=np.zeros(6),
                joints_rad=self.joints,
                dt_s=DT_S,
                chain=CHAIN,
                home_rad=HOME_RAD,
                feed_forward_rad_s=feed_forward_rad_s,
                change=self.change,
            )
            velocity = self.law.command(told).velocity_rad_s
            if feed_forward_rad_s is not None:
                velocity = velocity + feed_forward_rad_s
            self.change = Change.NOTHING
            self.joints = self.joints + DT_S * velocity

    def go(self, way_m):
        self.change = Change.TARGET
        self.target = self.target + way_m
        self.run(60)
        np.testing.assert_allclose(CHAIN.position(self.joints), self.target, atol=2e-4)

    @property
    def away_rad(self):
        return np.linalg.norm(self.joints - HOME_RAD)


@pytest.mark.parametrize("way_m", [0.01, 0.1])
def test_near_and_far_targets_lead_back_to_the_posture_of_the_start(way_m):
    arm = Following(away_from_home())
    before_rad = arm.away_rad
    for _ in range(round(0.4 / way_m)):
        arm.go(np.array([0.0, way_m, 0.0]))
        arm.go(np.array([0.0, -way_m, 0.0]))
    assert arm.away_rad < 0.8 * before_rad


def test_the_goal_goes_along_with_a_moving_target():
    """What leads along is not undone, wherever it takes the joints that do not move the ball."""
    arm = Following(away_from_home())
    free = np.linalg.svd(CHAIN.jacobian(arm.joints))[2][3]
    before = arm.joints
    arm.run(25, 0.1 * free)
    np.testing.assert_allclose((arm.joints - before) @ free, 25 * DT_S * 0.1, rtol=0.1)
    arm.run(50)
    np.testing.assert_allclose((arm.joints - before) @ free, 25 * DT_S * 0.1, rtol=0.1)
