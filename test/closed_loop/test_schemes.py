"""The schemes in lock step where it gets difficult: ends of ranges, noise, late stamps, drift."""

import dataclasses

import numpy as np
import pytest
from cases import each
from lock_step import EXACT, GOAL_RAD, START_RAD, feature_at, loop_from, run

from fvs_controller_node.reasons import State
from fvs_estimator_node.files import load_model
from fvs_lab.trials import HOME_RAD, make_cases, simulation_of
from fvs_ros.kinds.ball import Ball
from fvs_ros.paths import find_file
from fvs_sim_node.simulation import SimConfig, Simulation
from fvs_tools.closed_loop import ClosedLoop, make_estimator

each_scheme = pytest.mark.parametrize("name", ["best", "extended"])


# ---- joints at the ends of their ranges -------------------------------------------------------


@each_scheme
@pytest.mark.parametrize(
    ("start_rad", "target_m", "end", "within_reach"),
    [
        ((-0.294, -1.405, 1.605, -1.697, -1.074, 0.293), (0.271, 0.252, 1.529), (1, -1.143), False),
        ((0.150, -0.953, 1.876, -2.025, -1.770, 0.374), (-0.220, 0.412, 1.423), (0, -0.350), True),
    ],
    ids=["out of reach", "within reach"],
)
def test_the_others_do_what_a_joint_at_its_end_cannot_and_do_not_swing(
    name, start_rad, target_m, end, within_reach
):
    joint, end_rad = end
    side = "joint_min_rad" if within_reach else "joint_max_rad"
    ends_rad = [-6.2 if within_reach else 6.2] * len(start_rad)
    ends_rad[joint] = end_rad
    loop = loop_from(name, np.array(start_rad), **{side: ends_rad})
    commands, errors_m = run(loop, np.array(target_m), 2.5 if within_reach else 5.0)
    if within_reach:
        assert errors_m[-60:].max() < 0.005
    else:
        assert np.ptp(commands[-250:], axis=0).max() < 0.15
        assert errors_m[-1] < 1.1 * errors_m.min()


def test_a_joint_brakes_before_its_end_behind_a_drive_that_lags():
    simulation = simulation_of(dataclasses.replace(EXACT, joint_lag_s=0.06))
    passed_rad = []
    for case in make_cases("END", 2, 83):
        start, goal = np.array(case.start_rad), np.array(case.goal_rad)
        # Each joint's range ends where it has gone less than half of its way.
        end = start + 0.4 * (goal - start) + 0.02 * np.sign(goal - start)
        up = goal > start
        values = {
            "law": "ftsm",
            "joint_min_rad": np.where(up, -6.2, end).tolist(),
            "joint_max_rad": np.where(up, end, 6.2).tolist(),
        }
        target_m = feature_at(simulation, goal)
        simulation.reset(start, case.seed)
        loop = ClosedLoop(simulation, make_estimator("frozen", simulation), values)
        loop.run(0.4)
        loop.set_target(target_m)
        for _ in range(250):
            loop.tick()
            passed_rad.append(np.where(up, 1.0, -1.0) * (simulation.joints_rad - end))
    assert np.max(passed_rad) < 2e-3


# ---- images stamped late, noisy, or of another chain ------------------------------------------


def run_stamped_late(name, late_s):
    """A loop by images whose stamps are late, its errors, m, and its last command."""
    simulation = Simulation(dataclasses.replace(EXACT, latency_s=0.1))
    target_m = feature_at(simulation, HOME_RAD - 0.15)
    advance = simulation.advance

    def stamped_late():
        out = advance()
        late = [dataclasses.replace(o, stamp_s=o.stamp_s + late_s) for o in out.observations]
        return dataclasses.replace(out, observations=late)

    simulation.advance = stamped_late
    loop = loop_from(name, HOME_RAD + 0.15, simulation)
    commands, errors_m = run(loop, target_m, 3.0)
    return loop, errors_m, commands[-1]


@each_scheme
def test_images_stamped_30_ms_late_cost_no_time_and_100_ms_late_hold_the_arm(name):
    loop, errors_m, _ = run_stamped_late(name, 0.03)
    assert errors_m[round(1.2 / loop.period_s) :].max() < 0.005
    loop, errors_m, _ = run_stamped_late(name, 0.05)  # no late start is taken for a frozen image
    assert errors_m[round(2.0 / loop.period_s) :].max() < 0.005
    loop, _, command = run_stamped_late(name, 0.1)
    np.testing.assert_array_equal(command, 0.0)
    assert "check" in loop.loop.supervisor.last.text
    assert "stamp_delay_s" in loop.loop.supervisor.last.text


