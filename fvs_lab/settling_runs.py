"""The runs whose settling times are measured, each beside what was promised for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fvs_controller_node.config import build_law, default_values
from fvs_controller_node.ftsm import FtsmLaw
from fvs_controller_node.settling import reaching_time_s
from fvs_lab.settling_bounds import (
    BANDS,
    DURATION_S,
    bound_to_band_s,
    predicted_times_s,
    printed_sliding_time_s,
)
from fvs_lab.trials import BOUNDS_M, Case, Conditions, Outcome, Trial, seconds

#: A worse Jacobian does not count as good (relative Frobenius error).
GOOD_JACOBIAN = 0.05

#: Limits out of the way; the largest that the controller takes.
_FREE = {"max_joint_velocity_rad_s": 3.14, "max_joint_acceleration_rad_s2": 40.0, "damping": 1e-6}

_PAPER, _CALM, _FIXED, EVERYDAY = "0.19 → 0.5", "0.375 → 0.9", "fixed 0.6", "everyday limits"
GAINS: dict[str, dict[str, Any]] = {
    _PAPER: {
        **_FREE,
        "alpha1": 1.0,
        "alpha2": 0.3,
        "alpha3": 0.45,
        "lambda1": 0.344,
        "lambda2": 0.154,
        "switch_error_m": 0.00688,
        "k1": 1.63,
        "k2": 0.15,
        "k4": 0.2,
        "sigma": 0.82,
    },
    _CALM: {
        **_FREE,
        "alpha1": 1.0,
        "alpha2": 1.0,
        "alpha3": 0.6,
        "lambda1": 0.6375,
        "lambda2": 0.2625,
        "switch_error_m": 0.005,
        "k1": 1.5,
        "k2": 0.1,
        "k4": 0.2,
        "sigma": 0.75,
    },
    _FIXED: {
        **_FREE,
        "alpha1": 1.0,
        "alpha2": 0.7,
        "alpha3": 0.5,
        "lambda1": 0.6,
        "lambda2": 0.0,
        "k1": 1.6,
        "k2": 0.07,
        "k4": 0.15,
        "sigma": 0.75,
    },
    EVERYDAY: {},
}
#: The gains under which the theory's assumptions can hold.
FREE_GAINS = (_PAPER, _CALM, _FIXED)

SILENT, NOISY, ORACLE = "no noise", "1 mm noise", "no noise, true Jacobian"
#: Not the robot that there is; to tell the drives' part in what is left.
IDEAL = "no noise, ideal drives"

_PERIOD_S = 0.008


def law_of(gains: str) -> FtsmLaw:
    """The control law with a set of gains."""
    law = build_law(default_values(law="ftsm", **GAINS[gains]))
    assert isinstance(law, FtsmLaw)
    return law


# ---- what is run ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Plan:
    """Starts to be run with the same gains under the same conditions.

    Parameters
    ----------
    gains, world : str
        Set of gains, and what the conditions are called.
    method : str
        Estimator.
    conditions : Conditions
        The conditions.
    cases : sequence of Case
        Starts and goals.
    """

    gains: str
    world: str
    method: str
    conditions: Conditions
    cases: Sequence[Case]

    def trials(self) -> list[Trial]:
        """What to run, a trial a case."""
        return [
            Trial(
                case,
                self.method,
                "ftsm",
                controller_values=GAINS[self.gains],
                conditions=self.conditions,
                duration_s=DURATION_S,
                stop_after_s=1.0,
                record=True,
            )
            for case in self.cases
        ]


def plans(cases: Sequence[Case], noisy: Conditions) -> list[Plan]:
    """Every start with every gains; noise and oracle on a part of them, for the time it takes."""
    silent = Conditions(rendered=False, position_noise_m=0.0)
    ideal = replace(silent, dead_time_s=0.0, lag_s=0.0, acceleration_limit_rad_s2=1e4)
    half = cases[: max(1, len(cases) // 2)]
    found = []
    for number, gains in enumerate(FREE_GAINS):
        found.append(Plan(gains, SILENT, "rbf", silent, cases))
        found.append(Plan(gains, NOISY, "rbf", noisy, half))
        third = cases[number :: len(FREE_GAINS)]
        if third:
            found.append(Plan(gains, ORACLE, "oracle", silent, third))
            found.append(Plan(gains, IDEAL, "rbf", ideal, third))
    found.append(Plan(EVERYDAY, SILENT, "rbf", silent, half))
    return found


# ---- what came of it ------------------------------------------------------------------------


@dataclass(frozen=True)
class Run:
    """A run beside what was promised for it.

    Parameters
    ----------
    gains, world, case : str
        Set of gains, conditions, and start.
    excluded : str
        Which assumption of the theory did not hold; empty if all did.
    measured_s : dict of str to float
        Settling time by the band's name, s; infinite for never.
    bound_s : float
        Corrected bound to zero error, s.
    band_bound_s, predicted_s : dict of str to float
        Corrected bound, and the theory's own motion, to the same band, s.
    printed_s, printed_sliding_s, sliding_s : float
        By the paper's formula: reaching and sliding, and sliding alone; corrected: sliding alone.
    """

    gains: str
    world: str
    case: str
    excluded: str
    measured_s: dict[str, float]
    bound_s: float
    band_bound_s: dict[str, float]
    predicted_s: dict[str, float]
    printed_s: float
    printed_sliding_s: float
    sliding_s: float


def judged(plan: Plan, outcomes: Sequence[Outcome]) -> list[Run]:
    """Put each run of a plan beside what was promised."""
    law = law_of(plan.gains)
    errors = np.array([one.series["ball_m"][0] - np.array(one.target_m) for one in outcomes])
    predicted = predicted_times_s(errors, law.surface, law.reaching)
    acceleration = plan.conditions.acceleration_limit_rad_s2
    found = []
    for number, (case, outcome) in enumerate(zip(plan.cases, outcomes, strict=True)):
        error = errors[number]
        bound = law.settling_bound_s(error)
        assert bound is not None
        reaching = [reaching_time_s(law.surface.value(y, 0.0), law.reaching) for y in error]
        printed = [printed_sliding_time_s(y, law.surface) for y in error.tolist()]
        found.append(
            Run(
                gains=plan.gains,
                world=plan.world,
                case=case.name,
                excluded=exclusion(outcome, error, acceleration),
                measured_s={band: seconds(outcome.settling_s[band]) for band in BANDS},
                bound_s=bound,
                band_bound_s={
                    band: bound_to_band_s(error, BOUNDS_M[band], law.surface, law.reaching)
                    for band in BANDS
                },
                predicted_s={band: predicted[band][number] for band in BANDS},
                printed_s=max(a + b for a, b in zip(reaching, printed, strict=True)),
                printed_sliding_s=max(printed),
                sliding_s=bound - max(reaching),
            )
        )
    return found


def exclusion(outcome: Outcome, error_m: np.ndarray, acceleration_limit_rad_s2: float) -> str:
    """Which assumption of the theory a run breaks; empty if none.

    Parameters
    ----------
    outcome : Outcome
        A recorded run.
    error_m : ndarray, shape (3,)
        Its error at the beginning, m.
    acceleration_limit_rad_s2 : float
        Of the drives, which follow no faster command, rad/s^2.
    """
    if outcome.limited_share > 0.0:
        return "a limit of the controller shaped the command"
    steps = np.diff(outcome.series["command_rad_s"], axis=0, prepend=np.zeros((1, 6)))
    if float(np.abs(steps).max()) > acceleration_limit_rad_s2 * _PERIOD_S:
        return f"the drives' own ramp of {acceleration_limit_rad_s2:g} rad/s² was exceeded"
    if outcome.jacobian_error > GOOD_JACOBIAN:
        return f"the Jacobian was more than {100 * GOOD_JACOBIAN:.0f} % wrong"
    if float(np.abs(error_m).max()) >= 1.0:
        return "the error was above 1 m"
    return ""


def groups(runs: Sequence[Run]) -> dict[tuple[str, str], list[Run]]:
    """Sort runs by gains and world."""
    found: dict[tuple[str, str], list[Run]] = {}
    for one in runs:
        found.setdefault((one.gains, one.world), []).append(one)
    return found
