"""Is each row of the README's safety table kept? The controller without it is found out.

python -m bench mutants. Each mutant lacks one rule; in the scenes beside it the world of
``fuzz_world.py`` must see its promise broken, and kept by the controller as it is.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple
from unittest import mock

from bench.fuzz_world import BrokenPromiseError, Episode, Scene, World
from fvs_controller_node import limiter, monitors
from fvs_controller_node.inputs import InputMonitor
from fvs_controller_node.monitors import FollowingMonitor
from fvs_controller_node.progress import Progress
from fvs_controller_node.supervisor import Supervisor
from fvs_ros.agreement import Agreement
from fvs_ros.history import StampGate
from fvs_ros.limits import JointRange


class Mutant(NamedTuple):
    """The controller without one rule.

    Parameters
    ----------
    promise : str
        What the world sees broken.
    where, name : object, str
        The attribute that is replaced ...
    by : object
        ... by this.
    scenes : str
        When it shows: ``name/ticks/variant``, comma separated.
    rehearsed : bool
        Whether the arm servoes before the scenes.
    """

    promise: str
    where: Any
    name: str
    by: Any
    scenes: str
    rehearsed: bool = True


def _nothing(*_arguments: Any, **_options: Any) -> None:
    return None


_JUDGE = Agreement._judge


def _sees_no_error(*arguments: Any) -> Any:
    verdict = _JUDGE(*arguments)
    return None if verdict is None else replace(verdict, error_ratio=0.0)


_NEVER = property(lambda _self: False)
_INIT, _GOOD, _TARGET = Supervisor.__init__, InputMonitor.good, Supervisor.target


def _starts_by_itself(self: Supervisor, config: Any) -> None:
    _INIT(self, config)
    self._autostart_left = True


def _trusts_at_once(self: InputMonitor, now_s: float) -> None:
    _GOOD(self, now_s)
    self._trouble = None


def _takes_any_frame(self: Supervisor, position_m: Any, _frame: str, **options: Any) -> Any:
    return _TARGET(self, position_m, self.config.feature_frame, **options)


def _brakes_for_no_end(_self: JointRange, velocity: Any, *_rest: Any) -> Any:
    return velocity, []


_ASKED, _FRESH, _ZEROS = "moves when asked only", "fresh inputs", "zeros whatever came first"
_TRUSTED, _TOLD = "several good messages end a trouble", "a wrong target changes nothing"
_GROWS, _STALLS = "an error that grows is held", "an error that does not fall is held"
_WRONG, _FROZEN = "a wrong Jacobian is held", "a frozen image is held"
_FOLLOWS, _SINGULAR = "an arm that does not follow is held", "held near a singularity"

#: The table's rows, as they begin, and what happens without them.
ROWS = {
    "before everything is fresh": [
        Mutant(_ASKED, Supervisor, "__init__", _starts_by_itself, "target/40/9", rehearsed=False),
    ],
    "joint states older": [
        Mutant(_FRESH, InputMonitor, "find", _nothing, "silence/40/0"),
        Mutant(_TRUSTED, InputMonitor, "good", _trusts_at_once, "silence/40/1, work/40/3"),
    ],
    "a message that is not finite": [
        Mutant(_ZEROS, InputMonitor, "bad", _nothing, "garbage/40/7, garbage/40/9"),
    ],
    "held for more": [
        Mutant(_ASKED, Supervisor, "_held_long", lambda _self, it, _dt_s: it, "abandoned/60/1"),
    ],
    "another node commands": [
        Mutant(_ASKED, Supervisor, "conflicting_command", _nothing, "rival/20/0"),
    ],
    "messages whose stamps": [
        Mutant(_FRESH, StampGate, "advances", lambda _self, _stamp_s: True, "frozen stamps/40/1"),
    ],
    "always": [
        Mutant("velocity limit", limiter, "limit_speed", lambda v, _s: v, "work/40/11"),
        Mutant("acceleration limit", limiter, "limit_acceleration", lambda v, *_: v, "work/40/3"),
        Mutant("only slower", limiter, "ramp_to_zero", lambda v, _s: 1.001 * v, "silence/40/1"),
        Mutant(
            *("stops before its limit", JointRange, "slow_down", _brakes_for_no_end),
            "to the limit/40/6, to the limit/40/1",
        ),
    ],
    "a target in another frame": [
        Mutant(_TOLD, Supervisor, "target", _takes_any_frame, "target/4/2, target/5/2"),
        Mutant(_TOLD, Supervisor, "_outside", lambda _self, _m: [], "target/4/3, target/5/3"),
    ],
    "the Jacobian near singular": [
        Mutant(_SINGULAR, Supervisor, "_near_singular", _nothing, "estimator/10/7"),
    ],
    "the Jacobian predicting badly": [
        Mutant(_WRONG, Agreement, "_judge", _sees_no_error, "work/5/3, wrong way/120/9"),
    ],
    "the error grows": [
        Mutant(_GROWS, Progress, "growing", _NEVER, "work/40/3, long wait/60/0, push/90/9"),
        Mutant(_STALLS, Progress, "stalled", _NEVER, "another ball/60/6, long wait/60/0"),
        Mutant("a swing is held", Progress, "swinging", _NEVER, "work/5/3, swing/60/4"),
    ],
    "the image does not follow": [
        Mutant(_FROZEN, monitors, "_LEAST_SEEN", -1.0, "another ball/60/5"),
    ],
    "the arm does not move": [
        Mutant(_FOLLOWS, FollowingMonitor, "check", _nothing, "arm/59/3, long wait/60/0"),
    ],
    "the robot program stopped": [
        Mutant(_ZEROS, Supervisor, "program_running", _nothing, "robot/5/0"),
        Mutant(_ZEROS, Supervisor, "speed_scaling", _nothing, "robot/5/4"),
    ],
}

#: Rows that a process and its wires keep, not the loop: row -> the tests that guard it.
ELSEWHERE = {
    "a message above": "test/faults/test_fuzz_messages.py",
    "Ctrl-C, any signal": "test/faults/test_controller_faults.py",
}


def broken(mutant: Mutant, *, whole: bool = False) -> dict[str, str]:
    """Which promises are seen broken, and how, in the mutant's scenes.

    Parameters
    ----------
    mutant : Mutant
        The mutant.
    whole : bool
        The controller with all its rules in the same scenes.
    """
    words = [scene.split("/") for scene in mutant.scenes.split(", ")]
    scenes = tuple(Scene(name, int(ticks), int(variant)) for name, ticks, variant in words)
    found: dict[str, str] = {}
    for seed in range(3):
        world = Episode("proportional", seed, rehearsed=mutant.rehearsed, scenes=scenes)
        try:
            if whole:
                World(world).play()
            else:
                with mock.patch.object(mutant.where, mutant.name, mutant.by):
                    World(world).play()
        except BrokenPromiseError as error:
            found[error.promise] = str(error)
        if not whole and mutant.promise in found:
            break
    return found


def main() -> None:
    missed = []
    for row, mutants in ROWS.items():
        for mutant in mutants:
            found = broken(mutant)
            caught = mutant.promise in found and not broken(mutant, whole=True)
            how = found.get(mutant.promise, str(found))
            print(f"{'caught' if caught else 'MISSED'}  {row:30s} {mutant.name:20s} {how:.90s}")
            if not caught:
                missed.append(f"{row} ({mutant.name})")
    if missed:
        raise RuntimeError(f"{len(missed)} mutants not caught: {', '.join(missed)}")


if __name__ == "__main__":
    main()
