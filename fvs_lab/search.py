"""The same automatic search of gains for every scheme: CMA-ES, equal budget, tuning cases.

Many searches run side by side: a generation of all of them is one batch of trials, so that all
cores have work to the end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from fvs_lab.experiment import Context
from fvs_lab.outcome import Outcome
from fvs_lab.trials import Case, Conditions, Trial, Variant
from fvs_tools.schemes import SCHEMES, Scheme

#: Searches of each scheme, each with its own seed; their spread shows the effect of chance.
SEEDS = 3
#: True positions with the same noise, coarser physics: fast enough to search.
TUNING = Conditions(rendered=False, physics_rate_hz=125.0)

Key = TypeVar("Key")

# ---- what is free, and on what terms --------------------------------------------------------


@dataclass(frozen=True)
class Gain:
    """A node's parameter that the search may turn, and its range."""

    name: str
    low: float
    high: float
    of_estimator: bool = False
    #: Whether the range is divided evenly in the logarithm.
    log: bool = True

    def value(self, place: float) -> float:
        """The value at a place from 0 to 1 of the range."""
        if self.log:
            return float(self.low * (self.high / self.low) ** place)
        return float(self.low + (self.high - self.low) * place)


#: The gains of each law that the search may turn; what is fixed are units (alpha1) and what
#: another gain already scales.
_LAW_GAINS = {
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
}
#: Of the estimators, only the filter has a parameter that servoing depends on: its process noise.
#: The networks cover the whole box, so their n1 stays fixed.
_METHOD_GAINS = {"ukf": (Gain("online.process_noise", 1e-5, 1e-1, of_estimator=True),)}


@dataclass(frozen=True)
class Regime:
    """The conditions that are equal for all schemes."""

    #: In data, and on the page.
    name: str
    title: str
    #: Limits of the supervisor.
    controller_values: Mapping[str, Any]
    #: Length of a run, s.
    duration_s: float
    #: What tuning must keep in the median case: attribute of :class:`Candidate`, largest value.
    limit: tuple[str, float] | None = None
    #: A tuning run ends when the error has been below 5 mm for this time, s. Jitter is that of the
    #: last second: where it counts, the way from 5 mm to rest must have ended before.
    rest_s: float = 1.0


#: Limits as on a real arm, the nodes' defaults.
CLIPPED = {"max_joint_velocity_rad_s": 1.0, "max_joint_acceleration_rad_s2": 6.0}
#: Limits out of the way; the largest that the controller takes.
FREE = {"max_joint_velocity_rad_s": 3.14, "max_joint_acceleration_rad_s2": 40.0}
PEAK_RAD_S, JITTER_RAD_S = 0.8, 0.001

#: As on a real arm; nothing clips the command, as in the paper's figures; calm at rest.
REGIMES = (
    Regime("limit", "Equal joint-speed limit", CLIPPED, 4.0),
    Regime("peak", "Equal peak speed, no limit", FREE, 6.0, ("peak_joint_speed_rad_s", PEAK_RAD_S)),
    Regime("jitter", "Equal command jitter", CLIPPED, 5.0, ("jitter_rad_s", JITTER_RAD_S), 2.0),
)

PROPOSED = "proposed"
#: The paper's other schemes.
BASELINES = tuple(name for name in SCHEMES if name != PROPOSED)
#: Laws that are told the true Jacobian: yardsticks.
ORACLE_SLIDING, ORACLE = "oracle, sliding mode", "oracle, proportional"
ORACLES = {
    name: Scheme(name, "oracle", law, "")
    for name, law in ((ORACLE_SLIDING, "ftsm"), (ORACLE, "proportional"))
}

# ---- a search -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Candidate:
    """Gains that were tried, and their results on the tuning cases."""

    gains: dict[str, float]
    #: Mean settling time as :meth:`Search.judge` counts it, s.
    time_s: float
    #: Medians over the cases.
    jitter_rad_s: float
    peak_joint_speed_rad_s: float


