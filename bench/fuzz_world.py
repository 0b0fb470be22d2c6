"""A world that does to the controller whatever can be done, and checks its promises at every tick.

The node's own callbacks run, on real messages, with a clock, topics and timers made of plain
Python (:mod:`bench.dry_node`), so that a tick costs a fraction of a millisecond. The tests and
``bench_fuzz.py`` use the same world. An :class:`Episode` describes a run in a few words and
numbers, which Hypothesis draws and shrinks; a scene draws its many small numbers from a generator
seeded by that description.
"""

from __future__ import annotations

import math
from array import array
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PointStamped
from hypothesis import strategies as st
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray, MultiArrayDimension

from bench.dry_node import DryController
from fvs_controller_node.base import ControlLaw, ControlOutput
from fvs_controller_node.config import PARAMETERS, build_loop
from fvs_controller_node.progress import ProgressLimits
from fvs_controller_node.reasons import Reason, State, Stop
from fvs_controller_node.registry import LAWS
from fvs_controller_node.supervisor import (
    BALL,
    JACOBIAN,
    JOINT_STATES,
    KINEMATIC_CHAIN,
    MAX_TICK_S,
    Command,
)
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.chain import SerialChain
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_ros.params import Parameter, ParameterSet
from fvs_ros.ros import to_chain

TICK_S = 0.008
FRESH_TICKS = 26  # until every input counts again
IMAGE_EVERY, JACOBIAN_EVERY, LATENCY_TICKS = 4, 2, 4
STATUS_EVERY = 25
START_RAD = (0.0, -1.35, 1.6, -1.75, -1.57, 0.0)
BALL_AT_START_M = np.array([0.0, 0.0, 1.2])
TRUE_JACOBIAN = np.array(
    [
        [0.02, -0.45, -0.30, -0.10, 0.05, 0.0],
        [-0.55, 0.03, 0.04, 0.02, 0.17, 0.0],
        [0.10, -0.25, 0.35, 0.15, -0.02, 0.0],
    ]
)
WILD = (
    *(math.nan, math.inf, -math.inf, 1e308, -1e300, 5e-324, -5e-324, 0.0, -0.0, 1e-300),
    *(1e9, 100.0, 100.00001, -100.0, math.pi, 1e-9),
)
#: What the world sees for itself, the controller may see so much later, s, or larger: it knows it
#: from images only.
LATE_S, MARGIN = 1.0, 1.5
#: Rounding: what a promise may be missed by, rad/s.
ROUNDING = 1e-9
#: Below this the arm is at rest and zeros need no ramp, rad/s.
AT_REST = 1.5e-9

PARAMETER_SET = ParameterSet(PARAMETERS)
LIVE = tuple(p for p in PARAMETERS if p.live)


class BrokenPromiseError(AssertionError):
    """The controller did what it must never do; the text says which promise and how."""

    def __init__(self, promise: str, how: str) -> None:
        super().__init__(f"{promise}: {how}")
        self.promise = promise


# ---- what Hypothesis draws --------------------------------------------------------------------


@dataclass(frozen=True)
class Scene:
    """One thing that happens: its name, how many ticks it lasts, and which variant."""

    name: str
    ticks: int = 1
    variant: int = 0


@dataclass(frozen=True)
class Episode:
    """A run, described so that it can be told again: ``World(episode).play()``."""

    law: str = "ftsm"
    seed: int = 0
    parameters: tuple[tuple[str, Any], ...] = ()
    plant: str = "obeys"
    estimate: str = "good"
    simulated_time: bool = False
    epoch_s: float = 1000.0
    ambush: str = ""  # what happens whenever the arm is on its way to rest
    rehearsed: bool = True  # a target is set and the arm servoes before the scenes begin
    scenes: tuple[Scene, ...] = field(default_factory=tuple)
    allocation: str = "two_norm"


def number_in(parameter: Parameter) -> st.SearchStrategy:
    """Draw a number in the range of a parameter: its ends, or any magnitude between them."""
    low = -1e3 if parameter.minimum is None else parameter.minimum
    high = 1e3 if parameter.maximum is None else parameter.maximum
    if parameter.kind is int:
        return st.integers(int(low), int(min(high, low + 20)))
    choices = [st.sampled_from([low, high]), st.floats(low, high)]
    if low >= 0.0:
        least = math.log10(max(low, 1e-6 * high))
        exponents = st.floats(least, math.log10(high))
        choices.append(exponents.map(lambda e: min(high, max(low, 10.0**e))))
    return st.one_of(choices)


def value_of(parameter: Parameter) -> st.SearchStrategy:
    """Draw any valid value of a parameter."""
    if parameter.choices:
        return st.sampled_from(parameter.choices)
    if parameter.kind is bool:
        return st.booleans()
    if not parameter.is_list:
        return number_in(parameter)
    size = parameter.size or 1
    near = st.floats(-0.5, 0.5).map(lambda d: [float(v) + d for v in parameter.default])
    return st.one_of(near, st.lists(number_in(parameter), min_size=size, max_size=size)).filter(
        lambda values: _passes(parameter, values)
    )


def _passes(parameter: Parameter, value: Any) -> bool:
    try:
        parameter.check(value)
    except ValueError:
        return False
    return True


def changes(at_most: int) -> st.SearchStrategy:
    """Draw new values for some of the live parameters."""
    one = st.sampled_from(LIVE).flatmap(lambda p: st.tuples(st.just(p.name), value_of(p)))
    return st.lists(one, max_size=at_most).map(tuple)


PLANTS = ("obeys", "lags", "creeps", "ignores", "inverts", "one joint sticks", "jumps")
ESTIMATES = (
    *("good", "scaled", "noisy", "flipped", "one axis flipped", "weak"),
    *("near singular", "singular", "huge", "random"),
)


#: What may happen while the arm ramps down: there two reasons meet.
AMBUSHES: dict[str, Callable[[World, np.random.Generator], None]] = {
    "": lambda world, rng: None,
    "program": lambda world, rng: world.send_program(False),
    "speed scaling": lambda world, rng: world.send_scaling(0.0),
    "bad joints": lambda world, rng: world.send_joints(np.full(6, math.nan), world.ros_s),
    "bad ball": lambda world, rng: world.send_ball(np.full(3, math.inf), world.ros_s),
    "bad Jacobian": lambda world, rng: world.send_jacobian(np.full((3, 6), math.nan)),
    "start": lambda world, rng: world.start(),
    "stop": lambda world, rng: world.stop(),
    "target": lambda world, rng: world.aim(rng, 0.2),
    "slower": lambda world, rng: world.reconfigure([("max_joint_velocity_rad_s", 0.01)]),
    "softer": lambda world, rng: world.reconfigure([("max_joint_acceleration_rad_s2", 0.1)]),
}


