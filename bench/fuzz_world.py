"""A world around the controller node, none of it trustworthy: arm, camera, estimator, operator.

The node's own callbacks run on real messages, with clock, topics and timers of plain Python
(:mod:`bench.dry_node`), so that a tick takes a fraction of a millisecond. The world keeps an
account of its own of what it sent; :mod:`bench.fuzz_promises` judges every tick by it.
"""

from __future__ import annotations

import math
from collections import Counter, deque

import numpy as np
import rclpy
from sensor_msgs.msg import JointState

from bench.dry_node import DryController
from fvs_controller_node.config import PARAMETERS, SupervisorConfig
from fvs_controller_node.relation import OBJECT_FRAME
from fvs_ros import ros, topics
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.interface import POSITION
from fvs_ros.joints import UR_JOINT_NAMES, ForeignJointsError, JointMap
from fvs_ros.kinds.ball import Ball
from fvs_ros.limits import JointLimits
from fvs_ros.params import ParameterSet
from fvs_sim_node.robot import HOME_JOINTS_RAD

TICK_S = 0.008
#: A tick counts for at most this, s.
LONGEST_TICK_S = 0.05
FRESH_TICKS = 26  # until every input counts again
HOME_BALL_M = np.array([0.0, 0.0, 1.2])
#: An arm of fewer joints lacks the last ones.
MOST_JOINTS = 7
_HOME_RAD = np.array([*HOME_JOINTS_RAD, 0.4])
_JACOBIAN = np.array(
    [
        [0.02, -0.45, -0.30, -0.10, 0.05, 0.0, 0.20],
        [-0.55, 0.03, 0.04, 0.02, 0.17, 0.0, -0.10],
        [0.10, -0.25, 0.35, 0.15, -0.02, 0.0, 0.15],
    ]
)
JOINT_STATES, BALL, JACOBIAN = "joint_states", "ball_position", "jacobian"
OBJECT = "object_position"
#: The input's limit of age, by input.
MAX_AGE = {
    JOINT_STATES: "joint_states_max_age_s",
    BALL: "ball_max_age_s",
    OBJECT: "ball_max_age_s",
    JACOBIAN: "jacobian_max_age_s",
}

#: How the drives answer: (wanted speed, present speed, rad/s, dt, s) -> next speed, rad/s.
PLANTS = {
    "obeys": lambda wanted, _drive, _dt_s: wanted,
    "lags": lambda wanted, drive, dt_s: drive + (wanted - drive) * min(1.0, dt_s / 0.035),
    "creeps": lambda wanted, _drive, _dt_s: 0.2 * wanted,
    "ignores": lambda wanted, _drive, _dt_s: 0.0 * wanted,
    "inverts": lambda wanted, _drive, _dt_s: -wanted,
    "one joint sticks": lambda wanted, _drive, _dt_s: wanted * (np.arange(wanted.size) != 1),
}


class BrokenPromiseError(AssertionError):
    """The controller did what it must never do: the promise, and the values that show it."""

    def __init__(self, promise, *how):
        super().__init__(f"{promise}: {', '.join(map(str, how))}")
        self.promise = promise


def keep(promise, kept, *how):
    """Raise unless a promise was kept; ``how`` are the values that show it."""
    if not kept:
        raise BrokenPromiseError(promise, *how)


