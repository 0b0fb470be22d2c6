"""A joint at the end of its range, and a target beyond: the arm rests as near as it can."""

import numpy as np
import pytest

from fvs_lab.trials import Conditions, make_cases, simulation_of
from fvs_tools.closed_loop import ClosedLoop, make_estimator
from fvs_tools.schemes import BEYOND

EXACT = Conditions(rendered=False)
LAGS = Conditions(rendered=False, joint_lag_s=0.06)
START_RAD = np.array([-0.294, -1.405, 1.605, -1.697, -1.074, 0.293])
TARGET_M = np.array([0.271, 0.252, 1.529])
OTHER_START_RAD = np.array([0.150, -0.953, 1.876, -2.025, -1.770, 0.374])
OTHER_TARGET_M = np.array([-0.220, 0.412, 1.423])


def run(scheme, start_rad, target_m, seconds, **ends_rad):
    """Commands and errors, tick by tick, with the range of some joints narrowed."""
    lower, upper = np.full(6, -6.2), np.full(6, 6.2)
    for end, ends in (("lower", lower), ("upper", upper)):
        for joint, value in ends_rad.get(end, {}).items():
            ends[joint] = value
    simulation = simulation_of(EXACT)
    simulation.reset(start_rad, 1)
    values = {"joint_min_rad": lower.tolist(), "joint_max_rad": upper.tolist()}
    loop = ClosedLoop.of_scheme(scheme, simulation, **values)
    loop.run(0.5)
    loop.set_target(target_m)
    commands, errors_m = [], []
    for _ in range(round(seconds / loop.period_s)):
        commands.append(loop.tick().velocity_rad_s)
        errors_m.append(np.linalg.norm(simulation.true_ball_position() - target_m))
    return np.array(commands), np.array(errors_m)


@pytest.mark.parametrize("scheme", BEYOND.values(), ids=list(BEYOND))
@pytest.mark.parametrize("end_rad", [-1.143, -0.933])
def test_a_target_beyond_the_end_of_a_joint_does_not_make_the_others_swing(scheme, end_rad):
    commands, errors_m = run(scheme, START_RAD, TARGET_M, 5.0, upper={1: end_rad})
    late = commands[-250:]
    assert np.ptp(late, axis=0).max() < 0.15
    assert errors_m[-1] < 1.1 * errors_m.min()


@pytest.mark.parametrize("scheme", BEYOND.values(), ids=list(BEYOND))
def test_the_others_do_what_a_joint_at_its_end_cannot(scheme):
    _, errors_m = run(scheme, OTHER_START_RAD, OTHER_TARGET_M, 2.5, lower={0: -0.350})
    assert errors_m[-60:].max() < 0.005


def test_a_joint_brakes_before_its_end_behind_a_drive_that_lags():
    passed_rad = []
    for case in make_cases("END", 4, 83):
        start, goal = np.array(case.start_rad), np.array(case.goal_rad)
        # Each joint's range ends where it has gone less than half of its way.
        end = start + 0.4 * (goal - start) + 0.02 * np.sign(goal - start)
        up = goal > start
        values = {
            "law": "ftsm",
            "joint_min_rad": np.where(up, -6.2, end).tolist(),
            "joint_max_rad": np.where(up, end, 6.2).tolist(),
        }
        simulation = simulation_of(LAGS)
        simulation.reset(goal)
        target_m = simulation.true_ball_position()
        simulation.reset(start, case.seed)
        estimator = make_estimator("frozen", simulation)
        loop = ClosedLoop(simulation, estimator, values)
        loop.run(0.4)
        loop.set_target(target_m)
        for _ in range(250):
            loop.tick()
            passed_rad.append(np.where(up, 1.0, -1.0) * (simulation.joints_rad - end))
    assert np.max(passed_rad) < 2e-3
