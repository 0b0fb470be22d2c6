"""The whole controller over a UR5 in numpy: how fast, how exact, how calm, and when it holds."""

from __future__ import annotations

import numpy as np
import pytest
from control_plant import NOISE_M, TICK_S, chain_of_the_arm, pairs, servo
from scipy.optimize import minimize
from ur5_dh import HOME_RAD, ball_and_jacobian

from fvs_controller_node.config import LAWS
from fvs_tools.schemes import BEYOND

CASES = pairs(2, seed=21, low_m=0.28, high_m=0.32)
CENTRE_M = ball_and_jacobian(HOME_RAD)[0]
SPEED_RAD_S, ACCELERATION_RAD_S2 = 1.0, 6.0
MINIMUM_TIME = {"law": "minimum_time"}
EXTENDED = BEYOND["extended"].controller_values
SCHEMES = {name: {**one.controller_values, "law": one.law} for name, one in BEYOND.items()}


def rotation(degrees):
    """About the optical axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def servoes(run):
    return set(run.states) <= {"SERVOING", "SETTLED"}


def minimum_time_s(start_rad, goal_rad):
    """Least time to rest at the target: least largest joint travel, by another library."""
    target = ball_and_jacobian(goal_rad)[0]
    rng, best = np.random.default_rng(0), np.inf
    for attempt in range(6):
        guess = goal_rad - start_rad + (0.3 * rng.normal(size=6) if attempt else 0.0)
        found = minimize(
            lambda z: z[0],
            np.append(np.abs(guess).max(), guess),
            constraints=[
                {"type": "eq", "fun": lambda z: ball_and_jacobian(start_rad + z[1:])[0] - target},
                {"type": "ineq", "fun": lambda z: np.append(z[0] - z[1:], z[0] + z[1:])},
            ],
            method="SLSQP",
        )
        best = min(best, found.x[0]) if found.success else best
    return best / SPEED_RAD_S + SPEED_RAD_S / ACCELERATION_RAD_S2


@pytest.mark.parametrize(
    "how",
    [
        *({"values": {"law": law}} for law in LAWS),
        {"values": EXTENDED},
        {"values": {"lambda1": 0.75, "lambda2": 0.0}},
        {"values": {"max_joint_acceleration_rad_s2": 2.0}},
        {"values": {"max_joint_velocity_rad_s": 2.0}},
        {"noise_m": 4e-3, "values": EXTENDED},
        {"jacobian_error": 0.1},
        {"turned": rotation(20.0)},
    ],
    ids=str,
)
def test_from_30_cm_it_settles_within_the_limits_and_stays_exact_and_calm(how):
    values, noise_m = how.get("values", {}), how.get("noise_m", NOISE_M)
    speed = values.get("max_joint_velocity_rad_s", SPEED_RAD_S)
    acceleration = values.get("max_joint_acceleration_rad_s2", ACCELERATION_RAD_S2)
    for seed, case in enumerate(CASES):
        run = servo(*case, seed=seed, **how)
        assert servoes(run)
        assert run.settled_s(0.005) < (1.5 if set(how) == {"values"} else 2.0)
        assert run.final_rms_m < max(0.0015, 0.4 * noise_m)
        arrived = np.flatnonzero(run.error_m < 0.005)[0]
        assert run.error_m[arrived:].max() < 0.02
        assert run.jitter_rad_s < 4.0 * noise_m
        assert run.unrest_rad_s < 30.0 * noise_m
        assert np.abs(run.command).max() <= speed + 1e-12
        assert np.abs(np.diff(run.command, axis=0)).max() <= acceleration * TICK_S + 1e-12


@pytest.mark.parametrize(
    ("how", "median", "most"),
    [({"chain": chain_of_the_arm(), "jacobian_error": 0.001}, 1.08, 1.25), ({}, 1.2, 1.6)],
    ids=["with a chain", "without"],
)
def test_minimum_time_is_near_when_any_arm_can_rest(how, median, most):
    motions = pairs(3, seed=11)
    runs = [servo(*one, seed=k, values=MINIMUM_TIME, **how) for k, one in enumerate(motions)]
    ratios = [
        run.settled_s(0.005) / minimum_time_s(*motion)
        for run, motion in zip(runs, motions, strict=True)
    ]
    assert np.median(ratios) < median
    assert max(ratios) < most


@pytest.mark.parametrize("values", [{}, *SCHEMES.values()], ids=["default", *SCHEMES])
def test_a_frozen_image_with_fresh_stamps_is_found_before_the_arm_goes_far(values):
    run = servo(*CASES[0], seed=0, values=values, frozen_s=0.2)
    assert run.states[-1] == "IMAGE_NOT_FOLLOWING"
    assert run.time_s[run.states.index("IMAGE_NOT_FOLLOWING")] < 0.75
    assert not run.command[-1].any()
    assert run.error_m.max() < 1.2 * run.error_m[0]


def circle(speed_m_s, radius_m=0.08):
    """A target that goes round, by the time since the start."""

    def at(time_s):
        angle = speed_m_s / radius_m * time_s
        return CENTRE_M + radius_m * np.array([np.cos(angle) - 1.0, np.sin(angle), 0.0])

    return at


@pytest.mark.parametrize(
    ("motion", "how"),
    [
        (CASES[0], {"turned": rotation(180.0)}),
        ((HOME_RAD, HOME_RAD), {"turned": -np.eye(3), "target_of": circle(0.05)}),
    ],
    ids=["camera upside down", "moving target"],
)
def test_a_jacobian_of_the_wrong_sign_is_held_before_the_ball_goes_far(motion, how):
    run = servo(*motion, seed=1, **how)
    assert run.states[-1] == "PREDICTION_ERROR"
    assert not run.command[-1].any()
    assert run.error_m.max() < 1.5


def test_a_ball_hidden_on_the_way_is_held_and_then_reached():
    run = servo(*CASES[0], seed=0, hidden_s=(0.1, 0.8))
    assert "STALE" in run.states
    assert run.states[-1] == "SETTLED"
    assert run.final_rms_m < 0.0015
    assert np.abs(np.diff(run.command, axis=0)).max() <= ACCELERATION_RAD_S2 * TICK_S + 1e-12


def follow(values, speed_m_s, noise_m, feed_forward):
    """Rms distance from the true target, m, and of the command's step, rad/s, after 1.5 s."""
    rng, true_m = np.random.default_rng(7), []

    def target_of(time_s):
        true_m.append(circle(speed_m_s)(time_s))
        return true_m[-1] + noise_m * rng.normal(size=3)

    run = servo(
        HOME_RAD,
        HOME_RAD,
        seed=1,
        values={**values, "target_feed_forward": feed_forward},
        duration_s=4.0,
        target_of=target_of,
        chain=chain_of_the_arm() if values == MINIMUM_TIME else None,
        jacobian_error=0.01,
    )
    assert servoes(run)
    late = run.time_s > 1.5
    error_m = np.linalg.norm(run.ball_m - true_m, axis=1)[late]
    return np.sqrt(np.mean(error_m**2)), np.sqrt(np.mean(np.diff(run.command[late], axis=0) ** 2))


