"""Whatever happens to the controller, in whatever order: it keeps its promises at every tick.

World and promises are those of ``bench/``; ``make bench ARGS=fuzz`` plays a million ticks, these
tests play fewer.
"""

from pathlib import Path

import numpy as np
import pytest
from cases import each
from hypothesis import settings

from bench import bench_fuzz, bench_mutants
from bench.bench_fuzz import Machine
from bench.bench_mutants import MUTANTS, SCRIPTS, do
from bench.fuzz_world import BALL, FRESH_TICKS, JOINT_STATES, World
from fvs_controller_node.reasons import Reason
from fvs_ros import ros
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.interface import POSITION
from fvs_ros.kinds.ball import Ball
from fvs_ros.ros import commands

SAFETY = Path(__file__).resolve().parents[2] / "docs" / "safety.md"
FEW = settings(bench_fuzz.SETTINGS, max_examples=8)
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of numpy, about odd numbers


def test_no_promise_is_broken_whatever_happens():
    counts, broken = bench_fuzz.play(0, ticks=2_000, settings=FEW)
    assert not broken, broken
    assert counts["moving"] > 200


def test_every_reason_is_met():
    met = set()
    for script in SCRIPTS.values():
        met |= set(bench_mutants.play(script).reasons)
    assert met == {reason.name for reason in Reason}


@each("mutant", MUTANTS)
def test_a_controller_that_lacks_a_row_of_the_safety_table_is_found_out(mutant):
    assert bench_mutants.caught(mutant)


def test_every_row_of_the_safety_table_is_promised():
    table = SAFETY.read_text().split("| when | the arm |")[1].split("\n\n")[0]
    rows = [line.strip("| ") for line in table.splitlines()[2:]]
    tested = bench_mutants.TESTED
    known = {mutant.row for mutant in (*MUTANTS, *tested) if mutant.row}
    assert [begin for begin in known if not any(row.startswith(begin) for row in rows)] == []
    assert [row for row in rows if not row.startswith(tuple(known))] == []
    for mutant in tested:
        file, _, name = mutant.test.partition("::")
        assert f"def {name}" in (SAFETY.parents[1] / "test" / file).read_text(), file


# ---- scripts that once broke a promise --------------------------------------------------------


#: The ball is silent, and the arm on its ramp to rest.
ON_ITS_RAMP = [do("work"), do("wait", 32, silent=[BALL])]


@each(
    ("script", "reason"),
    [
        ([*ON_ITS_RAMP, do("robot", running=False)], "PROGRAM_STOPPED"),
        ([*ON_ITS_RAMP, do("robot", percent=0.0)], "SPEED_SCALING_ZERO"),
        ([*ON_ITS_RAMP, do("odd_joints", odd={0: np.nan})], "BAD_INPUT"),
        ([*ON_ITS_RAMP, do("odd_ball", {1: np.inf})], "BAD_INPUT"),
        (
            [
                *(do("work"), do("odd_ball", {0: np.nan}), do("other_commander", (0.1,), ticks=1)),
                *(do("show", 1.0, 4, 0.3), do("wait", 20)),
            ],
            "BAD_INPUT",
        ),
        (
            [do("work"), do("other_commander", (0.5,), ticks=1), do("robot", percent=-1.0)],
            "SPEED_SCALING_ZERO",
        ),
    ],
)
def test_what_stops_at_once_does_also_in_another_trouble(script, reason):
    world = bench_mutants.play([*script, do("wait", 5)])
    assert world.reasons[reason]
    assert not world.last.any()


def test_a_limit_that_is_lowered_in_motion_is_reached_by_braking_with_all_it_has():
    machine = Machine()
    machine.begin()
    machine.work(0.5 * np.sign(machine.home_rad) + 0.3, ticks=40)
    fastest = np.abs(machine.last).max()
    assert fastest > 0.5
    machine.change({"max_joint_velocity_rad_s": 0.05})
    machine.run(int(np.ceil((fastest - 0.05) / (6.0 * 0.008))))
    assert np.abs(machine.last).max() <= 0.05


def test_the_law_changes_only_while_the_arm_is_stopped():
    machine = Machine()
    machine.begin(at_work=True)
    for stop, law in ((lambda: None, "proportional"), (machine.stop, "ftsm")):
        stop()
        machine.change({"law": "ftsm"})
        assert machine.node.values["law"] == law


