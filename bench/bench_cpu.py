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


def _used_s(process):
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def play(folder, start, rate_hz=RATE_HZ):
    """Play an arm for what ``start`` starts: percent of a core, and the ticks, ms, if timed."""
    with closing(Harness(folder)) as harness:
        nodes = start(harness)
        arm = harness.start("bench.arm_node", str(rate_hz), str(SECONDS), ARM)
        harness.spin_until(lambda: "begin" in harness.output(arm), 60.0, "an arm that moves")
        before_s = [_used_s(node) for node in nodes]
        if harness.wait(arm, 3.0 * SECONDS):
            raise RuntimeError("the arm does not move")
        used_s = [_used_s(node) - used for node, used in zip(nodes, before_s, strict=True)]
        harness.end_processes()
        ticks = [json.loads(path.read_text()) for path in folder.glob("ticks_ms.json")]
    return 100.0 * sum(used_s) / SECONDS, ticks


def bare(*executor):
    """A node that answers each joint state with a command, by ``spin`` or another executor."""

    def start(harness):
        names = (f"{ARM}/{topic.name}" for topic in (topics.JOINT_STATES, topics.COMMANDS))
        return [harness.start("bench.bare_node", *names, *executor)]

    return start


def two_processes(harness):
    return [
        harness.start_node(module, {"__ns": f"/{ARM}"}, **parameters)
        for module, parameters in (
            ("fvs_controller_node.node", {"autostart": True}),
            ("fvs_estimator_node.node", {}),
        )
    ]


def one_process(module="fvs_tools.servo_node", **scheme):
    def start(harness):
        return [harness.start(module, ARM, *ros_arguments(autostart=True, **scheme))]

    return start


def main():
    with tempfile.TemporaryDirectory() as name:
        folders = (Path(name) / str(k) for k in range(99))

        def run(*arguments, **options):
            folder = next(folders)
            folder.mkdir()
            return play(folder, *arguments, **options)

        starts = {
            "bare, wait sets": bare(),
            "bare, events executor": bare("events"),
            "two processes": two_processes,
            "one process": one_process(),
        }
        cost = {label: [] for label in starts}
        for _ in range(ROUNDS):
            for label, start in starts.items():
                cost[label].append(run(start)[0])
        floors = [np.median(values) for values in list(cost.values())[:2]]
        print(f"CPU of an arm at {RATE_HZ:g} Hz, percent of a core, median of {ROUNDS}")
        for label, values in cost.items():
            percent = np.median(values)
            ratios = "".join(f"{percent / floor:7.2f}" for floor in floors)
            print(f"  {label:22s} {percent:5.1f}   times the bare nodes {ratios}")
        _, (ticks_ms,) = run(one_process("bench.timed_node"))
        print(f"  computation of a tick  {spread(ticks_ms['tick alone'], 'ms')}")
        fast = one_process(
            "bench.timed_node", method="poe", law="minimum_time", joint_state_rate_hz=FAST_HZ
        )
        percent, (ticks_ms,) = run(fast, rate_hz=FAST_HZ)
        print(f"one arm at {FAST_HZ:g} Hz, kinematic chain and minimum time: {percent:.1f} %")
        for label, ticks in ticks_ms.items():
            print(f"  {label:22s} {spread(ticks, 'ms', 99.9)}")
