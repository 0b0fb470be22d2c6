"""Does the controller keep its promises, whatever happens? A million ticks of everything.

python -m bench fuzz; FVS_BENCH_CYCLES is the number of ticks, FVS_BENCH_SEED the first seed.

Every core plays episodes of :class:`bench.fuzz_machine.Machine`. The first broken promise ends the
campaign: Hypothesis shrinks it to the shortest script that breaks it, and prints that.
"""

from __future__ import annotations

import functools
import multiprocessing
import os
import time
import traceback
import warnings
from collections import Counter

import hypothesis
from hypothesis.stateful import run_state_machine_as_test
from tqdm import tqdm

from bench.fuzz_machine import Machine
from fvs_controller_node.reasons import Reason

TICKS, CHUNK_TICKS, EPISODES = 1_000_000, 20_000, 20
SETTINGS = hypothesis.settings(
    max_examples=EPISODES,
    stateful_step_count=15,
    database=None,
    deadline=None,
    phases=[hypothesis.Phase.generate],
    suppress_health_check=list(hypothesis.HealthCheck),
)
#: Shrinking takes minutes; a test cannot wait for it.
_SHRINKS = hypothesis.settings(
    SETTINGS, phases=[hypothesis.Phase.generate, hypothesis.Phase.shrink]
)


def play(
    seed: int, ticks: int = CHUNK_TICKS, settings: hypothesis.settings = SETTINGS
) -> tuple[Counter[str], str]:
    """Play at least some ticks; returns counts by name, and what broke a promise."""
    warnings.simplefilter("ignore")  # of numpy, about the numbers that are sent here
    counts: Counter[str] = Counter()

    class Counted(Machine):
        def teardown(self) -> None:
            super().teardown()
            if hasattr(self, "world"):
                counts.update(self.world.reasons)
                played = self.world.reasons.total()
                counts.update(episodes=1, ticks=played, moving=self.world.moving_ticks)

    while counts["ticks"] < ticks:
        try:
            run_state_machine_as_test(hypothesis.seed(seed)(Counted), settings=settings)
        except Exception:
            return counts, traceback.format_exc()
        seed += 1
    return counts, ""


def main() -> None:
    """Play on all cores, and print what was reached."""
    chunks = -(-int(os.environ.get("FVS_BENCH_CYCLES", TICKS)) // CHUNK_TICKS)
    first = int(os.environ.get("FVS_BENCH_SEED", "0"))
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    counts: Counter[str] = Counter()
    begin_s = time.perf_counter()
    campaign = functools.partial(play, settings=_SHRINKS)
    with multiprocessing.get_context("spawn").Pool() as pool:
        seeds = range(1000 * first, 1000 * (first + chunks), 1000)
        for found, broken in tqdm(pool.imap_unordered(campaign, seeds), "fuzz", chunks):
            counts.update(found)
            if broken:
                raise RuntimeError(f"a promise was broken\n{broken}")
    ticks = counts["ticks"]
    print(
        f"{ticks} ticks in {counts['episodes']} episodes, {time.perf_counter() - begin_s:.0f} s; "
        f"{counts['moving'] / ticks:.0%} of the commands are not zero"
    )
    for reason in sorted(Reason, key=lambda reason: -counts[reason.name]):
        print(f"  {reason.name:20s} {counts[reason.name]:9d} {counts[reason.name] / ticks:7.2%}")
    unreached = [reason.name for reason in Reason if not counts[reason.name]]
    print(f"reasons never reached: {', '.join(unreached) or 'none'}")
    print("every promise was kept")


if __name__ == "__main__":
    main()