def test_a_jump_that_is_stamped_ahead_stops_the_arm_and_is_forgotten():
    machine = Machine()
    machine.begin(at_work=True)
    ahead = machine.joints + np.eye(6)[5]
    machine.send_joints(ahead, machine.ros_s + 0.05)
    assert not machine.last.any()
    machine.wait(10)
    assert machine.last.any()


def test_joint_states_of_another_arm_lead_away_no_position_that_is_held():
    world = Machine()
    world.begin(interface=POSITION, at_work=True)
    world.odd_ball({0: np.nan})
    world.run(20, silent=[BALL])
    held = world.goes_to
    for of_another in np.repeat([True, False] * 30, 2):
        world.ros_s += 0.004
        world.send_joints(world.joints + 0.5 * of_another, world.ros_s)
    assert world.session
    np.testing.assert_allclose(world.goes_to, held, atol=1e-9)


def test_a_target_is_heard_again_but_the_same_latched_message_not_twice():
    world = World()
    world.run(FRESH_TICKS)
    for stamp_s, counts_again in ((0.0, True), (world.ros_s, False)):
        target_m = world.ball() + [0.1, 0.0, 0.0]
        message = ros.to_feature(stamp_s, CAMERA_FRAME, Ball(), target_m)
        world.node._on_target(message)
        np.testing.assert_array_equal(world.target_m, target_m)
        world.run(100)  # longer than an echo takes
        assert world.node.call("~/set_current_as_target")[0]
        world.node._on_target(message)
        assert np.array_equal(world.target_m, target_m) is counts_again


# ---- a driver that checks limits in its own cycle ------------------------------------------------

CYCLE_S = 0.001
DRIVER = {
    "joint_state_rate_hz": 1.0 / CYCLE_S,
    "max_joint_velocity_rad_s": 0.5,
    "max_joint_acceleration_rad_s2": 10.0,
    "max_joint_jerk_rad_s3": 4000.0,
}


def driven(interface="velocity"):
    """A world at 1 kHz, servoing, and what is sent in it from then on."""
    world = World({**DRIVER, "command_interface": interface})
    sent = []
    world.judge = lambda *_: sent.extend(np.array(command.data) for command in world.wire)
    world.run(FRESH_TICKS, steady_s=CYCLE_S)
    world.send_target(world.ball() + world.true @ np.full(6, 0.3))
    world.start()
    return world, sent


@pytest.mark.parametrize("interface", ["velocity", "position"])
def test_neither_jitter_nor_stalls_take_a_driver_beyond_its_limits(interface):
    world, sent = driven(interface)
    for stall_s in (0.0, 0.01, 0.05, 0.3, 0.0):
        world.run(1, steady_s=stall_s + CYCLE_S)
        for jitter_s in np.random.default_rng(0).uniform(-2e-4, 2e-4, 120):
            world.run(1, steady_s=CYCLE_S + jitter_s, ros_s=CYCLE_S)
        world.run(40, steady_s=CYCLE_S, silent=[JOINT_STATES])
    world.stop()
    world.run(300, steady_s=CYCLE_S)
    sent = np.array(sent)
    moved = np.abs(sent[-1] - sent[0]).max() if interface == "position" else 0.0
    velocity = np.diff(sent, axis=0) / CYCLE_S if interface == "position" else sent
    assert np.abs(velocity).max() > 0.2 or moved > 0.05
    rounding = 1.0 + 1e-6 * (interface == "position")
    for order, most in enumerate((0.5, 10.0, 4000.0)):
        assert np.abs(np.diff(velocity, order, axis=0)).max() < rounding * most * CYCLE_S**order


@pytest.mark.parametrize("jerk", [0.0, 4000.0])
def test_a_process_that_ends_brings_the_arm_to_rest_within_a_jerk_limit(monkeypatch, jerk):
    zeros = []
    monkeypatch.setattr(commands, "send_last_zeros", lambda *_: zeros.append(len(sent)))
    world, sent = driven()
    world.set({"max_joint_jerk_rad_s3": jerk})
    world.run(150, steady_s=CYCLE_S)
    before = len(sent)
    assert np.abs(sent[-1]).max() > 0.3
    world.node.finish()
    assert zeros == [len(sent)]
    assert 30 < len(sent) - before < 100 if jerk else len(sent) == before
    if jerk:
        assert np.abs(np.diff(sent, 2, axis=0)).max() < jerk * CYCLE_S**2
        assert not sent[-1].any()