@dataclass(frozen=True)
class Search:
    """The search for the gains of one scheme in one regime."""

    scheme: Scheme
    regime: Regime

    @property
    def free(self) -> tuple[Gain, ...]:
        """The gains that the search may turn."""
        return (*_LAW_GAINS[self.scheme.law], *_METHOD_GAINS.get(self.scheme.method, ()))

    def gains(self, places: Sequence[float]) -> dict[str, float]:
        """Values of the free gains at places from 0 to 1 of their ranges."""
        return {gain.name: gain.value(place) for gain, place in zip(self.free, places, strict=True)}

    def variant(self, gains: Mapping[str, float]) -> Variant:
        """The scheme in this regime with such gains."""
        turned: tuple[dict[str, float], dict[str, float]] = ({}, {})
        for one in self.free:
            turned[one.of_estimator][one.name] = gains[one.name]
        variant = Variant.of(self.scheme, **self.regime.controller_values, **turned[False])
        return replace(variant, estimator_values={**variant.estimator_values, **turned[True]})

    def trial(self, gains: Mapping[str, float], case: Case) -> Trial:
        """A trial of the search."""
        terms = self.regime
        return self.variant(gains).trial(
            case, TUNING, duration_s=terms.duration_s, stop_after_s=terms.rest_s
        )

    def judge(self, gains: dict[str, float], outcomes: Sequence[Outcome]) -> Candidate:
        """Summarise the results of gains on the tuning cases.

        The cost is the mean settling time to 5 mm, with a small share of that to 2 mm. A run that
        did not settle costs its duration plus up to the same again, by the remaining error.
        """
        times_s, duration_s = [], self.regime.duration_s
        for one in outcomes:
            left = min(1.0, one.final_rms_m / one.start_distance_m)
            coarse_s = duration_s * (1.0 + left) if one.failure else one.to_5mm_s
            times_s.append(0.9 * coarse_s + 0.1 * min(duration_s, one.to_2mm_s))
        names = ("jitter_rad_s", "peak_joint_speed_rad_s")
        middle = [float(np.median([getattr(one, name) for one in outcomes])) for name in names]
        return Candidate(gains, sum(times_s) / len(times_s), *middle)

    def cost(self, candidate: Candidate) -> float:
        """The search's objective, s: settling time, and a penalty beyond the limit."""
        if self.regime.limit is None:
            return candidate.time_s
        quantity, bound = self.regime.limit
        excess = getattr(candidate, quantity) / bound - 1.0
        # Exceeding the limit by a tenth costs two seconds, more than any gain can save.
        return candidate.time_s + 20.0 * max(0.0, excess)


@dataclass(frozen=True)
class Tuned:
    """What a search found: all its candidates, in order."""

    search: Search
    tried: list[Candidate]
    #: Candidates of other searches of the same scheme that count here as well.
    others: list[Candidate] = field(default_factory=list)

    @property
    def best(self) -> Candidate:
        """The candidate of least cost."""
        return min([*self.tried, *self.others], key=self.search.cost)

    @property
    def variant(self) -> Variant:
        """The scheme with the best gains."""
        return self.search.variant(self.best.gains)

    def summary(self) -> dict[str, Any]:
        """The stored record: scheme, regime and ranges, the best gains, and all candidates."""
        return {
            "scheme": self.search.scheme.name,
            "regime": self.search.regime,
            "free": self.search.free,
            "best": self.best,
            "tried": self.tried,
        }


def search_all(
    context: Context, searches: Mapping[Key, Search], cases: Sequence[Case], seed: int
) -> dict[Key, list[Tuned]]:
    """Search each of them several times with the same budget; a quick run does one small search.

    Each search has another seed, counting from the one given.
    """
    from cmaes import CMA

    repeats, generations, population = (1, 1, 2) if context.quick else (SEEDS, 6, 10)
    found = [Tuned(search, []) for search in repeats * [*searches.values()]]
    optimisers = [
        CMA(
            mean=np.full(len(one.search.free), 0.5),
            sigma=0.3,
            bounds=np.tile([0.0, 1.0], (len(one.search.free), 1)),
            population_size=population,
            seed=seed + number,
        )
        for number, one in enumerate(found)
    ]
    for generation in range(generations):
        asked = [[one.ask() for _ in range(population)] for one in optimisers]
        gains = [
            [one.search.gains(places) for places in candidates]
            for one, candidates in zip(found, asked, strict=True)
        ]
        trials = [
            one.search.trial(values, case)
            for one, candidates in zip(found, gains, strict=True)
            for values in candidates
            for case in cases
        ]
        label = f"search, round {generation + 1} of {generations}"
        outcomes = iter(context.outcomes(trials, label))
        for optimiser, one, places, candidates in zip(optimisers, found, asked, gains, strict=True):
            judged = [
                one.search.judge(values, [next(outcomes) for _ in cases]) for values in candidates
            ]
            one.tried.extend(judged)
            optimiser.tell(list(zip(places, map(one.search.cost, judged), strict=True)))
    return {key: found[place :: len(searches)] for place, key in enumerate(searches)}
