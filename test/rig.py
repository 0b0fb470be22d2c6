"""The whole robot on wires: real simulator, estimator and controller, and a record of commands."""

from __future__ import annotations

import math
import subprocess
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from harness import Harness
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import Trigger
from wire import PREFIX, Wire

from fvs_controller_node.config import PARAMETERS as CONTROLLER_PARAMETERS
from fvs_ros import ros, topics
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.joints import HOME_JOINTS_RAD, JointMap
from fvs_sim_node.config import PARAMETERS as SIMULATOR_PARAMETERS

SIMULATOR, ESTIMATOR, CONTROLLER = "fvs_sim_node", "fvs_estimator_node", "fvs_controller_node"

#: Limits that the controller is given, rad/s and rad/s^2, and the time a ramp to zero takes, s.
VELOCITY, ACCELERATION = 0.5, 5.0
RAMP_S = VELOCITY / ACCELERATION

#: What a busy machine may add to any time between two processes, s: three or four of them in a
#: row, each waiting for a core.
BUSY_S = 0.3

#: The supervisor counts a tick for at most this long, s: so no command differs from the one before
#: by more than the acceleration limit times this, however late it comes.
LONGEST_TICK_S = 0.05

#: Two targets well inside the box of joints that the model was trained in, camera frame, m; each a
#: quarter of a metre from where the ball is at home, and 0.34 m from the other.
TARGET, OTHER_TARGET = (-0.15, 0.09, 1.58), (0.16, 0.20, 1.67)

#: Slower joint states than a UR's, so that four processes do not fill two small cores, and what a
#: test sees late is what the test made late.
_LIGHT = {"joint_state_rate_hz": 50}

_MODEL = Path(__file__).resolve().parents[1] / "config" / "models" / "ur5_front.npz"
_RELAYED = {
    topics.JOINT_STATES.name: JointState,
    topics.BALL_POSITION.name: PointStamped,
    topics.JACOBIAN.name: Float64MultiArray,
    topics.ROBOT_PROGRAM_RUNNING.name: Bool,
}
_DECLARED = {
    SIMULATOR: {p.name: p.default for p in SIMULATOR_PARAMETERS},
    CONTROLLER: {p.name: p.default for p in CONTROLLER_PARAMETERS},
}


@dataclass(frozen=True)
class Sent:
    """One command.

    Parameters
    ----------
    sent_s : float
        When the controller sent it, s, wall clock (the middleware's source time).
    values : tuple of float
        What it said, rad/s.
    """

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
    tick more, since a command may leave late and its follower on time. A step to zero may be of any
    size: some faults stop the arm at once.
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
            allowed = acceleration * (times[lag:] - times[:-lag] + LONGEST_TICK_S)
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


