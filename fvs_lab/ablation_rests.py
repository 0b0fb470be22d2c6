"""A long rest at a target, and what it does to the estimator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fvs_estimator_node.pairing import StepPairing
from fvs_lab.ablation_changes import DURATION_S
from fvs_lab.lockstep import LockStep, load_networks, make_estimator
from fvs_lab.trials import (
    BOUNDS_M,
    PRELUDE_S,
    Case,
    Conditions,
    seconds,
    simulation_of,
)
from fvs_tools.score import settling_time_s

#: Time to reach the target before holding it, s.
_REACH_S = 4.0
#: Below every motion of the joints: with it the estimator learns from every image, at rest, too.
_ANY_MOTION_RAD = 1e-12

NO_LEAK, ZERO_AT_REST = "no leak, learning at rest", "leak toward zero, learning at rest"
OFFLINE_AT_REST = "leak toward the trained weights, learning at rest"
ZERO_GATED = "leak toward zero, learning from motion only"


@dataclass(frozen=True)
class Rest:
    """Go to a target, hold it for long, go back.

    Parameters
    ----------
    case : Case
        Start and goal.
    name : str
        What is different.
    estimator : mapping
        The estimator's parameters.
    learns_at_rest : bool
        Whether every image is a step to learn from, as the paper's law has it, or only motion.
    hold_s : float
        Time to hold, s.
    """

    case: Case
    name: str
    estimator: Mapping[str, Any]
    learns_at_rest: bool
    hold_s: float


@dataclass(frozen=True)
class Rested:
    """What came of a rest.

    Parameters
    ----------
    name : str
        What was different.
    error_before, error_after : float
        Relative error of the Jacobian before and after holding.
    next_s : dict of str to float
        Settling times of the way back by the bound's name, s; infinite for never.
    """

    name: str
    error_before: float
    error_after: float
    next_s: dict[str, float]


def all_rests(cases: Sequence[Case], hold_s: float) -> list[Rest]:
    """List the long rests, those of a kind together; hold_s in s."""
    ungated = {"rbf.min_motion_rad": 0.0}
    zero = {"rbf.k3": 0.01, "rbf.leak_target": "zero"}
    offline = {"rbf.k3": 0.01, "rbf.leak_target": "offline"}
    return [
        Rest(case, name, values, at_rest, hold_s)
        for name, values, at_rest in (
            (NO_LEAK, ungated, True),
            (ZERO_AT_REST, {**ungated, **zero}, True),
            (OFFLINE_AT_REST, {**ungated, **offline}, True),
            (ZERO_GATED, zero, False),
        )
        for case in cases
    ]


def run_rest(rest: Rest) -> Rested:
    """Run one long rest, with the exact camera and 1 mm noise: a minute of images takes long."""
    simulation = simulation_of(Conditions(rendered=False))
    simulation.reset(rest.case.goal_rad)
    target_m = simulation.true_ball_position()
    simulation.reset(rest.case.start_rad, rest.case.seed)
    home_m = simulation.true_ball_position()
    estimator = make_estimator("rbf", simulation, load_networks(), rest.estimator)
    one = LockStep(simulation, estimator)
    if rest.learns_at_rest:
        one.estimation.pairing = StepPairing(min_joint_motion_rad=_ANY_MOTION_RAD)
    one.run(PRELUDE_S)
    one.set_target(target_m)
    one.run(_REACH_S)
    before = _jacobian_error(one)
    one.run(rest.hold_s)
    after = _jacobian_error(one)
    one.set_target(home_m)
    times, errors = [], []
    for number in range(round(DURATION_S / one.period_s)):
        one.tick()
        times.append((number + 1) * one.period_s)
        errors.append(float(np.linalg.norm(simulation.true_ball_position() - home_m)))
    found = {
        name: seconds(settling_time_s(np.array(times), np.array(errors), bound_m))
        for name, bound_m in BOUNDS_M.items()
    }
    return Rested(rest.name, before, after, found)


def _jacobian_error(one: LockStep) -> float:
    """Relative error of the estimator's Jacobian."""
    joints = one.simulation.joints_rad
    true = one.simulation.true_jacobian(joints)
    return float(np.linalg.norm(one.estimator.jacobian(joints) - true) / np.linalg.norm(true))
