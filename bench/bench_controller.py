"""Time of one controller tick and its parts, us; run it from the repository root.

python bench/bench_controller.py
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from fvs_controller_node.base import ControlInput  # noqa: E402
from fvs_controller_node.config import build_law, build_loop, default_values  # noqa: E402
from fvs_controller_node.loop import ServoLoop  # noqa: E402
from fvs_controller_node.pseudo_inverse import conditioning  # noqa: E402
from fvs_controller_node.registry import LAWS  # noqa: E402

TICK_S = 0.008
FRAME = "camera_color_optical_frame"
JACOBIAN = np.array(
    [
        [0.02, -0.45, -0.30, -0.10, 0.05, 0.0],
        [-0.55, 0.03, 0.04, 0.02, 0.17, 0.0],
        [0.10, -0.25, 0.35, 0.15, -0.02, 0.0],
    ]
)


def microseconds(call: Callable[[], object], times: int = 2000) -> tuple[float, float]:
    """Median and 99th percentile of the time of a call."""
    spent = []
    for _ in range(times):
        begin = time.perf_counter()
        call()
        spent.append(time.perf_counter() - begin)
    return 1e6 * float(np.median(spent)), 1e6 * float(np.percentile(spent, 99.0))


class Motion:
    """A perfect robot that servoes to and fro, so that every branch of a tick is in use."""

    def __init__(self, law: str) -> None:
        self.loop: ServoLoop = build_loop(default_values(law=law))
        self.joints = np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0])
        self.k = 0
        self.loop.supervisor.target(np.array([0.1, 0.1, 1.0]), FRAME)
        while not self.loop.supervisor.start(self.time_s)[0]:
            self.step()
            self.tick()

    @property
    def time_s(self) -> float:
        return self.k * TICK_S

    def step(self) -> None:
        self.k += 1
        t = self.time_s
        self.loop.add_jacobian(t, JACOBIAN)
        self.loop.add_joints(t, t, self.joints)
        if self.k % 4 == 0:
            ball = np.array([0.2, 0.3, 1.2]) + JACOBIAN @ self.joints
            self.loop.add_ball(t, t - 0.04, ball, FRAME)
        if self.k % 100 == 0:
            x = 0.1 if self.k % 200 else -0.2
            self.loop.supervisor.target(np.array([x, 0.1, 1.0]), FRAME)

    def tick(self) -> None:
        command = self.loop.tick(self.time_s, TICK_S)
        self.joints = self.joints + command.velocity_rad_s * TICK_S


def main() -> None:
    for law in LAWS:
        motion = Motion(law)
        ticks, inputs = [], []
        for _ in range(4000):
            begin = time.perf_counter()
            motion.step()
            middle = time.perf_counter()
            motion.tick()
            inputs.append(middle - begin)
            ticks.append(time.perf_counter() - middle)
        for what, spent in (("tick", ticks), ("inputs", inputs)):
            median, tail = 1e6 * np.median(spent), 1e6 * np.percentile(spent, 99.0)
            print(f"{law:14s} {what:12s} {median:7.1f} us median {tail:7.1f} us p99")
        told = ControlInput(
            np.array([0.2, -0.1, 0.004]), JACOBIAN, np.full(6, 0.1), motion.joints, TICK_S
        )
        control_law = build_law(default_values(law=law))
        median, tail = microseconds(lambda law=control_law, told=told: law.command(told))
        print(f"{law:14s} {'law alone':12s} {median:7.1f} us median {tail:7.1f} us p99")
    median, tail = microseconds(lambda: conditioning(JACOBIAN))
    print(f"{'conditioning':27s} {median:7.1f} us median {tail:7.1f} us p99")


if __name__ == "__main__":
    main()