class Rig:
    """Simulator, estimator and controller as processes of their own, with wires between them.

    Parameters
    ----------
    folder : Path
        Where their output goes.
    wires : iterable of str
        Topics that go through a relay of the test.
    simulator, estimator, controller : mapping
        Parameters of the nodes, beside the rig's own.
    """

    def __init__(
        self,
        folder: Path,
        wires: tuple[str, ...] = tuple(_RELAYED),
        simulator: Mapping[str, Any] | None = None,
        estimator: Mapping[str, Any] | None = None,
        controller: Mapping[str, Any] | None = None,
    ) -> None:
        self.harness = Harness(folder)
        try:
            self._set_up(wires, simulator or {}, estimator or {}, controller or {})
        except BaseException:
            self.close()
            raise

    def _set_up(self, wires, simulator, estimator, controller) -> None:
        node = self.harness.node
        limits = {
            "max_joint_velocity_rad_s": VELOCITY,
            "max_joint_acceleration_rad_s2": ACCELERATION,
        }
        self._parameters = {
            SIMULATOR: {**_LIGHT, **simulator},
            ESTIMATOR: {"model_path": str(_MODEL), **estimator},
            CONTROLLER: {**limits, "joint_state_rate_hz": 50.0, **controller},
        }
        self._wired = wires
        self._changed: set[tuple[str, str]] = set()
        self.commands: list[Sent] = []
        self.started_s = math.inf
        self.stop_s: float | None = None  # from the last fault to the first zero
        self.timers: list = []  # of a test
        self.wires = {topic: Wire(node, _RELAYED[topic], topic) for topic in wires}
        self._joint_map = JointMap()
        deep = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
        node.create_subscription(Float64MultiArray, topics.COMMANDS.name, self._on_command, deep)
        self.statuses = self.harness.collect(DiagnosticStatus, f"{CONTROLLER}/status")
        self.estimates = self.harness.collect(DiagnosticStatus, f"{ESTIMATOR}/status")
        self.states = self._listen(JointState, topics.JOINT_STATES.name)
        self.balls = self._listen(PointStamped, topics.BALL_POSITION.name)
        self.processes = {name: self.start_node(name) for name in self._parameters}
        self.wait(lambda: self.reason() == "NO_TARGET", 60.0, "all inputs")
        self._targets = self.harness.publisher(
            PointStamped, topics.TARGET_POSITION.name, ros.QOS_LATCHED
        )

    def _listen(self, message_type: type, topic: str) -> list:
        """What the simulator says; through the wire's ear if there is one, for one hearing each."""
        if topic not in self.wires:
            return self.harness.collect(message_type, topic)
        heard: list = []
        self.wires[topic].listeners.append(heard.append)
        return heard

    def close(self) -> None:
        """End all processes."""
        self.harness.close()

    # --- processes ---

    def start_node(self, name: str) -> subprocess.Popen:
        """Run one of the three nodes, again perhaps."""
        remaps = {topic: PREFIX + topic for topic in self._wired} if name != SIMULATOR else {}
        if name == ESTIMATOR:
            remaps.pop(topics.JACOBIAN.name, None)  # it says this one, and the controller hears it
        return self.harness.start_node(f"{name}.node", remaps=remaps, **self._parameters[name])

    def kill(self, name: str) -> float:
        """End a node as a power failure would; returns when it was gone, s, wall clock."""
        self.processes[name].kill()
        self.processes[name].wait()
        return time.time()

    def restart(self, name: str) -> None:
        """Run a node again that has ended."""
        assert self.processes[name].poll() is not None
        self.processes[name] = self.start_node(name)

    def complete(self) -> bool:
        """Whether all three nodes run."""
        return all(process.poll() is None for process in self.processes.values())

    def set(self, node: str, **values: Any) -> float:
        """Set live parameters; returns when the node had them, s, wall clock.

        ``rewind`` takes them back.
        """
        self._changed |= {(node, name) for name in values}
        for result in self.harness.set_parameters(node, **values):
            assert result.successful, result.reason
        return time.time()

    def rewind(self) -> None:
        """Go back to where a new rig would be, but for the target, ready for a start."""
        self.calm()
        assert self.harness.call(Trigger, f"{CONTROLLER}/stop").success
        self.wait(self.standing, what="zeros")
        for node, name in sorted(self._changed):
            value = self._parameters[node].get(name, _DECLARED[node][name])
            self.set(node, **{name: value})
        self._changed.clear()
        assert self.harness.call(Trigger, f"{SIMULATOR}/reset").success
        assert self.harness.call(Trigger, f"{ESTIMATOR}/reset").success
        self.wait(lambda: np.abs(self.joints() - HOME_JOINTS_RAD).max() < 0.01, what="home")
        # The predictor and the images from before the reset have to find together again.
        self.harness.spin_for(0.3)
        self.wait(lambda: self.reason() in ("READY", "NO_TARGET"), what="READY")
        for record in (self.commands, self.statuses, self.balls, self.states, self.estimates):
            del record[:-1]
        self.started_s = math.inf
        self.stop_s = None

    def calm(self) -> None:
        """Make all wires good again."""
        for wire in self.wires.values():
            wire.calm()
        while self.timers:
            self.harness.node.destroy_timer(self.timers.pop())

    # --- what is heard ---

    def _on_command(self, message: Float64MultiArray, info: Mapping[str, int]) -> None:
        self.commands.append(Sent(info["source_timestamp"] * 1e-9, tuple(message.data)))

    def value(self, key: str) -> str:
        """A key number of the controller's newest status."""
        return ros.from_status(self.statuses[-1]).get(key, "") if self.statuses else ""

    def reason(self) -> str:
        """Why the controller is in its state."""
        return self.value("reason")

    def state(self) -> str:
        """The controller's state."""
        return self.value("state")

    def text(self) -> str:
        """The controller's newest sentence."""
        return self.statuses[-1].message

    def reasons(self, since: int = 0) -> list[str]:
        """All reasons from a number of statuses on, repetitions left out."""
        seen = [ros.from_status(m)["reason"] for m in self.statuses[since:]]
        return [r for i, r in enumerate(seen) if i == 0 or r != seen[i - 1]]

    def estimator(self, key: str) -> str:
        """A key number of the estimator's newest status."""
        return ros.from_status(self.estimates[-1])[key]

    def ball(self) -> np.ndarray:
        """Where the camera sees the ball, camera frame, m; good to a millimetre."""
        point = self.balls[-1].point
        return np.array([point.x, point.y, point.z])

    def joints(self) -> np.ndarray:
        """Joint angles, kinematic order, rad."""
        return self.joints_of(self.states[-1])

    def joints_of(self, state: JointState) -> np.ndarray:
        """Joint angles of a joint state, kinematic order, rad."""
        return self._joint_map.positions(state.name, state.position)

    def arm_speed(self) -> float:
        """Of the fastest joint as the robot reports it, rad/s."""
        return float(np.nanmax(np.abs(self.states[-1].velocity)))

    def moving(self) -> bool:
        """Whether the last command moves the arm well."""
        return bool(self.commands) and self.commands[-1].speed > 0.3 * VELOCITY

    def standing(self) -> bool:
        """Whether the last command is zero."""
        return bool(self.commands) and self.commands[-1].zero

    # --- what is done, and promised ---

    def wait(
        self, condition: Callable[[], bool], timeout_s: float = 10.0, what: str = "the condition"
    ) -> None:
        """Receive until a condition holds."""
        self.harness.spin_until(condition, timeout_s, what, self._story)

    def _story(self) -> str:
        newest = self.text() if self.statuses else "no status"
        return f"controller, {' '.join(self.reasons()[-12:])}: {newest}"

    def send_target(self, target_m: tuple[float, ...], frame: str = CAMERA_FRAME) -> None:
        """Publish a target, m."""
        self._targets.publish(ros.to_point(time.time(), frame, np.array(target_m)))

    def aim(self, target_m: tuple[float, ...] = TARGET) -> None:
        """Publish a target, m, and wait until the controller has it."""
        self.send_target(target_m)
        wanted = [f"{v:.5g}" for v in target_m]
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

    def servo(self, target_m: tuple[float, ...] = TARGET) -> None:
        """Aim and start, and wait for fast motion."""
        self.aim(target_m)
        self.wait(lambda: self.state() == "READY", what="READY")
        self.start()
        self.wait(lambda: self.commands[-1].speed > 0.5 * VELOCITY, what="fast motion")

    def assert_stops(self, since_s: float, within_s: float) -> None:
        """After a moment (wall clock, s) there is motion for so long at most, then zeros only."""
        end_s = since_s + within_s + BUSY_S
        self.wait(lambda: self.commands[-1].sent_s > end_s, what="commands")
        assert self.commands[-1].zero, f"moves after {within_s + BUSY_S:.2f} s; {self._story()}"
        moving_s = max((c.sent_s for c in self.commands if not c.zero), default=since_s)
        self.stop_s = next(c.sent_s for c in self.commands if c.sent_s > moving_s) - since_s
        assert self.stop_s <= within_s + BUSY_S
        self.assert_stands()

    def assert_stands(self, seconds: float = 0.3) -> None:
        """Zeros keep flowing, and nothing but zeros."""
        count = len(self.commands)
        self.harness.spin_for(seconds)
        # The watchdog's are 20 a second; a machine that stands still a moment is given it back.
        self.wait(lambda: len(self.commands) > count + 8 * seconds, what="zeros")
        since = self.commands[count:]
        assert all(command.zero for command in since)

    def assert_says(self, state: str, reason: str, *words: str) -> None:
        """The status comes to a state and a reason, in a sentence with these words."""

        def says() -> bool:
            found = (self.state(), self.reason()) == (state, reason)
            return found and all(word in self.text() for word in words)

        self.wait(says, what=f"{state}, {reason}: {' ... '.join(words)}")

    def assert_goes_on_by_itself(self) -> None:
        """No start is needed for the arm to move again."""
        self.wait(lambda: self.state() == "SERVOING", what="SERVOING again")
        self.wait(self.moving, what="motion again")

    def assert_needs_a_start(self) -> None:
        """The arm stands until a start, and then moves."""
        self.assert_stands()
        self.start()
        self.wait(self.moving, what="motion again")

    def assert_settles(
        self,
        target_m: tuple[float, ...] = TARGET,
        within_m: float = 0.005,
        timeout_s: float = 15.0,
    ) -> None:
        """The ball is seen to come to the target and to stay there for a quarter of a second."""

        def there() -> bool:
            last = [t.point for t in self.balls[-8:]]
            near = [math.dist((p.x, p.y, p.z), target_m) < within_m for p in last]
            return len(near) == 8 and all(near)

        self.wait(there, timeout_s, f"the ball within {1e3 * within_m:.0f} mm")

    def assert_sound(self) -> None:
        """Every command of this test was sound."""
        assert_sound(self.commands, self.started_s)
