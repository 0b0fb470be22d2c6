"""Does the controller keep its promises, whatever happens? A million ticks of everything.

python -m bench fuzz; FVS_BENCH_CYCLES says how many ticks, FVS_BENCH_SEED where to begin.

Needs hypothesis. Each process plays episodes (:mod:`bench.fuzz_world`); a broken promise is
shrunk to the shortest episode that breaks it, which is printed ready to be played again.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import time
import traceback
import warnings
from collections import Counter
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path

from tqdm import tqdm

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

TICKS, EPISODES_A_CHUNK = 1_000_000, 40


@dataclass
class Tally:
    """What a chunk of episodes came to."""

    episodes: int = 0
    ticks: int = 0
    moving_ticks: int = 0
    states: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    #: Promise -> the episode that broke it, and how.
    broken: dict[str, str] = field(default_factory=dict)

    def add(self, other: Tally) -> None:
        """Add another chunk."""
        self.episodes += other.episodes
        self.ticks += other.ticks
        self.moving_ticks += other.moving_ticks
        self.states.update(other.states)
        self.reasons.update(other.reasons)
        self.broken.update({k: v for k, v in other.broken.items() if k not in self.broken})


def play(seed: int, episodes: int, known: frozenset[str]) -> Tally:
    """Play some episodes; promises in ``known`` are not reported again."""
    import hypothesis

    from bench import fuzz_world

    tally = Tally()

    @hypothesis.seed(seed)
    @hypothesis.settings(
        max_examples=episodes,
        database=None,
        deadline=None,
        phases=[hypothesis.Phase.generate, hypothesis.Phase.shrink],
        suppress_health_check=list(hypothesis.HealthCheck),
        print_blob=False,
        verbosity=hypothesis.Verbosity.quiet,
    )
    @hypothesis.given(fuzz_world.episodes())
    def one(episode: fuzz_world.Episode) -> None:
        world = fuzz_world.World(episode, known)
        try:
            world.play()
        except fuzz_world.BrokenPromiseError as error:
            tally.broken[error.promise] = f"{error}\nWorld({episode!r}).play()"
            raise
        except Exception as error:
            promise = f"no {type(error).__name__}"
            if promise in known:
                return
            last = traceback.extract_tb(error.__traceback__)[-1]
            tally.broken[promise] = (
                f"{error} ({last.filename}:{last.lineno})\nWorld({episode!r}).play()"
            )
            raise
        finally:
            tally.episodes += 1
            tally.ticks += world.ticks
            tally.moving_ticks += world.moving_ticks
            tally.states.update({state.name: n for state, n in world.states.items()})
            tally.reasons.update({reason.name: n for reason, n in world.reasons.items()})

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of numpy, about the numbers that are sent here
        try:
            one()
        except Exception:
            if not tally.broken:
                raise
    return tally


def fuzz(ticks: int, seed: int) -> Tally:
    """Play on all cores until so many ticks were made."""
    total, next_seed = Tally(), seed
    cores = os.cpu_count() or 1
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    with (
        ProcessPoolExecutor(cores, multiprocessing.get_context("spawn")) as pool,
        tqdm(total=ticks, unit=" ticks", unit_scale=True, desc="fuzz") as bar,
    ):
        running: set[Future[Tally]] = set()
        while total.ticks < ticks or running:
            while total.ticks < ticks and len(running) < cores + 1:
                known = frozenset(total.broken)
                running.add(pool.submit(play, next_seed, EPISODES_A_CHUNK, known))
                next_seed += 1
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                total.add(future.result())
            bar.n = min(total.ticks, ticks)
            bar.set_postfix(broken=len(total.broken), refresh=True)
    return total


def shares(counts: Counter[str], names: list[str], total: int) -> str:
    """A table of names, counts and shares, the most frequent first."""
    rows = sorted(names, key=lambda name: -counts[name])
    return "\n".join(
        f"  {name:20s} {counts[name]:9d} {100.0 * counts[name] / max(1, total):6.2f} %"
        for name in rows
    )


def main() -> None:
    from fvs_controller_node.reasons import Reason, State

    ticks = int(os.environ.get("FVS_BENCH_CYCLES", TICKS))
    start_s = time.perf_counter()
    total = fuzz(ticks, int(os.environ.get("FVS_BENCH_SEED", "0")))
    spent_s = time.perf_counter() - start_s
    print(
        f"{total.ticks} ticks in {total.episodes} episodes, {spent_s:.0f} s; "
        f"{total.moving_ticks} commands that are not zero "
        f"({100.0 * total.moving_ticks / max(1, total.ticks):.0f} %)"
    )
    print("state\n" + shares(total.states, [state.name for state in State], total.ticks))
    print("reason\n" + shares(total.reasons, [reason.name for reason in Reason], total.ticks))
    unreached = [reason.name for reason in Reason if not total.reasons[reason.name]]
    print(f"reasons never reached: {', '.join(unreached) or 'none'}")
    for text in total.broken.values():
        print(f"\nBROKEN  {text}")
    if total.broken:
        raise RuntimeError(f"{len(total.broken)} promises broken: {', '.join(total.broken)}")
    print("every promise was kept")


if __name__ == "__main__":
    main()
