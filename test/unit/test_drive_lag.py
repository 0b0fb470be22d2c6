"""The drives' lag, found from commands and joint positions."""

from __future__ import annotations

import numpy as np
import pytest

from fvs_controller_node.anticipation import braking_speed_within
from fvs_controller_node.drive_lag import DriveLag

DT_S = 0.008


def run(lag, delay_ticks, time_constant_s, seconds=6.0, slider=1.0, compare=True):
    """Let drives with dead time and a first-order lag follow moves to and fro."""
    rng = np.random.default_rng(1)
    joints, speed = np.zeros(6), np.zeros(6)
    waiting = [np.zeros(6)] * (delay_ticks + 1)
    command = np.zeros(6)
    share = 1.0 - np.exp(-DT_S / time_constant_s) if time_constant_s else 1.0
    for tick in range(round(seconds / DT_S)):
        if tick % 60 == 0:
            goal = rng.uniform(-1.0, 1.0, 6)
        waiting.append(command)
        speed = speed + share * (slider * waiting.pop(0) - speed)
        joints = joints + DT_S * speed
        lag.add(tick * DT_S, command, joints, compare=compare)
        command = command + np.clip(goal - command, -0.05, 0.05)
    return lag


@pytest.mark.parametrize(
    ("delay_ticks", "time_constant_s"), [(0, 0.0), (2, 0.0), (1, 0.02), (4, 0.05)]
)
def test_dead_time_and_lag_are_found_together(delay_ticks, time_constant_s):
    found = run(DriveLag(), delay_ticks, time_constant_s).lag_s
    # what was commanded at a tick moves the joints from the next one on
    wanted = DT_S * delay_ticks + time_constant_s
    assert found == pytest.approx(wanted, abs=0.012)


def test_before_any_motion_and_where_it_must_not_compare_it_keeps_the_first_guess():
    assert DriveLag(0.03).lag_s == pytest.approx(0.03)
    assert run(DriveLag(0.03), 1, 0.0, slider=0.3, compare=False).lag_s == pytest.approx(0.03)


@pytest.mark.parametrize("share", [0.0, 3.0], ids=["stalled", "pushed along"])
def test_an_arm_that_does_not_do_what_it_is_told_is_hardly_taken_for_a_lag(share):
    """One moment counts at most like the slowest drive and at least like one without a lag."""
    lag = run(DriveLag(), 2, 0.0)
    found_s, joints = lag.lag_s, np.zeros(6)
    lag.restart()
    for tick in range(250):
        command = np.full(6, 1.0 if tick % 125 < 63 else 0.3)
        joints = joints + share * command * DT_S
        lag.add(6.0 + tick * DT_S, command, joints)
    lag.restart()
    assert run(lag, 2, 0.0).lag_s == pytest.approx(found_s, abs=0.025)


def test_what_is_pending_is_what_was_told_within_the_lag():
    lag = DriveLag(0.02)
    for tick, speed in enumerate((0.0, 1.0, 2.0, 3.0)):
        lag.add(tick * DT_S, np.full(6, speed), np.zeros(6), compare=False)
    np.testing.assert_allclose(
        lag.pending_rad(), 3.0 * DT_S + 2.0 * DT_S + 1.0 * (lag.lag_s - 2 * DT_S)
    )
    lag.restart()
    assert not lag.pending_rad().any()


def test_one_can_brake_from_the_braking_speed_tick_by_tick():
    for travel in (1e-4, 1e-2, 0.3):
        speed = braking_speed_within(travel, 5.0, DT_S)
        way = 0.0
        while speed > 0.0:
            way += speed * DT_S
            speed -= 5.0 * DT_S
        assert way <= travel * (1.0 + 1e-9)
