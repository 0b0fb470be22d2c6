"""A contestant in a random world, and what is made of many such runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fvs_lab.robustness_worlds import World
from fvs_lab.statistics import Interval, wilson
from fvs_lab.trials import (
    NOT_STAYED,
    REST_S,
    Outcome,
    Trial,
    drive,
    simulation_of,
)

#: Length of a trial from the target on, s; of this the last second must be within 5 mm.
DURATION_S = 6.0


@dataclass(frozen=True)
class Contestant:
    """Who is sent through the worlds.

    Parameters
    ----------
    name : str
        For tables and ``--scheme``.
    method, law : str
        Estimator and control law, by their registries' names.
    estimator_values, controller_values : mapping
        The nodes' parameters, where they differ from the defaults.
    of_paper : bool
        Whether it is one of the paper's.
    """

    name: str
    method: str
    law: str
    estimator_values: Mapping[str, Any] = field(default_factory=dict)
    controller_values: Mapping[str, Any] = field(default_factory=dict)
    of_paper: bool = False

    @property
    def knows_truth(self) -> bool:
        """Whether it is told the true Jacobian: a yardstick, no competitor."""
        return self.method == "oracle"


@dataclass(frozen=True)
class Job:
    """One run.

    Parameters
    ----------
    world : World
        Where.
    contestant : Contestant
        Who.
    rendered : bool
        Whether ball positions come from rendered images.
    record : bool
        Whether to keep the time series.
    """

    world: World
    contestant: Contestant
    rendered: bool = True
    record: bool = False


def run_job(job: Job) -> Outcome:
    """Run one job; the same to the bit in whatever process."""
    one = job.contestant
    trial = Trial(
        job.world.case,
        one.method,
        one.law,
        one.estimator_values,
        one.controller_values,
        replace(job.world.conditions, rendered=job.rendered),
        DURATION_S,
        record=job.record,
    )
    return judged(drive(trial, simulation_of(trial.conditions), job.world.bump))


def judged(outcome: Outcome) -> Outcome:
    """Call it a failure, too, if the ball came to stay only within the last second."""
    if outcome.failure or outcome.settled_s <= DURATION_S - REST_S:
        return outcome
    return replace(
        outcome, failure=NOT_STAYED, settling_s={name: None for name in outcome.settling_s}
    )


# ---- many runs ------------------------------------------------------------------------------


def success_rate(outcomes: Sequence[Outcome]) -> Interval:
    """Share of the runs that settled, with its interval."""
    return wilson(sum(not one.failure for one in outcomes), len(outcomes))


def wins(ones: Sequence[Outcome], others: Sequence[Outcome]) -> Interval | None:
    """Of the worlds in which just one of two settles, the share that the first one does.

    Returns
    -------
    Interval or None
        None where there is no such world.
    """
    won = [
        not one.failure
        for one, other in zip(ones, others, strict=True)
        if bool(one.failure) != bool(other.failure)
    ]
    return wilson(sum(won), len(won)) if won else None


def settled_by(outcomes: Sequence[Outcome], share: float) -> float:
    """Time by which this share of the runs had settled, s; infinite if fewer ever do."""
    times = np.sort([one.settled_s for one in outcomes])
    return float(times[math.ceil(share * times.size) - 1])
