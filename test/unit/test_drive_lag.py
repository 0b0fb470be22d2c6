"""The drives' lag, found from commands and joint positions, and braking in time for it."""

import numpy as np
import pytest
from cases import each

from fvs_controller_node.base import ControlInput, ControlOutput
from fvs_controller_node.drive_lag import DriveLag, brake
from fvs_ros.limits import JointLimits

DT_S = 0.008


def run(lag, delay_ticks, time_constant_s, seconds=6.0, gain=1.0):
    """Let drives with dead time and a first-order lag follow moves to and fro."""
    rng = np.random.default_rng(1)
    joints, speed = np.zeros(6), np.zeros(6)
    waiting = [np.zeros(6)] * delay_ticks
    command = np.zeros(6)
    share = 1.0 - np.exp(-DT_S / time_constant_s) if time_constant_s else 1.0
    for tick in range(round(seconds / DT_S)):
        if tick % 60 == 0:
            goal = rng.uniform(-1.0, 1.0, 6)
        waiting.append(gain * command)
        speed = speed + share * (waiting.pop(0) - speed)
        joints = joints + DT_S * speed
        lag.add(tick * DT_S, command, joints, compare=tick > 0)
        command = command + np.clip(goal - command, -0.05, 0.05)
    return lag


@each(
    ("delay_ticks", "time_constant_s"),
    [(1, 0.0), (3, 0.0), (2, 0.02), (5, 0.05), (8, 0.1), (20, 0.0)],
)
def test_dead_time_and_lag_are_found_together(delay_ticks, time_constant_s):
    lag_s = run(DriveLag(), delay_ticks, time_constant_s).lag_s
    wanted = DT_S * delay_ticks + time_constant_s
    # A joint that lags is behind by less than its time constant while it speeds up and brakes.
    assert 0.7 * wanted < lag_s < 1.05 * wanted


def test_a_lag_that_grows_is_followed_within_twenty_seconds():
    lag = run(DriveLag(), 1, 0.02, 60.0)
    assert run(lag, 1, 0.1, 20.0).lag_s > 2.0 * 0.02 + 0.015


def test_an_arm_that_is_stuck_lags_by_no_more_than_drives_do():
    lag = DriveLag()
    for tick in range(750):
        lag.add(DT_S * tick, np.full(6, 0.5), np.zeros(6), compare=tick > 0)
    assert 0.1 < lag.lag_s < 0.2


LIMITS = JointLimits()
MOST_RAD_S2 = LIMITS.max_joint_acceleration_rad_s2
JACOBIAN = np.diag([0.5, 0.8, 1.0]) @ np.eye(3, 6)


@each("direction", [[1.0, 0.0, 0.0], [0.6, -0.5, 0.4]])
def test_a_law_that_never_slows_down_arrives_within_the_limit_and_does_not_pass(direction):
    error = 0.3 * np.array(direction) / np.linalg.norm(direction)
    speeds, ahead = [], []
    for _ in range(250):
        course = -np.linalg.pinv(JACOBIAN) @ error
        wanted = ControlOutput.plain(course / np.abs(course).max(), 3)
        state = ControlInput(error, JACOBIAN, np.zeros(6), np.zeros(6), DT_S)
        output = brake(wanted, state, LIMITS)
        speeds.append(np.abs(output.velocity_rad_s).max())
        error = error + JACOBIAN @ output.velocity_rad_s * DT_S
        ahead.append(error @ direction)
    assert min(ahead) > -1e-9
    assert np.linalg.norm(error) < 1e-4
    slowing = -np.diff(speeds).min() / DT_S
    assert 0.8 * MOST_RAD_S2 < slowing < MOST_RAD_S2
    assert max(speeds) == pytest.approx(1.0)
