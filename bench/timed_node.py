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


class Stopwatch:
    """Times every call of the functions above."""

    def __init__(self):
        self._ticks_ms = {label: [] for label in TIMED}
        self._sending_ns = 0
        for label, (owner, name) in TIMED.items():
            self._watch(owner, name, self._ticks_ms[label].append)
        self._watch(Publisher, "publish", self._add_sending)

    def _watch(self, owner, name, add):
        function = getattr(owner, name)

        def timed(*arguments, **options):
            begin_ns = thread_time_ns() - self._sending_ns
            try:
                return function(*arguments, **options)
            finally:
                add(1e-6 * (thread_time_ns() - self._sending_ns - begin_ns))

        setattr(owner, name, timed)

    def _add_sending(self, spent_ms):
        self._sending_ns += 1e6 * spent_ms

    def clear(self):
        """Forget the start."""
        for ticks in self._ticks_ms.values():
            ticks.clear()

    def write(self):
        """Write all times, and for each joint state the sum of both nodes."""
        _, controller, estimator = self._ticks_ms.values()
        both = [sum(pair) for pair in zip(controller, estimator, strict=False)]
        content = json.dumps({**self._ticks_ms, "both nodes": both})
        Path("ticks_ms.json").write_text(content, encoding="utf-8")


def main():
    watch = Stopwatch()
    threading.Timer(WARM_UP_S, watch.clear).start()
    code = servo_node.main()
    watch.write()
    return code


if __name__ == "__main__":
    sys.exit(main())
