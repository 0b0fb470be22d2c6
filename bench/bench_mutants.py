"""Is each row of the safety table (docs/safety.md) kept? A controller without it is found out.

python -m bench mutants. Each mutant lacks one rule: it never finds a reason, does not heed a
parameter, or has a function replaced. In the script beside it the promises of
:mod:`bench.fuzz_promises` are seen broken, and the controller as it is keeps them; or the test
beside it fails.
"""

from __future__ import annotations

import math
from contextlib import AbstractContextManager, redirect_stdout
from io import StringIO
from operator import methodcaller as do
from typing import NamedTuple
from unittest import mock

import pytest

from bench import fuzz_world
from bench.bench_fuzz import IMPATIENT, N_AXES, Machine
from bench.fuzz_world import BALL, FRESH_TICKS, JACOBIAN, OBJECT, BrokenPromiseError
from fvs_controller_node.goal import Progress
from fvs_controller_node.inbox import Inbox
from fvs_controller_node.reasons import Finding, Reason
from fvs_controller_node.references import References
from fvs_controller_node.relation import Relation
from fvs_controller_node.supervisor import Supervisor
from fvs_estimator_node.in_view import InView
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_ros.kinds.ball import Ball
from fvs_ros.view import ViewConfig

#: What happens to the controller: rules of the machine. Together they meet every reason.
SCRIPTS = {
    "waits for a start": [
        do("wait", FRESH_TICKS),
        do("odd_target", None),
        do("wait", 40),
        do("call", "stop", 10),
    ],
    "arrives": [do("work", ticks=300)],
    "inputs fall silent": [
        do("work"),
        do("wait", 40, silent=[BALL]),
        do("wait", 40, silent=[JACOBIAN]),
        do("wait", 40),
    ],
    "stamps freeze": [do("work"), do("wait", 60, frozen=[BALL])],
    "silent for long": [
        do("work"),
        do("change", IMPATIENT),
        do("wait", 90, silent=[BALL], steady_s=0.03),
        do("wait", 60),
    ],
    "clocks differ": [
        do("work"),
        do("wait", 1, silent=[BALL]),
        do("wait", 1, ros_s=10.0),
        do("wait", 8, silent=[BALL]),
        do("wait", 40),
    ],
    "a joint is not a number": [do("work"), do("odd_joints", odd={2: math.nan}), do("wait", 20)],
    "another node commands": [do("work"), do("other_commander", (0.1,))],
    "targets are wrong": [
        do("work"),
        do("odd_target", None, "base"),
        do("odd_target", (2.0, 0.0, 1.5)),
    ],
    "a joint meets its end": [
        do("work", ticks=0),
        do("call", "stop", 40),
        do("to_the_limit", 2, 1, 0.1, 120),
    ],
    "the Jacobian is singular": [do("work"), do("estimator", smallest=0.01, ticks=40)],
    "the image is reversed": [
        do("change", {"stall_time_s": 60.0, "max_joint_velocity_rad_s": 0.1}),
        do("work", ticks=5),
        do("show", -1.0, 1500),
    ],
    "the image freezes": [do("work", ticks=5), do("show", 0.0, 150, 0.02)],
    "the ball is pushed away": [
        do("work", ticks=200),
        do("change", {"max_joint_velocity_rad_s": 0.02}),
        do("push", (0.25, 0.15, 0.2), 300, 0.02),
    ],
    "a target out of reach": [
        do("change", IMPATIENT),
        do("work", ticks=0),
        do("close_in", (0.0,)),
        do("wait", 200, steady_s=0.03),
    ],
    "the ball swings": [
        do("work", ticks=5),
        do("change", {"max_joint_velocity_rad_s": 0.02, "stall_time_s": 60.0}),
        do("swing", 0.1, 550),
    ],
    "the arm is stuck": [do("work", ticks=0), do("arm", "ignores", 600)],
    "the program stops": [do("work"), do("robot", running=False), do("robot")],
    "the slider is at zero": [do("work"), do("robot", percent=0.0)],
    "an object moves while it is hidden": [
        do("relate", (0.05, 0.0, 0.0), 100),
        do("change", {"object_may_be_hidden_s": 3.0}),
        do("wait", 60),
        do("carry_hidden", (0.04, 0.03, 0.0)),
    ],
    "an object rides on the tool": [
        do("relate", (0.05, 0.0, 0.0), 100),
        do("grip", (0.15, 0.0, 0.0), 300),
    ],
    "an object falls silent": [
        do("relate", (0.05, 0.0, 0.0), 20),
        do("wait", 60, silent=[OBJECT]),
    ],
    "the law fails": [do("work"), do("mad_law")],
}


