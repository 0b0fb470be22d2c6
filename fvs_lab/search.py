"""The same automatic search of gains for every scheme: CMA-ES, equal budget, tuning cases.

Many searches run side by side: a generation of all of them is one batch of trials, so that all
cores have work to the end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

from fvs_lab.contestants import EXACT
from fvs_lab.experiment import Context
from fvs_lab.trials import Case, Trial, crossed
from fvs_tools.schemes import Scheme

# ---- what is free, and on what terms --------------------------------------------------------


@dataclass(frozen=True)
class Gain:
    """A node's parameter that the search may turn, and its range."""

    name: str
    low: float
    high: float
    #: Whether the range is divided evenly in the logarithm.
    log: bool = True

    def value(self, position: float) -> float:
        """The value at a position from 0 to 1 of the range."""
        if self.log:
            return float(self.low * (self.high / self.low) ** position)
        return float(self.low + (self.high - self.low) * position)


#: The gains of each law that the search may turn, and those of each estimator. What is fixed are
#: units (alpha1), what another gain already scales, and the networks' n1: they cover the whole box.
GAINS = {
    "ftsm": (
        Gain("alpha2", 0.1, 10.0),
        Gain("alpha3", 0.1, 20.0),
        Gain("lambda1", 0.35, 0.7, log=False),
        Gain("lambda2", 0.0, 0.3, log=False),
        Gain("switch_error_m", 0.002, 0.04),
        Gain("k4", 0.005, 0.5),
    ),
    "proportional": (Gain("proportional_gain_1_s", 0.3, 60.0), Gain("damping", 1e-6, 1e-2)),
    "mfac": (Gain("mfac_lambda", 1e-4, 3.0), Gain("control_interval_s", 0.015, 3.0)),
    "mpc": (
        Gain("mpc_horizon", 1.5, 60.0),
        Gain("mpc_alpha", 0.3, 1.0, log=False),
        Gain("mpc_rho", 0.03, 10.0),
        Gain("mpc_q", 0.0003, 3.0),
    ),
    "ukf": (Gain("online.process_noise", 1e-5, 1e-1),),
}


@dataclass(frozen=True)
class Terms:
    """What is equal for all schemes."""

    #: For the page.
    title: str
    #: Limits of the supervisor.
    limits: Mapping[str, Any]
    #: Length of a run, s.
    duration_s: float
    #: What tuning must keep in the median case: a field of the outcome, and its largest value.
    limit: tuple[str, float] = ("", inf)
    #: A tuning run ends when the error has been below 5 mm for this time, s. Jitter is that of the
    #: last second: where it counts, the way from 5 mm to rest must have ended before.
    rest_s: float = 1.0


# ---- a search -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Search:
    """The search for the gains of one scheme on some terms."""

    scheme: Scheme
    terms: Terms

    @property
    def free(self) -> tuple[Gain, ...]:
        """The gains that the search may turn."""
        return (*GAINS[self.scheme.law], *GAINS.get(self.scheme.method, ()))

    def variant(self, positions: np.ndarray) -> Trial:
        """The scheme with gains at positions from 0 to 1 of their ranges."""
        gains = {gain.name: gain.value(at) for gain, at in zip(self.free, positions, strict=True)}
        estimators = {name: value for name, value in gains.items() if "." in name}
        laws = {name: value for name, value in gains.items() if "." not in name}
        trial = Trial(self.scheme, EXACT, {"scheme": self.scheme.name})
        return trial.changed(
            estimator=estimators,
            controller={**self.terms.limits, **laws},
            duration_s=self.terms.duration_s,
        )

    def trials(self, positions: np.ndarray, cases: Sequence[Case]) -> list[Trial]:
        """Trials of the search, with coarser physics."""
        variant = self.variant(positions)
        coarse = variant.changed(
            conditions={"physics_rate_hz": 125.0}, stop_after_s=self.terms.rest_s
        )
        return crossed([coarse], cases)

    def cost(self, runs: Sequence[Mapping[str, Any]]) -> float:
        """The search's objective, s: the mean settling time, and a penalty beyond the limit.

        Mostly to 5 mm, with a small share of that to 2 mm. A run that did not settle costs its
        duration plus up to the same again, by the remaining error. Exceeding the limit by a tenth
        costs two seconds, more than any gain can save.
        """
        times_s, duration_s = [], self.terms.duration_s
        for run in runs:
            left = min(1.0, run["final_rms_m"] / run["start_distance_m"])
            coarse_s = run["to_5mm_s"] if run["settled"] else duration_s * (1.0 + left)
            times_s.append(0.9 * coarse_s + 0.1 * min(duration_s, run["to_2mm_s"]))
        quantity, most = self.terms.limit
        middle = float(np.median([run.get(quantity, 0.0) for run in runs]))
        return sum(times_s) / len(times_s) + 20.0 * max(0.0, middle / most - 1.0)


def search_all(
    context: Context, searches: Sequence[Search], cases: Sequence[Case], seed: int
) -> list[Trial]:
    """The variant with the best gains of each search, three times with the same budget.

    Each has another seed, counting from the one given, and the label ``search``: their spread shows
    the effect of chance. A quick run does one small search.
    """
    from cmaes import CMA

    repeats, generations, population = (1, 1, 2) if context.quick else (3, 6, 10)
    numbered = [(search, number) for search in searches for number in range(repeats)]
    optimisers = [
        CMA(
            mean=np.full(len(search.free), 0.5),
            sigma=0.3,
            bounds=np.tile([0.0, 1.0], (len(search.free), 1)),
            population_size=population,
            seed=seed + index,
        )
        for index, (search, _) in enumerate(numbered)
    ]
    best: list[tuple[np.ndarray, float]] = [(np.empty(0), inf)] * len(numbered)
    for generation in range(generations):
        asked = [[optimiser.ask() for _ in range(population)] for optimiser in optimisers]
        trials = [
            trial
            for (search, _), candidates in zip(numbered, asked, strict=True)
            for positions in candidates
            for trial in search.trials(positions, cases)
        ]
        label = f"search, round {generation + 1} of {generations}"
        runs = iter(context.run(trials, label))
        for index, candidates in enumerate(asked):
            costs = [numbered[index][0].cost([next(runs) for _ in cases]) for _ in candidates]
            judged = list(zip(candidates, costs, strict=True))
            optimisers[index].tell(judged)
            best[index] = min((best[index], *judged), key=lambda pair: pair[1])
    return [
        search.variant(positions).changed({"search": number})
        for (search, number), (positions, _) in zip(numbered, best, strict=True)
    ]
