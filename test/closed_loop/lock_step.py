"""Loops in lock step, and what becomes of them."""

import numpy as np

from fvs_lab.trials import Conditions, simulation_of
from fvs_tools.closed_loop import ClosedLoop

EXACT = Conditions(rendered=False)


def loop_from(name, start_rad, simulation=None, seed=1, **values):
    """A scheme's loop from a start; lets it run for half a second."""
    simulation = simulation or simulation_of(EXACT)
    simulation.reset(start_rad, seed)
    loop = ClosedLoop.of_scheme(name, simulation, **values)
    loop.run(0.5)
    return loop


def ball_at(simulation, joints_rad):
    simulation.reset(joints_rad)
    return simulation.true_ball_position()


def run(loop, target_m, seconds):
    """Commands, rad/s, and true errors, m, tick by tick."""
    loop.set_target(target_m)
    commands, errors_m = [], []
    for _ in range(round(seconds / loop.period_s)):
        commands.append(loop.tick().velocity_rad_s)
        errors_m.append(np.linalg.norm(loop.simulation.true_ball_position() - target_m))
    return np.array(commands), np.array(errors_m)