def lacks(name):
    """The controller never finds this reason."""

    def because(self, **numbers):
        return None if self.name == name else Finding(self, numbers)

    return mock.patch.object(Reason, "because", because)


def disregards(**values):
    """The controller has these values, whatever it is given."""
    dry = fuzz_world.DryController
    return mock.patch.object(
        fuzz_world, "DryController", lambda overrides, *rest: dry({**overrides, **values}, *rest)
    )


def stays(part, name, value):
    """An attribute of a part of the controller has this value, whatever it is set to."""
    return mock.patch.object(part, name, property(lambda _: value, lambda *_: None), create=True)


class Mutant(NamedTuple):
    """The controller without one rule, the script that shows it, and what is seen broken."""

    #: Of the table, as it begins.
    row: str
    #: The reason that is never found, or how the rule is taken away.
    without: str | AbstractContextManager
    script: str
    promise: str


_ASKED, _FRESH, _ZEROS = "moves when asked only", "fresh inputs", "zeros whatever came first"
_TROUBLE, _TARGET = "several good messages end a trouble", "a wrong target changes nothing"
_SUDDEN, _ENDS = "acceleration limit", "stops before its limit"
_SINGULAR, _WRONG = "held near a singularity", "a wrong Jacobian is held"
_GROWS, _STALLED = "an error that grows is held", "an error that does not fall is held"
_FROZEN, _STUCK = "a frozen image is held", "an arm that does not follow is held"
_FAR = [9.0] * len(UR_JOINT_NAMES)
_NO_LIMIT = {"workspace_min_m": [-9.0] * N_AXES, "workspace_max_m": [9.0] * N_AXES}
_STAMPS = mock.patch("fvs_controller_node.loop.repeats", return_value=False)
_ANY_FRAME = mock.patch.object(Ball, "any_frame", True)
_SHARED = mock.patch("fvs_controller_node.inbox.Inbox.conflicting_command")
_STANDS = stays(Relation, "moved_m", 0.0)
_RAMP = mock.patch("fvs_ros.limiter.ramp_to_zero", lambda velocity, *_: 1.001 * velocity)

MUTANTS = (
    Mutant("until every input", disregards(autostart=True), "waits for a start", _ASKED),
    Mutant("joint states older", "STALE", "inputs fall silent", _FRESH),
    Mutant("joint states older", "RETURNING", "inputs fall silent", _TROUBLE),
    Mutant("a message with a non-finite value", "BAD_INPUT", "a joint is not a number", _ZEROS),
    Mutant("held for more", "HELD_LONG", "silent for long", _ASKED),
    Mutant("another node commands", _SHARED, "another node commands", _ASKED),
    Mutant("stamps that do not advance", _STAMPS, "stamps freeze", _FRESH),
    Mutant("always", disregards(max_joint_velocity_rad_s=1.5), "arrives", "velocity limit"),
    Mutant("always", disregards(max_joint_acceleration_rad_s2=9.0), "arrives", _SUDDEN),
    Mutant("always", _RAMP, "inputs fall silent", "only slower"),
    Mutant("always", disregards(joint_max_rad=_FAR), "a joint meets its end", _ENDS),
    Mutant("a target in another frame", _ANY_FRAME, "targets are wrong", _TARGET),
    Mutant("a target in another frame", disregards(**_NO_LIMIT), "targets are wrong", _TARGET),
    Mutant("the Jacobian near singular", "NEAR_SINGULAR", "the Jacobian is singular", _SINGULAR),
    Mutant("the Jacobian predicting", "PREDICTION_ERROR", "the image is reversed", _WRONG),
    Mutant("the error grows", "ERROR_GROWING", "the ball is pushed away", _GROWS),
    Mutant("the error grows", "STALLED", "a target out of reach", _STALLED),
    Mutant("the error grows", "OSCILLATING", "the ball swings", "a swing is held"),
    Mutant("the image does not follow", "IMAGE_NOT_FOLLOWING", "the image freezes", _FROZEN),
    Mutant("a joint does not follow", "NOT_FOLLOWING", "the arm is stuck", _STUCK),
    Mutant("the object of a relative target", "STALE", "an object falls silent", _FRESH),
    Mutant(
        "the object of a relative target", _STANDS, "an object moves while it is hidden", _ASKED
    ),
    Mutant("the robot program stopped", "PROGRAM_STOPPED", "the program stops", _ZEROS),
    Mutant("the robot program stopped", "SPEED_SCALING_ZERO", "the slider is at zero", _ZEROS),
)


