"""Is each row of the README's safety table kept? A controller without it is found out.

python -m bench mutants. Each mutant lacks one rule: it never finds a reason, does not heed a
parameter, or has a function replaced. In the script beside it the promises of
:mod:`bench.fuzz_promises` are seen broken, and the controller as it is keeps them.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, NamedTuple
from unittest import mock

from bench import fuzz_world
from bench.fuzz_machine import IMPATIENT, Machine
from bench.fuzz_promises import BrokenPromiseError
from bench.fuzz_world import BALL, FRESH_TICKS, HOME_RAD, JACOBIAN
from fvs_controller_node.node import ControllerNode
from fvs_controller_node.reasons import Finding, Reason
from fvs_ros.camera import CAMERA_FRAME

# ---- scripts: what happens to the controller ----------------------------------------------


def waits_for_a_start(m: Machine) -> None:
    m.world.run(FRESH_TICKS)
    m.odd_target(None)
    m.wait(40)
    m.call("stop", 10)


def arrives(m: Machine) -> None:
    m.work(ticks=300)


def inputs_fall_silent(m: Machine) -> None:
    m.work()
    m.silence([BALL])
    m.silence([JACOBIAN])
    m.wait(40)


def stamps_freeze(m: Machine) -> None:
    m.work()
    m.silence(frozen=[BALL], ticks=60)


def input_is_silent_for_long(m: Machine) -> None:
    m.work()
    m.change(IMPATIENT)
    m.silence([BALL], ticks=90, steady_s=0.03)
    m.wait(60)


def clocks_differ(m: Machine) -> None:
    m.work()
    m.silence([BALL], ticks=2)
    m.world.ros_s += 10.0
    m.silence([BALL], ticks=8)
    m.wait(40)


def joint_is_not_a_number(m: Machine) -> None:
    m.work()
    m.odd_joints(odd={2: math.nan})
    m.wait(20)


def another_node_commands(m: Machine) -> None:
    m.work()
    m.other_commander((0.1,) * HOME_RAD.size)


def targets_are_wrong(m: Machine) -> None:
    m.work()
    m.odd_target(None, "base")
    m.odd_target((2.0, 0.0, 1.5))


def joint_meets_its_end(m: Machine) -> None:
    m.work(ticks=0)
    m.call("stop", 40)
    m.to_the_limit(0, 1, 0.1, 120)


def jacobian_is_singular(m: Machine) -> None:
    m.work()
    m.estimator(smallest=0.01, ticks=40)


def image_is_reversed(m: Machine) -> None:
    m.change({"stall_time_s": 60.0, "max_joint_velocity_rad_s": 0.1})
    m.work(ticks=5)
    m.show(-1.0, 600, 0.02)


def image_freezes(m: Machine) -> None:
    m.work(ticks=5)
    m.show(0.0, 150, 0.02)


def ball_is_pushed_away(m: Machine) -> None:
    m.work(ticks=200)
    m.change({"max_joint_velocity_rad_s": 0.02})
    m.push((0.25, 0.15, 0.2), 300, 0.02)


def target_is_out_of_reach(m: Machine) -> None:
    m.change(IMPATIENT)
    m.work(ticks=0)
    m.close_in((0.0,) * HOME_RAD.size)
    m.wait(200, 0.03)


def ball_swings(m: Machine) -> None:
    m.work(ticks=5)
    m.change({"max_joint_velocity_rad_s": 0.02, "stall_time_s": 60.0})
    m.swing(0.1, 500)


def arm_is_stuck(m: Machine) -> None:
    m.work(ticks=0)
    m.arm("ignores", 600)


def program_stops_and_runs(m: Machine) -> None:
    m.work()
    m.robot(running=False)
    m.robot()


def slider_is_at_zero(m: Machine) -> None:
    m.work()
    m.robot(percent=0.0)


def law_fails(m: Machine) -> None:
    m.work()
    m.mad_law([], [])


# ---- mutants ------------------------------------------------------------------------------


def lacks(*names: str) -> AbstractContextManager:
    """The controller never finds these reasons."""

    def because(self: Reason, **numbers: object) -> Finding | None:
        return None if self.name in names else Finding(self, numbers)

    return mock.patch.object(Reason, "because", because)


def disregards(**values: Any) -> AbstractContextManager:
    """The controller has these values, whatever it is given."""
    dry = fuzz_world.DryController

    def make(given: dict[str, Any], *rest: Any) -> fuzz_world.DryController:
        return dry({**given, **values}, *rest)

    return mock.patch.object(fuzz_world, "DryController", make)


def takes_any_frame() -> AbstractContextManager:
    """The controller takes every target for one in the camera's frame."""
    on_target = ControllerNode._on_target

    def take(self: ControllerNode, message: Any) -> None:
        message.header.frame_id = CAMERA_FRAME
        on_target(self, message)

    return mock.patch.object(ControllerNode, "_on_target", take)


class Mutant(NamedTuple):
    """The controller without one rule.

    Parameters
    ----------
    promise : str
        What is seen broken.
    make : callable
        Makes the context in which the controller lacks the rule.
    script : callable
        What happens.
    """

    promise: str
    make: Callable[[], AbstractContextManager]
    script: Callable[[Machine], None]


def _lacks(promise: str, script: Callable[[Machine], None], *names: str) -> Mutant:
    return Mutant(promise, functools.partial(lacks, *names), script)


