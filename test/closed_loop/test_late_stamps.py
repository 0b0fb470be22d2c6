"""A camera that stamps its images late: it must not be taken for one that was turned."""

import dataclasses

import numpy as np
import pytest

from fvs_lab.trials import HOME_RAD, Conditions, jacobian_error, simulation_of
from fvs_tools.closed_loop import ClosedLoop
from fvs_tools.schemes import scheme

TRUE_LATENCY_S = 0.1


def run(name, late_s, start_off_rad=0.15):
    """Let a scheme go to a target; returns the loop, its errors, m, and the last command."""
    one = scheme(name)
    simulation = simulation_of(Conditions(rendered=False, latency_s=TRUE_LATENCY_S))
    simulation.reset(HOME_RAD - start_off_rad)
    target_m = simulation.true_ball_position()
    simulation.reset(HOME_RAD + start_off_rad, 1)
    loop = ClosedLoop.of_scheme(one, simulation)
    advance = simulation.advance

    def stamped_late():
        out = advance()
        late = [dataclasses.replace(o, stamp_s=o.stamp_s + late_s) for o in out.observations]
        return dataclasses.replace(out, observations=late)

    simulation.advance = stamped_late  # there is one simulation for all
    errors = []
    try:
        loop.run(0.5)
        loop.set_target(target_m)
        for _ in range(round(3.0 / loop.period_s)):
            command = loop.tick()
            errors.append(np.linalg.norm(simulation.true_ball_position() - target_m))
    finally:
        del simulation.advance
    return loop, np.array(errors), command


@pytest.mark.parametrize("name", ["best", "extended"])
def test_late_stamps_turn_no_camera(name):
    loop, errors, _ = run(name, 0.06)
    assert errors[round(1.8 / loop.period_s) :].max() < 0.005
    assert jacobian_error(loop) < 0.1
    assert "too late" in loop.estimation.remark


@pytest.mark.parametrize("name", ["best", "extended"])
def test_where_no_loop_comes_to_rest_the_arm_is_held_and_the_estimator_says_why(name):
    loop, _, command = run(name, 0.1)
    assert "too late by about 0.1" in loop.estimation.problem
    np.testing.assert_array_equal(command.velocity_rad_s, 0.0)
    assert "the estimator says: image stamps are too late" in command.text
    assert loop.estimator.status_values()["camera_turned_deg"] < 10.0