def scenes() -> st.SearchStrategy:
    """Draw a list of scenes."""
    names = [name for name, share in SCENES.items() for _ in range(share[0])]
    one = st.builds(Scene, st.sampled_from(names), st.integers(1, 60), st.integers(0, 11))
    return st.lists(one, min_size=1, max_size=12).map(tuple)


def episodes() -> st.SearchStrategy:
    """Draw an episode."""
    mostly_good = st.one_of(st.just("good"), st.just("good"), st.sampled_from(ESTIMATES))
    mostly_obeys = st.one_of(
        st.just("obeys"), st.just("lags"), st.just("lags"), st.sampled_from(PLANTS)
    )
    autostart = st.sampled_from([(), (), (), (("autostart", True),)])
    few = st.one_of(st.just(()), changes(3))
    return st.builds(
        Episode,
        law=st.sampled_from(sorted(LAWS)),
        allocation=st.sampled_from(["two_norm", "least_speed"]),
        seed=st.integers(0, 2**32 - 1),
        parameters=st.builds(lambda a, b: a + b, few, autostart),
        plant=mostly_obeys,
        estimate=mostly_good,
        simulated_time=st.booleans(),
        epoch_s=st.sampled_from([1000.0, 0.0, 1.7e9, 2147483600.0]),
        ambush=st.sampled_from(sorted(AMBUSHES)),
        rehearsed=st.sampled_from([True, True, True, False]),
        scenes=scenes(),
    )


# ---- the world --------------------------------------------------------------------------------


class Errand:
    """How the ball comes to its target, since a start or another target, by the world's own eyes.

    Parameters
    ----------
    target : ndarray, shape (3,)
        m.
    """

    def __init__(self, target: np.ndarray) -> None:
        self.target = target
        self._first_m = self._best_m = self._mark_m = math.inf
        self._up_s = self._since_s = self._still_s = self._swings_m = 0.0
        self._turned_m = np.zeros(3)

    def add(self, ball_m: np.ndarray, dt_s: float, limits: ProgressLimits) -> str:
        """Take a tick of servoing; returns what should have held the arm by now, mostly nothing."""
        error = ball_m - self.target
        error_m = float(np.linalg.norm(error))
        if self._first_m == math.inf:
            self._first_m, self._turned_m = error_m, error
        self._best_m = min(self._best_m, error_m)
        up_m = max(limits.growth_factor * self._best_m, self._best_m + limits.growth_m)
        self._up_s = self._up_s + dt_s if error_m > MARGIN * up_m else 0.0
        self._since_s += dt_s
        if error_m < MARGIN * limits.stall_error_m or self._best_m < 0.98 * self._mark_m:
            self._mark_m, self._since_s = self._best_m, 0.0
        self._still_s += dt_s
        if (went_m := float(np.linalg.norm(error - self._turned_m))) > 0.02:
            nearer_m = float(np.linalg.norm(self._turned_m)) - error_m
            self._swings_m += went_m - max(0.0, nearer_m)
            self._turned_m, self._still_s = error, 0.0
        elif self._still_s > 0.5:
            self._swings_m = 0.0
        if self._up_s > limits.growth_time_s + LATE_S:
            return "an error that grows is held"
        if self._since_s > limits.stall_time_s + LATE_S:
            return "an error that does not fall is held"
        return "a swing is held" if self._swings_m > MARGIN * (0.5 + 2.0 * self._first_m) else ""


