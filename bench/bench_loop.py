"""How long the loop over DDS takes, beside a bare loop of three processes, and how long to start.

``python -m bench loop``
"""

from __future__ import annotations

import tempfile
import time
from contextlib import closing
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from harness import Harness
from std_msgs.msg import Float64MultiArray

from bench.arm_node import Arm
from bench.timing import spread
from fvs_ros import ros, topics
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.kinds.ball import Ball

PERIOD_S = 0.008


def rounds(harness, send, received):
    """Send every period; what was sent and the time to the first answer of each round with one."""
    spent = []
    next_s = time.monotonic()
    for _ in range(800):
        received.clear()
        begin = time.monotonic()
        sent = send()
        next_s = max(next_s + PERIOD_S, begin)
        while time.monotonic() < next_s:
            harness.executor.spin_once(timeout_sec=max(0.0, next_s - time.monotonic()))
        if received:
            spent.append((sent, received[0] - begin))
    return spent


def bare_loop(folder):
    with closing(Harness(folder)) as harness:
        harness.start("bench.bare_node", "bench_a", "bench_b")
        harness.start("bench.bare_node", "bench_b", "bench_c")
        received = []
        harness.node.create_subscription(
            Float64MultiArray, "bench_c", lambda _m: received.append(time.monotonic()), 1
        )
        publisher = harness.publisher(Float64MultiArray, "bench_a")
        message = Float64MultiArray(data=[0.1] * 18)
        harness.spin_until(lambda: publisher.publish(message) or bool(received), what="the relays")
        spent = rounds(harness, lambda: publisher.publish(message), received)
        return spread([1e3 * t for _, t in spent], "ms")


def control_loop(folder):
    """Joint state to command; image stamp to command, with the estimator learning beside."""
    with closing(Harness(folder)) as harness:
        harness.start_node("fvs_estimator_node.node")
        harness.start_node("fvs_controller_node.node", autostart=True)
        received = []
        harness.node.create_subscription(
            Float64MultiArray, topics.COMMANDS.name, lambda _m: received.append(time.monotonic()), 1
        )
        statuses = harness.collect(DiagnosticStatus, "fvs_controller_node/status")
        arm = Arm(harness.node, "")

        def send():
            return arm.step(time.monotonic(), PERIOD_S)

        rounds(harness, send, received)
        state = ros.from_status(statuses[-1]).get("state")
        if state != "SERVOING":
            raise RuntimeError(f"the controller is {state}: {statuses[-1].message}")
        spent = rounds(harness, send, received)
        images = [1e3 * t for with_image, t in spent if with_image]
        return spread([1e3 * t for _, t in spent], "ms"), spread(images, "ms")


def start_up(folder):
    """From the launcher's start to the first command that moves the arm, s."""
    with closing(Harness(folder)) as harness:
        commands = harness.collect(Float64MultiArray, topics.COMMANDS.name)
        targets = harness.node.create_publisher(
            PointStamped, Ball.topics.target.name, ros.QOS_LATCHED
        )
        targets.publish(ros.to_point(1.0, CAMERA_FRAME, np.array([0.05, 0.2, 1.45])))
        begin = time.monotonic()
        harness.start("fvs_tools.launcher", "servo")
        harness.spin_until(lambda: bool(commands) and bool(np.any(commands[-1].data)), 60.0)
        return time.monotonic() - begin


def main():
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print(f"bare loop of three processes     {bare_loop(folder)}", flush=True)
        joints, images = control_loop(folder)
        print(f"joint state to command           {joints}")
        print(f"image stamp to command           {images}", flush=True)
        starts = [start_up(folder) for _ in range(3)]
        print(
            f"launcher to a moving arm         {np.median(starts):7.2f} s median of {len(starts)}"
        )