def _disregards(promise: str, script: Callable[[Machine], None], **values: Any) -> Mutant:
    return Mutant(promise, functools.partial(disregards, **values), script)


def _replaces(promise: str, script: Callable[[Machine], None], where: str, by: Any) -> Mutant:
    return Mutant(promise, functools.partial(mock.patch, where, by), script)


_ASKED, _FRESH, _ZEROS = "moves when asked only", "fresh inputs", "zeros whatever came first"
_TOLD, _GROWS = "a wrong target changes nothing", "an error that grows is held"
_WIDE = {"workspace_min_m": [-9.0] * 3, "workspace_max_m": [9.0] * 3}

#: The table's rows, as they begin, and the controllers without them, by name.
ROWS: dict[str, dict[str, Mutant]] = {
    "before everything is fresh": {
        "starts by itself": _disregards(_ASKED, waits_for_a_start, autostart=True),
    },
    "joint states older": {
        "never late": _lacks(_FRESH, inputs_fall_silent, "STALE"),
        "trusts at once": _lacks(
            "several good messages end a trouble", inputs_fall_silent, "RETURNING"
        ),
    },
    "a message that is not finite": {
        "takes anything": _lacks(_ZEROS, joint_is_not_a_number, "BAD_INPUT")
    },
    "held for more": {"resumes for ever": _lacks(_ASKED, input_is_silent_for_long, "HELD_LONG")},
    "another node commands": {
        "shares": _replaces(
            _ASKED,
            another_node_commands,
            "fvs_controller_node.inbox.Inbox.conflicting_command",
            lambda *_: None,
        )
    },
    "messages whose stamps": {
        "counts all": _replaces(
            _FRESH, stamps_freeze, "fvs_ros.timeline.StampGate.advances", lambda *_: True
        ),
    },
    "always": {
        "too fast": _disregards("velocity limit", arrives, max_joint_velocity_rad_s=1.5),
        "too sudden": _disregards("acceleration limit", arrives, max_joint_acceleration_rad_s2=9.0),
        "does not slow down": _replaces(
            *("only slower", inputs_fall_silent, "fvs_controller_node.limiter.ramp_to_zero"),
            lambda velocity, _step: 1.001 * velocity,
        ),
        "no end of a range": _disregards(
            "stops before its limit", joint_meets_its_end, joint_max_rad=[9.0] * HOME_RAD.size
        ),
    },
    "a target in another frame": {
        "any frame": Mutant(_TOLD, takes_any_frame, targets_are_wrong),
        "any place": _disregards(_TOLD, targets_are_wrong, **_WIDE),
    },
    "the Jacobian near singular": {
        "goes on": _lacks("held near a singularity", jacobian_is_singular, "NEAR_SINGULAR"),
    },
    "the Jacobian predicting badly": {
        "believes it": _lacks("a wrong Jacobian is held", image_is_reversed, "PREDICTION_ERROR"),
    },
    "the error grows": {
        "grows": _lacks(_GROWS, ball_is_pushed_away, "ERROR_GROWING"),
        "stalls": _lacks("an error that does not fall is held", target_is_out_of_reach, "STALLED"),
        "swings": _lacks("a swing is held", ball_swings, "OSCILLATING"),
    },
    "the image does not follow": {
        "believes it": _lacks("a frozen image is held", image_freezes, "IMAGE_NOT_FOLLOWING"),
    },
    "the arm does not move": {
        "pushes on": _lacks("an arm that does not follow is held", arm_is_stuck, "NOT_FOLLOWING"),
    },
    "the robot program stopped": {
        "program": _lacks(_ZEROS, program_stops_and_runs, "PROGRAM_STOPPED"),
        "speed slider": _lacks(_ZEROS, slider_is_at_zero, "SPEED_SCALING_ZERO"),
    },
}

#: Rows that a process and its wires keep, not the loop: row -> the tests that guard it.
ELSEWHERE = {
    "a message above": "test/faults/test_fuzz_messages.py",
    "Ctrl-C, any signal": "test/faults/test_hostile_terminal.py",
}

MUTANTS = {
    f"{row}: {name}": mutant for row, mutants in ROWS.items() for name, mutant in mutants.items()
}
#: Every script, by name: together they meet every reason.
SCRIPTS = {
    one.__name__: one for one in (*(m.script for m in MUTANTS.values()), clocks_differ, law_fails)
}


def play(script: Callable[[Machine], None]) -> Machine:
    """Play a script to its end."""
    machine = Machine()
    machine.begin()
    script(machine)
    machine.teardown()
    return machine


def caught(mutant: Mutant) -> str:
    """How the mutant breaks its promise in its script; empty if it keeps it."""
    try:
        with mutant.make():
            play(mutant.script)
    except BrokenPromiseError as error:
        return str(error) if error.promise == mutant.promise else ""
    return ""


def main() -> None:
    """Print a line for each mutant."""
    for script in SCRIPTS.values():
        play(script)
    missed = []
    for name, mutant in MUTANTS.items():
        how = caught(mutant)
        print(f"{'caught' if how else 'MISSED'}  {name:48s} {how:.90s}")
        missed += [] if how else [name]
    if missed:
        raise RuntimeError(f"{len(missed)} mutants not caught: {', '.join(missed)}")
    print(f"{len(MUTANTS)} of {len(MUTANTS)} mutants caught")


if __name__ == "__main__":
    main()
