"""The soonest that anybody could arrive, joints being limited one by one."""

from __future__ import annotations

import numpy as np

from fvs_ros.apps.experiments.trials import Case
from fvs_sim_node.kinematics import ball_jacobian, ball_position

_ATTEMPTS, _SPREAD_RAD = 8, 0.3


def least_travel_rad(case: Case) -> float:
    """Least largest joint travel that puts the ball on the target, by true kinematics, rad.

    By sequential quadratic programmes from several guesses; never above the travel to the joints
    that the target was drawn from, which are a guess, too.
    """
    from scipy.optimize import minimize

    start, goal = np.array(case.start_rad), np.array(case.goal_rad)
    target_m = ball_position(goal)
    rng = np.random.default_rng(case.seed)
    # Unknowns are the largest travel and the travels: the largest above each, either way.
    slopes = np.hstack([np.ones((12, 1)), np.vstack([-np.eye(6), np.eye(6)])])
    constraints = (
        {
            "type": "eq",
            "fun": lambda z: ball_position(start + z[1:]) - target_m,
            "jac": lambda z: np.hstack([np.zeros((3, 1)), ball_jacobian(start + z[1:])]),
        },
        {"type": "ineq", "fun": lambda z: slopes @ z, "jac": lambda z: slopes},
    )
    unit = np.eye(7)[0]
    best = float(np.abs(goal - start).max())
    for attempt in range(_ATTEMPTS):
        guess = goal - start + (_SPREAD_RAD * rng.normal(size=6) if attempt else 0.0)
        found = minimize(
            lambda z: z[0],
            np.append(np.abs(guess).max(), guess),
            jac=lambda z: unit,
            constraints=constraints,
            method="SLSQP",
        )
        if found.success:
            best = min(best, float(found.x[0]))
    return best


def floor_s(case: Case, speed_rad_s: float, acceleration_rad_s2: float) -> float:
    """Least time from rest to rest for the least largest travel within the limits, s.

    Parameters
    ----------
    case : Case
        Start and goal.
    speed_rad_s, acceleration_rad_s2 : float
        Limits of every joint.
    """
    travel_rad = least_travel_rad(case)
    if travel_rad < speed_rad_s**2 / acceleration_rad_s2:
        return 2.0 * float(np.sqrt(travel_rad / acceleration_rad_s2))
    return travel_rad / speed_rad_s + speed_rad_s / acceleration_rad_s2
