"""Real nodes in real processes, watched from one test thread over DDS."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from fvs_ros import ros, topics
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_ros.kinds import Kind
from fvs_ros.kinds.ball import Ball
from fvs_ros.paths import program

_BEGAN_S = time.time()
#: How many times as long everything takes here as on a good computer.
SLOWNESS = float(os.environ.get("FVS_TEST_SLOWNESS", "1"))
#: Where this process begins to look for a domain; ids above 101 collide with ephemeral ports.
_DOMAINS = itertools.cycle(1 + (os.getpid() * 17 + i) % 101 for i in range(101))
_SHELLS_DOMAIN = int(os.environ.get("ROS_DOMAIN_ID") or 0)


def _take_domain() -> tuple[int, socket.socket]:
    """A domain that no other test on this machine has while the socket is open.

    Never the shell's own: a loop that somebody watches there, or a robot, may be in it.
    """
    for domain in _DOMAINS:
        lock = socket.socket(socket.AF_UNIX)
        try:
            if domain != _SHELLS_DOMAIN:
                lock.bind(f"\0fvs_test_domain_{domain}")
                return domain, lock
        except OSError:
            pass
        lock.close()
    raise AssertionError("there is always another domain")


def _clear_shared_memory() -> None:
    """Remove what killed processes left of the middleware's shared memory.

    It makes every later discovery take seconds. Only what is ours, younger than these tests, and
    mapped by no process goes.
    """
    paths, used = list(Path("/dev/shm").glob("*fastrtps_*")), ""
    for maps in Path("/proc").glob("[0-9]*/maps"):
        with contextlib.suppress(OSError):
            used += maps.read_text()
    for path in paths:
        name = path.name.removeprefix("sem.").removesuffix("_mutex").removesuffix("_el")
        with contextlib.suppress(OSError):
            status = path.stat()
            ours = status.st_uid == os.getuid() and status.st_mtime > _BEGAN_S
            if ours and f"/dev/shm/{name}" not in used:
                path.unlink()


def ros_arguments(remaps: Mapping[str, str] | None = None, **parameters: Any) -> list[str]:
    """Arguments that give a node other names and parameters."""
    arguments = ["--ros-args"]
    for name, other in (remaps or {}).items():
        arguments += ["-r", f"{name}:={other}"]
    for name, value in parameters.items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        arguments += ["-p", f"{name}:={text}"]
    return arguments


def children(pid: int) -> list[int]:
    """Processes that a process has started and that have not ended."""
    tasks = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(child) for task in tasks for child in task.read_text().split()]


class Harness:
    """A ROS context of its own, and the node processes of one test.

    Processes write into files of ``folder``. Those of the harness ``beside`` are talked to as well,
    and outlive this one.
    """

    def __init__(self, folder: Path, beside: Harness | None = None) -> None:
        self.folder = folder
        self.domain, self._lock = (beside.domain, None) if beside else _take_domain()
        self.context = rclpy.Context()
        rclpy.init(
            context=self.context,
            domain_id=self.domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = rclpy.create_node(
            "test_node",
            context=self.context,
            start_parameter_services=False,  # each would be looked at in every spin
        )
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.processes: list[subprocess.Popen] = []
        #: Where processes write instead of into their log: a file descriptor.
        self.sink: int | None = None
        self._others = beside.processes if beside else []
        self._kept: dict[str, subprocess.Popen] = {}
        self._clients: dict[str, Any] = {}

    # --- processes ---

    @property
    def environment(self) -> dict[str, str]:
        """Environment of every process of this test."""
        return {**os.environ, "ROS_DOMAIN_ID": str(self.domain), "PYTHONUNBUFFERED": "1"}

    def start(self, module: str, *arguments: str) -> subprocess.Popen:
        """Run a module, its output kept for ``output``; it ends with these tests, if killed."""
        path = self.folder / f"{len(self.processes)}_{module}.log"
        with path.open("w", encoding="utf-8") as log:
            process = subprocess.Popen(
                [*program(module), *arguments],
                stdout=log if self.sink is None else self.sink,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                env=self.environment,
                cwd=self.folder,
            )
        process.log_path = path  # type: ignore[attr-defined]
        self.processes.append(process)
        return process

    def start_node(
        self, module: str, remaps: Mapping[str, str] | None = None, **parameters: Any
    ) -> subprocess.Popen:
        """Run a node with parameters and remaps of names."""
        return self.start(module, *ros_arguments(remaps, **parameters))

    def keep(self, module: str, **parameters: Any) -> subprocess.Popen:
        """The process of a node, from an earlier test if it still runs."""
        process = self._kept.get(module)
        if process is None or process.poll() is not None:
            process = self._kept[module] = self.start_node(module, **parameters)
        return process

    @staticmethod
    def output(process: subprocess.Popen) -> str:
        """What a process has printed so far."""
        return process.log_path.read_text(encoding="utf-8")  # type: ignore[attr-defined]

    def stop(self, process: subprocess.Popen, number: int = signal.SIGTERM) -> int:
        """Signal a process, keep spinning until it ends, return its exit code."""
        process.send_signal(number)
        return self.wait(process)

    def wait(self, process: subprocess.Popen, timeout_s: float = 20.0) -> int:
        """Keep spinning until a process ends, return its exit code."""
        name = process.log_path.name  # type: ignore[attr-defined]
        self.spin_until(lambda: process.poll() is not None, timeout_s, f"{name} to end")
        return process.returncode

    # --- topics ---

    def collect(self, message_type: type, topic: str, qos: QoSProfile = ros.QOS_NEWEST) -> list:
        """Subscribe; the returned list grows with every message."""
        received: list = []
        self.node.create_subscription(message_type, topic, received.append, qos)
        return received

    def publisher(self, message_type: type, topic: str, qos: QoSProfile = ros.QOS_RELIABLE):
        """A publisher that somebody listens to already."""
        publisher = self.node.create_publisher(message_type, topic, qos)
        self.spin_until(
            lambda: publisher.get_subscription_count() > 0, what=f"a subscriber of {topic}"
        )
        return publisher

    def call(self, service_type: type, name: str, request: Any = None) -> Any:
        """Call a service and return its response."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(service_type, name)
        client = self._clients[name]
        self.spin_until(client.service_is_ready, what=f"service {name}")
        future = client.call_async(request or service_type.Request())
        self.spin_until(future.done, what=f"an answer of {name}")
        return future.result()

    def set_parameters(self, node: str, **values: Any) -> list[SetParametersResult]:
        """Set live parameters of a node; what it answered to each."""
        parameters = [Parameter(name, value=value) for name, value in values.items()]
        request = SetParameters.Request(parameters=[p.to_parameter_msg() for p in parameters])
        return self.call(SetParameters, f"{node}/set_parameters", request).results

    def spin_for(self, seconds: float) -> None:
        """Receive for a while: for claims that something does not happen."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self.executor.spin_once(timeout_sec=0.02)

    def spin_until(
        self,
        condition: Callable[[], bool],
        timeout_s: float = 15.0,
        what: str = "the condition",
        story: Callable[[], str] = str,
    ) -> None:
        """Receive until a condition holds; fail with every process's output if it never does.

        The time-out is that of a good computer. ``story`` says what else is worth knowing then.
        """
        timeout_s *= SLOWNESS
        end_s = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > end_s:
                processes = [*self._others, *self.processes]
                logs = "\n".join(f"--- {p.log_path.name}\n{self.output(p)}" for p in processes)
                raise AssertionError(
                    f"waited {timeout_s:g} s in vain for {what}; {story()}\n{logs}"
                )
            self.executor.spin_once(timeout_sec=0.02)

    def end_processes(self) -> None:
        """End every process."""
        for process in self.processes:
            if process.poll() is None:
                process.terminate()
        for process in self.processes:
            try:
                process.wait(10 * SLOWNESS)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self.processes.clear()

    def close(self) -> None:
        """End every process and the context."""
        self.end_processes()
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)
        _clear_shared_memory()
        if self._lock:
            self._lock.close()


class Statuses:
    """What a node says of itself, and waits for it."""

    def __init__(self, harness: Harness, node: str, qos: QoSProfile = ros.QOS_NEWEST) -> None:
        self.harness = harness
        self.statuses = harness.collect(DiagnosticStatus, f"{node}/status", qos)

    def value(self, key: str) -> str:
        """A key number of the newest status."""
        return ros.from_status(self.statuses[-1]).get(key, "") if self.statuses else ""

    def reason(self) -> str:
        """Why the node is in its state."""
        return self.value("reason")

    def text(self) -> str:
        """The newest sentence."""
        return self.statuses[-1].message if self.statuses else ""

    def wait(
        self, condition: Callable[[], bool], timeout_s: float = 15.0, what: str = "the condition"
    ) -> None:
        """Receive until a condition holds."""
        self.harness.spin_until(condition, timeout_s, what, self.text)

    def wait_for(self, state: str, *words: str, timeout_s: float = 40.0) -> None:
        """Receive until the newest status has this state, in a sentence with these words."""

        def says() -> bool:
            return self.value("state") == state and all(word in self.text() for word in words)

        self.wait(says, timeout_s, f"{state}: {' ... '.join(words)}")


class PlayedRobot:
    """Plays robot, tracker and estimator towards a controller: a plant x' = J r', J constant."""

    FRAME = "camera_color_optical_frame"

    def __init__(self, harness: Harness, kind: Kind | None = None) -> None:
        self.harness, self.kind = harness, kind or Ball()
        self.jacobian = np.array(
            [
                [0.5, 0.1, 0.1, 0.05, 0.1, 0.0],
                [0.1, 0.5, -0.3, 0.1, 0.05, 0.0],
                [0.1, -0.2, 0.4, 0.2, -0.1, 0.0],
                [0.0, 0.1, 0.0, 0.4, 0.0, 0.0],
                [0.1, 0.0, 0.0, 0.0, 0.4, 0.0],
                [0.0, 0.0, 0.1, 0.0, 0.0, 0.4],
            ]
        )[: self.kind.size]
        self.joints = np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0])
        self.z = self.kind.of_body(np.array([0.0, 0.1, 1.4]), np.eye(3))
        self.object: Any = None  # as measured; none is there
        self.velocity = np.zeros(6)
        self.silent: set[str] = set()  # topics that are not published for now
        #: Topic -> what changes each of its messages.
        self.spoil: dict[str, Callable[[Any], None]] = {}
        #: When each command was sent, s, wall clock of the middleware, and the command.
        self.commands: list[tuple[float, Float64MultiArray]] = []
        node = harness.node
        qos = ros.QOS_RELIABLE
        named = self.kind.topics
        self._publishers = {
            topic.name: node.create_publisher(topics.message_class(topic.type), topic.name, qos)
            for topic in (topics.JOINT_STATES, topics.JACOBIAN, named.tool, named.object)
        }
        deep = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
        node.create_subscription(Float64MultiArray, topics.COMMANDS.name, self._on_command, deep)
        self._last_s = time.monotonic()
        node.create_timer(1 / 60, self._step)
        node.create_timer(1 / 30, self._look)

    def show_object(self) -> None:
        """Have an object from now on."""
        self.object = self.kind.of_body(np.array([0.1, 0.05, 1.3]), np.eye(3))

    def move_object(self, *motion_m: float) -> None:
        """Let the object jump, m, (d,)."""
        self.object = self.kind.retract(self.object, np.array(motion_m))

    def from_object(self) -> np.ndarray:
        """Where the tool is, seen from the object, (m,)."""
        return self.kind.relative(self.z, self.object)

    def now_s(self) -> float:
        """ROS time, s."""
        return self.harness.node.get_clock().now().nanoseconds * 1e-9

    def _send(self, topic: str, message: Any) -> None:
        if topic not in self.silent:
            self.spoil.get(topic, lambda _: None)(message)
            self._publishers[topic].publish(message)

    def _on_command(self, message: Float64MultiArray, info: Mapping[str, int]) -> None:
        self.commands.append((info["source_timestamp"] * 1e-9, message))
        self.velocity = np.array(message.data)

    def _step(self) -> None:
        now_s = time.monotonic()
        moved = self.velocity * (now_s - self._last_s)
        self._last_s = now_s
        self.joints = self.joints + moved
        self.z = self.kind.retract(self.z, self.jacobian @ moved)
        order = np.argsort(UR_JOINT_NAMES)
        names = [UR_JOINT_NAMES[i] for i in order]
        stamp_s = self.now_s()
        self._send(
            topics.JOINT_STATES.name,
            ros.to_joint_state(stamp_s, names, self.joints[order], self.velocity[order]),
        )
        self._send(topics.JACOBIAN.name, ros.to_jacobian(self.jacobian, self.kind))

    def _look(self) -> None:
        named = self.kind.topics
        for topic, z in ((named.tool, self.z), (named.object, self.object)):
            if z is not None:
                self._send(topic.name, ros.to_feature(self.now_s(), self.FRAME, self.kind, z))

    def meet_controller(self) -> None:
        """Wait until the controller hears this robot, and the robot the controller."""
        self.harness.spin_until(
            lambda: (
                len(self.commands) > 5
                and all(p.get_subscription_count() for p in self._publishers.values())
            ),
            what="a controller",
        )
        assert self.harness.call(Trigger, "fvs_controller_node/stop").success
        self.harness.spin_for(0.2)  # until it has five of everything

    def speed(self) -> float:
        """Largest joint speed of the last command, rad/s."""
        return float(np.abs(self.commands[-1][1].data).max())

    def moving(self) -> bool:
        """Whether the last command moves the arm well."""
        return bool(self.commands) and self.speed() > 0.2

    def standing(self) -> bool:
        """Whether the last command is zero."""
        return bool(self.commands) and self.speed() == 0.0
