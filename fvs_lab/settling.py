"""Measured settling times against the bounds (36)-(39) of the paper."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from math import log, log1p
from typing import Any

import numpy as np
from scipy.integrate import quad

from fvs_controller_node.config import default_values, make_law
from fvs_controller_node.ftsm import FtsmLaw
from fvs_controller_node.surface import ReachingLaw, SlidingSurface
from fvs_lab import experiment as lab
from fvs_lab.contestants import FREE
from fvs_lab.results import Results
from fvs_lab.trials import Case, Trial, crossed, make_cases
from fvs_sim_node.simulation import SimConfig

#: Sets of gains by their exponents, low enough not to reach the limits.
GAINS: dict[str, dict[str, Any]] = {
    "0.19 → 0.5": {
        "alpha2": 0.3, "alpha3": 0.45, "lambda1": 0.344, "lambda2": 0.154,
        "switch_error_m": 0.00688, "k1": 1.63, "k2": 0.15, "k4": 0.2, "sigma": 0.82,
    },
    "0.375 → 0.9": {
        "alpha2": 1.0, "alpha3": 0.6, "lambda1": 0.6375, "lambda2": 0.2625,
        "switch_error_m": 0.005, "k1": 1.5, "k2": 0.1, "k4": 0.2, "sigma": 0.75,
    },
    "fixed 0.6": {
        "alpha2": 0.7, "alpha3": 0.5, "lambda1": 0.6, "lambda2": 0.0,
        "k1": 1.6, "k2": 0.07, "k4": 0.15, "sigma": 0.75,
    },
}  # fmt: skip
#: The drives' own ramp.
RAMP_RAD_S2 = SimConfig.acceleration_limit_rad_s2


def planned(cases: Sequence[Case]) -> Iterator[Trial]:
    """All gains on all starts without noise, and on a part of them in the other worlds."""
    half, silent = max(1, len(cases) // 2), {"rendered": False, "position_noise_m": 0.0}
    for number, (name, gains) in enumerate(GAINS.items()):
        trial = Trial(duration_s=6.0, stop_after_s=1.0, record=True).changed(
            {"gains": name}, controller={**FREE, "damping": 1e-6, "alpha1": 1.0, **gains}
        )
        exact = trial.changed({"world": "no noise"}, conditions=silent)
        oracle = exact.changed({"world": "no noise, true Jacobian"}, method="oracle")
        yield from crossed([exact], cases)
        yield from crossed([trial.changed({"world": "1 mm noise"})], cases[:half])
        yield from crossed([oracle], cases[number :: len(GAINS)])


def reaching_time_s(s0: float, law: ReachingLaw) -> float:
    """Time in which k4 s' = -k1 s - k2 |s|^(2 sigma - 1) sgn s brings s0 to zero, s."""
    p = 2.0 - 2.0 * law.sigma
    return law.k4 / (law.k1 * p) * log1p(law.k1 * abs(s0) ** p / law.k2)


def sliding_time_s(y0: float, surface: SlidingSurface) -> float:
    """Time to slide from an error, m, to zero without speed limits, s: (36)-(39) as corrected.

    The integral of dt = a1 dy / (a2 y + a3 y^g(y)) over z = y^(1 - g(0)), which is regular at 0.
    """
    near = surface.exponent(0.0)
    p = 1.0 - near

    def pace(z: float) -> float:
        y = z ** (1.0 / p)
        attractor = surface.alpha3 * y ** (surface.exponent(y) - near)
        return surface.alpha1 / (p * (surface.alpha2 * z + attractor))

    ends = [0.0, min(surface.switch_error_m, abs(y0)) ** p, abs(y0) ** p]
    return float(sum(quad(pace, *pair)[0] for pair in pairwise(ends)))


def printed_time_s(y: float, gamma: float, surface: SlidingSurface) -> float:
    """The right side of (36), (37) and (39) as printed, s; negative where alpha2 < alpha3."""
    a2, a3 = surface.alpha2, surface.alpha3
    power = abs(y) ** (gamma - 1.0)
    return surface.alpha1 * log(power / (power + a2 / a3)) / ((gamma - 1.0) * (a2 - a3))


def printed_sliding_time_s(y0: float, surface: SlidingSurface) -> float:
    """Sliding time of an axis as printed, s: the sum over the exponent's two values."""
    near = surface.exponent(0.0)
    if abs(y0) <= surface.switch_error_m:
        return printed_time_s(y0, near, surface)
    far = surface.lambda1 - surface.lambda2
    return printed_time_s(y0, far, surface) + printed_time_s(surface.switch_error_m, near, surface)


def promised(row: Mapping[str, Any]) -> dict[str, Any]:
    """What was promised for a run, as further columns.

    ``excluded``: whether the drives did not follow. Bounds ``bound_s`` (corrected) and
    ``printed_s``, and whether they were kept: ``within``, ``printed_kept``.
    """
    law = make_law(default_values(law="ftsm", alpha1=1.0, **GAINS[row["gains"]]))
    assert isinstance(law, FtsmLaw)
    surface, reaching_law = law.gains.surface, law.gains.reaching
    commands = row["series"]["command_rad_s"]
    steps = np.diff(commands, axis=0, prepend=np.zeros((1, commands.shape[1])))
    error_m = row["series"]["feature_m"][0] - np.array(row["target_m"])
    reaching = [reaching_time_s(surface.value(y, 0.0), reaching_law) for y in error_m]
    sliding, printed = (
        [time_s(y, surface) for y in error_m.tolist()]
        for time_s in (sliding_time_s, printed_sliding_time_s)
    )
    # Until the surface is reached the error does not grow.
    bound_s, printed_s = (float(np.add(reaching, times).max()) for times in (sliding, printed))
    return {
        "excluded": bool(np.abs(steps).max() > RAMP_RAD_S2 / SimConfig.joint_state_rate_hz),
        "bound_s": bound_s,
        "printed_s": printed_s,
        "within": max(row["to_5mm_s"], row["to_2mm_s"]) <= bound_s,
        "printed_kept": max(printed) > 0.0 and row["to_5mm_s"] <= printed_s,
    }


def measure(context: lab.Context) -> Results:
    """Run all gains in all worlds, and compute what was promised."""
    cases = make_cases("s", context.count(60), 302)
    return context.run(planned(cases), "settling").adding(promised)


def claims(runs: Results) -> Iterator[lab.Claim]:
    """The bounds, corrected and as printed."""
    counted = runs.where(excluded=False)
    yield lab.ours("bound", lab.kept("runs within it", counted.values("within"), 0.95))
    positive = "runs with a positive one that was kept"
    yield lab.papers("printed", lab.kept(positive, counted.values("printed_kept"), 0.95))


TABLES = (
    lab.Table(
        "promises",
        ("gains", "world"),
        ("to_5mm_s:half", "bound_s:half", "printed_s:half", "within:of", "printed_kept:of"),
        where={"excluded": False},
    ),
)
EXPERIMENT = lab.Experiment("settling", measure, claims, TABLES, globals())
