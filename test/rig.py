"""The whole robot on wires: real simulator, estimator and controller, and a record of commands."""

import math
import subprocess
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PointStamped
from harness import SLOWNESS, Harness, Statuses
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import Trigger
from wire import PREFIX, Wire

from fvs_ros import ros, topics
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.kinds.ball import Ball

SIMULATOR, ESTIMATOR, CONTROLLER = "fvs_sim_node", "fvs_estimator_node", "fvs_controller_node"

#: Limits that the controller is given, rad/s and rad/s^2, and the time a ramp to zero takes, s.
VELOCITY, ACCELERATION = 0.5, 5.0
RAMP_S = VELOCITY / ACCELERATION
#: What a busy machine may add to any time between two processes, s: three or four of them in a
#: row, each waiting for a core.
BUSY_S = 0.3 * SLOWNESS
#: The supervisor counts a tick for at most this long, s: so no command differs from the one before
#: by more than the acceleration limit times this, however late it comes.
LONGEST_TICK_S = 0.05
#: Two targets well inside the box of joints that the model was trained in, camera frame, m; each a
#: quarter of a metre from where the ball is at home, and 0.34 m from the other.
TARGETS = (-0.15, 0.09, 1.58), (0.16, 0.20, 1.67)

#: Slower joint states than a UR's, so that four processes do not fill two small cores, and what a
#: test sees late is what the test made late.
_RATE_HZ = 50
_PARAMETERS = {
    SIMULATOR: {"joint_state_rate_hz": _RATE_HZ},
    ESTIMATOR: {},
    CONTROLLER: {
        "joint_state_rate_hz": float(_RATE_HZ),
        "max_joint_velocity_rad_s": VELOCITY,
        "max_joint_acceleration_rad_s2": ACCELERATION,
    },
}
_WIRED = {
    topics.JOINT_STATES.name: JointState,
    Ball.topics.tool.name: PointStamped,
    topics.JACOBIAN.name: Float64MultiArray,
    topics.ROBOT_PROGRAM_RUNNING.name: Bool,
}


@dataclass(frozen=True)
class Sent:
    """One command, rad/s, and when the controller sent it, s, wall clock of the middleware."""

    sent_s: float
    values: tuple[float, ...]

    @property
    def speed(self) -> float:
        """Of the fastest joint, rad/s."""
        return max((abs(v) for v in self.values), default=0.0)

    @property
    def zero(self) -> bool:
        """Whether it is rest."""
        return not any(self.values)


def assert_sound(commands: list[Sent], started_s: float, acceleration: float = ACCELERATION):
    """What holds for every command of every test.

    Six finite numbers within the velocity limit; zeros before the first start. From one command to
    the next, no joint's speed changes by more than the acceleration limit allows in
    ``LONGEST_TICK_S``; over any longer time, by no more than it allows in that time and one such
    tick more, since a command may leave late and its follower on time, or in as many periods of the
    joint states: a busy machine hands these on in bursts. A step to zero may be of any size: some
    faults stop the arm at once.
    """
    for command in commands:
        assert len(command.values) == 6, command
        assert all(math.isfinite(v) for v in command.values), command
        assert command.speed <= VELOCITY + 1e-9, command
        assert command.zero or command.sent_s > started_s, "motion before the start"
    for run in _runs(commands):
        times = np.array([c.sent_s for c in run])
        values = np.array([c.values for c in run])
        step = np.abs(np.diff(values, axis=0)).max(initial=0.0)
        assert step <= acceleration * LONGEST_TICK_S + 1e-9
        for lag in (2, 5, 10, 20):
            change = np.abs(values[lag:] - values[:-lag]).max(axis=1, initial=0.0)
            passed_s = np.maximum(times[lag:] - times[:-lag], lag / _RATE_HZ)
            allowed = acceleration * (passed_s + LONGEST_TICK_S)
            assert np.all(change <= allowed + 1e-9), f"too fast a change within {lag} commands"


def _runs(commands: list[Sent]) -> list[list[Sent]]:
    """Stretches of motion, each with the zero that it began at."""
    runs: list[list[Sent]] = []
    last: Sent | None = None
    for command in commands:
        if not command.zero:
            if last is None or last.zero:
                runs.append([last] if last is not None else [])
            runs[-1].append(command)
        last = command
    return runs


