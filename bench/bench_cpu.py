"""What an arm costs beside a bare rclpy node, how long a tick takes, and 1 kHz.

``python -m bench cpu``. The arm is played by a light process of its own, which is not counted.
"""

from __future__ import annotations

import json
import os
import tempfile
from contextlib import closing
from pathlib import Path

import numpy as np
from harness import Harness, ros_arguments

from bench.timing import spread
from fvs_ros import topics

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
    """Play an arm for some processes: percent of a core, and the ticks, ms, if timed."""
    with tempfile.TemporaryDirectory() as name, closing(Harness(Path(name))) as harness:
        nodes = [harness.start(module, *arguments) for module, arguments in processes]
        arm = harness.start("bench.arm_node", str(rate_hz), str(SECONDS), ARM)
        harness.spin_until(lambda: "begin" in harness.output(arm), 60.0, "an arm that moves")
        before_s = [_used_s(node) for node in nodes]
        if harness.wait(arm, 3.0 * SECONDS):
            raise RuntimeError("the arm does not move")
        used_s = [_used_s(node) - used for node, used in zip(nodes, before_s, strict=True)]
        harness.end_processes()
        ticks = [json.loads(path.read_text()) for path in Path(name).glob("ticks_ms.json")]
    return 100.0 * sum(used_s) / SECONDS, ticks


def main():
    cost = {label: [] for label in STARTS}
    for _ in range(ROUNDS):
        for label, processes in STARTS.items():
            cost[label].append(run(processes)[0])
    floors = [np.median(values) for values in list(cost.values())[:2]]
    print(f"CPU of an arm at {RATE_HZ:g} Hz, percent of a core, median of {ROUNDS}")
    for label, values in cost.items():
        percent = np.median(values)
        ratios = "".join(f"{percent / floor:7.2f}" for floor in floors)
        print(f"  {label:22s} {percent:5.1f}   times the bare nodes {ratios}")
    _, (ticks_ms,) = run(servo("bench.timed_node"))
    print(f"  computation of a tick  {spread(ticks_ms['tick alone'], 'ms')}")
    fast = servo("bench.timed_node", method="poe", law="minimum_time", joint_state_rate_hz=FAST_HZ)
    percent, (ticks_ms,) = run(fast, FAST_HZ)
    print(f"one arm at {FAST_HZ:g} Hz, kinematic chain and minimum time: {percent:.1f} %")
    for label, ticks in ticks_ms.items():
        print(f"  {label:22s} {spread(ticks, 'ms', 99.9)}")
