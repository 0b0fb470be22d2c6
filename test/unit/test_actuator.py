"""Dead time, ramps, lag and stops of the drives."""

import numpy as np
import pytest
from cases import each

from fvs_sim_node.actuator import Actuator
from fvs_sim_node.config import SimConfig

DT_S = 0.002
WIDE = np.full(6, 100.0)
QUICK = {"dead_time_s": 0.0, "lag_s": 0.0, "acceleration_limit_rad_s2": 1000.0}


def make(lower=-WIDE, upper=WIDE, **constants):
    return Actuator(SimConfig(**constants), lower, upper, np.full(6, np.pi))


def run(actuator, steps, command=None, positions=None):
    """Velocities over time, (steps, 6), with the positions integrated along."""
    positions = np.zeros(6) if positions is None else positions
    if command is not None:
        actuator.command(np.broadcast_to(command, 6))
    velocities = []
    for _ in range(steps):
        velocities.append(actuator.step(positions))
        positions += DT_S * velocities[-1]
    return np.array(velocities)


def test_dead_time_then_ramp_then_command_for_ever():
    velocity = run(make(lag_s=0.0), 5000, 0.3)[:, 0]
    assert not velocity[:4].any()
    np.testing.assert_allclose(velocity[4:14], 15.0 * DT_S * np.arange(1, 11))
    np.testing.assert_allclose(velocity[14:], 0.3)
    np.testing.assert_allclose(run(make(), 500, 50.0)[-1], np.pi, atol=1e-6)  # the fastest


@each(("lag_s", "joint_lag_s"), [(0.1, 0.0), (0.0, 0.1)])
def test_lag_is_first_order(lag_s, joint_lag_s):
    velocity = run(make(**{**QUICK, "lag_s": lag_s, "joint_lag_s": joint_lag_s}), 30, 1.0)[:, 2]
    time_s = DT_S * np.arange(1, 31)
    np.testing.assert_allclose(velocity, 1.0 - np.exp(-time_s / 0.1), atol=1e-12)


@each("joint_lag_s", [0.0, 0.05])
@each("way", [1.0, -1.0])
def test_joint_stops_at_its_limit_and_leaves_it_as_from_rest(way, joint_lag_s):
    end = WIDE.copy()
    end[1] = 0.1
    actuator = make(lower=-end, upper=end, joint_lag_s=joint_lag_s)
    resting, positions = make(joint_lag_s=joint_lag_s), np.zeros(6)
    velocities = run(actuator, 400, 0.5 * way, positions)
    assert positions[1] == pytest.approx(0.1 * way, abs=1e-9)
    assert velocities[-1, 1] == 0.0
    assert way * positions[0] > 0.3
    left = run(actuator, 50, -0.5 * way, positions)
    np.testing.assert_allclose(left[:, 1], run(resting, 50, -0.5 * way)[:, 1], atol=1e-12)
