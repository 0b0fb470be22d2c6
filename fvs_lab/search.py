"""The same automatic search for every scheme: CMA-ES over its gains, equal budget, tuning cases.

Many searches run abreast: a generation of all of them is one batch of trials, so that all cores
have work to the end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from fvs_lab.context import Context
from fvs_lab.outcome import Outcome
from fvs_lab.trials import Case, Conditions, Trial, Variant, run_trial

#: Steepness of the penalty on a constraint's relative violation, s: breaking it by a tenth
#: costs two seconds, more than any gain is worth.
_PENALTY_S = 20.0
#: Share of the time to 2 mm in the cost, to decide between equals at 5 mm.
_FINE_SHARE = 0.1
#: First spread of the search, in a cube of edge 1.
_SPREAD = 0.3
#: Searches of each scheme, each from a seed of its own: their spread is what chance is worth. The
#: candidates of each are rounds times candidates of a round.
SEEDS, _ROUNDS, _ABREAST = 3, 6, 10
#: True positions with the same noise, coarser physics: fast enough to search.
TUNING = Conditions(rendered=False, physics_rate_hz=125.0)

ESTIMATOR, CONTROLLER = "estimator", "controller"

Key = TypeVar("Key")


@dataclass(frozen=True)
class Knob:
    """A number that the search may turn.

    Parameters
    ----------
    name : str
        Parameter of a node.
    low, high : float
        Its range.
    node : str
        ``controller`` or ``estimator``.
    log : bool
        Whether the range is divided evenly in the logarithm.
    """

    name: str
    low: float
    high: float
    node: str = CONTROLLER
    log: bool = True

    def value(self, place: float) -> float:
        """The value at a place from 0 to 1 of the range."""
        place = min(1.0, max(0.0, place))
        if self.log:
            return float(self.low * (self.high / self.low) ** place)
        return float(self.low + (self.high - self.low) * place)

    def place(self, value: float) -> float:
        """The place from 0 to 1 of a value in the range."""
        if self.log:
            return float(np.log(value / self.low) / np.log(self.high / self.low))
        return (value - self.low) / (self.high - self.low)


@dataclass(frozen=True)
class Limit:
    """A bound that a tuned scheme must keep in the median tuning case.

    Parameters
    ----------
    quantity : str
        Attribute of :class:`Candidate`.
    bound : float
        Its largest value.
    """

    quantity: str
    bound: float


@dataclass(frozen=True)
class Search:
    """What is searched.

    Parameters
    ----------
    name : str
        For progress and data.
    variant : Variant
        Estimator, control law and what is fixed.
    knobs : tuple of Knob
        The gains that are free.
    limit : Limit, optional
        What the gains must keep.
    duration_s : float
        Longest run, s.
    rest_s : float
        A run ends when the error has been below 5 mm for this time, s. Jitter is that of the last
        second: where it counts, the way from 5 mm to rest must have ended before.
    """

    name: str
    variant: Variant
    knobs: tuple[Knob, ...]
    limit: Limit | None = None
    duration_s: float = 4.0
    rest_s: float = 1.0

    def at_an_edge(self, gains: Mapping[str, float]) -> list[str]:
        """Knobs that stand within a twentieth of an end of their range."""
        return [
            knob.name
            for knob in self.knobs
            if knob.name in gains and not 0.05 <= knob.place(gains[knob.name]) <= 0.95
        ]

    def gains(self, places: Sequence[float]) -> dict[str, float]:
        """Values of the knobs at places from 0 to 1 of their ranges."""
        return {
            knob.name: knob.value(place) for knob, place in zip(self.knobs, places, strict=True)
        }

    def trial(self, gains: Mapping[str, float], case: Case, conditions: Conditions) -> Trial:
        """The trial of a case with such gains; knobs that they leave out keep their defaults."""
        turned: dict[str, dict[str, float]] = {CONTROLLER: {}, ESTIMATOR: {}}
        for knob in self.knobs:
            if knob.name in gains:
                turned[knob.node][knob.name] = gains[knob.name]
        variant = replace(
            self.variant,
            estimator_values={**self.variant.estimator_values, **turned[ESTIMATOR]},
            controller_values={**self.variant.controller_values, **turned[CONTROLLER]},
        )
        return variant.trial(case, conditions, duration_s=self.duration_s, stop_after_s=self.rest_s)

    def time_s(self, outcomes: Sequence[Outcome]) -> float:
        """Mean settling time, s: to 5 mm, with a small share of that to 2 mm.

        A run that did not settle costs its duration and as much again, by the error left.
        """
        total = 0.0
        for one in outcomes:
            left = min(1.0, one.final_rms_m / one.start_distance_m)
            never_s = self.duration_s * (1.0 + left)
            coarse = never_s if one.failure else one.settled_s
            fine_s = one.settling_s["2 mm"]
            fine = self.duration_s if fine_s is None else fine_s
            total += (1.0 - _FINE_SHARE) * coarse + _FINE_SHARE * fine
        return total / len(outcomes)

    def judge(self, gains: dict[str, float], outcomes: Sequence[Outcome]) -> Candidate:
        """Sum up what came of gains on the tuning cases."""

        def middle(quantity: str) -> float:
            return float(np.median([getattr(one, quantity) for one in outcomes]))

        return Candidate(
            gains=gains,
            time_s=self.time_s(outcomes),
            settled_s=middle("settled_s"),
            jitter_rad_s=middle("jitter_rad_s"),
            peak_joint_speed_rad_s=middle("peak_joint_speed_rad_s"),
        )

    def cost(self, candidate: Candidate) -> float:
        """What the search makes small, s: settling time, and a penalty beyond the limit."""
        if self.limit is None:
            return candidate.time_s
        excess = getattr(candidate, self.limit.quantity) / self.limit.bound - 1.0
        return candidate.time_s + _PENALTY_S * max(0.0, excess)


@dataclass(frozen=True)
class Candidate:
    """Gains that were tried, and what came of them on the tuning cases.

    Parameters
    ----------
    gains : dict of str to float
        Values of the knobs.
    time_s : float
        Mean settling time as :meth:`Search.time_s` counts it, s.
    settled_s, jitter_rad_s, peak_joint_speed_rad_s : float
        Medians over the cases; the settling time is to 5 mm, infinite for never.
    """

    gains: dict[str, float]
    time_s: float
    settled_s: float
    jitter_rad_s: float
    peak_joint_speed_rad_s: float


@dataclass(frozen=True)
class Tuned:
    """What a search found.

    Parameters
    ----------
    search : Search
        What was searched.
    tried : list of Candidate
        All its candidates, in order.
    others : list of Candidate
        Candidates of other searches of the same scheme that count here as well.
    """

    search: Search
    tried: list[Candidate]
    others: list[Candidate] = field(default_factory=list)

    @property
    def best(self) -> Candidate:
        """The candidate of least cost."""
        return min([*self.tried, *self.others], key=self.search.cost)

    def trial(self, case: Case, conditions: Conditions, duration_s: float, **changes) -> Trial:
        """A scoring trial with the best gains; changes are fields of the trial."""
        trial = self.search.trial(self.best.gains, case, conditions)
        return replace(trial, duration_s=duration_s, stop_after_s=None, **changes)


def run_searches(
    context: Context,
    searches: Sequence[Search],
    cases: Sequence[Case],
    conditions: Conditions,
    generations: int,
    population: int,
    seed: int,
) -> list[Tuned]:
    """Search all of them with the same budget.

    Parameters
    ----------
    context : Context
        For its cores.
    searches : sequence of Search
        What is searched.
    cases : sequence of Case
        The tuning cases.
    conditions : Conditions
        The world of the tuning runs.
    generations, population : int
        The budget: their product is the number of candidates of each search.
    seed : int
        Of the first search; each has another one.
    """
    from cmaes import CMA

    optimisers = [
        CMA(
            mean=np.full(len(search.knobs), 0.5),
            sigma=_SPREAD,
            bounds=np.tile([0.0, 1.0], (len(search.knobs), 1)),
            population_size=population,
            seed=seed + number,
        )
        for number, search in enumerate(searches)
    ]
    found = [Tuned(search, []) for search in searches]
    for generation in range(generations):
        asked = [[one.ask() for _ in range(population)] for one in optimisers]
        trials = [
            search.trial(search.gains(places), case, conditions)
            for search, candidates in zip(searches, asked, strict=True)
            for places in candidates
            for case in cases
        ]
        outcomes = iter(
            context.map(run_trial, trials, f"search, round {generation + 1} of {generations}")
        )
        for optimiser, one, candidates in zip(optimisers, found, asked, strict=True):
            told = []
            for places in candidates:
                results = [next(outcomes) for _ in cases]
                candidate = one.search.judge(one.search.gains(places), results)
                one.tried.append(candidate)
                told.append((places, one.search.cost(candidate)))
            optimiser.tell(told)
    return found


def search_all(
    context: Context, searches: Mapping[Key, Search], cases: Sequence[Case], seed: int
) -> dict[Key, list[Tuned]]:
    """Search each of them several times, from other seeds, all with the same budget.

    Parameters
    ----------
    context : Context
        For its cores; a quick one searches once, and little.
    searches : mapping to Search
        What is searched.
    cases : sequence of Case
        The tuning cases.
    seed : int
        Of the first search; each has another one.
    """
    found = run_searches(
        context,
        (1 if context.quick else SEEDS) * [*searches.values()],
        cases,
        TUNING,
        generations=1 if context.quick else _ROUNDS,
        population=2 if context.quick else _ABREAST,
        seed=seed,
    )
    return {key: found[place :: len(searches)] for place, key in enumerate(searches)}