class World:
    """A controller node, an arm, a ball, an estimator and an operator.

    ``parameters`` are those of the node that are not at their defaults; with ``simulated_time`` it
    takes its time steps from the stamps, which begin at ``epoch_s``. The arm has 4 to 7 joints.
    """

    def __init__(self, parameters=None, simulated_time=False, epoch_s=1000.0, joints=6):
        self.home_rad, self.true = _HOME_RAD[:joints], _JACOBIAN[:, :joints]
        # From no place to an end is it a full turn: that would be no jump, but a driver that wraps.
        arm = {"joint_min_rad": [-3.6] * joints, "joint_max_rad": [3.6] * joints}
        if joints != len(UR_JOINT_NAMES):
            arm["joint_names"] = [f"joint_{number}" for number in range(joints)]
        nowhere = "/proc/nowhere/references.yaml"  # nothing is written
        own = {"joint_state_rate_hz": 1.0 / TICK_S, "references_path": nowhere}
        parameters = {**arm, **own, **(parameters or {})}
        self.values = ParameterSet(PARAMETERS).values(parameters)
        self.limits = JointLimits.from_values(self.values)
        self.now_s, self.ros_s = 100.0, epoch_s
        self.node = DryController(parameters, lambda: self.now_s, simulated_time)
        self.node.on_tick = self._on_tick
        self.positions = self.values["command_interface"] == POSITION
        topic = topics.POSITION_COMMANDS if self.positions else topics.COMMANDS
        self.wire = self.node.published[topic.name]  # commands since the last tick
        self.goes_to = None  # the last position command of a session, rad
        self.names = tuple(self.values["joint_names"])
        self.last = self.before = np.zeros(joints)  # the last two commands, rad/s
        # the arm, the camera, the estimator
        self.plant = "obeys"
        self.joints = self.home_rad.copy()
        self.drive = np.zeros(joints)  # the drives' speed, rad/s
        self.honest = True  # since the start the arm did what it was told, as far as it could
        self.push_m = np.zeros(HOME_BALL_M.size)  # what moved the ball beside the arm
        self.seen_share = 1.0  # of the ball's motion, that the camera shows
        self.estimate = self.true
        self._images = deque(maxlen=5)  # the camera's latency is four ticks
        #: A camera on the arm has no object beside the ball.
        self.on_arm = self.node._kind.on_arm
        self.object_m = None  # none is there
        self.relative = False  # whether the target is relative to it
        self._beats = 0
        # the account: what a good controller knows
        self.session, self._autostart_left = False, self.values["autostart"]
        self.asked_s = -math.inf  # when ~/start was called last
        self.program_runs, self.scaling = True, 100.0
        self.arrived_s = dict.fromkeys(MAX_AGE, -math.inf)
        self._seen_s = {BALL: [], OBJECT: []}
        self.good = dict.fromkeys(MAX_AGE, 0.0)  # messages since the last trouble; inf: trusted
        self.bad = set()
        self.stamps_s = {}
        self._heard_joints = -math.inf, self.joints  # stamp, s, and positions, rad
        #: Whether a task began (a start, a change), and whether the image or the arm was moved.
        self.new_task = self.new_image = True
        self.reasons = Counter()
        self.moving_ticks = 0

    def _on_tick(self, command, now_s, dt_s):
        self.before, self.last = self.last, command.velocity_rad_s
        self.reasons[command.reason.name] += 1
        self.moving_ticks += bool(self.last.any())
        self.judge(command, now_s, dt_s)
        self.wire.clear()

    def judge(self, command, now_s, dt_s):
        """Judge a tick: its command, the steady clock and the time step, s."""

    def end_session(self):
        """From here on a motion needs a start."""
        if self.session:
            self.session = self._autostart_left = False

    # ---- time -----------------------------------------------------------------------------

    def run(self, ticks, *, silent=(), frozen=(), steady_s=TICK_S, ros_s=None):
        """Let time pass, with every message except ``silent`` and fresh stamps except ``frozen``.

        A tick takes ``steady_s`` on the steady clock and ``ros_s`` on that of the stamps.
        """
        self.honest &= ros_s is None and self.plant in ("obeys", "lags") and self.scaling == 100.0
        self.honest &= steady_s == TICK_S or not self.positions  # a path steps by a known period
        for _ in range(ticks):
            self._beats += 1
            self.now_s += steady_s
            self.ros_s += steady_s if ros_s is None else ros_s
            self._move(min(steady_s, LONGEST_TICK_S))
            if BALL not in silent and self._beats % 4 == 0:
                stamp_s, ball = self._images[0]
                self.send_ball(ball, self.stamps_s.get(BALL, 0.0) if BALL in frozen else stamp_s)
            if self.object_m is not None and OBJECT not in silent and self._beats % 4 == 2:
                last_s = self.stamps_s.get(OBJECT, 0.0)
                self.send_object(self.object_m, last_s if OBJECT in frozen else self.ros_s)
            if JACOBIAN not in silent and self._beats % 2 == 0:
                self.send_jacobian(ros.to_jacobian(self.estimate))
            if JOINT_STATES in silent:
                self.node._ticker.on_missing()
            else:
                last_s = self.stamps_s.get(JOINT_STATES, 0.0)
                self.send_joints(self.joints, last_s if JOINT_STATES in frozen else self.ros_s)
            if self._beats % 25 == 0:
                self.node._publish_status()

    def _move(self, dt_s):
        """Let the arm do what it does with the last command."""
        wanted = self.last
        if self.goes_to is not None:
            fast = self.values["max_joint_velocity_rad_s"]
            wanted = np.clip((self.goes_to - self.joints) / max(dt_s, 1e-9), -fast, fast)
        wanted = min(max(self.scaling, 0.0), 100.0) / 100.0 * wanted
        self.drive = PLANTS[self.plant](wanted, self.drive, dt_s)
        self.joints = self.joints + self.drive * dt_s
        self._images.append((self.ros_s, self.ball()))

    def arm_moved_m(self):
        """How far the arm has carried the ball from home, m."""
        return self.true @ (self.joints - self.home_rad)

    def ball(self):
        """Where the camera sees the ball, m."""
        return HOME_BALL_M + self.seen_share * self.arm_moved_m() + self.push_m

    # ---- inputs, each entered into the account on its way ---------------------------------

    def _note(self, name, value, stamp_s=None):
        """Count a message; ``value`` is None where it cannot be read."""
        last_s = self.stamps_s.get(name)
        if value is not None and stamp_s is not None:
            # An older stamp is a late message, a much older one another clock.
            if last_s is not None and last_s - 0.1 <= stamp_s <= last_s:
                return
            self.stamps_s[name] = stamp_s
        if value is None or not np.all(np.abs(value) <= 100.0):
            self.bad.add(name)
            return
        late = not self.now_s - self.arrived_s[name] <= self.max_age_s(name)
        self.good[name] = 1.0 if late or name in self.bad else self.good[name] + 1.0
        if self.good[name] >= SupervisorConfig.fresh_samples:
            self.good[name] = math.inf
        if name in self._seen_s:
            self._seen_s[name].append(self.now_s)
        self.arrived_s[name] = self.now_s
        self.bad.discard(name)

    def image_period_s(self, name=BALL):
        """Longest time between the last images, s."""
        return max(np.diff(self._seen_s[name][-10:]), default=0.0)

    @property
    def idle(self):
        """Inputs that do not count now."""
        return set() if self.relative else {OBJECT}

    def max_age_s(self, name):
        """Age up to which an input is fresh, s; of what a slow camera sees half a second."""
        slow_s = min(0.5, 2.5 * self.image_period_s(name)) if name in self._seen_s else 0.0
        hidden_s = self.values["object_may_be_hidden_s"] if name == OBJECT else 0.0
        return max(self.values[MAX_AGE[name]], slow_s) + hidden_s

    def send_joints(self, joints_rad, stamp_s, names=None):
        """Send a joint state; the node ticks."""
        self.honest &= np.array_equal(joints_rad, self.joints)
        names = self.names if names is None else names
        message = JointState(name=list(names), position=[float(q) for q in joints_rad])
        message.header.stamp = ros.to_stamp(stamp_s)
        try:
            joints = JointMap(self.names).positions(message.name, message.position)
        except ForeignJointsError:
            pass  # another device's
        except ValueError:
            self._note(JOINT_STATES, None)
        else:
            stamp_s = ros.from_stamp(message.header.stamp)
            (before_s, before), self._heard_joints = self._heard_joints, (stamp_s, joints)
            passed_s = stamp_s - before_s
            # No joint steps further, unless it was not seen for long.
            fastest_rad = 0.1 + 1.5 * math.pi * passed_s
            jumped = 0.0 < passed_s < 0.5 and np.abs(joints - before).max() > fastest_rad
            self._note(JOINT_STATES, None if jumped else joints, stamp_s)
        self.node._on_joint_states(message)

    def send_ball(self, ball_m, stamp_s, frame=CAMERA_FRAME):
        """Send a ball position, m."""
        message = ros.to_feature(stamp_s, frame, Ball(), ball_m)
        value = _read(ros.from_feature, message, Ball(), CAMERA_FRAME, BALL)
        self._note(BALL, value, ros.from_stamp(message.header.stamp))
        self.node.hears[self.node._kind.feature.name](message)

    def send_object(self, object_m, stamp_s, frame=CAMERA_FRAME):
        """Send an object's position, m."""
        if self.on_arm:
            return
        message = ros.to_feature(stamp_s, frame, Ball(), object_m)
        value = _read(ros.from_feature, message, Ball(), CAMERA_FRAME, OBJECT)
        self._note(OBJECT, value, ros.from_stamp(message.header.stamp))
        self.new_task |= self.relative
        self.node.hears[OBJECT](message)

    def send_jacobian(self, message):
        """Send a Jacobian, m/rad."""
        self._note(JACOBIAN, _read(ros.from_jacobian, message, self.joints.size))
        self.node.hears[topics.JACOBIAN.name](message)

    @property
    def singular_m_rad(self):
        """Smallest singular value of the Jacobian in use, m/rad."""
        jacobian = self.node._loop.jacobian
        return math.inf if jacobian is None else np.linalg.svd(jacobian, compute_uv=False)[-1]

    def send_chain(self, message):
        """Send a kinematic chain: only one that cannot be read counts."""
        if _read(ros.from_chain, message, self.joints.size, self.node._kind) is None:
            self._note(JACOBIAN, None)
        self.node.hears[topics.KINEMATIC_CHAIN.name](message)

    # ---- the operator -------------------------------------------------------------------------

    def send_target(self, target_m, frame=CAMERA_FRAME):
        """Send a target, m."""
        target_m = np.array(list(target_m))
        before = self.target_m
        self.node._on_target(ros.to_feature(self.ros_s, frame, Ball(), target_m))
        low, high = (np.array(self.values[f"workspace_{end}_m"]) for end in ("min", "max"))
        inside = np.all((low <= target_m) & (target_m <= high))
        allowed = frame == OBJECT_FRAME or (frame == CAMERA_FRAME and inside)
        same = np.array_equal(before, self.target_m)
        keep("a wrong target changes nothing", allowed or same, target_m, frame)
        if not self.node._refusal:
            self.relative = frame == OBJECT_FRAME and not self.on_arm

    @property
    def target_m(self):
        """The target in use, m, or None."""
        return self.node._loop.supervisor.goal.target

    def start(self):
        """Call ``~/start``."""
        rests = not (self.session or self.last.any()) and self.goes_to is None
        done, text = self.node.call("~/start")
        self.session, self.honest = self.session or done, self.honest or (rests and done)
        self.asked_s, self.new_task = self.now_s, True
        keep("says why", bool(text), "~/start")

    def stop(self):
        """Call ``~/stop``."""
        self.node.call("~/stop")
        self.session = self._autostart_left = False

    def set(self, values):
        """Set live parameters; a refusal must change nothing."""
        self.new_task, self.honest = True, False
        loop = self.node._loop
        before = loop.law, loop.supervisor.config, self.node.values
        result = self.node.set_parameters_atomically(
            [rclpy.Parameter(k, value=v) for k, v in values.items()]
        )
        if result.successful:
            self.values = {**self.values, **self.node.parameter_set.checked(values)}
            self.limits = JointLimits.from_values(self.values)
            return
        same = before == (loop.law, loop.supervisor.config, self.node.values)
        keep("a refusal changes nothing", same, values)
        keep("says why", bool(result.reason), values)


def _read(parse, message, *rest):
    """What a message says, or None."""
    try:
        return parse(message, *rest)
    except ros.MessageError:
        return None
