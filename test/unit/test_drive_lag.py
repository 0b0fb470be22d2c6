"""The drives' lag, found from commands and joint positions."""

from __future__ import annotations

import numpy as np
import pytest

from fvs_controller_node.drive_lag import DriveLag, braking_speed_within
from fvs_sim_node.config import SimConfig

DT_S = 0.008


def run(lag, delay_ticks, time_constant_s, seconds=6.0, *, begin_s=0.0, fastest=1.0, compare=True):
    """Let drives with dead time and a first-order lag follow moves to and fro."""
    rng = np.random.default_rng(1)
    joints, speed = np.zeros(6), np.zeros(6)
    waiting = [np.zeros(6)] * delay_ticks
    command = np.zeros(6)
    share = 1.0 - np.exp(-DT_S / time_constant_s) if time_constant_s else 1.0
    for tick in range(round(seconds / DT_S)):
        if tick % 60 == 0:
            goal = rng.uniform(-fastest, fastest, 6)
        waiting.append(command)
        speed = speed + share * (waiting.pop(0) - speed)
        joints = joints + DT_S * speed
        # where it begins, joints may have been moved by something else
        lag.add(begin_s + tick * DT_S, command, joints, compare=compare and tick > 0)
        command = command + np.clip(goal - command, -0.05, 0.05)
    return lag


@pytest.mark.parametrize(
    ("delay_ticks", "time_constant_s"),
    [(1, 0.0), (3, 0.0), (2, 0.02), (5, 0.05), (8, 0.1), (20, 0.0)],
)
def test_dead_time_and_lag_are_found_together(delay_ticks, time_constant_s):
    found = run(DriveLag(), delay_ticks, time_constant_s).lag_s
    wanted = DT_S * delay_ticks + time_constant_s
    # A joint that lags is behind by less than its time constant while it speeds up and brakes.
    assert 0.7 * wanted < found < 1.05 * wanted


def test_noise_of_encoders_is_averaged_where_the_arm_rests_and_hides_no_motion():
    """Noise averaged with weight k, 0.05 at rest, has k / (2 - k) of its variance."""
    rng, lag = np.random.default_rng(3), DriveLag()
    told = np.outer(5e-3 * (-1.0) ** np.arange(2500), np.ones(6))  # as it trembles at rest
    told[1250:1500] = 0.5  # rad/s, for two seconds
    true = DT_S * np.cumsum(told, axis=0)
    seen = np.array(
        [
            lag.add(tick * DT_S, command, joints + rng.normal(0.0, 2e-4, 6))
            for tick, (command, joints) in enumerate(zip(told, true, strict=True))
        ]
    )
    assert np.std((seen - true)[500:1250]) < 1.2 * 2e-4 * np.sqrt(0.05 / 1.95)
    assert np.abs(seen[1260:1500] - true[1260:1500]).max() < 5 * 2e-4
    assert np.abs(seen[1600:] - true[1600:]).max() < 5e-4


def test_no_slow_motion_is_told_late_and_what_moves_a_joint_at_rest_in_half_a_second():
    """Even where the drives answer at once, sooner than was supposed."""
    lag, told = DriveLag(), np.zeros((300, 6))
    told[100:160] = 0.05
    true = DT_S * np.cumsum(told, axis=0)
    true[200:] += 1e-3
    seen = np.array([lag.add(k * DT_S, told[k], true[k]) for k in range(300)])
    assert np.abs(seen - true)[:200].max() < 0.5 * 0.05 * DT_S
    assert np.abs(seen - true)[262:].max() < 0.1 * 1e-3


def test_before_any_motion_and_where_it_must_not_compare_it_takes_the_drives_for_a_urs():
    drive = SimConfig()
    usual_s = 0.5 / drive.joint_state_rate_hz + drive.dead_time_s + drive.lag_s
    assert DriveLag().lag_s == pytest.approx(usual_s, abs=0.01)
    assert run(DriveLag(), 10, 0.0, compare=False).lag_s == DriveLag().lag_s


def test_commands_too_small_to_move_an_arm_teach_nothing():
    lag = DriveLag()
    for tick in range(round(60.0 / DT_S)):
        command = 4e-3 * np.sin(np.pi * (tick * DT_S + np.arange(6) / 3.0))
        lag.add(tick * DT_S, command, np.zeros(6))
    assert lag.lag_s == pytest.approx(DriveLag().lag_s, abs=0.003)


def test_drives_that_become_slow_are_known_soon_however_long_they_were_quick():
    lag = run(DriveLag(), 3, 0.0, 120.0)
    assert run(lag, 5, 0.05, 20.0, begin_s=120.0).lag_s > 0.5 * (0.024 + 0.09)


@pytest.mark.parametrize("share", [0.0, 3.0], ids=["stalled", "pushed along"])
def test_an_arm_that_does_not_do_what_it_is_told_is_hardly_taken_for_a_lag(share):
    """One moment counts at most like the slowest drive and at least like one without a lag."""
    lag = run(DriveLag(), 3, 0.0)
    found_s, joints = lag.lag_s, np.zeros(6)
    for tick in range(250):
        command = np.full(6, 1.0 if tick % 125 < 63 else 0.3)
        joints = joints + share * command * DT_S
        lag.add(6.0 + tick * DT_S, command, joints, compare=tick > 0)
    assert lag.lag_s == pytest.approx(found_s, abs=0.05)
    assert run(lag, 3, 0.0, begin_s=8.0).lag_s == pytest.approx(found_s, abs=0.03)


@pytest.mark.parametrize("set_to_s", [-10.0, 10.0])
def test_what_is_pending_is_what_was_told_within_the_lag_and_a_clock_that_is_set_is_none(set_to_s):
    lag = DriveLag()
    assert not lag.pending_rad().any()
    for tick, speed in enumerate((0.0, 0.0, 1.0, 2.0, 3.0, 4.0)):
        lag.add(tick * DT_S, np.full(6, speed), np.zeros(6), compare=False)
    np.testing.assert_allclose(
        lag.pending_rad(), (4.0 + 3.0 + 2.0) * DT_S + 1.0 * (lag.lag_s - 3 * DT_S)
    )
    lag.add(set_to_s, np.full(6, 4.0), np.zeros(6))
    assert not lag.pending_rad().any()
    assert lag.lag_s == DriveLag().lag_s


def test_one_can_brake_from_the_braking_speed_tick_by_tick():
    for travel in (1e-4, 1e-2, 0.3):
        speed = braking_speed_within(travel, 5.0, DT_S)
        way = 0.0
        while speed > 0.0:
            way += speed * DT_S
            speed -= 5.0 * DT_S
        assert way <= travel * (1.0 + 1e-9)
