"""Does the settling time keep its promise? Measured against the bounds (36)-(39) of the paper."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from fvs_controller_node.config import build_law, default_values
from fvs_controller_node.ftsm import FtsmLaw
from fvs_controller_node.settling import reaching_time_s
from fvs_lab.context import Context
from fvs_lab.experiment import OURS, PAPER, Claim, Experiment, Found, Named, Part
from fvs_lab.figures import keys, panels
from fvs_lab.outcome import BOUNDS_M
from fvs_lab.results import METRICS, Cell, Metric, Results, table
from fvs_lab.settling_bounds import (
    DURATION_S,
    bound_to_band_s,
    predicted_times_s,
    printed_sliding_time_s,
)
from fvs_lab.trials import Case, Variant, make_cases

SEED = 302
#: A worse Jacobian does not count as good (relative Frobenius error).
GOOD_JACOBIAN = 0.05
#: What the bounds leave out and the arm has: a tick until the first command leaves, the drives'
#: dead time and their lag, s.
ALLOWANCE_S = 0.008 + 0.008 + 0.012
#: Share of the runs that must keep a promise.
ENOUGH = 0.95
_PERIOD_S = 0.008

#: Limits out of the way; the largest that the controller takes.
_FREE = {"max_joint_velocity_rad_s": 3.14, "max_joint_acceleration_rad_s2": 40.0, "damping": 1e-6}
EVERYDAY = "everyday limits"
#: Sets of gains by their exponents; in the last the limits break the theory's assumptions.
GAINS: dict[str, dict[str, Any]] = {
    "0.19 → 0.5": {
        **_FREE, "alpha1": 1.0, "alpha2": 0.3, "alpha3": 0.45, "lambda1": 0.344, "lambda2": 0.154,
        "switch_error_m": 0.00688, "k1": 1.63, "k2": 0.15, "k4": 0.2, "sigma": 0.82,
    },
    "0.375 → 0.9": {
        **_FREE, "alpha1": 1.0, "alpha2": 1.0, "alpha3": 0.6, "lambda1": 0.6375, "lambda2": 0.2625,
        "switch_error_m": 0.005, "k1": 1.5, "k2": 0.1, "k4": 0.2, "sigma": 0.75,
    },
    "fixed 0.6": {
        **_FREE, "alpha1": 1.0, "alpha2": 0.7, "alpha3": 0.5, "lambda1": 0.6,
        "lambda2": 0.0, "k1": 1.6, "k2": 0.07, "k4": 0.15, "sigma": 0.75,
    },
    EVERYDAY: {},
}  # fmt: skip
_COLOURS = dict(zip(GAINS, ("#0072B2", "#D55E00", "#009E73"), strict=False))

SILENT, NOISY, ORACLE = "no noise", "1 mm noise", "no noise, true Jacobian"
#: Not the real robot; it tells the drives' part in what is left.
IDEAL = "no noise, ideal drives"
_SILENT = {"rendered": False, "position_noise_m": 0.0}
_IDEAL = {**_SILENT, "dead_time_s": 0.0, "lag_s": 0.0, "acceleration_limit_rad_s2": 1e3}
WORLDS: dict[str, dict[str, Any]] = {
    SILENT: _SILENT,
    NOISY: {"position_noise_m": 0.001},
    ORACLE: _SILENT,
    IDEAL: _IDEAL,
}
_MARKS = dict(zip(WORLDS, "ox^+", strict=True))

_SHOWN = METRICS | {
    "bound_s": Metric("bound to 0, s"),
    "band_5mm_s": Metric("bound to 5 mm, s"),
    "predicted_5mm_s": Metric("theory's motion to 5 mm, s"),
    "printed_sliding_s": Metric("as printed, s"),
    "sliding_s": Metric("corrected, s"),
}


def law_of(gains: str) -> FtsmLaw:
    """The control law with a set of gains."""
    law = build_law(default_values(law="ftsm", **GAINS[gains]))
    assert isinstance(law, FtsmLaw)
    return law


def pairs(cases: list[Case]) -> list[tuple[Variant, Case]]:
    """All gains on all starts without noise, and on a part of them in the other worlds."""
    half = cases[: max(1, len(cases) // 2)]
    parts = []
    for number, gains in enumerate(_COLOURS):
        third = cases[number :: len(_COLOURS)]
        parts += [(gains, SILENT, cases), (gains, NOISY, half)]
        parts += [(gains, ORACLE, third), (gains, IDEAL, third)]
    parts.append((EVERYDAY, SILENT, half))
    return [
        (
            Variant(
                {"gains": gains, "world": world},
                "oracle" if world == ORACLE else "rbf",
                controller_values=GAINS[gains],
                conditions=WORLDS[world],
            ),
            case,
        )
        for gains, world, some in parts
        for case in some
    ]


def judged(runs: Results, gains: str, acceleration_limit_rad_s2: float) -> Iterator[dict[str, Any]]:
    """The rows of runs with the same gains, each beside what was promised for it.

    Further columns: ``excluded``, the broken assumption; corrected bounds ``bound_s`` (to zero),
    ``band_5mm_s``, ``band_2mm_s`` and ``sliding_s``; the theory's own motion ``predicted_5mm_s``,
    ``predicted_2mm_s``; the paper's formula ``printed_s`` and ``printed_sliding_s``.
    """
    law = law_of(gains)
    errors = np.array([row["series"]["ball_m"][0] - np.array(row["target_m"]) for row in runs])
    predicted = predicted_times_s(errors, law.surface, law.reaching)
    for number, (row, error) in enumerate(zip(runs, errors, strict=True)):
        bound = law.settling_bound_s(error)
        assert bound is not None
        reaching = [reaching_time_s(law.surface.value(y, 0.0), law.reaching) for y in error]
        printed = [printed_sliding_time_s(y, law.surface) for y in error.tolist()]
        more = {
            "excluded": exclusion(row, error, acceleration_limit_rad_s2),
            "bound_s": bound,
            "printed_s": max(a + b for a, b in zip(reaching, printed, strict=True)),
            "printed_sliding_s": max(printed),
            "sliding_s": bound - max(reaching),
        }
        for name, times_s in predicted.items():
            band = name.replace(" ", "")
            more[f"predicted_{band}_s"] = times_s[number]
            more[f"band_{band}_s"] = bound_to_band_s(
                error, BOUNDS_M[name], law.surface, law.reaching
            )
        yield {**row, **more}


def exclusion(run: Mapping[str, Any], error_m: np.ndarray, acceleration_limit_rad_s2: float) -> str:
    """Which assumption of the theory a recorded run breaks; empty if none.

    Parameters
    ----------
    run : mapping
        Its row.
    error_m : ndarray, shape (3,)
        Its error at the beginning, m.
    acceleration_limit_rad_s2 : float
        Of the drives, which follow no faster command, rad/s^2.
    """
    if run["limited_share"] > 0.0:
        return "a limit of the controller shaped the command"
    commands = run["series"]["command_rad_s"]
    steps = np.diff(commands, axis=0, prepend=np.zeros((1, commands.shape[1])))
    if float(np.abs(steps).max()) > acceleration_limit_rad_s2 * _PERIOD_S:
        return f"the drives' own ramp of {acceleration_limit_rad_s2:g} rad/s² was exceeded"
    if run["jacobian_error"] > GOOD_JACOBIAN:
        return f"the Jacobian was more than {100 * GOOD_JACOBIAN:.0f} % wrong"
    if float(np.abs(error_m).max()) >= 1.0:
        return "the error was above 1 m"
    return ""


def measure(context: Context) -> Found:
    """Run all gains in all worlds, and compute what was promised."""
    cases = make_cases("s", context.count(60, 4), SEED)
    planned = pairs(cases)
    raw = context.run_pairs(
        planned, "settling", duration_s=DURATION_S, stop_after_s=1.0, record=True
    )
    rows: list[dict[str, Any]] = []
    for (gains, world), ones in raw.groups("gains", "world").items():
        limit = context.conditions(**WORLDS[world]).acceleration_limit_rad_s2
        rows += judged(ones, gains, limit)
    runs = Results(rows)
    free = runs.those(lambda run: run["gains"] != EVERYDAY and run["world"] != IDEAL)
    facts = {
        "starts": len(cases),
        "good_percent": round(100 * GOOD_JACOBIAN),
        "free": len(free),
        "reasons": Counter(filter(None, free.values("excluded"))).most_common(),
        "allowance_ms": 1e3 * ALLOWANCE_S,
    }
    return Found(runs, facts, {"seed": SEED, "gains": GAINS, "cases": cases})


# ---- promises kept --------------------------------------------------------------------------

_Promise = Callable[[Mapping[str, Any]], bool]


def within(run: Mapping[str, Any]) -> bool:
    """Whether 5 mm and 2 mm were reached within the bound to zero."""
    return max(run["to_5mm_s"], run["to_2mm_s"]) <= run["bound_s"]


def within_band(run: Mapping[str, Any], allowance_s: float = 0.0) -> bool:
    """Whether each band was reached within the bound to that band, and an allowance, s."""
    return all(run[f"to_{band}_s"] <= run[f"band_{band}_s"] + allowance_s for band in _BANDS)


_BANDS = ("5mm", "2mm")


def _predicted(run: Mapping[str, Any]) -> bool:
    time_s = run["predicted_5mm_s"]
    return abs(run["to_5mm_s"] - time_s) <= 0.1 * time_s + ALLOWANCE_S


def _printed_kept(run: Mapping[str, Any]) -> bool:
    return run["printed_sliding_s"] > 0.0 and run["to_5mm_s"] <= run["printed_s"]


def _kept(runs: Results, promise: _Promise, label: str) -> Part:
    hits, count = sum(map(promise, runs)), len(runs)
    share = hits / count if count else 0.0
    text = f"{hits} of {count} ({100 * share:.1f} %), asked: {100 * ENOUGH:.0f} %"
    return Part(label, text, share >= ENOUGH if count else None)


def claims(found: Found) -> Iterator[Claim]:
    """The bounds, corrected and as printed."""
    free = found.runs.those(lambda run: run["gains"] != EVERYDAY and not run["excluded"])
    counted = free.those(lambda run: run["world"] != IDEAL)
    yield Claim("bound", OURS, [_kept(counted, within, "runs within it")])
    yield Claim("band", OURS, [_kept(counted, within_band, "runs within it")])
    yield Claim("motion", OURS, [_kept(counted, _predicted, "runs that agree")])
    label = "runs with a positive one that was kept"
    yield Claim("printed", PAPER, [_kept(counted, _printed_kept, label)])
    limited = found.runs.where(gains=EVERYDAY)
    yield Claim("limited", OURS, [_kept(limited, within_band, "runs within it")])


# ---- tables and figure ----------------------------------------------------------------------


def _percent(promise: _Promise) -> Cell:
    return lambda runs: f"{100 * float(np.mean([*map(promise, runs)])):.0f} %" if len(runs) else "-"


def tables(found: Found) -> Iterator[Named]:
    """Measured beside promised, and the formula as printed."""
    chosen = found.runs.those(lambda run: run["gains"] == EVERYDAY or not run["excluded"])
    metrics = ["to_5mm_s", "to_2mm_s", "bound_s", "band_5mm_s", "predicted_5mm_s"]
    cells: dict[str, Cell] = {
        "runs": lambda runs: str(len(runs)),
        "within bound to 0": _percent(within),
        "within bound to 5 and 2 mm": _percent(within_band),
        f"the same + {1e3 * ALLOWANCE_S:.0f} ms": _percent(
            lambda run: within_band(run, ALLOWANCE_S)
        ),
    }
    by = {"gains": "exponents", "world": "conditions"}
    yield "promises", table(chosen, by, metrics, cells, known=_SHOWN)
    silent = found.runs.those(lambda run: run["gains"] != EVERYDAY and run["world"] == SILENT)
    negative: dict[str, Cell] = {"negative": _percent(lambda run: run["printed_sliding_s"] < 0.0)}
    metrics = ["printed_sliding_s", "sliding_s", "to_2mm_s"]
    yield "printed", table(silent, {"gains": "exponents"}, metrics, negative, known=_SHOWN)


def figures(found: Found) -> Iterator[Named]:
    """Measured against computed times, a panel per computation."""
    counted = found.runs.those(lambda run: run["gains"] != EVERYDAY and not run["excluded"])
    figure, axes = panels(2, 2, (11, 8.4), sharey=True)
    labels = {
        "bound_s": "corrected bound on the time to zero error, s",
        "band_5mm_s": "corrected bound on the time to 5 mm, s",
        "predicted_5mm_s": "the theory's own motion to 5 mm (no bound), s",
        "printed_s": "the paper's formula as printed, s",
    }
    times = [time for time in counted.values("to_5mm_s") if np.isfinite(time)]
    top = 1.15 * max(times, default=1.0)
    for axis, (column, label) in zip(axes.flat, labels.items(), strict=True):
        for (gains, world), runs in counted.groups("gains", "world").items():
            look = {"marker": _MARKS[world], "color": _COLOURS[gains], "alpha": 0.6, "s": 22}
            axis.scatter(runs.values(column), np.minimum(runs.values("to_5mm_s"), top), **look)
        low, high = min(axis.get_xlim()[0], 0.0), max(axis.get_xlim()[1], top)
        axis.fill_between([0.0, high], [0.0, high], color="#1f8a4c", alpha=0.08, linewidth=0.0)
        axis.axvspan(low, 0.0, color="#c0392b", alpha=0.08, linewidth=0.0)
        axis.set(xlim=(low, high), ylim=(0.0, top), xlabel=label)
    for axis in axes[:, 0]:
        axis.set_ylabel("measured settling time to 5 mm, s")
    looks = {
        **{f"exponent {name}": {"color": colour} for name, colour in _COLOURS.items()},
        **{
            world: {"color": "black", "marker": mark, "linestyle": ""}
            for world, mark in _MARKS.items()
        },
    }
    keys(figure, looks)
    yield "settling", figure


EXPERIMENT = Experiment("settling", measure, claims, tables, figures)
