"""A world around the controller node, none of it trustworthy: arm, camera, estimator, operator.

The node's own callbacks run on real messages, with clock, topics and timers of plain Python
(:mod:`bench.dry_node`), so that a tick takes a fraction of a millisecond. The world keeps an
account of its own of what it sent; :mod:`bench.fuzz_promises` judges every tick by it.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray

from bench.dry_node import DryController
from bench.fuzz_promises import LONGEST_TICK_S, Promises
from fvs_controller_node.config import PARAMETERS, SupervisorConfig
from fvs_controller_node.supervisor import Command
from fvs_ros import ros, topics
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.joints import HOME_JOINTS_RAD, UR_JOINT_NAMES, ForeignJointsError, JointMap
from fvs_ros.params import ParameterSet

TICK_S = 0.008
FRESH_TICKS = 26  # until every input counts again
IMAGE_EVERY, JACOBIAN_EVERY, STATUS_EVERY, LATENCY_TICKS = 4, 2, 25, 4
HOME_RAD = np.array(HOME_JOINTS_RAD)
HOME_BALL_M = np.array([0.0, 0.0, 1.2])
TRUE_JACOBIAN = np.array(
    [
        [0.02, -0.45, -0.30, -0.10, 0.05, 0.0],
        [-0.55, 0.03, 0.04, 0.02, 0.17, 0.0],
        [0.10, -0.25, 0.35, 0.15, -0.02, 0.0],
    ]
)
#: No number in an input is larger (rad, m, m/rad); no joint moves faster, rad/s, or steps further,
#: rad; an older stamp is a late message, an even older one another clock, s.
LARGEST, FASTEST_RAD_S, STEP_RAD, BACKSTEP_S = 100.0, 1.5 * math.pi, 0.1, 0.1
#: A gap after which joints may be anywhere, s; silence after which a chain is forgotten, s.
GAP_S, CHAIN_S = 0.5, 1.5
JOINT_STATES, BALL, JACOBIAN = "joint_states", "ball_position", "jacobian"
INPUTS = (JOINT_STATES, BALL, JACOBIAN)
CHAIN, SPEED_SCALING = "kinematic_chain", "speed_scaling"
MAX_AGE = {
    JOINT_STATES: "joint_states_max_age_s",
    BALL: "ball_max_age_s",
    JACOBIAN: "jacobian_max_age_s",
}

#: How the drives answer: (wanted speed, present speed, rad/s, dt, s) -> next speed, rad/s.
PLANTS: dict[str, Callable[[np.ndarray, np.ndarray, float], np.ndarray]] = {
    "obeys": lambda wanted, _drive, _dt_s: wanted,
    "lags": lambda wanted, drive, dt_s: drive + (wanted - drive) * min(1.0, dt_s / 0.035),
    "creeps": lambda wanted, _drive, _dt_s: 0.2 * wanted,
    "ignores": lambda wanted, _drive, _dt_s: 0.0 * wanted,
    "inverts": lambda wanted, _drive, _dt_s: -wanted,
    "one joint sticks": lambda wanted, _drive, _dt_s: wanted * (np.arange(wanted.size) != 1),
}


class World:
    """A controller node, an arm, a ball, an estimator and an operator.

    Parameters
    ----------
    given : mapping
        Parameters of the node that are not at their defaults.
    simulated_time : bool
        Whether the node takes its time steps from stamps.
    epoch_s : float
        Where the stamps begin, s.
    """

    def __init__(
        self,
        given: Mapping[str, Any] | None = None,
        simulated_time: bool = False,
        epoch_s: float = 1000.0,
    ) -> None:
        given = given or {}
        self.values = ParameterSet(PARAMETERS).values(given)
        self.now_s, self.ros_s = 100.0, epoch_s
        self.node = DryController(given, lambda: self.now_s, simulated_time)
        self.node.on_tick = self._judge
        commands = self.node.publishers_by_topic[topics.COMMANDS.name]
        commands.heard = lambda data: self.wire.append(np.array(data))
        self.wire: list[np.ndarray] = []  # commands since the last tick
        # the arm, the camera, the estimator
        self.plant = "obeys"
        self.joints = HOME_RAD.copy()
        self.drive = np.zeros(HOME_RAD.size)  # the drives' speed, rad/s
        self.push_m = np.zeros(HOME_BALL_M.size)  # what moved the ball beside the arm
        self.seen_share = 1.0  # of the ball's motion, that the camera shows
        self.estimate = TRUE_JACOBIAN
        self._images: deque[tuple[float, np.ndarray]] = deque(maxlen=LATENCY_TICKS + 1)
        self._beats = 0
        # the account: what a good controller knows
        self.session, self._autostart_left = False, self.values["autostart"]
        self.asked_s = -math.inf  # when ~/start was called last
        self.program_runs, self.scaling = True, 100.0
        self.arrived_s = dict.fromkeys(INPUTS, -math.inf)
        self.good = dict.fromkeys(INPUTS, 0.0)  # messages since the last trouble; inf: trusted
        self.bad: set[str] = set()
        self.stamps_s: dict[str, float] = {}
        self._chain_s = -math.inf
        self._heard_joints: np.ndarray | None = None
        self.singular_m_rad = math.inf
        self.promises = Promises(self)
        self.reasons: Counter[str] = Counter()
        self.moving_ticks = 0

    def _judge(self, command: Command, now_s: float, dt_s: float) -> None:
        self.reasons[command.reason.name] += 1
        self.moving_ticks += bool(command.velocity_rad_s.any())
        if now_s - self._chain_s > CHAIN_S:
            self.bad.discard(CHAIN)
        self.promises.judge(command, now_s, dt_s)
        self.wire.clear()

    def end_session(self) -> None:
        """From here on a motion needs a start."""
        if self.session:
            self.session = self._autostart_left = False

    def take_session(self) -> bool:
        """Whether the arm may move: it was started, or starts once by itself."""
        if not self.session and self._autostart_left:
            self.session, self._autostart_left = True, False
        return self.session

    def age_limits_s(self) -> dict[str, float]:
        """Age from which each input is late, s."""
        return {name: self.values[limit] for name, limit in MAX_AGE.items()}

    # ---- time -----------------------------------------------------------------------------

    def run(
        self,
        ticks: int,
        *,
        silent: Iterable[str] = (),
        frozen: Iterable[str] = (),
        steady_s: float = TICK_S,
        ros_s: float | None = None,
    ) -> None:
        """Let time pass, with every message except ``silent`` and fresh stamps except ``frozen``.

        A tick takes ``steady_s`` on the steady clock and ``ros_s`` on that of the stamps.
        """
        for _ in range(ticks):
            self._beats += 1
            self.now_s += steady_s
            self.ros_s += steady_s if ros_s is None else ros_s
            self._move(steady_s)
            if BALL not in silent and self._beats % IMAGE_EVERY == 0:
                stamp_s, ball = self._images[0]
                self.send_ball(ball, self.stamps_s.get(BALL, 0.0) if BALL in frozen else stamp_s)
            if JACOBIAN not in silent and self._beats % JACOBIAN_EVERY == 0:
                self.send_jacobian(ros.to_jacobian(self.estimate))
            if JOINT_STATES in silent:
                self.node._watchdog()
            else:
                last_s = self.stamps_s.get(JOINT_STATES, 0.0)
                self.send_joints(self.joints, last_s if JOINT_STATES in frozen else self.ros_s)
            if self._beats % STATUS_EVERY == 0:
                self.node._publish_status()

    def _move(self, dt_s: float) -> None:
        """Let the arm do what it does with the last command."""
        dt_s = min(dt_s, LONGEST_TICK_S)
        wanted = min(max(self.scaling, 0.0), 100.0) / 100.0 * self.promises.last
        self.drive = PLANTS[self.plant](wanted, self.drive, dt_s)
        self.joints = self.joints + self.drive * dt_s
        self._images.append((self.ros_s, self.ball()))

    @property
    def known_joints(self) -> np.ndarray | None:
        """Joints as the controller knows them, its encoders' noise averaged, rad, or None."""
        return self.node._loop._joints

    @property
    def estimate_is_wrong(self) -> bool:
        """Whether the estimator's Jacobian is not that of the arm."""
        return self.estimate is not TRUE_JACOBIAN

    def arm_speed_m_s(self) -> float:
        """How fast the arm carries the ball, m/s."""
        return float(np.linalg.norm(TRUE_JACOBIAN @ self.drive))

    def arm_moved_m(self) -> np.ndarray:
        """How far the arm has carried the ball from home, m."""
        return TRUE_JACOBIAN @ (self.joints - HOME_RAD)

    def ball(self) -> np.ndarray:
        """Where the camera sees the ball, m."""
        return HOME_BALL_M + self.seen_share * self.arm_moved_m() + self.push_m

    # ---- inputs, each entered into the account on its way ---------------------------------

    def _note(self, name: str, value: np.ndarray | None, stamp_s: float | None = None) -> None:
        """Count a message; ``value`` is None where it cannot be read."""
        last_s = self.stamps_s.get(name)
        if value is not None and stamp_s is not None:
            if last_s is not None and last_s - BACKSTEP_S <= stamp_s <= last_s:
                return
            self.stamps_s[name] = stamp_s
        if value is None or not np.all(np.abs(value) <= LARGEST):
            self.bad.add(name)
            return
        late = not self.now_s - self.arrived_s[name] <= self.values[MAX_AGE[name]]
        self.good[name] = 1.0 if late or name in self.bad else self.good[name] + 1.0
        if self.good[name] >= SupervisorConfig.fresh_samples:
            self.good[name] = math.inf
        self.arrived_s[name] = self.now_s
        self.bad.discard(name)

    def send_joints(
        self, joints_rad: Iterable[float], stamp_s: float, names: Iterable[str] = UR_JOINT_NAMES
    ) -> None:
        """Send a joint state; the node ticks."""
        message = JointState(name=list(names), position=[float(q) for q in joints_rad])
        message.header.stamp = ros.to_stamp(stamp_s)
        before_s, before = self.stamps_s.get(JOINT_STATES), self._heard_joints
        try:
            joints = JointMap().positions(message.name, message.position)
        except ForeignJointsError:
            pass  # another device's
        except ValueError:
            self._note(JOINT_STATES, None)
        else:
            stamp_s = ros.from_stamp(message.header.stamp)
            self._note(JOINT_STATES, joints, stamp_s)
            if self.stamps_s[JOINT_STATES] == stamp_s != before_s:
                self._heard_joints = joints
                passed_s = math.inf if before_s is None else stamp_s - before_s
                if before is not None and 0.0 < passed_s < GAP_S:
                    step_rad = float(np.abs(joints - before).max())
                    if step_rad > STEP_RAD + FASTEST_RAD_S * passed_s:
                        self.bad.add(JOINT_STATES)
        self.node._on_joint_states(message)

    def send_ball(self, ball_m: Iterable[float], stamp_s: float, frame: str = CAMERA_FRAME) -> None:
        """Send a ball position, m, (3,)."""
        message = ros.to_point(stamp_s, frame, ball_m)
        value = _read(ros.from_point, message, CAMERA_FRAME, BALL)
        self._note(BALL, value, ros.from_stamp(message.header.stamp))
        self.node._on_ball(message)

    def send_jacobian(self, message: Float64MultiArray) -> None:
        """Send a Jacobian, m/rad."""
        jacobian = _read(ros.from_jacobian, message, *TRUE_JACOBIAN.shape)
        self._note(JACOBIAN, jacobian)
        usable = JACOBIAN not in self.bad and jacobian is not None
        self.singular_m_rad = np.linalg.svd(jacobian, compute_uv=False)[-1] if usable else math.inf
        self.node._on_jacobian(message)

    def send_chain(self, message: Float64MultiArray) -> None:
        """Send a kinematic chain; it counts while the law reads chains, until it is forgotten."""
        if self.node._loop.law.reads_chain:
            self._chain_s = self.now_s
            self.bad.discard(CHAIN)
            if _read(ros.from_chain, message, TRUE_JACOBIAN.shape[1]) is None:
                self.bad.add(CHAIN)
        self.node._on_chain(message)

    def send_program(self, running: bool) -> None:
        """Say whether the robot's program runs."""
        self.program_runs = running
        if not running:
            self.end_session()
        self.node._on_program_running(Bool(data=running))

    def send_scaling(self, percent: float) -> None:
        """Say the robot's speed scaling, %."""
        if math.isfinite(percent):
            self.scaling = percent
            self.bad.discard(SPEED_SCALING)
            if percent <= 0.0:
                self.end_session()
        else:
            self.bad.add(SPEED_SCALING)
        self.node._on_speed_scaling(Float64(data=percent))

    def send_command(self, values: Iterable[float]) -> None:
        """Let another node command the arm."""
        values = [float(v) for v in values]
        if tuple(values) not in self.node._sent:  # one's own come back, too
            self.end_session()
        self.node._on_any_command(Float64MultiArray(data=values))

    # ---- the operator -------------------------------------------------------------------------

    def send_target(self, target_m: Iterable[float], frame: str = CAMERA_FRAME) -> None:
        """Send a target, m, (3,)."""
        target_m = np.array(list(target_m))
        before = self.target_m
        self.node._on_target(ros.to_point(self.ros_s, frame, target_m))
        low, high = (np.array(self.values[f"workspace_{end}_m"]) for end in ("min", "max"))
        allowed = frame == CAMERA_FRAME and np.all((low <= target_m) & (target_m <= high))
        same = np.array_equal(before, self.target_m)
        self.promises.keep("a wrong target changes nothing", allowed or same, target_m, frame)

    @property
    def target_m(self) -> np.ndarray | None:
        """The target in use, m, (3,), or None."""
        return self.node._loop.supervisor.goal.target_m

    def aim(self, way_rad: Iterable[float]) -> None:
        """Send a target that such a motion of the joints from here reaches."""
        self.send_target(self.ball() + TRUE_JACOBIAN @ np.array(list(way_rad)))

    def start(self) -> None:
        """Call ``~/start``."""
        done, text = self.node.call("~/start")
        self.session |= done
        self.asked_s = self.now_s
        self.promises.begin()
        self.promises.keep("says why", bool(text), "~/start")

    def stop(self) -> None:
        """Call ``~/stop``."""
        self.node.call("~/stop")
        self.session = self._autostart_left = False

    def set(self, values: Mapping[str, Any]) -> None:
        """Set live parameters; a refusal must change nothing."""
        self.promises.begin()
        loop = self.node._loop
        before = loop.law, loop.supervisor.config, self.node.values
        result = self.node.set_parameters_atomically(
            [rclpy.Parameter(k, value=v) for k, v in values.items()]
        )
        if result.successful:
            self.values = {**self.values, **self.node.parameter_set.checked(values)}
            return
        same = before == (loop.law, loop.supervisor.config, self.node.values)
        self.promises.keep("a refusal changes nothing", same, values)
        self.promises.keep("says why", bool(result.reason), values)

    def shut_down(self) -> None:
        """End the node: zeros, whatever comes after."""
        self.node._loop.supervisor.shutdown()
        self.end_session()
        self.bad.add("the end")
        self.promises.last = np.zeros_like(self.promises.last)
        self.run(3)


def _read(parse: Callable, message: PointStamped | Float64MultiArray, *rest: str) -> Any:
    """What a message says, or None."""
    try:
        return parse(message, *rest)
    except ros.MessageError:
        return None