class World:
    """A controller node, an arm, a ball, an estimator and an operator, none of them trustworthy.

    Parameters
    ----------
    episode : Episode
        What happens.
    unkept : collection of str
        Promises that are counted but not enforced.
    """

    def __init__(self, episode: Episode, unkept: frozenset[str] = frozenset()) -> None:
        self.episode = episode
        self.states: Counter[State] = Counter()
        self.reasons: Counter[Reason] = Counter()
        self.ticks = self.moving_ticks = 0
        self.broken: Counter[str] = Counter()
        self._unkept = unkept
        given = {"law": episode.law, "allocation": episode.allocation}
        for name, value in episode.parameters:
            if _fits({**given, name: value}):
                given[name] = value
        self.now_s, self.ros_s = 100.0, episode.epoch_s
        self.node = DryController(given, lambda: self.now_s, episode.simulated_time)
        self._published: list[array] = []
        self.node.publishers_by_topic[
            "forward_velocity_controller/commands"
        ].heard = self._published.append
        self._listen()
        self._plant, self._estimate = episode.plant, TRUE_JACOBIAN
        self._stuck_joint = episode.seed % 6
        self._joints = np.array(START_RAD)
        self._drive = np.zeros(6)  # the drives' speed, rad/s
        self._away = np.zeros(3)  # what pushed the ball, m
        self._images: deque[tuple[float, np.ndarray]] = deque(maxlen=LATENCY_TICKS + 1)
        self._other_ball: np.ndarray | None = None
        self._seen_share = 1.0  # of the ball's motion
        self._beats = 0
        self._ambushed = False
        self._messages()
        # what the promises are judged by
        self._last = self._before = (0.0,) * 6
        self._singular_m_rad = math.inf
        self._ticked_s = -math.inf
        self._session = False
        self._autostart_left = bool(given.get("autostart", False))
        self._shut_down = False
        self._program_runs, self._scaling = True, 100.0
        self._arrived = dict.fromkeys((JOINT_STATES, BALL, JACOBIAN), -math.inf)
        self._stamps: dict[str, float] = {}
        self._good = dict.fromkeys(self._arrived, 0.0)  # messages since the last trouble
        self._bad: set[str] = set()
        self._errand, self._judged_ball = Errand(BALL_AT_START_M), BALL_AT_START_M
        self._asked_s = -math.inf  # when ~/start was called last
        self._held_s = self._ignored_s = 0.0
        self._begin_lie()
        self.set_estimate(episode.estimate, np.random.default_rng(episode.seed))

    def play(self) -> World:
        """Play the episode."""
        if self.episode.rehearsed:
            self.calm(FRESH_TICKS)
            self.aim(np.random.default_rng(self.episode.seed), 0.25)
            self.start()
            self.calm(25)
        for scene in self.episode.scenes:
            key = [self.episode.seed, list(SCENES).index(scene.name), scene.ticks, scene.variant]
            SCENES[scene.name][1](self, np.random.default_rng(key), scene)
            self.calm(2)
        return self

    # ---- promises -------------------------------------------------------------------------

    def _listen(self) -> None:
        """Note what the node hands on, and judge every tick."""
        loop, supervisor = self.node._loop, self.node._loop.supervisor
        tick, add_joints, add_ball = loop.tick, loop.add_joints, loop.add_ball
        jacobian, bad_input = supervisor.jacobian, supervisor.bad_input
        no_chain = supervisor.no_chain

        def on_tick(now_s: float, dt_s: float) -> Command:
            command = tick(now_s, dt_s)
            self._judge(command, now_s, dt_s)
            return command

        def arrives(name: str, now_s: float, stamp_s: float | None = None) -> None:
            last = self._stamps.get(name)
            if stamp_s is not None:
                if last is not None and last - 0.1 <= stamp_s <= last:
                    return
                self._stamps[name] = stamp_s
            limits = self._age_limits_s()
            late = not now_s - self._arrived.get(name, -math.inf) <= limits.get(name, math.inf)
            self._good[name] = 1 if late or name in self._bad else self._good[name] + 1
            if self._good[name] >= self.node._loop.supervisor.config.fresh_samples:
                self._good[name] = math.inf  # trusted, until the next trouble
            self._arrived[name] = now_s
            self._bad.discard(name)

        def on_joints(now_s: float, stamp_s: float, joints: np.ndarray) -> None:
            arrives(JOINT_STATES, now_s, stamp_s)
            add_joints(now_s, stamp_s, joints)

        def on_ball(now_s: float, stamp_s: float, *rest: Any) -> None:
            arrives(BALL, now_s, stamp_s)
            add_ball(now_s, stamp_s, *rest)

        def on_jacobian(now_s: float, values: np.ndarray) -> bool:
            arrives(JACOBIAN, now_s)
            self._singular_m_rad = np.inf
            if values.shape == (3, 6) and np.isfinite(values).all():
                self._singular_m_rad = float(np.linalg.svd(values, compute_uv=False)[-1])
            return jacobian(now_s, values)

        def on_bad(now_s: float, name: str, why: str) -> None:
            self._bad.add(name)
            bad_input(now_s, name, why)

        loop.tick, loop.add_joints, loop.add_ball = on_tick, on_joints, on_ball
        supervisor.jacobian, supervisor.bad_input = on_jacobian, on_bad
        # Without any chain none is missed, and the last one's faults are past.
        supervisor.no_chain = lambda: (self._bad.discard(KINEMATIC_CHAIN), no_chain())

    def _promise(self, kept: bool, promise: str, how: Callable[[], str]) -> None:
        if kept:
            return
        self.broken[promise] += 1
        if promise not in self._unkept:
            raise BrokenPromiseError(promise, f"{how()} at tick {self.ticks}")

    def _judge(self, command: Command, now_s: float, dt_s: float) -> None:
        self.ticks += 1
        velocity = command.velocity_rad_s
        ok = velocity.shape == (6,) and velocity.dtype == np.float64
        self._promise(ok, "six numbers", lambda: f"{velocity!r}")
        v, last = tuple(velocity.tolist()), self._last
        self._before, self._last = last, v
        self._promise(all(map(math.isfinite, v)), "finite", lambda: f"{v}")
        state, reason = command.state, command.reason
        self.states[state] += 1
        self.reasons[reason] += 1
        moving, servoing = any(v), state is State.SERVOING
        self.moving_ticks += moving
        config = self.node._loop.supervisor.config

        dt_s = min(dt_s, MAX_TICK_S) if math.isfinite(dt_s) and dt_s > 0.0 else 0.0
        passed_s = min(max(now_s - self._ticked_s, 0.0), MAX_TICK_S)
        self._ticked_s = now_s
        step = config.speed.max_joint_acceleration_rad_s2 * dt_s
        # A stop has half a second from full speed, at most.
        stop_rad_s2 = max(
            config.speed.max_joint_acceleration_rad_s2, 2.0 * config.speed.max_joint_velocity_rad_s
        )
        if not servoing:
            step = stop_rad_s2 * (dt_s or passed_s)

        # A limit that is lowered in motion cannot be obeyed at once, since the acceleration limit
        # holds, too: from the next command on the arm slows down with all it has.
        fastest, before = max(map(abs, v)), max(map(abs, last))
        limit = config.speed.max_joint_velocity_rad_s
        ok = fastest <= limit or fastest <= before - step + ROUNDING
        self._promise(ok, "velocity limit", lambda: f"{fastest} after {before}, limit {limit}")

        change = max(abs(a - b) for a, b in zip(v, last, strict=True))
        at_once = reason.stop is Stop.AT_ONCE
        ok = change <= step + ROUNDING or (not moving and (at_once or before <= AT_REST))
        self._promise(ok, "acceleration limit", lambda: f"{last} to {v} in {step}, {reason.name}")

        self._promise(not (at_once and moving), "zeros at once", lambda: f"{v} in {reason.name}")
        paused = not self._program_runs or self._scaling <= 0.0
        ok = not moving or not (paused or self._bad or self._shut_down)
        self._promise(ok, "zeros whatever came first", lambda: f"{v} in {reason.name}, {self._bad}")

        if not servoing:
            ok = all(0.0 <= a / b <= 1.0 if b else a == 0.0 for a, b in zip(v, last, strict=True))
            self._promise(ok, "only slower", lambda: f"{last} to {v} in {reason.name}")
        self._judge_words(command)
        self._judge_session(command, now_s, passed_s)
        if servoing:
            self._judge_servoing(command, v, dt_s)
        else:
            self._ignored_s = 0.0
            self._begin_lie()
        if moving:
            brake_rad_s2 = config.speed.max_joint_acceleration_rad_s2 if servoing else stop_rad_s2
            self._judge_range(v, last, step, servoing, brake_rad_s2)

    def _judge_words(self, command: Command) -> None:
        state, reason = command.state, command.reason
        ok = state is reason.state or (state is State.WAITING and not self._session)
        self._promise(ok, "state and reason agree", lambda: f"{state} {reason.name}")
        ok = (state is State.SERVOING) == (command.output is not None)
        self._promise(ok, "the law is asked to servo only", lambda: f"{state} {command.output}")
        ok = isinstance(command.text, str) and bool(command.text.strip())
        self._promise(ok, "says why", lambda: f"{command.text!r}")

    def _age_limits_s(self) -> dict[str, float]:
        config = self.node._loop.supervisor.config
        return {
            JOINT_STATES: config.joint_states_max_age_s,
            BALL: config.ball_max_age_s,
            JACOBIAN: config.jacobian_max_age_s,
        }

    def _judge_session(self, command: Command, now_s: float, passed_s: float) -> None:
        """Nothing moves but by a start, nor on old inputs."""
        if command.state is State.SERVOING:
            if not self._session and self._autostart_left:
                self._session, self._autostart_left = True, False
            self._promise(self._session, "moves when asked only", lambda: command.text)
            for name, limit_s in self._age_limits_s().items():
                age_s = now_s - self._arrived[name]
                self._promise(
                    age_s <= limit_s,
                    "fresh inputs",
                    lambda name=name, age_s=age_s: f"{name} is {age_s} s old",
                )
                self._promise(
                    self._good[name] == math.inf,
                    "several good messages end a trouble",
                    lambda name=name: f"{self._good[name]} of {name}",
                )
        self._held_s = 0.0 if command.state is State.SERVOING else self._held_s + passed_s
        long_s = self.node._loop.supervisor.config.resume_within_s + 2.0 * MAX_TICK_S
        if self._held_s > long_s:
            self._end_session()
        if command.reason.needs_start:
            self._end_session()

    def _judge_servoing(self, command: Command, v: tuple[float, ...], dt_s: float) -> None:
        """What the arm must not go on with, by the world's own eyes."""
        config = self.node._loop.supervisor.config
        fastest = max(map(abs, v))
        low = self._singular_m_rad < config.singular_hold_m_rad
        leaves = self.now_s - self._asked_s < 10.0 + LATE_S and fastest <= 0.1 + ROUNDING
        ok = not low or leaves or fastest < max(map(abs, self._before))
        self._promise(ok, "held near a singularity", lambda: f"{self._singular_m_rad}, {v}")

        target = self.node._loop.supervisor.target_m
        assert target is not None
        ball, before = self.ball(), self._judged_ball
        self._judged_ball = ball
        if not np.array_equal(target, self._errand.target) or np.linalg.norm(ball - before) > 0.1:
            self._errand, self._ignored_s = Errand(target), 0.0
        wrong = self._errand.add(ball, dt_s, config.progress)
        self._promise(not wrong, wrong, lambda: f"{ball} to {target}")

        slow = self._plant != "ignores" or fastest < 0.05
        self._ignored_s += 0.0 if slow else dt_s
        ok = self._ignored_s < config.follow_time_s + LATE_S
        self._promise(ok, "an arm that does not follow is held", lambda: f"{self._ignored_s} s")

        # Half a second passes until enough was seen of an arm that is fast.
        at_m, astray_m = TRUE_JACOBIAN @ self._joints, 0.0
        speed_m_s = float(np.linalg.norm(TRUE_JACOBIAN @ self._drive))
        self._lie_speed_m_s = max(self._lie_speed_m_s, speed_m_s)
        seen = 0.5 * self._lie_speed_m_s
        if self._lie == "frozen":
            astray_m = float(np.linalg.norm(at_m - self._lie_at_m))
            ok = astray_m < 0.03 + seen
            self._promise(ok, "a frozen image is held", lambda: f"{astray_m} m")
        elif self._lie == "reversed" and config.prediction_hold < 1.5:
            self._lie_way_m += speed_m_s * dt_s
            ok = self._lie_way_m < 0.03 + config.prediction_hold_m + seen
            self._promise(ok, "a wrong Jacobian is held", lambda: f"{self._lie_way_m} m")

    def _begin_lie(self) -> None:
        """From here on it counts what the arm does on what is shown to it."""
        self._lie_at_m, self._lie_way_m = TRUE_JACOBIAN @ self._joints, 0.0
        self._lie_speed_m_s = 0.0

    @property
    def _lie(self) -> str:
        """What is wrong with the image, if it is wrong enough to be held for certain."""
        if self._estimate is not TRUE_JACOBIAN or self._plant not in ("obeys", "lags"):
            return ""
        if self._other_ball is not None:
            return "frozen"
        return "reversed" if self._seen_share == -1.0 else ""

    def _judge_range(
        self,
        v: tuple[float, ...],
        last: tuple[float, ...],
        step: float,
        servoing: bool,
        brake_rad_s2: float,
    ) -> None:
        """No joint goes outward faster than it can brake, unless it brakes already."""
        config = self.node._loop.supervisor.config
        joints = self.node._loop._joints
        if joints is None:
            return
        promise = "stops before its limit" if servoing else "stops before its limit, resting too"
        lower, upper = config.joint_range.joint_min_rad, config.joint_range.joint_max_rad
        for i, (a, b, q) in enumerate(zip(v, last, joints.tolist(), strict=True)):
            room = max(0.0, upper[i] - q if a > 0.0 else q - lower[i])
            brake = math.sqrt(2.0 * brake_rad_s2 * room)
            braking = a * b > 0.0 and abs(a) <= abs(b) - step + ROUNDING
            ok = abs(a) <= brake + ROUNDING or braking
            self._promise(
                ok,
                promise,
                lambda i=i, a=a, b=b, room=room: f"joint {i}: {a} after {b}, {room} rad left",
            )

    def _end_session(self) -> None:
        if self._session:
            self._session = self._autostart_left = False

    # ---- time -----------------------------------------------------------------------------

    def calm(
        self,
        ticks: int,
        *,
        silent: tuple[str, ...] = (),
        frozen: tuple[str, ...] = (),
        steady_s: float = TICK_S,
        ros_s: float = TICK_S,
    ) -> None:
        """Let time pass, with every message but those ``silent``, stamps but those ``frozen``."""
        for _ in range(ticks):
            self._beats += 1
            self.now_s += steady_s
            self.ros_s += ros_s
            self._move(steady_s)
            if BALL not in silent and self._beats % IMAGE_EVERY == 0:
                stamp_s, ball = self._images[0]
                self.send_ball(ball, self._stamps.get(BALL, 0.0) if BALL in frozen else stamp_s)
            if JACOBIAN not in silent and self._beats % JACOBIAN_EVERY == 0:
                self.send_jacobian(self._estimate)
            if JOINT_STATES in silent:
                self.node._watchdog()
            else:
                frozen_s = self._stamps.get(JOINT_STATES, 0.0)
                stamp_s = frozen_s if JOINT_STATES in frozen else self.ros_s
                self.send_joints(self._joints, stamp_s)
            if self._beats % STATUS_EVERY == 0:
                self.node._publish_status()
            self._check_wire()
            self._lie_in_wait()

    def _lie_in_wait(self) -> None:
        """Spring the ambush once in every ramp to rest."""
        ramping = any(self._last) and self.node._loop.supervisor.last.output is None
        if ramping and not self._ambushed:
            self._ambushed = True
            AMBUSHES[self.episode.ambush](self, np.random.default_rng(self._beats))
        elif not ramping:
            self._ambushed = False

    def _check_wire(self) -> None:
        """What was sent is what was decided."""
        for data in self._published:
            ok = len(data) == 6 and all(map(math.isfinite, data))
            self._promise(ok, "six finite numbers on the wire", lambda data=data: f"{data}")
        if self._published:
            ok = tuple(self._published[-1]) == self._last
            self._promise(ok, "sends what it decided", lambda: f"{self._published}")
        self._published.clear()

    def _move(self, dt_s: float) -> None:
        """Let the arm do what it does with the last command."""
        dt_s = min(dt_s, MAX_TICK_S)
        share = min(max(self._scaling, 0.0), 100.0) / 100.0
        wanted, plant = share * np.array(self._last), self._plant
        if plant == "lags":
            self._drive += (wanted - self._drive) * min(1.0, dt_s / 0.035)
        elif plant == "creeps":
            self._drive = 0.2 * wanted
        elif plant == "ignores":
            self._drive = np.zeros(6)
        elif plant == "inverts":
            self._drive = -wanted
        elif plant == "one joint sticks":
            self._drive = wanted
            self._drive[self._stuck_joint] = 0.0
        else:
            self._drive = wanted
        self._joints = self._joints + self._drive * dt_s
        if plant == "jumps" and self._beats % 50 == 0:
            self._joints[self._stuck_joint] += 0.3
        self._images.append((self.ros_s, self.ball()))

    def ball(self) -> np.ndarray:
        """Where the ball is, m."""
        if self._other_ball is not None:
            return self._other_ball
        moved_m = TRUE_JACOBIAN @ (self._joints - START_RAD)
        return BALL_AT_START_M + self._seen_share * moved_m + self._away

    # ---- messages -------------------------------------------------------------------------

    def _messages(self) -> None:
        """Make the messages that are sent over and over."""
        self._joint_state, self._point = JointState(name=list(UR_JOINT_NAMES)), PointStamped()
        self._point.header.frame_id = CAMERA_FRAME
        self._matrix = Float64MultiArray()
        self._matrix.layout.dim = [
            MultiArrayDimension(label="feature", size=3, stride=18),
            MultiArrayDimension(label="joint", size=6, stride=6),
        ]

    def send_joints(self, joints: np.ndarray, stamp_s: float) -> None:
        """Send a joint state; the node ticks."""
        message = self._joint_state
        _stamp(message, stamp_s)
        message.position = array("d", joints.tolist())
        self.node._on_joint_states(message)

    def send_ball(self, ball: np.ndarray, stamp_s: float) -> None:
        """Send a ball position."""
        message = self._point
        _stamp(message, stamp_s)
        message.point.x, message.point.y, message.point.z = ball.tolist()
        self.node._on_ball(message)

    def send_jacobian(self, jacobian: np.ndarray) -> None:
        """Send a Jacobian."""
        self._matrix.data = array("d", jacobian.ravel().tolist())
        self.node._on_jacobian(self._matrix)

    def send_target(self, target: np.ndarray, frame: str = CAMERA_FRAME) -> None:
        """Send a target."""
        message = PointStamped()
        message.header.frame_id = frame
        point = message.point
        point.x, point.y, point.z = (float(value) for value in target)
        _stamp(message, self.ros_s)
        supervisor = self.node._loop.supervisor
        before = supervisor._set_target
        self.node._on_target(message)
        low, high = supervisor.config.workspace_min_m, supervisor.config.workspace_max_m
        right = frame == CAMERA_FRAME and np.all((low <= target) & (target <= high))
        ok = right or supervisor._set_target is before
        self._promise(ok, "a wrong target changes nothing", lambda: f"{target} in {frame}")

    def send_program(self, running: bool) -> None:
        """Say whether the robot's program runs."""
        self._program_runs = running
        if not running:
            self._end_session()
        self.node._on_program_running(Bool(data=running))

    def send_scaling(self, percent: float) -> None:
        """Say the robot's speed scaling."""
        if math.isfinite(percent):
            self._scaling = percent
            self._bad.discard("speed_scaling")
            if percent <= 0.0:
                self._end_session()
        self.node._on_speed_scaling(Float64(data=percent))

    def show(self, share: float) -> None:
        """From where the ball is, let the camera show this share of its motion."""
        moved_m = TRUE_JACOBIAN @ (self._joints - START_RAD)
        self._away = self._away + (self._seen_share - share) * moved_m
        self._seen_share = share
        self._begin_lie()

    def start(self) -> None:
        """Call ``~/start``."""
        done, text = self.node.call("~/start")
        self._session = self._session or done
        self._asked_s, self._errand = self.now_s, Errand(self._errand.target)
        self._begin_lie()
        self._promise(bool(text), "says why", lambda: "~/start")

    def stop(self) -> None:
        """Call ``~/stop``."""
        self.node.call("~/stop")
        self._session = self._autostart_left = False

    def aim(self, rng: np.random.Generator, reach_rad: float) -> None:
        """Send a target that the arm can reach."""
        self.send_target(self.ball() + TRUE_JACOBIAN @ rng.uniform(-reach_rad, reach_rad, 6))

    def set_estimate(self, kind: str, rng: np.random.Generator) -> None:
        """Choose the estimator's Jacobian."""
        u, s, vt = np.linalg.svd(TRUE_JACOBIAN, full_matrices=False)
        made = {
            "good": lambda: TRUE_JACOBIAN,
            "scaled": lambda: TRUE_JACOBIAN * rng.uniform(0.3, 8.0),
            "noisy": lambda: TRUE_JACOBIAN + rng.normal(0.0, 0.15, (3, 6)),
            "flipped": lambda: -TRUE_JACOBIAN,
            "one axis flipped": lambda: TRUE_JACOBIAN * np.array([[1.0], [-1.0], [1.0]]),
            "weak": lambda: (u * [s[0], s[1], 0.06]) @ vt,
            "near singular": lambda: (u * [s[0], s[1], rng.uniform(0.02, 0.06)]) @ vt,
            "singular": lambda: (u * [s[0], s[1], 0.0]) @ vt,
            "huge": lambda: rng.uniform(-100.0, 100.0, (3, 6)),
            "random": lambda: rng.normal(0.0, 0.4, (3, 6)),
        }
        self._estimate = made[kind]()

    def reconfigure(self, values: list[tuple[str, Any]]) -> None:
        """Set live parameters; a refusal must change nothing."""
        self._errand, self._ignored_s = Errand(self._errand.target), 0.0
        before = self.node._loop.supervisor.config, dict(self.node.values), self.node._loop.law
        result = self.node._on_set([rclpy.Parameter(name, value=value) for name, value in values])
        if not result.successful:
            after = self.node._loop.supervisor.config, self.node.values, self.node._loop.law
            same = before[0] == after[0] and before[1] == after[1] and before[2] is after[2]
            self._promise(same, "a refusal changes nothing", lambda: result.reason)
            self._promise(bool(result.reason), "says why", lambda: f"{values}")


