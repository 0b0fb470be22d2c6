"""``fvs_servo_node`` that times its ticks, and writes them into ``ticks_ms.json`` when it ends.

A time is CPU time of the computation alone, without that of sending.
"""

from __future__ import annotations

import json
import sys
import threading
from pathlib import Path
from time import thread_time_ns

from rclpy.publisher import Publisher

from fvs_controller_node.loop import ServoLoop
from fvs_controller_node.node import ControllerNode
from fvs_estimator_node.node import EstimatorNode
from fvs_tools import servo_node

#: Measured from so long after the start, when the arms move, s.
WARM_UP_S = 6.0
TIMED = {
    "tick alone": (ServoLoop, "tick"),
    "controller node": (ControllerNode, "_on_joint_states"),
    "estimator node": (EstimatorNode, "_on_joint_states"),
}


def watch(owner, name, sends_ms, calls_ms):
    """Note how long each call of a method takes, without the sending in it."""
    function = getattr(owner, name)

    def timed(*arguments, **options):
        sends, begin_ns = len(sends_ms), thread_time_ns()
        try:
            return function(*arguments, **options)
        finally:
            spent_ms = 1e-6 * (thread_time_ns() - begin_ns)
            calls_ms.append(spent_ms - sum(sends_ms[sends:]))

    setattr(owner, name, timed)


def main():
    ticks_ms, sends_ms = {label: [] for label in TIMED}, []
    watch(Publisher, "publish", [], sends_ms)
    for label, (owner, name) in TIMED.items():
        watch(owner, name, sends_ms, ticks_ms[label])

    def forget():
        for ticks in ticks_ms.values():
            ticks.clear()

    threading.Timer(WARM_UP_S, forget).start()
    code = servo_node.main()
    both = zip(ticks_ms["controller node"], ticks_ms["estimator node"], strict=False)
    content = json.dumps({**ticks_ms, "both nodes": list(map(sum, both))})
    Path("ticks_ms.json").write_text(content, encoding="utf-8")
    return code


if __name__ == "__main__":
    sys.exit(main())
