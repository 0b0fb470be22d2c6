"""The floor: no motion brings the ball near its target for good in less time."""

from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import pytest
from cases import each

pytest.importorskip("pybullet")

from fvs_lab import floor
from fvs_lab.floor import Limits, ur5
from fvs_lab.trials import Case, make_cases
from fvs_sim_node.robot import HOME_JOINTS_RAD

LIMITS = Limits(1.0, 6.0)
START_RAD = np.array(HOME_JOINTS_RAD)
GOAL_RAD = START_RAD + [0.5, -0.3, 0.4, 0.3, -0.5, 0.2]
CASE = Case("", tuple(START_RAD), tuple(GOAL_RAD), 1)
#: Of the race.
CASES = make_cases("B", 2, 410)

fastest = lru_cache(maxsize=None)(floor.fastest)


def test_from_rest_to_rest_the_time_is_that_of_a_trapezium():
    assert LIMITS.rest_s(0.7) == pytest.approx(0.7 + 1.0 / 6.0)
    assert LIMITS.rest_s(0.05) == pytest.approx(2.0 * np.sqrt(0.05 / 6.0))


@each("tolerance_m", [0.005, 0.001])
def test_a_single_joint_enters_at_the_near_edge_and_brakes_at_the_far_one(tolerance_m):
    # Three joints along three axes, a target on the first: a metre is a radian.
    slopes = np.eye(3, 6)
    gantry = SimpleNamespace(
        position=lambda joints: joints[..., :3],
        jacobian=lambda joints: np.broadcast_to(slopes, (*joints.shape[:-1], 3, 6)),
    )
    case = Case("", (0.0,) * 6, (0.4, 0.0, 0.0, 0.0, 0.0, 0.0), 1)
    known_s = LIMITS.rest_s(0.4 + tolerance_m) - np.sqrt(4.0 * tolerance_m / 6.0)
    found = floor.fastest(case, LIMITS, tolerance_m, gantry)
    assert found.time_s == pytest.approx(known_s, rel=1e-3)


def speeds_rad_s(motion, times_s):
    """Speeds of the joints of the fastest motion at times, shape (n, joints), rad/s."""
    end = motion.speed_rad_s
    so_far = np.clip(times_s, 0.0, motion.time_s)[:, None]
    ramp, left = 6.0 * so_far, 6.0 * (motion.time_s - so_far)
    # A mean of the quickest motions either way is within the limits as they are.
    up, down = np.minimum(np.minimum(ramp, 1.0), end + left), end - left
    down = np.maximum(np.maximum(-ramp, -1.0), down)
    furthest = LIMITS.furthest(end, motion.time_s)[0]
    least = -LIMITS.furthest(-end, motion.time_s)[0]
    share = (motion.travel_rad - least) / (furthest - least)
    # How much of each piece of braking is over.
    over = (times_s[:, None] - motion.time_s) / motion.piece_s - np.arange(floor.PIECES)
    braked = motion.piece_s * np.clip(over, 0.0, 1.0) @ motion.braking_rad_s2
    return share * up + (1.0 - share) * down + braked


@each(
    ("case", "tolerance_m"),
    [(CASE, one) for one in (0.005, 0.001)] + [(case, 0.005) for case in CASES],
)
def test_the_fastest_motion_keeps_the_limits_and_stays_near(case, tolerance_m):
    found = fastest(case, LIMITS, tolerance_m)
    step_s = 1e-4
    times_s = np.arange(0.0, found.time_s + 0.2, step_s)
    speeds = speeds_rad_s(found, times_s)
    assert np.abs(speeds).max() <= 1.0 + 1e-6
    assert np.abs(np.diff(speeds, axis=0)).max() <= 6.0 * step_s + 1e-6
    assert not np.abs(speeds[0]).any()
    np.testing.assert_allclose(speeds[-1], 0.0, atol=1e-6)
    ways = np.cumsum(0.5 * step_s * (speeds[1:] + speeds[:-1]), axis=0)
    balls_m = ur5().position(np.array(case.start_rad) + ways)
    errors_m = np.linalg.norm(balls_m - ur5().position(np.array(case.goal_rad)), axis=1)
    after = times_s[1:] >= found.time_s
    assert errors_m[after].max() < 1.03 * tolerance_m
    assert errors_m[~after].min() > 0.97 * tolerance_m  # and not near any sooner
