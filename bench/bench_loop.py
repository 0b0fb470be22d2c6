"""What an arm costs over DDS beside a bare rclpy node: CPU and time to the command; and 1 kHz.

``python -m bench loop``. The arm is played by a light process of its own, which is not counted.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from contextlib import closing
from pathlib import Path

import numpy as np
from geometry_msgs.msg import PointStamped
from harness import Harness, ros_arguments
from std_msgs.msg import Float64MultiArray

from bench.timing import spread
from fvs_ros import ros, topics
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.kinds.ball import Ball

SECONDS, RATE_HZ, FAST_HZ, ROUNDS, ARM = 8.0, 125.0, 1000.0, 3, "arm"


def servo(module="fvs_tools.servo_node", **scheme):
    """Both nodes in a process."""
    return [(module, [ARM, *ros_arguments(autostart=True, **scheme)])]


def alone(module, **parameters):
    """A node in a process of its own."""
    return module, ros_arguments({"__ns": f"/{ARM}"}, **parameters)


BARE = "bench.bare_node", [f"{ARM}/{topics.JOINT_STATES.name}", f"{ARM}/{topics.COMMANDS.name}"]
#: Modules of the processes of an arm, and their arguments.
STARTS = {
    "bare, wait sets": [BARE],
    "bare, events executor": [(BARE[0], [*BARE[1], "events"])],
    "two processes": [
        alone("fvs_controller_node.node", autostart=True),
        alone("fvs_estimator_node.node"),
    ],
    "one process": servo(),
}


def _used_s(process):
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def run(processes, rate_hz=RATE_HZ):
    """Play an arm for some processes.

    Percent of a core, times to the command after joint states and after images, ms, and the ticks,
    ms, if they are timed.
    """
    with tempfile.TemporaryDirectory() as name, closing(Harness(Path(name))) as harness:
        nodes = [harness.start(module, *arguments) for module, arguments in processes]
        arm = harness.start("bench.arm_node", str(rate_hz), str(SECONDS), ARM)
        harness.spin_until(lambda: "begin" in harness.output(arm), 60.0, "an arm that moves")
        before_s = [_used_s(node) for node in nodes]
        if harness.wait(arm, 3.0 * SECONDS):
            raise RuntimeError("the arm does not move")
        used_s = [_used_s(node) - used for node, used in zip(nodes, before_s, strict=True)]
        answers_ms = json.loads(harness.output(arm).splitlines()[-1])
        harness.end_processes()
        ticks = [json.loads(path.read_text()) for path in Path(name).glob("ticks_ms.json")]
    return 100.0 * sum(used_s) / SECONDS, *answers_ms, *ticks


def start_up():
    """From the launcher's start to the first command that moves the arm, s."""
    with tempfile.TemporaryDirectory() as name, closing(Harness(Path(name))) as harness:
        commands = harness.collect(Float64MultiArray, topics.COMMANDS.name)
        targets = harness.node.create_publisher(
            PointStamped, Ball.topics.target.name, ros.QOS_LATCHED
        )
        targets.publish(ros.to_feature(1.0, CAMERA_FRAME, Ball(), np.array([0.05, 0.2, 1.45])))
        begin_s = time.monotonic()
        harness.start("fvs_tools.launcher", "servo")
        harness.spin_until(lambda: bool(commands) and bool(np.any(commands[-1].data)), 60.0)
        return time.monotonic() - begin_s


def main():
    runs = {label: [] for label in STARTS}
    for _ in range(ROUNDS):
        for label, processes in STARTS.items():
            runs[label].append(run(processes))
    percents = {label: np.median([percent for percent, *_ in runs[label]]) for label in runs}
    print(f"an arm at {RATE_HZ:g} Hz, {ROUNDS} times: percent of a core, times the bare nodes")
    for label, percent in percents.items():
        ratios = "".join(f"{percent / floor:7.2f}" for floor in list(percents.values())[:2])
        print(f"  {label:24s} {percent:5.1f}   {ratios}")
        _, *answers_ms = zip(*runs[label], strict=True)
        for what, times_ms in zip(("joint state", "image stamp"), answers_ms, strict=True):
            print(f"    {what} to command {spread(np.concatenate(times_ms), 'ms')}", flush=True)
    *_, ticks_ms = run(servo("bench.timed_node"))
    print(f"  computation of a tick    {spread(ticks_ms['tick alone'], 'ms')}")
    fast = servo("bench.timed_node", method="poe", law="minimum_time", joint_state_rate_hz=FAST_HZ)
    percent, *_, ticks_ms = run(fast, FAST_HZ)
    print(f"one arm at {FAST_HZ:g} Hz, kinematic chain and minimum time: {percent:.1f} %")
    for label, ticks in ticks_ms.items():
        print(f"  {label:24s} {spread(ticks, 'ms', 99.9)}")
    starts_s = [start_up() for _ in range(3)]
    print(f"launcher to a moving arm {np.median(starts_s):7.2f} s median of {len(starts_s)}")
