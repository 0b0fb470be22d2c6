"""Whatever happens to the controller, in whatever order: it keeps its promises at every tick.

The world and the promises are those of ``bench/fuzz_world.py``; ``make bench ARGS=fuzz`` plays a
million ticks of it, these tests play fewer, always the same.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bench import bench_mutants, fuzz_world
from bench.bench_mutants import ROWS
from bench.fuzz_world import AMBUSHES, SCENES, Episode, Scene, World
from fvs_controller_node.reasons import Reason
from fvs_controller_node.registry import LAWS

README = Path(__file__).resolve().parents[2] / "README.md"
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of numpy, about wild numbers


def some(examples):
    return settings(
        max_examples=examples,
        derandomize=True,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )


@some(40)
@given(episode=fuzz_world.episodes())
def test_no_episode_breaks_a_promise(episode):
    World(episode).play()


@pytest.mark.parametrize("law", sorted(LAWS))
@pytest.mark.parametrize("name", sorted(SCENES))
def test_no_scene_breaks_a_promise_with_any_law(law, name):
    for variant in range(0, 12, 2 if name in ("clocks", "target") else 5):
        World(Episode(law=law, scenes=(Scene(name, 20, variant),))).play()


class Unasked(World):
    """A world in which nobody calls ``~/start``."""

    def start(self):
        pass


@some(15)
@given(episode=fuzz_world.episodes())
def test_nothing_but_a_start_starts_it(episode):
    asked = tuple(pair for pair in episode.parameters if pair[0] != "autostart")
    world = Unasked(dataclasses.replace(episode, parameters=asked))
    assert not world.play().moving_ticks


@some(15)
@given(
    start=st.lists(st.floats(-7.0, 7.0), min_size=6, max_size=6),
    seed=st.integers(0, 2**32 - 1),
    plant=st.sampled_from(["obeys", "creeps", "one joint sticks"]),
)
def test_an_arm_that_obeys_never_passes_the_ends_of_its_range(start, seed, plant):
    world = World(Episode(seed=seed, plant=plant, rehearsed=False))
    lower, upper = (
        np.array(world.node.values[name]) for name in ("joint_min_rad", "joint_max_rad")
    )
    world._joints = np.clip(start, lower, upper)
    world._away = fuzz_world.TRUE_JACOBIAN @ (np.array(fuzz_world.START_RAD) - world._joints)
    world.calm(fuzz_world.FRESH_TICKS)
    world.aim(np.random.default_rng(seed), 1.0)
    world.start()
    for _ in range(100):
        world.calm(1)
        assert np.all(world._joints <= upper + 1e-9)
        assert np.all(world._joints >= lower - 1e-9)
    assert world.moving_ticks


#: What it takes to meet the reasons.
TO_SEE = (
    (Scene("services", 60, 9),),  # READY
    (Scene("work", 60, 1), Scene("long wait", 60)),  # SERVOING, SETTLED
    (Scene("silence", 40, 2),),  # STALE
    (Scene("silence", 30, 0), Scene("calm", 9)),  # RETURNING
    (Scene("garbage", 60, 6),),  # BAD_INPUT
    (Scene("clocks", 20, 9),),  # NO_POSITION
    (Scene("estimator", 10, 7),),  # NEAR_SINGULAR
    (Scene("work", 5, 3), Scene("wrong way", 60, 0)),  # PREDICTION_ERROR
    (Scene("work", 5, 3), Scene("swing", 60, 1)),  # OSCILLATING
    (Scene("work", 60, 1), Scene("long wait", 60), Scene("push", 60, 9)),  # ERROR_GROWING
    (Scene("another ball", 60, 0),),  # IMAGE_NOT_FOLLOWING
    (Scene("another ball", 60, 6),),  # STALLED
    (Scene("arm", 59, 3),),  # NOT_FOLLOWING
    (Scene("robot", 5, 0), Scene("robot", 5, 9)),  # PROGRAM_STOPPED, PAUSE_OVER
    (Scene("robot", 5, 4),),  # SPEED_SCALING_ZERO
    (Scene("mad law", 6, 0),),  # LAW_FAULT
    (Scene("shutdown", 5, 0),),  # SHUT_DOWN
    (Scene("abandoned", 60, 1),),  # HELD_LONG
    (Scene("rival", 20, 0),),  # CONFLICT
)


def test_every_reason_is_met():
    met = set()
    for scenes in TO_SEE:
        for seed in range(3):
            met |= set(World(Episode("proportional", seed, scenes=scenes)).play().reasons)
    assert met == set(Reason), f"not met: {[reason.name for reason in set(Reason) - met]}"


MUTANTS = [(row, mutant) for row, mutants in ROWS.items() for mutant in mutants]


@pytest.mark.parametrize(
    ("row", "mutant"), MUTANTS, ids=[f"{row}: {mutant.name}" for row, mutant in MUTANTS]
)
def test_a_controller_that_lacks_a_row_of_the_safety_table_is_found_out(row, mutant):
    assert mutant.promise in bench_mutants.broken(mutant), f"nobody misses {mutant.name}"
    assert not bench_mutants.broken(mutant, whole=True)


def test_every_row_of_the_safety_table_is_promised():
    table = README.read_text().split("| when | the arm |")[1].split("\n\n")[0]
    told = [line.strip("| ") for line in table.splitlines()[2:]]
    known = [*ROWS, *bench_mutants.ELSEWHERE]
    assert [begin for begin in known if not any(row.startswith(begin) for row in told)] == []
    assert [row for row in told if not row.startswith(tuple(known))] == []


# ---- the shortest episodes that once broke a promise ------------------------------------------

STALLS = Scene("another ball", 60, 5)


@pytest.mark.parametrize("ambush", ["program", "speed scaling", "bad joints", "bad ball"])
def test_a_pause_or_a_bad_message_stops_at_once_an_arm_that_is_coming_to_rest(ambush):
    assert ambush in AMBUSHES
    World(Episode(law="proportional", ambush=ambush, scenes=(STALLS,))).play()


def test_a_joint_that_is_slow_near_its_limit_is_not_carried_over_it_by_a_ramp():
    world = World(
        Episode(
            parameters=(
                ("max_joint_velocity_rad_s", 2.0),
                ("max_joint_acceleration_rad_s2", 0.5),
                ("joint_limit_margin_rad", 0.01),
            )
        ),
    )
    world.calm(fuzz_world.FRESH_TICKS)
    supervisor_ = world.node._loop.supervisor
    # Fast in one joint, and in another as fast as it can just brake before its end.
    world._joints[1] = 0.0
    room, end = 0.02, world.node.values["joint_max_rad"][0]
    world._joints[0] = end - room
    world.calm(1)
    supervisor_._velocity = np.array([0.1, 2.0, 0.0, 0.0, 0.0, 0.0])
    world._last = tuple(supervisor_._velocity.tolist())
    world.calm(400)


def test_a_limit_that_is_lowered_in_motion_is_reached_by_braking_with_all_it_has():
    world = World(Episode(law="proportional"))
    world.play()
    world.aim(np.random.default_rng(1), 1.0)
    world.calm(40)
    before = world.node._loop.supervisor.velocity_rad_s
    assert np.abs(before).max() > 0.5
    world.reconfigure([("max_joint_velocity_rad_s", 0.05)])
    ticks = 0
    while np.abs(world.node._loop.supervisor.velocity_rad_s).max() > 0.05:
        world.calm(1)
        ticks += 1
        assert ticks <= np.ceil((np.abs(before).max() - 0.05) / (6.0 * 0.008))
    world.calm(50)