def _fits(values: dict[str, Any]) -> bool:
    try:
        build_loop(PARAMETER_SET.values(values))
    except ValueError:
        return False
    return True


def _stamp(message: Any, stamp_s: float) -> None:
    whole = math.floor(stamp_s)
    stamp = message.header.stamp
    stamp.sec = int(min(max(whole, -(2**31)), 2**31 - 1))
    stamp.nanosec = int((stamp_s - whole) * 1e9)


# ---- scenes -----------------------------------------------------------------------------------


def _calm(world: World, _rng: np.random.Generator, scene: Scene) -> None:
    world.calm(scene.ticks)


def _work(world: World, rng: np.random.Generator, scene: Scene) -> None:
    """Do everything that servoing needs, mend what is broken, and go."""
    if scene.variant % 3:
        world.send_program(True)
        world.send_scaling(float(rng.uniform(20.0, 100.0)))
        world.set_estimate("good", rng)
        world._plant, world._other_ball = "obeys", None
    world.calm(FRESH_TICKS)
    world.aim(rng, 0.1 + 0.05 * scene.variant)
    world.start()
    world.calm(scene.ticks)


def _target(world: World, rng: np.random.Generator, scene: Scene) -> None:
    v = scene.variant
    if v == 0:
        world.node.call("~/set_current_as_target")
    elif v == 1:
        world.send_target(rng.choice(WILD, 3))
    elif v == 2:
        frames = ("", "base", CAMERA_FRAME.upper(), "\0", "x" * 1000)
        world.send_target(world.ball(), frames[int(rng.integers(5))])
    elif v == 3:
        world.send_target(rng.uniform(-3.0, 3.0, 3))
    elif v == 4:
        config = world.node._loop.supervisor.config
        corners = np.array([config.workspace_min_m, config.workspace_max_m])
        world.send_target(corners[rng.integers(0, 2, 3), [0, 1, 2]])
    else:
        world.aim(rng, (1e-6, 0.01, 0.1, 0.3, 0.6, 1.0)[v % 6])
    world.calm(scene.ticks)


