"""What a law is shown of the near future, and that it is never faster than it can brake for it."""

import numpy as np
import pytest

from fvs_controller_node.base import ControlInput, ControlOutput
from fvs_controller_node.drive_lag import BRAKING_SHARE, brake, braking_speed_within

DT_S, MOST_RAD_S2 = 0.008, 6.0
JACOBIAN = np.diag([0.5, 0.8, 1.0]) @ np.eye(3, 6)


def given(error_m, joints_rad=None):
    joints = np.zeros(6) if joints_rad is None else joints_rad
    return ControlInput(np.asarray(error_m), JACOBIAN, np.zeros(6), joints, DT_S)


def wanted(velocity_rad_s):
    return ControlOutput(np.asarray(velocity_rad_s), np.zeros(3), np.ones(3))


@pytest.mark.parametrize("direction", [[1.0, 0.0, 0.0], [0.6, -0.5, 0.4]])
def test_a_law_that_never_slows_down_arrives_within_the_limit_and_does_not_pass(direction):
    error = 0.3 * np.array(direction) / np.linalg.norm(direction)
    speeds, ahead = [], []
    for _ in range(250):
        course = -np.linalg.pinv(JACOBIAN) @ error
        output = brake(wanted(course / np.abs(course).max()), given(error), MOST_RAD_S2)
        speeds.append(np.abs(output.velocity_rad_s).max())
        error = error + JACOBIAN @ output.velocity_rad_s * DT_S
        ahead.append(error @ direction)
    assert min(ahead) > -1e-9
    assert np.linalg.norm(error) < 1e-4
    slowing = -np.diff(speeds).min() / DT_S
    assert 0.8 * MOST_RAD_S2 < slowing < MOST_RAD_S2
    assert max(speeds) == pytest.approx(1.0)


def test_a_slow_command_and_one_that_leads_away_are_left_alone():
    slow = np.array([-0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    away = np.array([0.9, 0.0, 0.0, 0.0, 0.0, 0.0])
    for velocity in (slow, away):
        output = brake(wanted(velocity), given([0.3, 0.0, 0.0]), MOST_RAD_S2)
        np.testing.assert_array_equal(output.velocity_rad_s, velocity)


def test_the_speed_is_the_one_that_the_travel_left_allows():
    output = brake(wanted([-1.0, 0.0, 0.0, 0.0, 0.0, 0.0]), given([0.01, 0.0, 0.0]), MOST_RAD_S2)
    # The error of 0.01 m at 0.5 m/rad leaves 0.02 rad.
    most = braking_speed_within(0.02, BRAKING_SHARE * MOST_RAD_S2, DT_S)
    np.testing.assert_allclose(output.velocity_rad_s, [-most, 0, 0, 0, 0, 0])
    assert most < 1.0
