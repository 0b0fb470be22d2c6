"""``fvs_servo_node`` that times its parts, and writes them into ``parts.json`` when it ends.

A part's time is its own: what it calls counts for the called part. What no part has is the rest:
rclpy's executor, DDS threads, the interpreter.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from pathlib import Path
from time import perf_counter_ns, thread_time_ns

from rclpy.publisher import Publisher

import fvs_ros.ros.node
from fvs_controller_node.loop import ServoLoop
from fvs_controller_node.node import ControllerNode
from fvs_controller_node.supervisor import Supervisor
from fvs_estimator_node.loop import EstimationLoop
from fvs_estimator_node.node import EstimatorNode
from fvs_ros.joints import JointMap
from fvs_ros.ros import CommandPublisher, FvsNode
from fvs_tools import servo_node

#: Measured from so long after the start, when the arms move, s.
WARM_UP_S = 6.0
_PUBLISH, _TICK = "publish", "tick alone"
_CONTROLLER, _ESTIMATOR = "controller node", "estimator node"
PARTS = {
    "deserialize": ((fvs_ros.ros.node, "unpacked"),),
    _PUBLISH: ((Publisher, "publish"),),
    "joints by name": ((JointMap, "positions"),),
    "prediction, drive lag": ((ServoLoop, "add_joints"), (ServoLoop, "add_image")),
    "supervision": ((ServoLoop, "tick"), (Supervisor, "permit"), (Supervisor, "release")),
    "law": ((ServoLoop, "_propose"),),
    "command": ((CommandPublisher, "send"),),
    "status": ((FvsNode, "_publish_diagnostics"), (FvsNode, "publish_status")),
    "learning": ((EstimationLoop, "add_joints"), (EstimationLoop, "add_image")),
    "Jacobian": ((EstimatorNode, "_publish_jacobian"),),
    _CONTROLLER: tuple(
        (ControllerNode, name)
        for name in ("_on_joint_states", "_on_feature", "_on_jacobian", "_publish_status")
    ),
    _ESTIMATOR: tuple(
        (EstimatorNode, name)
        for name in ("_on_joint_states", "_on_feature", "_on_sliding", "_publish_status")
    ),
}


class Stopwatch:
    """Times functions, each without what it calls that is timed, too."""

    def __init__(self):
        self._inner_ns = [0]
        self.clear()

    def clear(self):
        self.calls, self.own_ns = dict.fromkeys(PARTS, 0), dict.fromkeys(PARTS, 0)
        self._sent_ns = 0  # CPU time of sending
        #: CPU time, without sending, of each tick, and of each joint state by node.
        self.ticks_ns = {_TICK: [], _CONTROLLER: [], _ESTIMATOR: []}
        self.begin_s, self.used_s = time.monotonic(), time.process_time()

    def watch(self, label, owner, name):
        function = getattr(owner, name)
        ticks = _TICK if (owner, name) == (ServoLoop, "tick") else label
        counted = ticks == _TICK or name == "_on_joint_states"

        def timed(*arguments, **options):
            begin_ns, busy_ns, sent_ns = perf_counter_ns(), thread_time_ns(), self._sent_ns
            self._inner_ns.append(0)
            try:
                return function(*arguments, **options)
            finally:
                spent_ns, busy_ns = perf_counter_ns() - begin_ns, thread_time_ns() - busy_ns
                self.own_ns[label] += spent_ns - self._inner_ns.pop()
                self._inner_ns[-1] += spent_ns
                self.calls[label] += 1
                if label == _PUBLISH:
                    self._sent_ns += busy_ns
                elif counted:
                    self.ticks_ns[ticks].append(busy_ns - (self._sent_ns - sent_ns))

        setattr(owner, name, timed)

    def write(self):
        seconds = time.monotonic() - self.begin_s
        ticks_ms = {label: [1e-6 * one for one in ticks] for label, ticks in self.ticks_ns.items()}
        both = zip(ticks_ms[_CONTROLLER], ticks_ms[_ESTIMATOR], strict=False)
        content = {
            "cpu_percent": 100.0 * (time.process_time() - self.used_s) / seconds,
            "parts": {
                label: (count / seconds, 1e-7 * self.own_ns[label] / seconds)
                for label, count in self.calls.items()
            },
            "ticks_ms": {**ticks_ms, "both nodes": [sum(one) for one in both]},
        }
        Path("parts.json").write_text(json.dumps(content), encoding="utf-8")


def main():
    watch = Stopwatch()
    for label, functions in PARTS.items():
        for owner, name in functions:
            watch.watch(label, owner, name)
    threading.Timer(WARM_UP_S, watch.clear).start()
    code = servo_node.main()
    watch.write()
    return code


if __name__ == "__main__":
    sys.exit(main())