def _moving_target(world: World, rng: np.random.Generator, scene: Scene) -> None:
    """Tell a target again and again on its way, with a jump or a pause now and then."""
    at, step = world.ball(), rng.normal(0.0, 0.002 * (1 + scene.variant), 3)
    for _ in range(scene.ticks):
        if rng.random() < 0.05:
            at = at + rng.normal(0.0, 0.1, 3)
        at = at + step
        world.send_target(at)
        world.calm(int(rng.integers(1, 6)))


def _silence(world: World, rng: np.random.Generator, scene: Scene) -> None:
    who = (JOINT_STATES, BALL, JACOBIAN)
    silent = who if scene.variant > 9 else (who[scene.variant % 3],)
    world.calm(scene.ticks, silent=silent)
    if rng.random() < 0.5:
        world.calm(8)


def _abandon(world: World, rng: np.random.Generator, scene: Scene) -> None:
    """Let an input be silent for longer than a hold may last, then come back."""
    world.reconfigure([("resume_within_s", 0.5)])
    who = (JOINT_STATES, BALL, JACOBIAN)[scene.variant % 3]
    world.calm(60 + scene.ticks, silent=(who,), steady_s=0.03, ros_s=0.03)
    world.calm(10)
    if rng.random() < 0.5:
        world.start()
        world.calm(scene.ticks)


