"""What a joint state costs estimator and controller in the closed loop, us; simulator not counted.

python bench/bench_schemes.py

In lock step, with exact ball positions and 1 mm of noise, on the way from target to target, and
behind a target that goes round a circle and is told thirty times a second. An
*update* is what the estimator does with a ball position; a *tick* is the controller's, *with an
image* the one that follows a ball position, when laws that plan look at their goal anew. *All* is
all that a joint state brings about: besides these, the Jacobian at the joints, and the checks of
what is told.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from fvs_controller_node.reasons import State  # noqa: E402
from fvs_lab.lockstep import (  # noqa: E402
    LockStep,
    load_chain,
    load_networks,
    make_estimator,
)
from fvs_lab.trials import Conditions, make_cases  # noqa: E402
from fvs_sim_node.simulation import Simulation  # noqa: E402
from fvs_tools.schemes import BEYOND, SCHEMES, Scheme  # noqa: E402

TARGETS, TARGET_S = 12, 0.8
RADIUS_M, SPEED_M_S, TOLD_HZ = 0.1, 0.15, 30.0
#: Slower commands are rest, when there is less to do, rad/s.
MOVING_RAD_S = 0.05


class Stopwatch:
    """Adds up the time of calls of a function until it is read.

    Parameters
    ----------
    call : callable
        The function.
    """

    def __init__(self, call: Callable) -> None:
        self._call = call
        self.spent_s = 0.0

    def __call__(self, *given, **named):
        begin = time.perf_counter()
        try:
            return self._call(*given, **named)
        finally:
            self.spent_s += time.perf_counter() - begin

    def read(self) -> float:
        """Time since the last reading, s."""
        spent, self.spent_s = self.spent_s, 0.0
        return spent


def hops(simulation: Simulation, period_s: float) -> Iterator[np.ndarray | None]:
    """Targets, m, (3,), one after the other; None at a joint state that no target comes with."""
    rng = np.random.default_rng(0)
    for _ in range(TARGETS):
        yield simulation.true_ball_position() + rng.uniform(-0.1, 0.1, 3)
        for _ in range(round(TARGET_S / period_s) - 1):
            yield None


def circle(simulation: Simulation, period_s: float) -> Iterator[np.ndarray | None]:
    """A target that goes round, m, (3,), as long as the others take; None in between."""
    start_m, told = simulation.true_ball_position(), -1
    for k in range(round(TARGETS * TARGET_S / period_s)):
        due = int(k * period_s * TOLD_HZ)
        angle = SPEED_M_S / RADIUS_M * k * period_s
        way_m = RADIUS_M * np.array([np.cos(angle) - 1.0, 0.0, np.sin(angle)])
        yield start_m + way_m if due > told else None
        told = due


def measure(scheme: Scheme, targets: Callable) -> dict[str, np.ndarray]:
    """Times of one scheme, s, by what was done."""
    case = make_cases("B", 1, 1)[0]
    found: dict[str, list[float]] = {
        name: [] for name in ("update", "tick", "with image", "both", "all")
    }
    config = Conditions(rendered=False).sim_config()
    with Simulation(config) as simulation:
        simulation.reset(np.array(case.start_rad))
        estimator = make_estimator(
            scheme.method, simulation, load_networks(), scheme.estimator_values, load_chain()
        )
        loop = LockStep(simulation, estimator, {"law": scheme.law, **scheme.controller_values})
        learn = loop._learn = Stopwatch(loop._learn)
        advance = simulation.advance = Stopwatch(simulation.advance)
        obey = simulation.command = Stopwatch(simulation.command)
        observe = estimator.observe = Stopwatch(estimator.observe)
        tick = loop.loop.tick = Stopwatch(loop.loop.tick)
        loop.run(0.5)
        for target_m in targets(simulation, loop.period_s):
            seen = loop.loop.predictor.images
            begin_s = time.perf_counter()
            if target_m is not None:
                loop.set_target(target_m)
            loop.tick()
            all_s = time.perf_counter() - begin_s - advance.read() - obey.read()
            update_s, tick_s, learned = learn.read(), tick.read(), observe.read() > 0.0
            image = loop.loop.predictor.images > seen
            last = loop.loop.supervisor.last
            moving = np.abs(last.velocity_rad_s).max() > MOVING_RAD_S
            if last.state is State.SERVOING and moving:
                found["tick"].append(tick_s)
                if image:
                    found["with image"].append(tick_s)
                # A ball position is learned from once the joints of its exposure are known.
                if learned:
                    found["update"].append(update_s)
                found["both"].append(update_s + tick_s)
                found["all"].append(all_s)
    return {name: np.array(times) for name, times in found.items()}


def main() -> None:
    """Print a row a scheme: medians and 99th percentiles."""
    titles = ("update", "tick", "tick with image", "both", "all")
    for what, targets in (("from target to target", hops), ("behind a circling one", circle)):
        print(f"{what:22s} {' '.join(f'{title:>16s}' for title in titles)}")
        for scheme in (*SCHEMES.values(), *BEYOND.values()):
            times = measure(scheme, targets)
            cells = [
                f"{1e6 * np.median(one):6.0f} ({1e6 * np.percentile(one, 99.0):5.0f})"
                for one in times.values()
            ]
            print(f"{scheme.name:22s} {' '.join(f'{cell:>16s}' for cell in cells)}", flush=True)
    print("us, median (99th percentile); both, all: of all joint states")


if __name__ == "__main__":
    main()
