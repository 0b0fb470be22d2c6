"""Loops in lock step, and what becomes of them."""

import numpy as np

from fvs_lab.trials import Conditions, simulation_of
from fvs_tools.closed_loop import ClosedLoop

EXACT = Conditions(rendered=False)
#: Of a tag, with noise like that of images.
EXACT_POSE = Conditions(feature="pose", rendered=False, position_noise_m=3e-4)
START_RAD = np.array([0.1, -1.2, 1.5, -1.8, -1.4, -0.1])
GOAL_RAD = np.array([-0.2, -1.5, 1.75, -1.6, -1.75, 0.2])


def loop_from(name, start_rad, simulation=None, seed=1, **values):
    """A scheme's loop from a start; lets it run for half a second."""
    simulation = simulation or simulation_of(EXACT)
    simulation.reset(start_rad, seed)
    loop = ClosedLoop.of_scheme(name, simulation, **values)
    loop.run(0.5)
    return loop


def feature_at(simulation, joints_rad):
    simulation.reset(joints_rad)
    return simulation.true_feature()


def run(loop, target, seconds):
    """Commands, rad/s, and true errors, m, tick by tick."""
    loop.set_target(target)
    commands, errors_m = [], []
    for _ in range(round(seconds / loop.period_s)):
        commands.append(loop.tick().velocity_rad_s)
        errors_m.append(np.linalg.norm(loop.kind.minus(loop.true_feature, target)))
    return np.array(commands), np.array(errors_m)
