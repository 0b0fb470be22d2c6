"""What a joint state costs estimator and controller in the closed loop, us; simulator not counted.

python -m bench schemes

In lock step, with exact ball positions and 1 mm of noise, from target to target, and behind a
target on a circle that is sent thirty times a second. *All* is everything that a joint state brings
about, learning from images included.
"""

from __future__ import annotations

import time

import numpy as np

from fvs_controller_node.reasons import State
from fvs_lab.trials import Conditions, make_cases
from fvs_sim_node.simulation import Simulation
from fvs_tools.closed_loop import ClosedLoop
from fvs_tools.schemes import BEYOND, SCHEMES

TARGETS, TARGET_S = 12, 0.8


class Stopwatch:
    """Adds up the time of calls of a function until it is read."""

    def __init__(self, call):
        self._call, self._spent_s = call, 0.0

    def __call__(self, *given):
        begin = time.perf_counter()
        answer = self._call(*given)
        self._spent_s += time.perf_counter() - begin
        return answer

    def read(self):
        """Time since the last reading, s."""
        spent_s, self._spent_s = self._spent_s, 0.0
        return spent_s


def hops(start_m, period_s):
    """Targets, m, one after the other; None at a joint state that no target comes with."""
    rng = np.random.default_rng(0)
    for _ in range(TARGETS):
        yield start_m + rng.uniform(-0.1, 0.1, start_m.size)
        yield from [None] * (round(TARGET_S / period_s) - 1)


def circle(start_m, period_s):
    """A target that goes round with 0.15 m/s for the same time, m; None in between."""
    radius_m, every = 0.1, round(1.0 / (30.0 * period_s))
    for k in range(round(TARGETS * TARGET_S / period_s)):
        angle = 0.15 / radius_m * k * period_s
        way_m = radius_m * np.array([np.cos(angle) - 1.0, 0.0, np.sin(angle)])
        yield None if k % every else start_m + way_m


def measure(scheme, targets):
    """Times of one scheme's estimator, controller and both at joint states in motion, s."""
    with Simulation(Conditions(rendered=False).sim_config()) as simulation:
        simulation.reset(np.array(make_cases("B", 1, 1)[0].start_rad))
        loop = ClosedLoop.of_scheme(scheme, simulation)
        advance = simulation.advance = Stopwatch(simulation.advance)
        obey = simulation.command = Stopwatch(simulation.command)
        tick = loop.loop.tick = Stopwatch(loop.loop.tick)
        loop.run(0.5)
        rows = []
        for target_m in targets(simulation.true_ball_position(), loop.period_s):
            begin_s = time.perf_counter()
            if target_m is not None:
                loop.set_target(target_m)
            command = loop.tick()
            all_s = time.perf_counter() - begin_s - advance.read() - obey.read()
            tick_s = tick.read()
            # Slower commands are rest, when there is less to do.
            if command.state is State.SERVOING and np.abs(command.velocity_rad_s).max() > 0.05:
                rows.append((all_s - tick_s, tick_s, all_s))
    return np.transpose(rows)


def main():
    """Print a row for each scheme: medians and 99th percentiles."""
    for what, targets in (("from target to target", hops), ("behind a circling one", circle)):
        print(
            f"{what:22s}" + "".join(f"{title:>17s}" for title in ("estimator", "controller", "all"))
        )
        for scheme in (*SCHEMES.values(), *BEYOND.values()):
            times_us = [1e6 * np.percentile(one, (50, 99)) for one in measure(scheme, targets)]
            cells = [f"{median:6.0f} ({most:5.0f})" for median, most in times_us]
            print(f"{scheme.name:22s}" + "".join(f"{cell:>17s}" for cell in cells), flush=True)
    print("us, median (99th percentile)")