@each(
    ("name", "image_rate_hz", "after_s", "seed"),
    [
        # The cases that went wrong once did so by chance: several seeds.
        *((name, 30.0, 2.5, seed) for name in ("best", "extended") for seed in (0, 1)),
        # With fewer images it takes longer to know the noise, and the arm swings until then.
        ("best", 10.0, 11.0, 0),
    ],
)
def test_the_noise_of_images_is_learned_and_not_thrown_back_at_the_arm(
    name, image_rate_hz, after_s, seed
):
    noise_m = 0.010
    simulation = Simulation(dataclasses.replace(EXACT, image_rate_hz=image_rate_hz))
    target_m = feature_at(simulation, HOME_RAD - 0.3)
    simulation.position_noise = lambda rng: noise_m * rng.normal(size=3)
    loop = loop_from(name, HOME_RAD + 0.2, simulation, seed)
    loop.set_target(target_m)
    loop.run(after_s)
    commands, errors_m = run(loop, target_m, 2.0)
    assert np.sqrt(np.mean(np.square(errors_m))) < 0.5 * noise_m
    assert np.abs(commands).max() < 0.1
    assert loop.loop.eyes[0].track.filter.noise_m == pytest.approx(noise_m, rel=0.3)


# ---- from target to target the joints do not turn away without end ----------------------------


def test_a_target_that_goes_round_and_round_is_followed_near_the_posture_of_the_start():
    radius_m, speed_m_s = 0.1, 0.15
    loop = loop_from("extended", HOME_RAD)
    simulation = loop.simulation
    began_s, start_m = simulation.time_s, simulation.true_pose().position_m
    away_rad, next_s = 0.0, 0.0
    while (now_s := simulation.time_s - began_s) < 12.0:
        if now_s >= next_s:
            angle = speed_m_s / radius_m * now_s
            loop.set_target(start_m + radius_m * np.array([np.cos(angle) - 1, 0.0, np.sin(angle)]))
            next_s += 1.0 / 30.0
        assert loop.tick().state is State.SERVOING
        away_rad = max(away_rad, np.abs(simulation.joints_rad - HOME_RAD).max())
    # The first round takes 0.32. Without the way back: 0.6 there, and ever more.
    assert away_rad < 0.4


# ---- by rendered images -----------------------------------------------------------------------


@each("latency_s", [0.0, 0.12])
def test_from_a_third_of_a_metre_the_ball_is_on_target_in_time(latency_s):
    simulation, rng = Simulation(SimConfig(seed=1, latency_s=latency_s)), np.random.default_rng(1)
    estimator = make_estimator("rbf", simulation)
    loop = ClosedLoop(simulation, estimator, {"max_joint_velocity_rad_s": 1.0})
    loop.run(0.3)
    trained = load_model(find_file(Ball().model))
    for _ in range(2):
        here_m = simulation.true_pose().position_m
        target_m = trained.target(here_m, 0.3, rng)
        commands, errors_m = run(loop, target_m, 3.0)
        assert errors_m[round(1.5 / loop.period_s) :].max() < 0.005
        assert np.sqrt(np.mean(errors_m[round(2.0 / loop.period_s) :] ** 2)) < 0.0015
        assert np.abs(commands).max() <= 1.0
        assert np.abs(np.diff(commands, axis=0)).max() <= 6.0 * loop.period_s + 1e-12


def test_no_joint_speeds_up_while_the_newest_image_is_in_doubt():
    simulation = simulation_of(EXACT)
    target = feature_at(simulation, GOAL_RAD)
    loop = loop_from("best", START_RAD, simulation)
    loop.set_target(target)
    before, doubtful = np.zeros(6), 0
    for tick in range(40):
        if tick == 10:
            simulation.camera = simulation.camera.moved(np.array([0.0, 0.05, 0.0]))
        velocity = loop.tick().velocity_rad_s
        if loop.loop.eyes[0].track.filter.outliers:
            doubtful += 1
            assert np.all(np.abs(velocity) <= np.abs(before))
            assert np.all(velocity * before >= 0.0)
        before = velocity
    assert doubtful > 2