def _rival(world: World, rng: np.random.Generator, scene: Scene) -> None:
    """Let another node command the arm, or one's own commands come back."""
    for k in range(scene.ticks):
        own = scene.variant % 2 and k % 2
        data = list(world._last) if own else [float(v) for v in rng.normal(size=6)]
        world.node._on_any_command(Float64MultiArray(data=data))
        if not own:
            world._end_session()
        world.calm(1)
    world.calm(3 * scene.ticks)


def _freeze(world: World, _rng: np.random.Generator, scene: Scene) -> None:
    frozen = ((JOINT_STATES,), (BALL,), (JOINT_STATES, BALL))[scene.variant % 3]
    world.calm(scene.ticks, frozen=frozen)


def _clocks(world: World, rng: np.random.Generator, scene: Scene) -> None:
    """Let a clock stall, run, crawl, jump, or go back."""
    v, ticks = scene.variant, scene.ticks
    if v == 0:
        world.calm(ticks, steady_s=0.0)
    elif v == 1:
        world.calm(ticks, ros_s=0.0)
    elif v == 2:
        world.calm(ticks, ros_s=-TICK_S)
    elif v == 3:
        world.calm(min(ticks, 10), steady_s=0.3, ros_s=0.3)
    elif v == 4:
        world.calm(ticks, steady_s=1e-9, ros_s=1e-9)
    elif v == 5:
        world.ros_s += float(rng.choice([-3600.0, -5.0, -0.5, -0.05, 0.05, 0.5, 5.0, 3600.0]))
    elif v == 6:
        world.now_s += float(rng.choice([0.05, 0.5, 5.0, 1e6]))
    elif v == 7:
        for _ in range(ticks):
            world.calm(1, steady_s=float(rng.exponential(0.01)), ros_s=float(rng.normal(0.0, 0.1)))
    elif v == 8:
        world.calm(ticks, steady_s=0.07, ros_s=0.008)
    elif v == 9:
        world.ros_s = float(rng.choice([0.0, -2147483648.0, 2147483647.9, 4e9, 1.7e9]))
    else:
        world.calm(ticks, steady_s=0.002, ros_s=0.002)
    world.calm(3)


def _odd_tick(world: World, rng: np.random.Generator, scene: Scene) -> None:
    """Tick the loop with a time step that no clock gives."""
    for _ in range(min(scene.ticks, 5)):
        dt_s = float(rng.choice([*WILD, -1.0, 0.008, 1e-12, 10.0]))
        world.node._loop.tick(world.now_s, dt_s)
        world.calm(1)