class Rig(Statuses):
    """Simulator, estimator and controller as processes of their own, with wires between them."""

    def __init__(self, folder: Path) -> None:
        super().__init__(Harness(folder), CONTROLLER)
        try:
            self._set_up()
        except BaseException:
            self.close()
            raise

    def _set_up(self) -> None:
        node = self.harness.node
        self.commands: list[Sent] = []
        self.started_s = math.inf
        self.stop_s = math.nan  # from the last fault to the first zero
        self.timers: list = []  # of a test
        self.wires = {topic: Wire(node, kind, topic) for topic, kind in _WIRED.items()}
        deep = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
        node.create_subscription(Float64MultiArray, topics.COMMANDS.name, self._on_command, deep)
        self.estimates = self.harness.collect(DiagnosticStatus, f"{ESTIMATOR}/status")
        self.states: list[JointState] = []
        self.balls: list[PointStamped] = []
        joints = self.wires[topics.JOINT_STATES.name]
        joints.listeners.append(self.states.append)
        # What is late on any wire goes on at the rate of the joint states.
        joints.listeners.append(lambda _: [wire.deliver() for wire in self.wires.values()])
        self.wires[Ball.topics.tool.name].listeners.append(self.balls.append)
        self.processes = {name: self.start_node(name) for name in _PARAMETERS}
        self.wait(lambda: self.reason() == "NO_TARGET", 60.0, "all inputs")
        self.target_m = TARGETS[0]
        self._targets = self.harness.publisher(
            PointStamped, Ball.topics.target.name, ros.QOS_LATCHED
        )

    def close(self) -> None:
        """End all processes."""
        self.harness.close()

    # --- processes ---

    def start_node(self, name: str) -> subprocess.Popen:
        """Run one of the three nodes, again perhaps."""
        remaps = {topic: PREFIX + topic for topic in _WIRED} if name != SIMULATOR else {}
        if name == ESTIMATOR:
            del remaps[topics.JACOBIAN.name]  # it says this one, and the controller hears it
        return self.harness.start_node(f"{name}.node", remaps=remaps, **_PARAMETERS[name])

    def kill(self, name: str) -> None:
        """End a node as a power failure would, and let the wires pass on what it had sent."""
        self.processes[name].kill()
        self.processes[name].wait()
        self.harness.spin_for(0.05)

    def restart(self, name: str) -> None:
        """Run a node again that has ended; of a robot no joint is heard before it hears commands.

        An arm that is servoed and does not hear it yet is rightly held.
        """
        assert self.processes[name].poll() is not None
        self.processes[name] = self.start_node(name)
        if name == SIMULATOR:
            self.wires[topics.JOINT_STATES.name].silent = True
            reports = self.harness.collect(DiagnosticArray, topics.DIAGNOSTICS.name)
            count = f"{topics.COMMANDS.name} count"

            def obeys() -> bool:
                told = [ros.from_status(one) for report in reports for one in report.status]
                return any(int(values.get(count, 0)) > 0 for values in told)

            self.wait(obeys, what="a robot that hears commands")
            self.wires[topics.JOINT_STATES.name].silent = False

    def set(self, node: str, **values: Any) -> None:
        """Set live parameters."""
        for result in self.harness.set_parameters(node, **values):
            assert result.successful, result.reason

    def renew(self) -> None:
        """Forget the last test; nothing may be wrong any more, and all nodes run."""
        self.calm()
        assert all(process.poll() is None for process in self.processes.values())
        self.wait(lambda: self.reason() in ("SERVOING", "SETTLED", "NO_TARGET"), 2.0, "calm")
        for record in (self.commands, self.statuses, self.balls, self.states, self.estimates):
            del record[:-1]
        self.stop_s = math.nan

    def calm(self) -> None:
        """Make all wires good again."""
        for wire in self.wires.values():
            wire.calm()
        while self.timers:
            self.harness.node.destroy_timer(self.timers.pop())

    # --- what is heard ---

    def _on_command(self, message: Float64MultiArray, info: Mapping[str, int]) -> None:
        self.commands.append(Sent(info["source_timestamp"] * 1e-9, tuple(message.data)))

    def reason(self) -> str:
        """Why the controller is in its state."""
        return self.value("reason")

    def estimator(self, key: str) -> str:
        """A key number of the estimator's newest status."""
        return ros.from_status(self.estimates[-1])[key]

    def arm_speed(self) -> float:
        """Of the fastest joint as the robot reports it, rad/s."""
        return float(np.nanmax(np.abs(self.states[-1].velocity)))

    def moving(self) -> bool:
        """Whether the last command moves the arm well."""
        return bool(self.commands) and self.commands[-1].speed > 0.3 * VELOCITY

    # --- what is done, and promised ---

    def wait(
        self, condition: Callable[[], bool], timeout_s: float = 10.0, what: str = "the condition"
    ) -> None:
        """Receive until a condition holds."""
        self.harness.spin_until(condition, timeout_s, what, self._story)

    def _story(self) -> str:
        seen = [ros.from_status(status)["reason"] for status in self.statuses]
        changes = [r for i, r in enumerate(seen) if i == 0 or r != seen[i - 1]][-12:]
        return f"controller, {' '.join(changes)}: {self.text() if seen else 'no status'}"

    def send_target(self, target_m: tuple[float, ...]) -> None:
        """Publish a target, m."""
        self._targets.publish(ros.to_point(time.time(), CAMERA_FRAME, np.array(target_m)))

    def aim(self, target_m: tuple[float, ...] | None = None) -> None:
        """Publish a target, or the other one, and wait until the controller has it."""
        self.target_m = target_m or TARGETS[1 - TARGETS.index(self.target_m)]
        self.send_target(self.target_m)
        wanted = [f"{v:.5g}" for v in self.target_m]
        self.wait(
            lambda: [self.value(f"target_{axis}_m") for axis in "xyz"] == wanted, what="the target"
        )

    def start(self) -> None:
        """Call ``~/start`` when all is ready; again if the machine made an input late just then."""
        self.started_s = min(self.started_s, time.time())
        for _ in range(5):
            response = self.harness.call(Trigger, f"{CONTROLLER}/start")
            if response.success:
                return
            self.harness.spin_for(0.5)
        raise AssertionError(response.message)

    def servo(self) -> None:
        """Aim at the target that is further away, start if need be, and wait for fast motion."""
        ball = self.balls[-1].point
        self.aim(max(TARGETS, key=lambda target: math.dist((ball.x, ball.y, ball.z), target)))
        self.wait(lambda: self.value("state") in ("READY", "SERVOING"), what="READY")
        if self.value("state") == "READY":
            self.start()
        self.wait(lambda: self.commands[-1].speed > 0.5 * VELOCITY, what="fast motion")

    def assert_stops(self, since_s: float, within_s: float) -> None:
        """After a moment (wall clock, s) there is motion for so long at most, then zeros only.

        A controller that gets no processor time sends nothing, and so long it is excused.
        """

        def most_s() -> float:
            times = [one.sent_s for one in self.commands if one.sent_s > since_s - RAMP_S]
            return within_s + BUSY_S + float(np.diff(times).max(initial=0.0))

        self.wait(lambda: self.commands[-1].sent_s > since_s + most_s(), what="commands")
        assert self.commands[-1].zero, f"moves after {most_s():.2f} s; {self._story()}"
        moving_s = max((c.sent_s for c in self.commands if not c.zero), default=since_s)
        self.stop_s = next(c.sent_s for c in self.commands if c.sent_s > moving_s) - since_s
        assert self.stop_s <= most_s()
        self.assert_stands()

    def assert_stands(self) -> None:
        """Zeros keep flowing, and nothing but zeros."""
        # The watchdog's are 20 a second.
        count = len(self.commands)
        self.wait(lambda: len(self.commands) > count + 3, what="zeros")
        assert all(command.zero for command in self.commands[count:])

    def assert_says(self, state: str, reason: str, *words: str) -> None:
        """The status comes to a state and a reason, in a sentence with these words."""

        def says() -> bool:
            found = (self.value("state"), self.reason()) == (state, reason)
            return found and all(word in self.text() for word in words)

        self.wait(says, what=f"{state}, {reason}: {' ... '.join(words)}")

    def assert_goes_on(self) -> None:
        """The arm is servoed again, to its target if it is not there yet."""
        self.wait(
            lambda: self.reason() == "SETTLED" or (self.reason() == "SERVOING" and self.moving()),
            what="motion again",
        )

    def assert_settles(self) -> None:
        """The ball comes to the target, is seen to stay there, and the controller says so."""

        def there() -> bool:
            last = [t.point for t in self.balls[-5:]]
            return all(math.dist((p.x, p.y, p.z), self.target_m) < 0.005 for p in last)

        self.wait(there, 15.0, "the ball within 5 mm")
        self.wait(lambda: self.reason() == "SETTLED", what="SETTLED")


