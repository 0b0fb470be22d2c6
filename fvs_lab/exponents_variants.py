"""What is run to compare exponents, and what is kept of each run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fvs_lab.trials import BOUNDS_M, Outcome, seconds

EXPONENTS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.9)

#: Limits out of the way; the largest that the controller takes.
FREE = {"max_joint_velocity_rad_s": 3.14, "max_joint_acceleration_rad_s2": 40.0, "damping": 1e-6}
SURFACE = {"alpha1": 1.0, "alpha2": 0.3, "alpha3": 0.45}
REACHING = {"k1": 1.63, "k2": 0.067, "k4": 0.125, "sigma": 0.82}
#: Reaching gains with which the law as printed runs at 125 Hz with the surface above.
LITERAL_REACHING = {"k1": 0.1, "k2": 0.01, "k4": 0.001, "sigma": 0.82}
#: The paper's adaptive exponent, and the same idea away from the noise.
SMALL_TO_HALF = {"lambda1": 0.3, "lambda2": 0.2, "switch_error_m": 0.00688}
LARGE = {"lambda1": 0.6375, "lambda2": 0.2625, "switch_error_m": 0.005}
#: Factor on alpha2 and alpha3 that gives the larger exponents about the same top speed.
SCALE = 1.6

SILENT, NOISY = "no noise", "1 mm noise"
IMPLICIT, LITERAL = "implicit", "as printed"
ADAPTIVE, ADAPTIVE_LARGE = "0.1 → 0.5", "0.375 → 0.9"
ADAPTIVE_SCALED = f"0.375 → 0.9, faster (α2, α3 × {SCALE:g})"
#: The law as printed with the reaching gains of the implicit form.
UNSTABLE = "0.5, reaching gains of the implicit form"

_PERIOD_S = 0.008


@dataclass(frozen=True)
class Variant:
    """A form of the law with an exponent.

    Parameters
    ----------
    form : str
        ``as printed`` or ``implicit``.
    exponent : str
        Its exponent or exponents, as the tables call it.
    values : mapping
        The controller's parameters.
    """

    form: str
    exponent: str
    values: Mapping[str, Any]


def variants_of(world: str) -> list[Variant]:
    """List what is run in a world; with noise fewer as printed, for the time it takes."""
    implicit = {**FREE, **SURFACE, **REACHING}
    literal = {**FREE, **SURFACE, **LITERAL_REACHING, "discretisation": "literal"}
    faster = {name: SCALE * SURFACE[name] for name in ("alpha2", "alpha3")}
    found = []
    for form, values in ((LITERAL, literal), (IMPLICIT, implicit)):
        found += [
            Variant(form, f"{one:g}", {**values, **_fixed(one)})
            for one in exponents_of(world, form)
        ]
        found.append(Variant(form, ADAPTIVE, {**values, **SMALL_TO_HALF}))
    found.append(Variant(IMPLICIT, ADAPTIVE_LARGE, {**implicit, **LARGE}))
    found.append(Variant(IMPLICIT, ADAPTIVE_SCALED, {**implicit, **LARGE, **faster}))
    if world == SILENT:
        unstable = {**implicit, **_fixed(0.5), "discretisation": "literal"}
        found.append(Variant(LITERAL, UNSTABLE, unstable))
    return found


def _fixed(exponent: float) -> dict[str, Any]:
    return {"lambda1": exponent, "lambda2": 0.0}


def exponents_of(world: str, form: str) -> tuple[float, ...]:
    """The fixed exponents that a form is run with in a world."""
    return EXPONENTS[::2] if (world, form) == (NOISY, LITERAL) else EXPONENTS


def literal_limits() -> tuple[float, float]:
    """Largest k4 and k1 with which the law as printed is stable far from the goal.

    ``k4 < 2 a2 dt / (2 a1 + a2 dt)`` and ``k1 < 2 a2 / (a1 + a2 dt / 2)``, with the surface above
    and the time dt from command to command.
    """
    a1, a2 = SURFACE["alpha1"], SURFACE["alpha2"]
    return (
        2.0 * a2 * _PERIOD_S / (2.0 * a1 + a2 * _PERIOD_S),
        2.0 * a2 / (a1 + 0.5 * a2 * _PERIOD_S),
    )


#: World, form and exponent.
Key = tuple[str, str, str]


@dataclass(frozen=True)
class Results:
    """The runs of one variant in one world, a number a case.

    Parameters
    ----------
    settling_s : mapping of str to sequence of float
        Settling times by the bound's name, s; infinite for never.
    jitter_rad_s, final_rms_m, peak_rad_s, limited_share : sequence of float
        As in :class:`~fvs_lab.trials.Outcome`.
    pace : sequence of float
        Settling time to 5 mm over the time that the way takes at the run's own top joint speed.
    path_ratio : sequence of float
        Length of the ball's path to 5 mm over the straight line.
    """

    settling_s: Mapping[str, Sequence[float]]
    jitter_rad_s: Sequence[float]
    final_rms_m: Sequence[float]
    peak_rad_s: Sequence[float]
    limited_share: Sequence[float]
    pace: Sequence[float]
    path_ratio: Sequence[float]


def results_of(outcomes: Sequence[Outcome]) -> Results:
    """What is kept of a variant's outcomes."""
    return Results(
        settling_s={name: [seconds(one.settling_s[name]) for one in outcomes] for name in BOUNDS_M},
        jitter_rad_s=[one.jitter_rad_s for one in outcomes],
        final_rms_m=[one.final_rms_m for one in outcomes],
        peak_rad_s=[one.peak_joint_speed_rad_s for one in outcomes],
        limited_share=[one.limited_share for one in outcomes],
        pace=[_pace(one) for one in outcomes],
        path_ratio=[one.path_ratio for one in outcomes],
    )


def _pace(outcome: Outcome) -> float:
    """Settling time over the longest joint travel at the top joint speed of the run."""
    if not np.isfinite(outcome.settled_s):
        return float("inf")
    moving = outcome.series["time_s"] <= outcome.settled_s
    speeds = np.abs(outcome.series["command_rad_s"][moving])
    travel_rad = float(speeds.sum(axis=0).max()) * _PERIOD_S
    return outcome.settled_s * float(speeds.max()) / travel_rad