def _garbage(world: World, rng: np.random.Generator, scene: Scene) -> None:
    """Send messages that nobody should send, alone or in a storm."""
    for _ in range(1 + scene.ticks // 6 if scene.variant > 5 else 1):
        MESSAGES[int(rng.integers(len(MESSAGES)))](world, rng)
        world._check_wire()
        if rng.random() < 0.5:
            world.calm(1)
    if scene.variant % 2:
        world.calm(8)


def _garbage_joints(world: World, rng: np.random.Generator) -> None:
    names, positions = list(UR_JOINT_NAMES), world._joints.tolist()
    for _ in range(int(rng.integers(1, 3))):
        what = int(rng.integers(8))
        if what == 0:
            order = rng.permutation(len(names)).tolist()
            names, positions = [names[i] for i in order], (positions + [0.0] * 9)[: len(names)]
        elif what == 1 and names:
            names.pop(int(rng.integers(len(names))))
        elif what == 2:
            names.append(
                str(rng.choice(["gripper", "", names[0] if names else "x", "é", "a" * 99]))
            )
        elif what == 3 and positions:
            positions.pop()
        elif what == 4:
            positions.append(float(rng.choice(WILD)))
        elif what == 5 and positions:
            positions[int(rng.integers(len(positions)))] = float(rng.choice(WILD))
        elif what == 6:
            names, positions = ["gripper"], [0.5]
        else:
            names, positions = [], []
    message = JointState(name=names, position=positions)
    if rng.random() < 0.3:
        message.header.stamp.sec = int(rng.choice([-(2**31), -1, 0, 1, 2**31 - 1]))
        message.header.stamp.nanosec = int(rng.choice([0, 999_999_999, 2**32 - 1]))
    else:
        _stamp(message, world.ros_s)
    world.node._on_joint_states(message)


def _garbage_ball(world: World, rng: np.random.Generator) -> None:
    message = PointStamped()
    frames = [CAMERA_FRAME, CAMERA_FRAME, CAMERA_FRAME, "", "map", " " + CAMERA_FRAME]
    message.header.frame_id = str(rng.choice(frames))
    ball = world.ball().tolist()
    for _ in range(int(rng.integers(3))):
        ball[int(rng.integers(3))] = float(rng.choice(WILD))
    message.point.x, message.point.y, message.point.z = ball
    if rng.random() < 0.3:
        message.header.stamp.sec = int(rng.choice([-(2**31), -1, 0, 1, 2**31 - 1]))
        message.header.stamp.nanosec = int(rng.choice([0, 999_999_999, 2**32 - 1]))
    else:
        _stamp(message, world.ros_s + float(rng.normal(0.0, 0.05)))
    world.node._on_ball(message)
    if message.header.frame_id != CAMERA_FRAME:
        world._bad.add(BALL)


def _garbage_jacobian(world: World, rng: np.random.Generator) -> None:
    message = Float64MultiArray()
    count = int(rng.choice([0, 1, 17, 18, 18, 18, 18, 19, 36]))
    data = np.resize(world._estimate, count)
    if count:
        data[rng.integers(count, size=int(rng.integers(3)))] = float(rng.choice(WILD))
    message.data = data.tolist()
    sizes = ([], [3, 6], [3, 6], [6, 3], [18], [2**32 - 1, 2**32 - 1])[int(rng.integers(6))]
    message.layout.dim = [MultiArrayDimension(size=size) for size in sizes]
    message.layout.data_offset = int(rng.choice([0, 0, 1, 2**32 - 1]))
    world.node._on_jacobian(message)


def _garbage_chain(world: World, rng: np.random.Generator) -> None:
    """Send any chain, or what is none."""
    chain = SerialChain(
        rng.normal(size=(6, 3)),
        rng.normal(size=(6, 3)),
        rng.normal(size=3),
        rng.uniform(-3.0, 3.0, 6),
    )
    message = to_chain(chain)
    if rng.random() < 0.5:
        message.data[int(rng.integers(len(message.data)))] = float(rng.choice(WILD))
    if rng.random() < 0.2:
        message.data = message.data[: int(rng.integers(len(message.data)))]
    world.node._on_chain(message)


def _garbage_words(world: World, rng: np.random.Generator) -> None:
    texts = [
        "unknown",
        "",
        "nan",
        "inf",
        "-1",
        "1e999",
        "0x10",
        "1_0",
        "٣",
        "1e308",
        "\0",
        "9" * 5000,
    ]
    pair = KeyValue(key=str(rng.choice(texts)), value=str(rng.choice(texts)))
    world.node._on_estimator_status(DiagnosticStatus(values=[pair], message=str(rng.choice(texts))))


def _garbage_scaling(world: World, rng: np.random.Generator) -> None:
    world.send_scaling(float(rng.choice([*WILD, 50.0, 100.0])))


def _garbage_target(world: World, rng: np.random.Generator) -> None:
    world.send_target(rng.choice([*WILD, 0.0, 0.5, 1.0], 3))


MESSAGES = (
    *(_garbage_joints, _garbage_joints, _garbage_ball, _garbage_ball),
    *(
        _garbage_jacobian,
        _garbage_jacobian,
        _garbage_chain,
        _garbage_words,
        _garbage_scaling,
        _garbage_target,
    ),
)


def _robot(world: World, rng: np.random.Generator, scene: Scene) -> None:
    """Stop the program, turn the speed slider, and back."""
    v = scene.variant
    if v < 3:
        world.send_program(False)
    elif v < 5:
        world.send_scaling(0.0)
    elif v == 5:
        world.send_scaling(float(rng.uniform(0.1, 150.0)))
    elif v == 6:
        world.send_scaling(-1.0)
    elif v == 7:
        world.send_scaling(math.nan)
    world.calm(scene.ticks)
    if v % 2 or v > 7:
        world.send_program(True)
        world.send_scaling(100.0)
        world.calm(8)
    if v > 8:
        world.start()


def _services(world: World, rng: np.random.Generator, scene: Scene) -> None:
    calls = (world.start, world.stop, lambda: world.node.call("~/set_current_as_target"))
    for _ in range(1 + scene.variant // 3):
        calls[int(rng.integers(3))]()
        world.calm(1 + scene.ticks // 6)


def _parameters(world: World, rng: np.random.Generator, scene: Scene) -> None:
    """Change live parameters in mid-motion."""
    v = scene.variant
    values: list[tuple[str, Any]] = []
    if v < 3:
        values.append(("max_joint_velocity_rad_s", float(rng.choice([0.01, 0.05, 0.3, 1.0, 3.0]))))
    elif v < 5:
        acceleration = float(rng.choice([0.1, 1.0, 6.0, 40.0]))
        values.append(("max_joint_acceleration_rad_s2", acceleration))
    elif v == 5:  # the range closes in on where the arm is
        joints = world._joints
        room = rng.uniform(-0.05, 0.3, (2, 6))
        values.append(("joint_min_rad", (joints - room[0]).tolist()))
        values.append(("joint_max_rad", (joints + np.maximum(room[1], 0.06)).tolist()))
    elif v == 6:
        values.append(("follow_time_s", float(rng.uniform(1.0, 5.0))))
    else:
        for _ in range(v - 6):
            parameter = LIVE[int(rng.integers(len(LIVE)))]
            values.append((parameter.name, _any_value(parameter, rng)))
    world.reconfigure(values)
    world.calm(scene.ticks)


def _any_value(parameter: Parameter, rng: np.random.Generator) -> Any:
    """A value of the right type, mostly within its range."""
    if parameter.choices:
        return str(rng.choice([*parameter.choices, "nonsense"]))
    if parameter.kind is bool:
        return bool(rng.integers(2))
    low = -10.0 if parameter.minimum is None else parameter.minimum
    high = 10.0 if parameter.maximum is None else parameter.maximum
    if parameter.kind is int:
        return int(rng.integers(int(low) - 1, int(min(high, low + 20))))

    def number() -> float:
        if rng.random() < 0.05:
            return float(rng.choice(WILD))
        if low >= 0.0 and rng.random() < 0.7:
            return float(10.0 ** rng.uniform(math.log10(max(low, 1e-6 * high)), math.log10(high)))
        return float(rng.uniform(low, high))

    if not parameter.is_list:
        return number()
    if rng.random() < 0.5:
        return [float(v) + float(rng.uniform(-0.5, 0.5)) for v in parameter.default]
    return [number() for _ in range(parameter.size or 1)]


def _arm(world: World, rng: np.random.Generator, scene: Scene) -> None:
    world._plant = PLANTS[scene.variant % len(PLANTS)]
    world.reconfigure([("follow_time_s", float(rng.choice([0.1, 0.4, 3.0])))])
    if scene.ticks % 4:
        world.aim(rng, 0.3)
        world.start()
    world.calm(2 * scene.ticks, steady_s=0.012, ros_s=0.012)
    if rng.random() < 0.5:
        world._plant = "obeys"


def _estimator(world: World, rng: np.random.Generator, scene: Scene) -> None:
    if scene.variant < len(ESTIMATES):
        world.set_estimate(ESTIMATES[scene.variant], rng)
    else:
        world.show(float(rng.choice([0.1, 0.5, 2.0])))
    world.calm(2 * scene.ticks)
    world.show(1.0)


def _wrong_way(world: World, rng: np.random.Generator, scene: Scene) -> None:
    """Show the ball going the other way, as behind a joint of the wrong sign."""
    if scene.variant > 5:  # slowly
        world.reconfigure([("max_joint_velocity_rad_s", 0.1)])
    world.show(-1.0)
    if scene.variant > 5:  # from a start on
        world.stop()
        world.calm(30)
        world.start()
    world.aim(rng, 0.3)
    world.calm(60 + 2 * scene.ticks, steady_s=0.02, ros_s=0.02)
    world.show(1.0)


def _swing(world: World, _rng: np.random.Generator, scene: Scene) -> None:
    """Let the ball swing, whatever the arm does."""
    world.reconfigure([("max_joint_velocity_rad_s", 0.02), ("growth_time_s", 50.0)])
    here, way = world._away, np.array([0.02 + 0.02 * scene.variant, 0.0, 0.0])
    for tick in range(300 + 4 * scene.ticks):
        world._away = here + way * np.sin(0.1 * tick)
        world.calm(1, steady_s=0.01, ros_s=0.01)
    world._away = here


def _push(world: World, rng: np.random.Generator, scene: Scene) -> None:
    """Push the ball (or the camera) away, at once or steadily."""
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    if scene.variant < 4:
        world._away = world._away + direction * (0.01, 0.05, 0.2, 1.0)[scene.variant]
        world.calm(2 * scene.ticks)
    else:
        if scene.variant > 7:  # faster than the arm
            world.reconfigure([("max_joint_velocity_rad_s", 0.02)])
        for _ in range(2 * scene.ticks):
            world._away = world._away + direction * 0.002
            world.calm(1, steady_s=0.02, ros_s=0.02)
    if rng.random() < 0.5:
        world._away = np.zeros(3)


def _wait_long(world: World, _rng: np.random.Generator, scene: Scene) -> None:
    """Let seconds pass at a slow rate of joint states: what needs time happens."""
    world.calm(40 + 2 * scene.ticks, steady_s=0.03, ros_s=0.03)


def _another_ball(world: World, rng: np.random.Generator, scene: Scene) -> None:
    """Show a ball that is not on the arm, for so long that somebody should notice."""
    world.reconfigure([("stall_time_s", 0.5 + 0.1 * scene.variant)])
    if scene.variant > 5:  # on an arm that cannot move
        ends = [("joint_min_rad", -0.001), ("joint_max_rad", 0.001)]
        world.reconfigure([(name, (world._joints + off).tolist()) for name, off in ends])
    world._other_ball = world.ball()
    world._begin_lie()
    world.aim(rng, 0.3)
    world.calm(60 + 2 * scene.ticks, steady_s=0.02, ros_s=0.02)
    if scene.variant % 2:
        world._other_ball = None


def _mad_law(world: World, rng: np.random.Generator, scene: Scene) -> None:
    """Let the law answer anything at all."""
    loop = world.node._loop

    def answer(_input: Any) -> Any:
        what = int(rng.integers(8))
        if what == 0:
            raise ZeroDivisionError("a law's own mistake")
        velocity = rng.choice([*WILD, 1.0, -1.0, 0.1], int(rng.choice([6, 6, 6, 5, 0])))
        sliding = np.zeros(3) if what < 6 else rng.choice(WILD, int(rng.choice([3, 2])))
        return ControlOutput(velocity, sliding, np.ones(3)) if what != 1 else None

    sane = loop.law
    loop.law = MadLaw(answer)
    world.calm(min(scene.ticks, 6))
    loop.law = sane
    if scene.variant % 2:
        world.start()


class MadLaw(ControlLaw):
    """A law that answers what it is told to."""

    def __init__(self, answer: Callable[[Any], Any]) -> None:
        self._answer = answer

    @classmethod
    def from_values(cls, values: Any) -> ControlLaw:
        raise NotImplementedError

    def command(self, control_input: Any) -> ControlOutput:
        return self._answer(control_input)


def _to_the_limit(world: World, rng: np.random.Generator, scene: Scene) -> None:
    """Put the arm near ends of its range, with a target beyond."""
    lower, upper = (np.array(world.node.values[k]) for k in ("joint_min_rad", "joint_max_rad"))
    joint = int(rng.integers(6))
    room = float(rng.choice([0.0, 1e-6, 0.01, 0.1, 0.3]))
    end = upper[joint] - room if scene.variant % 2 else lower[joint] + room
    world._away = world._away + TRUE_JACOBIAN[:, joint] * (world._joints[joint] - end)
    world._joints[joint] = end
    world.calm(FRESH_TICKS)
    side = 1.0 if scene.variant % 2 else -1.0
    world.send_target(world.ball() + side * 0.5 * TRUE_JACOBIAN[:, joint])
    world.start()
    world.calm(scene.ticks)
    if scene.variant > 5:
        world.stop()
        world.calm(scene.ticks)


def _shutdown(world: World, _rng: np.random.Generator, scene: Scene) -> None:
    """Shut down, rarely: nothing moves any more."""
    if scene.variant == 0:
        world.node._loop.supervisor.shutdown()
        world._shut_down = True
        world._end_session()
        world._last = tuple(world.node._loop.supervisor.velocity_rad_s.tolist())
        world._promise(not any(world._last), "zeros at once", lambda: "shutdown")
    world.calm(scene.ticks)


#: Scenes by name: how often, relative to each other, and what happens.
SCENES: dict[str, tuple[int, Callable[[World, np.random.Generator, Scene], None]]] = {
    "calm": (3, _calm),
    "work": (7, _work),
    "target": (3, _target),
    "moving target": (2, _moving_target),
    "services": (2, _services),
    "silence": (2, _silence),
    "abandoned": (1, _abandon),
    "rival": (1, _rival),
    "frozen stamps": (1, _freeze),
    "clocks": (3, _clocks),
    "odd tick": (1, _odd_tick),
    "garbage": (3, _garbage),
    "robot": (2, _robot),
    "parameters": (4, _parameters),
    "arm": (2, _arm),
    "estimator": (2, _estimator),
    "wrong way": (1, _wrong_way),
    "swing": (1, _swing),
    "push": (2, _push),
    "long wait": (1, _wait_long),
    "another ball": (1, _another_ball),
    "mad law": (1, _mad_law),
    "to the limit": (2, _to_the_limit),
    "shutdown": (1, _shutdown),
}
