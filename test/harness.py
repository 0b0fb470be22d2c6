"""Real nodes in real processes, watched from one test thread over DDS."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

from fvs_ros.core import ros

_STARTED = 0


def _next_domain() -> int:
    """A domain of its own for each test; ids above 101 collide with ephemeral ports."""
    global _STARTED
    _STARTED += 1
    return 1 + (os.getpid() * 17 + _STARTED) % 100


class Harness:
    """A ROS context of its own, and the node processes of one test.

    Parameters
    ----------
    folder : Path
        Where the processes' output goes.
    simulated_time : bool
        Whether the test's own node follows ``/clock``.
    """

    def __init__(self, folder: Path, simulated_time: bool = False) -> None:
        self.folder = folder
        self.domain = _next_domain()
        self.context = rclpy.Context()
        rclpy.init(
            context=self.context,
            domain_id=self.domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = rclpy.create_node(
            "test_node",
            context=self.context,
            parameter_overrides=[Parameter("use_sim_time", value=simulated_time)],
        )
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.processes: list[subprocess.Popen] = []

    # --- processes ---

    @property
    def environment(self) -> dict[str, str]:
        """Environment of every process of this test."""
        return {**os.environ, "ROS_DOMAIN_ID": str(self.domain), "PYTHONUNBUFFERED": "1"}

    def start(self, module: str, *arguments: str) -> subprocess.Popen:
        """Run ``python -m module arguments``, its output kept for ``output``."""
        path = self.folder / f"{len(self.processes)}_{module}.log"
        with path.open("w", encoding="utf-8") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", module, *arguments],
                stdout=log,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                env=self.environment,
                cwd=self.folder,
            )
        process.log_path = path  # type: ignore[attr-defined]
        self.processes.append(process)
        return process

    def start_node(self, module: str, **parameters: Any) -> subprocess.Popen:
        """Run a node with parameters."""
        arguments = ["--ros-args"]
        for name, value in parameters.items():
            text = str(value).lower() if isinstance(value, bool) else str(value)
            arguments += ["-p", f"{name}:={text}"]
        return self.start(module, *arguments)

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
        self.spin_until(lambda: process.poll() is not None, timeout_s, f"{process.args} to end")
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
        client = self.node.create_client(service_type, name)
        self.spin_until(client.service_is_ready, what=f"service {name}")
        future = client.call_async(request or service_type.Request())
        self.spin_until(future.done, what=f"an answer of {name}")
        return future.result()

    def spin_for(self, seconds: float) -> None:
        """Receive for a while: for claims that something does not happen."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self.executor.spin_once(timeout_sec=0.02)

    def spin_until(
        self, condition: Callable[[], bool], timeout_s: float = 15.0, what: str = "the condition"
    ) -> None:
        """Receive until a condition holds; fail with every process's output if it never does."""
        end_s = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > end_s:
                logs = "\n".join(f"--- {p.args}\n{self.output(p)}" for p in self.processes)
                raise AssertionError(f"waited {timeout_s:g} s in vain for {what}\n{logs}")
            self.executor.spin_once(timeout_sec=0.02)

    def close(self) -> None:
        """End every process and the context."""
        for process in self.processes:
            if process.poll() is None:
                process.terminate()
        for process in self.processes:
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)
