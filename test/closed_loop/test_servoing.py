"""The schemes in lock step: how fast, how exact, how calm, and when the arm is held."""

import dataclasses

import numpy as np
from cases import each
from lock_step import EXACT, EXACT_POSE, feature_at, loop_from, run

from fvs_controller_node.reasons import Reason, State
from fvs_lab.trials import HOME_RAD, make_cases, simulation_of
from fvs_sim_node.simulation import Simulation
from fvs_tools.schemes import BEYOND, SCHEMES

ALL = [*SCHEMES, *BEYOND]
(CASE,) = make_cases("t", 1, 21, 0.28, 0.32)


def servo(name, seconds=3.0, **values):
    """A loop after a way of 30 cm, its commands, rad/s, and errors, m."""
    target_m = feature_at(simulation_of(EXACT), np.array(CASE.goal_rad))
    loop = loop_from(name, np.array(CASE.start_rad), **values)
    return loop, *run(loop, target_m, seconds)


@each(
    ("name", "values"),
    [
        *((name, {}) for name in ALL),
        ("rbf+pid", {"redundancy_resolution": "least_speed"}),
        ("proposed", {"lambda1": 0.75, "lambda2": 0.0}),
        ("proposed", {"max_joint_acceleration_rad_s2": 2.0}),
        ("best", {"max_joint_velocity_rad_s": 2.0}),
        ("best", {"max_joint_jerk_rad_s3": 200.0}),
        ("proposed", {"max_joint_jerk_rad_s3": 200.0}),
    ],
)
def test_from_30_cm_it_settles_within_the_limits_and_stays_exact_and_calm(name, values):
    loop, commands, errors_m = servo(name, **values)
    late = round(2.0 / loop.period_s)
    assert loop.loop.supervisor.last.reason is Reason.SETTLED
    assert errors_m[round(1.5 / loop.period_s) :].max() < 0.005
    assert np.sqrt(np.mean(errors_m[late:] ** 2)) < 0.0015
    arrived = np.flatnonzero(errors_m < 0.005)[0]
    assert errors_m[arrived:].max() < 0.02
    assert np.sqrt(np.mean(np.diff(commands[late:], axis=0) ** 2, axis=0)).max() < 0.004
    assert np.sqrt(np.mean(commands[late:] ** 2, axis=0)).max() < 0.03
    assert np.abs(commands).max() <= values.get("max_joint_velocity_rad_s", 1.0) + 1e-12
    acceleration = values.get("max_joint_acceleration_rad_s2", 6.0)
    assert np.abs(np.diff(commands, axis=0)).max() <= acceleration * loop.period_s + 1e-12
    jerk = values.get("max_joint_jerk_rad_s3", np.inf)
    assert np.abs(np.diff(commands, 2, axis=0)).max() <= jerk * loop.period_s**2 + 1e-12


@each("rate_hz", [60, 1000])
def test_any_rate_of_joint_states_will_do(rate_hz):
    rates = {"joint_state_rate_hz": rate_hz, "physics_rate_hz": 0}
    simulation = Simulation(dataclasses.replace(EXACT, **rates))
    target_m = feature_at(simulation, np.array(CASE.goal_rad))
    values = {"joint_state_rate_hz": float(rate_hz)}
    loop = loop_from("proposed", np.array(CASE.start_rad), simulation, **values)
    _, errors_m = run(loop, target_m, 2.0)
    assert errors_m[round(1.5 / loop.period_s) :].max() < 0.005


@each(("name", "conditions"), [*((name, EXACT) for name in ALL), ("best", EXACT_POSE)])
def test_a_frozen_image_with_fresh_stamps_is_found_before_the_arm_goes_far(name, conditions):
    simulation = simulation_of(conditions)
    target = feature_at(simulation, np.array(CASE.goal_rad))
    loop = loop_from(name, np.array(CASE.start_rad), simulation)
    _, errors_m = run(loop, target, 0.2)
    add_image, frozen = loop.loop.add_image, loop.true_feature
    loop.loop.add_image = lambda now_s, stamp_s, _, *eye: add_image(now_s, stamp_s, frozen, *eye)
    commands, later_m = run(loop, target, 0.6)
    assert loop.loop.supervisor.last.reason is Reason.IMAGE_NOT_FOLLOWING
    assert not commands[-1].any()
    assert later_m.max() < 1.2 * errors_m[0]


def follow(name, speed_m_s, noise_m, feed_forward):
    """Rms distance from a target on a circle, m, and of the command's step, rad/s, after 1.5 s."""
    rng, radius_m = np.random.default_rng(7), 0.08
    loop = loop_from(name, HOME_RAD, target_feed_forward=feed_forward)
    start_m, commands, errors_m, next_s = loop.true_feature, [], [], 0.0
    for tick in range(round(3.0 / loop.period_s)):
        angle = speed_m_s / radius_m * tick * loop.period_s
        true_m = start_m + radius_m * np.array([np.cos(angle) - 1.0, np.sin(angle), 0.0])
        if tick * loop.period_s >= next_s:
            loop.set_target(true_m + noise_m * rng.normal(size=3))
            next_s += 1.0 / 30.0
        command = loop.tick()
        assert command.state is State.SERVOING
        commands.append(command.velocity_rad_s)
        errors_m.append(np.linalg.norm(loop.true_feature - true_m))
    late = round(1.5 / loop.period_s)
    steps = np.diff(commands[late:], axis=0)
    return np.sqrt(np.mean(np.square(errors_m[late:]))), np.sqrt(np.mean(steps**2))


@each("name", ["proposed", "best"])
@each(
    ("speed_m_s", "noise_m", "ratio", "step_ratio", "most_m"),
    [(0.1, 0.0, 0.34, 2.0, 0.002), (0.0, 3e-3, 1.2, 1.2, 0.0023)],
)
def test_feed_forward_follows_a_moving_target_and_leaves_the_noise_of_a_still_one(
    name, speed_m_s, noise_m, ratio, step_ratio, most_m
):
    (rms_m, step), (rms_without_m, step_without) = (
        follow(name, speed_m_s, noise_m, on) for on in (True, False)
    )
    assert rms_m < min(most_m, ratio * rms_without_m)
    assert step < step_ratio * step_without