class Loop(Statuses):
    """A loop that runs, perhaps in a namespace, as a test hears it."""

    def __init__(self, harness: Harness, namespace: str = "") -> None:
        where = f"{namespace}/" if namespace else ""
        super().__init__(harness, where + CONTROLLER)
        self.commands = harness.collect(Float64MultiArray, where + topics.COMMANDS.name)
        self.balls = harness.collect(PointStamped, where + Ball.topics.tool.name)
        # Not latched: the controller would hear each target of a moving one twice.
        self._targets = harness.node.create_publisher(
            PointStamped, where + Ball.topics.target.name, ros.QOS_RELIABLE
        )
        harness.spin_until(self.waits_for_a_target, 60.0, "all inputs")

    def waits_for_a_target(self) -> bool:
        """Whether nothing but a target is missing."""
        heard = self._targets.get_subscription_count() > 0
        return heard and self.reason() == "NO_TARGET" and len(self.balls) > 5

    def reason(self) -> str:
        """Why the controller is in its state."""
        return self.value("reason")

    def aim(self, position_m: np.ndarray) -> None:
        """Publish a target, m."""
        self._targets.publish(ros.to_point(time.time(), CAMERA_FRAME, position_m))

    def distance_m(self, position_m: np.ndarray, count: int = 6) -> float:
        """How far the last balls were away at most, m."""
        last = [m.point for m in self.balls[-count:]]
        return max((math.dist((p.x, p.y, p.z), position_m) for p in last), default=math.inf)

    def reach(self, position_m: np.ndarray) -> None:
        """Have the ball brought to a target, m."""
        self.aim(position_m)
        self.harness.spin_until(
            lambda: self.distance_m(position_m) < 0.005, 30.0, "the ball there", self.reason
        )
