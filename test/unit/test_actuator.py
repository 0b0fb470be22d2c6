"""Dead time, ramps, lag and stops of the drives."""

import numpy as np
import pytest

from fvs_sim_node.actuator import Actuator, ActuatorConfig

DT_S = 0.002
WIDE = np.full(6, 100.0)


def make(lower=-WIDE, upper=WIDE, **constants):
    return Actuator(ActuatorConfig(**constants), DT_S, lower, upper)


def run(actuator, steps, positions=None):
    """Velocities over time, (steps, 6), with the positions integrated along."""
    positions = np.zeros(6) if positions is None else positions
    velocities = []
    for _ in range(steps):
        velocity = actuator.step(positions)
        positions += DT_S * velocity
        velocities.append(velocity)
    return np.array(velocities)


def test_dead_time_then_ramp_then_command():
    actuator = make(lag_s=0.0)
    actuator.command(np.full(6, 0.3))
    velocity = run(actuator, 30)[:, 0]
    assert not velocity[:4].any()
    np.testing.assert_allclose(velocity[4:14], 15.0 * DT_S * np.arange(1, 11))
    np.testing.assert_allclose(velocity[14:], 0.3)


@pytest.mark.parametrize(("lag_s", "joint_lag_s"), [(0.012, 0.0), (0.0, 0.1)])
def test_lag_is_first_order(lag_s, joint_lag_s):
    actuator = make(dead_time_s=0.0, acceleration_limit_rad_s2=1e6, lag_s=lag_s)
    actuator.joint_lag_s = joint_lag_s
    actuator.command(np.full(6, 1.0))
    velocity = run(actuator, 30)[:, 2]
    time_s = DT_S * np.arange(1, 31)
    np.testing.assert_allclose(velocity, 1.0 - np.exp(-time_s / (lag_s + joint_lag_s)), atol=1e-12)


def test_extra_joint_lag_slows_down_but_arrives():
    quick, slow = make(), make()
    slow.joint_lag_s = 0.1
    for actuator in (quick, slow):
        actuator.command(np.full(6, 0.5))
    fast, late = run(quick, 500)[:, 0], run(slow, 500)[:, 0]
    assert np.all(late[5:100] < fast[5:100])
    assert late[-1] == pytest.approx(0.5, abs=1e-3)


def test_default_lag_is_hold_plus_dead_time_plus_lag():
    # Half a control period, 8 ms and 12 ms; no more while the acceleration limit is not reached.
    actuator = make()
    time_s = DT_S * np.arange(2000)
    out = np.empty(2000)
    for i, t in enumerate(time_s):
        if i % 4 == 0:
            actuator.command(np.full(6, 0.3 * np.sin(2 * np.pi * t)))
        out[i] = actuator.step(np.zeros(6))[0]
    spectrum = np.sum(out[1000:] * np.exp(-2j * np.pi * (time_s[1000:] + DT_S)))
    late_s = -(np.angle(spectrum) + np.pi / 2) / (2 * np.pi)
    assert late_s == pytest.approx(0.024, abs=0.003)


def test_the_drive_looks_only_once_a_period():
    actuator = make(dead_time_s=0.0, lag_s=0.0, acceleration_limit_rad_s2=1e6)
    actuator.step(np.zeros(6))
    actuator.command(np.full(6, 0.2))
    assert not run(actuator, 3).any()
    np.testing.assert_allclose(run(actuator, 1), 0.2)


def test_a_command_holds_for_ever():
    actuator = make()
    actuator.command(np.linspace(-0.3, 0.3, 6))
    np.testing.assert_allclose(run(actuator, 5000)[-1], np.linspace(-0.3, 0.3, 6), atol=1e-9)


def test_speed_scaling_scales_and_stops():
    actuator = make()
    actuator.command(np.full(6, 0.4))
    actuator.speed_scaling = 0.5
    np.testing.assert_allclose(run(actuator, 200)[-1], 0.2, atol=1e-6)
    actuator.speed_scaling = 0.0
    np.testing.assert_allclose(run(actuator, 200)[-1], 0.0, atol=1e-6)


def test_speed_is_limited():
    actuator = make()
    actuator.command(np.full(6, 50.0))
    np.testing.assert_allclose(run(actuator, 500)[-1], np.pi, atol=1e-6)


@pytest.mark.parametrize("joint_lag_s", [0.0, 0.05])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_joint_stops_at_its_limit_and_leaves_it_as_from_rest(way, joint_lag_s):
    end = WIDE.copy()
    end[1] = 0.1
    actuator, resting = make(lower=-end, upper=end), make()
    actuator.joint_lag_s = resting.joint_lag_s = joint_lag_s
    positions = np.zeros(6)
    actuator.command(np.full(6, 0.5 * way))
    velocities = run(actuator, 400, positions)
    assert positions[1] == pytest.approx(0.1 * way, abs=1e-9)
    assert velocities[-1, 1] == 0.0
    assert way * positions[0] > 0.3
    for one in (actuator, resting):
        one.command(np.full(6, -0.5 * way))
    left = run(actuator, 50, positions)
    np.testing.assert_allclose(left[:, 1], run(resting, 50)[:, 1], atol=1e-12)


def test_same_commands_same_motion():
    def motion():
        rng = np.random.default_rng(4)
        actuator = make()
        positions = np.zeros(6)
        for _ in range(50):
            actuator.command(rng.uniform(-1, 1, 6))
            run(actuator, 4, positions)
        return positions

    np.testing.assert_array_equal(motion(), motion())


@pytest.mark.parametrize(
    "bad",
    [
        {"control_period_s": 0.0},
        {"dead_time_s": -0.1},
        {"acceleration_limit_rad_s2": 0.0},
        {"lag_s": -1.0},
    ],
)
def test_bad_constants_are_refused_by_name(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        ActuatorConfig(**bad)