@pytest.mark.parametrize("values", [{}, EXTENDED, MINIMUM_TIME], ids=["default", "extended", "min"])
@pytest.mark.parametrize(
    ("speed_m_s", "noise_m", "share", "step_share", "most_m"),
    [
        (0.1, 0.0, 0.34, 2.0, 0.002),
        (0.1, 3e-3, 0.8, 1.0, 0.01),
        (0.0, 3e-3, 1.2, 1.2, 0.6 * 3e-3 + 0.5 * NOISE_M),
    ],
)
def test_feed_forward_follows_a_moving_target_and_leaves_the_noise_of_a_still_one(
    values, speed_m_s, noise_m, share, step_share, most_m
):
    (off_m, step), (alone_m, alone_step) = (
        follow(values, speed_m_s, noise_m, on) for on in (True, False)
    )
    assert off_m < min(most_m, share * alone_m)
    assert step < step_share * alone_step


@pytest.mark.parametrize("values", [{}, EXTENDED], ids=["default", "extended"])
def test_a_target_dragged_faster_than_the_arm_is_reached_when_it_stops(values):
    run = servo(
        HOME_RAD,
        HOME_RAD,
        seed=1,
        values={**values, "max_joint_velocity_rad_s": 0.1, "max_joint_acceleration_rad_s2": 1.0},
        duration_s=8.0,
        target_of=lambda time_s: CENTRE_M + np.array([0.1, 0.05, 0.0]) * min(time_s, 2.0),
    )
    assert servoes(run)
    assert run.error_m.max() > 0.05
    assert run.error_m[-1] < 0.005
