"""What one arm costs beside a bare rclpy node, where it goes, eight arms, and 1 kHz.

``python -m bench cpu``. All arms are played by one light process of its own, which is not counted.
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

SECONDS, RATE_HZ, FAST_HZ, ARMS, ROUNDS = 8.0, 125.0, 1000.0, 8, 3
_CLOCK_HZ = os.sysconf("SC_CLK_TCK")
CONTROLLER, ESTIMATOR = ("fvs_controller_node.node", "fvs_estimator_node.node")
SERVO, TIMED = "fvs_tools.servo_node", "bench.timed_node"
FAST = tuple({"method": "poe", "law": "minimum_time", "joint_state_rate_hz": FAST_HZ}.items())


def _used_s(process):
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _CLOCK_HZ


def play(folder, start, namespaces=("arm",), rate_hz=RATE_HZ):
    """Play arms for what ``start`` starts: percent of a core, and what each arm saw."""
    with closing(Harness(folder)) as harness:
        nodes = start(harness, namespaces)
        command = [rate_hz, SECONDS, *namespaces]
        arms = harness.start("bench.arms_node", *map(str, command))
        harness.spin_until(lambda: "begin" in harness.output(arms), 60.0, "arms that move")
        before_s = [_used_s(node) for node in nodes]
        harness.wait(arms, 3.0 * SECONDS)
        used_s = [_used_s(node) - used for node, used in zip(nodes, before_s, strict=True)]
        harness.end_processes()
        seen = json.loads(harness.output(arms).splitlines()[-1])
        parts = [json.loads(path.read_text()) for path in folder.glob("parts.json")]
    if not all(arm["moves"] for arm in seen):
        raise RuntimeError("an arm does not move")
    return 100.0 * sum(used_s) / SECONDS, seen, parts


def bare(*executor):
    """A node that answers each joint state with a command, by ``spin`` or another executor."""

    def start(harness, namespaces):
        return [harness.start("bench.answer_node", one, *executor) for one in namespaces]

    return start


def two_processes(harness, namespaces):
    return [
        harness.start_node(module, {"__ns": f"/{namespace}"}, **parameters)
        for namespace in namespaces
        for module, parameters in ((CONTROLLER, {"autostart": True}), (ESTIMATOR, {}))
    ]


def one_process(*scheme, module=SERVO):
    def start(harness, namespaces):
        return [harness.start(module, *namespaces, *ros_arguments(autostart=True, **dict(scheme)))]

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
        (parts,) = run(one_process(module=TIMED))[2]
        print(f"  computation of a tick  {spread(parts['ticks_ms']['tick alone'], 'ms')}")
        _print_parts(parts)
        percent, seen, _ = run(one_process(), [f"arm_{number}" for number in range(ARMS)])
        print(f"{ARMS} arms in one process at {RATE_HZ:g} Hz: {percent / ARMS:.1f} % for each")
        for arm in seen:
            answers_ms = 1e3 * np.array(arm["answers_s"])
            lost = arm["sent"] - len(answers_ms)
            print(f"  joint state to command {spread(answers_ms, 'ms')}   {lost} lost")
        percent, _, (parts,) = run(one_process(*FAST, module=TIMED), rate_hz=FAST_HZ)
        print(f"one arm at {FAST_HZ:g} Hz, kinematic chain and minimum time: {percent:.1f} %")
        for label, ticks_ms in parts["ticks_ms"].items():
            print(f"  {label:22s} {spread(ticks_ms, 'ms', 99.9)}")
        _print_parts(parts)


def _print_parts(parts):
    """Print where the time of a joint state goes, in percent of a core."""
    rest = parts["cpu_percent"] - sum(percent for _, percent in parts["parts"].values())
    print(f"  {'part':22s}  calls/s  percent of a core")
    for label, (rate_hz, percent) in parts["parts"].items():
        print(f"  {label:22s} {rate_hz:8.1f} {percent:8.2f}")
    print(f"  {'rclpy, DDS, the rest':22s} {'':8s} {rest:8.2f}", flush=True)