class Tested(NamedTuple):
    """What the scripts cannot show, and the test that fails without it."""

    #: Of the table, as it begins; empty for what is none of its rows.
    row: str
    #: How it is taken away; None where the test runs other processes.
    without: AbstractContextManager | None
    test: str  # in the folder test/


def takes_any_mount():
    """The controller takes references that were taught with another camera mount."""
    parse = References._parse

    def take(self, entry):
        return parse(self, {**entry, "mount": self._origin["mount"]})

    return mock.patch.object(References, "_parse", take)


TESTED = (
    Tested("a message or request", None, "faults/test_fuzz_messages.py"),
    Tested("any catchable signal", None, "faults/test_hostile_terminal.py"),
    Tested(
        "a target in another frame",
        mock.patch.object(ViewConfig, "out_of_view", return_value=""),
        "closed_loop/test_stay_in_view.py::test_a_target_out_of_view_is_refused",
    ),
    Tested(
        "a target in another frame",
        takes_any_mount(),
        "unit/test_references.py::test_a_damaged_file_is_refused_with_what_is_wrong",
    ),
    Tested(
        "joint states older",
        stays(Inbox, "lost", {0: "", 1: ""}),
        "closed_loop/test_image_points.py::test_the_arm_rests_while_no_webcam_sees",
    ),
    Tested(
        "the view's edge",
        mock.patch.object(Supervisor, "_view", return_value=None),
        "closed_loop/test_stay_in_view.py::test_a_way_that_would_leave_the_view_is_bent",
    ),
    Tested(
        "the view's edge",
        mock.patch.object(InView, "limited", lambda _, velocity, *rest: velocity),
        "unit/test_collecting.py::test_the_object_stays_in_view_of_a_camera_on_the_arm",
    ),
    Tested(
        "the image does not follow",
        stays(Progress, "travel_m", 0.0),
        "closed_loop/test_camera_on_arm.py::test_an_image_that_stands_is_no_object_that_is_followed",
    ),
    Tested(
        "",
        mock.patch("fvs_estimator_node.on_arm.min", lambda causes, **_: causes[0], create=True),
        "unit/test_on_arm.py::test_an_object_on_a_belt_is_not_taken_for_a_bumped_bracket",
    ),
)


def play(script):
    """Play a script, a list of calls on a machine, and shut down."""
    machine = Machine()
    machine.begin()
    for step in script:
        step(machine)
    machine.teardown()
    return machine


def caught(mutant):
    """How the mutant breaks its promise in its script; empty if it keeps it."""
    without = lacks(mutant.without) if isinstance(mutant.without, str) else mutant.without
    try:
        with without:
            play(SCRIPTS[mutant.script])
    except BrokenPromiseError as error:
        return str(error) if error.promise == mutant.promise else ""
    return ""


def fails(tested):
    """How the test notices that what it tests is missing; empty if it does not, or fails anyway."""
    options = ["-q", "-x", "-p", "no:cacheprovider", f"test/{tested.test}"]
    with redirect_stdout(StringIO()):
        passes = pytest.main(options) == pytest.ExitCode.OK
        with tested.without:
            noticed = passes and pytest.main(options) == pytest.ExitCode.TESTS_FAILED
    return "the test fails" if noticed else ""


def main():
    """Print a line for each mutant."""
    for script in SCRIPTS.values():
        play(script)
    tested = [each for each in TESTED if each.without is not None]
    checks = [(each.row, each.promise, caught, each) for each in MUTANTS]
    checks += [(each.row, each.test.rpartition("::")[2], fails, each) for each in tested]
    missed = 0
    for row, promise, check, mutant in checks:
        how = check(mutant)
        missed += not how
        print(f"{'caught' if how else 'MISSED'}  {row:34s} {promise:36s} {how:.60s}", flush=True)
    if missed:
        raise RuntimeError(f"{missed} mutants not caught")
    print(f"{len(checks)} of {len(checks)} mutants caught")
