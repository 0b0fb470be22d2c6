"""The least time until the ball stays near the target, within the joints' limits.

It is found by sequential quadratic programming from one start. The arm may still move at that
time: the ball only has to be within the tolerance and stay there while the joints brake. Braking
lasts no longer than from full speed. Before that time the joints are independent, and each reaches
any state between its fastest motions in both directions, which have a closed form. So the unknowns
are the time, the travel and speed of each joint at that time, and its braking afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fvs_lab.trials import Case, Conditions, simulation_of
from fvs_ros.chain import SerialChain

#: Pieces of constant acceleration during braking, and checks of the ball in each: twice as many of
#: either change the time by less than a millisecond.
PIECES, _LOOKS = 4, 8


@dataclass(frozen=True)
class Limits:
    """What every joint can do."""

    speed_rad_s: float
    acceleration_rad_s2: float

    def least_s(self, travel_rad: np.ndarray, end_rad_s: np.ndarray) -> float:
        """Least time from rest until all joints have made a travel and have a speed, s."""
        top, steep = self.speed_rad_s, self.acceleration_rad_s2
        sign = np.where(travel_rad < end_rad_s * np.abs(end_rad_s) / (2.0 * steep), -1.0, 1.0)
        travel, end = sign * travel_rad, sign * end_rad_s
        # Up to a peak and down to the end; a peak above the limit is cut off.
        peak = np.sqrt(np.maximum(0.5 * end**2 + steep * travel, 0.0))
        cut = np.maximum(peak - top, 0.0)
        return float(((2.0 * peak - end) / steep + cut**2 / (steep * top)).max())

    def furthest(self, end_rad_s: np.ndarray, time_s: float) -> tuple[np.ndarray, ...]:
        """Largest travel from rest in a time with a speed at its end, rad.

        Also its slopes over that speed, s, and over the time, rad/s.
        """
        top, steep = self.speed_rad_s, self.acceleration_rad_s2
        peak = 0.5 * (steep * time_s + end_rad_s)
        cut = np.maximum(peak - top, 0.0)
        travel = (peak**2 - 0.5 * end_rad_s**2 - cut**2) / steep
        return travel, (peak - end_rad_s - cut) / steep, peak - cut


def least_time_s(
    case: Case,
    limits: Limits,
    tolerance_m: float,
    arm: SerialChain | None = None,
    share: np.ndarray | float = 1.0,
) -> float:
    """Find the least time until the ball is near the target for good, s, by true kinematics.

    By a sequential quadratic programme from the motion to the joints that the target was drawn
    from. Joints may turn as far as they like; near is within the tolerance, m. A joint has its
    share of the limits.
    """
    from scipy.optimize import minimize

    start, goal = np.array(case.start_rad) / share, np.array(case.goal_rad) / share
    travel = goal - start
    rest_s = limits.least_s(travel, np.zeros_like(travel))
    steep, top = limits.acceleration_rad_s2, limits.speed_rad_s
    # More time than a joint needs to brake from the speed limit gains nothing.
    piece_s = min(top / steep, 0.5 * rest_s) / PIECES
    fastest_rad_s = PIECES * piece_s * steep
    joints = len(travel)
    unit, travels, speeds, pieces, paths = _unknowns(joints, piece_s)
    rest = speeds + piece_s * pieces.sum(axis=0)
    signs, either_rad = np.repeat([1.0, -1.0], joints), np.vstack([travels, -travels])
    arm = arm or simulation_of(Conditions()).world.chain  # by default that of the UR5
    target_m = arm.position(goal * share)

    # All joints are in units of their shares, and so have equal limits.
    def near(unknown: np.ndarray) -> np.ndarray:
        missing = (arm.position((start + paths @ unknown) * share) - target_m) / tolerance_m
        return 1.0 - np.sum(missing**2, axis=1)

    def near_slopes(unknown: np.ndarray) -> np.ndarray:
        joints = (start + paths @ unknown) * share
        missing = (arm.position(joints) - target_m) / tolerance_m**2
        return -2.0 * np.einsum("kx,kxj,kjn->kn", missing, arm.jacobian(joints) * share, paths)

    def reached(unknown: np.ndarray) -> np.ndarray:
        return limits.furthest(signs * np.tile(speeds @ unknown, 2), unknown[0])[0] - (
            either_rad @ unknown
        )

    def reached_slopes(unknown: np.ndarray) -> np.ndarray:
        _, over_speed, over_time = limits.furthest(signs * np.tile(speeds @ unknown, 2), unknown[0])
        over_speeds = (signs * over_speed)[:, None] * np.vstack([speeds, speeds])
        return np.outer(over_time, unit[0]) + over_speeds - either_rad

    solution = minimize(
        lambda unknown: unknown[0],
        np.concatenate([[rest_s], travel, np.zeros((1 + PIECES) * joints)]),
        jac=lambda _: unit[0],
        constraints=(
            {"type": "ineq", "fun": near, "jac": near_slopes},
            {"type": "ineq", "fun": reached, "jac": reached_slopes},
            {"type": "eq", "fun": lambda unknown: rest @ unknown, "jac": lambda _: rest},
        ),
        # No less time than it takes to reach the largest speed.
        bounds=[(PIECES * piece_s, rest_s)]
        + joints * [(None, None)]
        + joints * [(-fastest_rad_s, fastest_rad_s)]
        + PIECES * joints * [(-steep, steep)],
        method="SLSQP",
        options={"maxiter": 2000, "ftol": 1e-7},
    ).x
    if near(solution).min() < -0.02:  # outside by a hundredth of the tolerance
        raise RuntimeError(f"no fastest motion found for case {case.name}")
    return limits.least_s(travels @ solution, speeds @ solution)


def _unknowns(joints: int, piece_s: float) -> tuple[np.ndarray, ...]:
    """Matrices that take quantities out of the vector of unknowns.

    The unknowns are time, travels, speeds, and accelerations joint by joint within each piece; the
    last matrix gives the joints' travel at each look while they brake.
    """
    unit = np.eye(1 + (2 + PIECES) * joints)
    travels, speeds = unit[1 : 1 + joints], unit[1 + joints : 1 + 2 * joints]
    pieces = unit[1 + 2 * joints :].reshape(PIECES, joints, -1)
    looks = np.arange(PIECES * _LOOKS + 1)[:, None] / _LOOKS
    begun = np.maximum(looks - np.arange(PIECES), 0.0)
    done = np.minimum(begun, 1.0)
    moved = piece_s**2 * done * (begun - 0.5 * done)
    paths = travels + np.multiply.outer(piece_s * looks[:, 0], speeds)
    return unit, travels, speeds, pieces, paths + np.tensordot(moved, pieces, 1)
