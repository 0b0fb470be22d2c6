"""Everything that may happen to the controller, as a Hypothesis state machine.

Each rule is one thing that happens to a :class:`~bench.fuzz_world.World`; Hypothesis draws their
order and numbers, and shrinks what breaks a promise. Called by hand, the rules are a script:
``m = Machine()``, ``m.begin()``, ``m.work()``, ``m.silence(["jacobian"])``.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from typing import Any
from unittest import mock

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from bench.fuzz_world import BALL, FRESH_TICKS, INPUTS, JOINT_STATES, PLANTS, TICK_S, World
from bench.fuzz_world import TRUE_JACOBIAN as TRUE
from fvs_controller_node.base import ControlOutput
from fvs_controller_node.config import LAWS, PARAMETERS
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_ros.params import Parameter

N_AXES, N_JOINTS = TRUE.shape
ODD = (
    *(math.nan, math.inf, -math.inf, 1e308, -1e300, 5e-324, -5e-324, 0.0, -0.0, 1e-300),
    *(1e9, 100.0, 100.00001, -100.0, math.pi, 1e-9),
)
ODD_NAMES = ("gripper", "", "é", "a" * 99)
#: What would take long otherwise, made quick.
IMPATIENT = {"resume_within_s": 0.5, "stall_time_s": 0.6}

FEW, TICKS = st.integers(1, 9), st.integers(0, 60)
OFTEN = st.sampled_from([True, True, True, False])
JOINT = st.integers(0, N_JOINTS - 1)
NUMBER = st.one_of(st.sampled_from(ODD), st.floats())
FRAME = st.sampled_from([CAMERA_FRAME] * 3 + ["", "base", "\0", " " + CAMERA_FRAME, "x" * 999])
#: Of a tick on the steady clock, s; of a stamp beside its clock, s.
STEADY_S = st.sampled_from([TICK_S] * 4 + [0.0, 1e-9, 0.002, 0.012, 0.03, 0.07, 0.3, 5.0, 1e6])
STAMP_S = st.sampled_from([TICK_S, 0.0, 0.05, -0.05, 0.5, -0.5, -5.0, 3600.0, -(2.0**31), 4e9])
WORDS = st.sampled_from(["unknown", "", "nan", "-1", "1e999", "0x10", "1_0", "\0", "9" * 5000])


def vector(size: int, largest: float = 1.0) -> st.SearchStrategy:
    """Draw numbers of either sign, up to some size."""
    return st.lists(st.floats(-largest, largest), min_size=size, max_size=size)


def odd_at(places: int) -> st.SearchStrategy:
    """Draw which numbers of a message become odd: index -> number."""
    return st.dictionaries(st.integers(0, places - 1), NUMBER, max_size=2)


def value_of(parameter: Parameter) -> st.SearchStrategy:
    """Draw a value in the range of a parameter, of any magnitude."""
    if parameter.choices:
        return st.sampled_from(parameter.choices)
    if parameter.kind is bool:
        return st.booleans()
    low = -10.0 if parameter.minimum is None else parameter.minimum
    high = 1e3 if parameter.maximum is None else parameter.maximum
    if parameter.kind is int:
        return st.integers(int(low), int(min(high, low + 20)))
    number = st.one_of(st.floats(low, high), st.sampled_from((low, high)))
    if low >= 0.0:
        exponents = st.floats(math.log10(max(low, 1e-6 * high)), math.log10(high))
        number = st.one_of(number, exponents.map(lambda e: min(high, max(low, 10.0**e))))
    if not parameter.is_list:
        return number
    size = len(parameter.default)
    near = vector(size, 0.5).map(lambda by: np.add(parameter.default, by).tolist())
    return st.one_of(near, st.lists(number, min_size=size, max_size=size))


LIVE = st.sampled_from([parameter for parameter in PARAMETERS if parameter.live])
CHANGES = st.one_of(
    st.sampled_from([{name: value} for name, value in IMPATIENT.items()]),
    st.lists(LIVE.flatmap(lambda p: st.tuples(st.just(p.name), value_of(p))), max_size=3).map(dict),
    st.builds(lambda p, value: {p.name: value}, LIVE, st.sampled_from((*ODD, "nonsense"))),
)


class Machine(RuleBasedStateMachine):
    """One controller and what happens to it."""

    world: World

    @initialize(
        law=st.sampled_from(sorted(LAWS)),
        autostart=st.sampled_from([False, False, False, True]),
        simulated_time=st.booleans(),
        epoch_s=st.sampled_from([1000.0, 0.0, 1.7e9, 2147483600.0]),
        at_work=OFTEN,
    )
    def begin(
        self,
        law: str = "proportional",
        autostart: bool = False,
        at_work: bool = False,
        **times: Any,
    ) -> None:
        """Make the world, of the plainest law by default, at rest or at work."""
        self.world = World({"law": law, "autostart": autostart}, **times)
        if at_work:
            self.work()

    def teardown(self) -> None:
        """Shut down, unless something is wrong already."""
        if sys.exc_info()[0] is None and hasattr(self, "world"):
            self.world.shut_down()

    # ---- the operator -----------------------------------------------------------------------

    @rule(way_rad=vector(N_JOINTS, 0.6), ticks=TICKS, mend=OFTEN)
    def work(
        self, way_rad: Sequence[float] = (0.3,) * N_JOINTS, ticks: int = 25, mend: bool = True
    ) -> None:
        """Do all that servoing needs, mend what is broken, and go."""
        if mend:
            self.robot(True, 100.0, 0)
            self.show(1.0)
            self.world.plant, self.world.estimate = "obeys", TRUE
        self.world.run(FRESH_TICKS)
        self.world.aim(way_rad)
        self.world.start()
        self.world.run(ticks)

    work_again = work  # twice as often as anything else: most of the time the arm should move

    @rule(ticks=TICKS, steady_s=STEADY_S, ros_s=st.one_of(st.none(), STAMP_S))
    def wait(self, ticks: int, steady_s: float = TICK_S, ros_s: float | None = None) -> None:
        """Let time pass, by clocks that run, crawl, stand or jump, together or apart."""
        self.world.run(ticks, steady_s=steady_s, ros_s=ros_s)

    @rule(name=st.sampled_from(["start", "stop", "set_current_as_target"]), ticks=TICKS)
    def call(self, name: str, ticks: int = 0) -> None:
        """Call a service."""
        own = {"start": self.world.start, "stop": self.world.stop}
        own.get(name, lambda: self.world.node.call(f"~/{name}"))()
        self.world.run(ticks)

    @rule(target_m=st.lists(NUMBER, min_size=N_AXES, max_size=N_AXES), frame=FRAME)
    def odd_target(self, target_m: Sequence[float] | None, frame: str = CAMERA_FRAME) -> None:
        """Send any target, in any frame."""
        self.world.send_target(self.world.ball() if target_m is None else target_m, frame)
        self.world.run(3)

    @rule(step_m=vector(N_AXES, 0.02), count=st.integers(1, 40), every=FEW)
    def moving_target(self, step_m: Sequence[float], count: int, every: int) -> None:
        """Send a target again and again on its way."""
        at_m = self.world.ball()
        for _ in range(count):
            at_m = at_m + step_m
            self.world.send_target(at_m)
            self.world.run(every)

    @rule(changes=CHANGES, ticks=TICKS)
    def change(self, changes: Mapping[str, Any], ticks: int = 0) -> None:
        """Change live parameters in mid-motion."""
        self.world.set(changes)
        self.world.run(ticks)

    @rule(room_rad=st.lists(st.floats(-0.05, 0.3), min_size=N_JOINTS, max_size=N_JOINTS))
    def close_in(self, room_rad: Sequence[float]) -> None:
        """Let the ends of the joints' ranges close in on where the arm is."""
        low = self.world.joints - room_rad
        high = np.maximum(self.world.joints + room_rad, low + 0.002)
        self.world.set({"joint_min_rad": low.tolist(), "joint_max_rad": high.tolist()})
        self.world.run(10)

    @rule(joint=JOINT, side=st.sampled_from([-1, 1]), room_rad=st.floats(0.0, 0.3), ticks=TICKS)
    def to_the_limit(self, joint: int, side: int, room_rad: float, ticks: int) -> None:
        """Put the arm near an end of its range, with a target beyond."""
        world = self.world
        ball_m, end = world.ball(), "joint_max_rad" if side > 0 else "joint_min_rad"
        world.joints[joint] = world.values[end][joint] - side * room_rad
        world.promises.begin_lie()  # the arm did not go there by itself
        world.push_m = world.push_m + ball_m - world.ball()
        world.run(FRESH_TICKS)
        world.send_target(world.ball() + side * 0.5 * TRUE[:, joint])
        world.start()
        world.run(ticks)

    # ---- robot, camera, estimator -----------------------------------------------------------

    @rule(
        silent=st.sets(st.sampled_from(INPUTS)),
        frozen=st.sets(st.sampled_from((JOINT_STATES, BALL))),
        ticks=TICKS,
        steady_s=STEADY_S,
    )
    def silence(
        self,
        silent: Sequence[str] = (),
        frozen: Sequence[str] = (),
        ticks: int = 40,
        steady_s: float = TICK_S,
    ) -> None:
        """Let inputs fall silent, or repeat their stamps."""
        self.world.run(ticks, silent=silent, frozen=frozen, steady_s=steady_s)

    @rule(running=OFTEN, percent=st.sampled_from([100.0] * 9 + [30.0, -1.0, *ODD]), ticks=TICKS)
    def robot(self, running: bool = True, percent: float = 100.0, ticks: int = 5) -> None:
        """Let the robot's program stop or run, and turn its speed slider."""
        self.world.send_program(running)
        self.world.send_scaling(percent)
        self.world.run(ticks)

    @rule(plant=st.sampled_from(sorted(PLANTS)), ticks=TICKS)
    def arm(self, plant: str, ticks: int) -> None:
        """Let the drives answer in another way."""
        self.world.plant = plant
        self.world.run(ticks)

    @rule(joint=JOINT, step_rad=st.floats(-0.5, 0.5))
    def knock(self, joint: int, step_rad: float) -> None:
        """Let a joint jump."""
        self.world.joints[joint] += step_rad
        self.world.promises.begin_lie()
        self.world.run(8)

    @rule(values=vector(N_JOINTS), own=st.booleans(), ticks=FEW)
    def other_commander(self, values: Sequence[float], own: bool = False, ticks: int = 9) -> None:
        """Let another node command the arm, or one's own commands come back."""
        for _ in range(ticks):
            self.world.send_command(self.world.promises.last if own else values)
            self.world.run(1)

    @rule(
        signs=st.sampled_from([(1, 1, 1), (-1, -1, -1), (1, -1, 1)]),
        scale=st.sampled_from([1.0, 1.0, 0.3, 8.0, 1e3]),
        smallest=st.sampled_from([None, 0.0, 0.02, 0.04, 0.06]),
        noise=st.one_of(st.just(0.0), vector(TRUE.size)),
        ticks=TICKS,
    )
    def estimator(
        self, signs: Any = 1, scale: float = 1.0, smallest: Any = None, noise: Any = 0.0, ticks=20
    ) -> None:
        """Let the estimator err: in sign, scale, smallest singular value, or anyhow."""
        u, s, vt = np.linalg.svd(TRUE, full_matrices=False)
        s[-1] = s[-1] if smallest is None else smallest
        erring = scale * (u * s) @ vt + np.resize(noise, TRUE.shape)
        self.world.estimate = np.resize(signs, (N_AXES, 1)) * erring
        self.world.run(ticks)

    @rule(share=st.sampled_from([1.0, 0.0, -1.0, 0.1, 0.5, 2.0]), ticks=TICKS, steady_s=STEADY_S)
    def show(self, share: float, ticks: int = 0, steady_s: float = TICK_S) -> None:
        """From where the ball is, let the camera show this share of its motion; 0: it is frozen."""
        ball_m, self.world.seen_share = self.world.ball(), share
        self.world.push_m = self.world.push_m + ball_m - self.world.ball()
        self.world.promises.begin_lie()
        self.world.run(ticks, steady_s=steady_s)

    @rule(step_m=vector(N_AXES, 0.3), steps=st.integers(1, 100), steady_s=STEADY_S)
    def push(self, step_m: Sequence[float], steps: int, steady_s: float = TICK_S) -> None:
        """Push the ball, or the camera, away: at once or steadily."""
        for _ in range(steps):
            self._push(np.array(step_m) / steps, steady_s)

    @rule(size_m=st.floats(0.02, 0.12), ticks=st.integers(0, 600))
    def swing(self, size_m: float, ticks: int) -> None:
        """Let the ball swing, whatever the arm does."""
        way_m = size_m * np.eye(N_AXES)[0]
        for tick in range(ticks):
            self._push(way_m * (math.sin(0.1 * tick) - math.sin(0.1 * (tick - 1))), 0.01)

    def _push(self, step_m: np.ndarray, steady_s: float) -> None:
        self.world.push_m = self.world.push_m + step_m
        self.world.promises.begin_lie()  # the image shows more than the arm's motion
        self.world.run(1, steady_s=steady_s)

    # ---- messages and answers that should not be ---------------------------------------------

    @rule(
        names=st.one_of(
            st.permutations(UR_JOINT_NAMES),
            st.lists(st.sampled_from(UR_JOINT_NAMES + ODD_NAMES), max_size=9),
        ),
        odd=odd_at(9),
        more=st.integers(-1, 1),
        late_s=STAMP_S,
    )
    def odd_joints(
        self,
        names: Sequence[str] = UR_JOINT_NAMES,
        odd: Mapping[int, float] | None = None,
        more: int = 0,
        late_s: float = 0.0,
    ) -> None:
        """Send joint states with names, positions or stamps that are odd."""
        known = dict(zip(UR_JOINT_NAMES, self.world.joints.tolist(), strict=True))
        positions = [known.get(name, 0.5) for name in (*names, "")][: len(names) + more]
        for index, value in (odd or {}).items():
            positions[index : index + 1] = [value] if index < len(positions) else []
        self.world.send_joints(positions, self.world.ros_s - late_s, names)

    @rule(odd=odd_at(N_AXES), late_s=STAMP_S, frame=FRAME)
    def odd_ball(self, odd: Mapping[int, float], late_s: float, frame: str) -> None:
        """Send a ball position with numbers, stamp or frame that are odd."""
        ball_m = self.world.ball().copy()
        ball_m[list(odd)] = list(odd.values())
        self.world.send_ball(ball_m, self.world.ros_s - late_s, frame)

    @rule(
        odd=odd_at(TRUE.size),
        size=st.sampled_from([TRUE.size, TRUE.size, 0, 1, 17, 19, 36]),
        sizes=st.sampled_from([[], TRUE.shape, TRUE.shape[::-1], [18], [2**32 - 1] * 2]),
    )
    def odd_jacobian(self, odd: Mapping[int, float], size: int, sizes: Sequence[int]) -> None:
        """Send a Jacobian with numbers or dimensions that are odd."""
        data = self.world.estimate.ravel().copy()
        data[list(odd)] = list(odd.values())
        message = Float64MultiArray(data=np.resize(data, size).tolist())
        message.layout.dim = [MultiArrayDimension(size=one) for one in sizes]
        self.world.send_jacobian(message)

    @rule(data=st.one_of(vector(49, 3.0), st.lists(NUMBER, max_size=49)))
    def odd_chain(self, data: Sequence[float]) -> None:
        """Send any chain, or what is none."""
        self.world.send_chain(Float64MultiArray(data=data))

    @rule(key=WORDS, value=WORDS, message=WORDS)
    def odd_status(self, key: str, value: str, message: str) -> None:
        """Let the estimator say anything."""
        pairs = [KeyValue(key=key, value=value), KeyValue(key="state", value="WAITING")]
        self.world.node._on_estimator_status(DiagnosticStatus(values=pairs, message=message))

    @rule(velocity=st.lists(NUMBER, max_size=N_JOINTS), sliding=st.lists(NUMBER, max_size=N_AXES))
    def mad_law(self, velocity: Sequence[float], sliding: Sequence[float]) -> None:
        """Let the law answer anything, or fail."""
        answer = ControlOutput(np.array(velocity), np.array(sliding), np.ones(N_AXES))
        error = None if velocity else ZeroDivisionError("a law's own mistake")
        law = type(self.world.node._loop.law)
        with mock.patch.object(law, "command", side_effect=error, return_value=answer):
            self.world.run(3)

    @rule(dt_s=st.sampled_from((*ODD, -1.0, 10.0)))
    def odd_tick(self, dt_s: float) -> None:
        """Tick with a time step that no clock gives."""
        self.world.node._tick(self.world.now_s, dt_s)
        self.world.run(1)
