"""Which estimator knows the Jacobian best along a smooth motion: section 4.1 of the paper."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from fvs_lab.estimators_recordings import FIRST_S
from fvs_lab.estimators_study import CLEAN, CONTESTANTS, DRAWN, NOISE, World, measure
from fvs_lab.experiment import OURS, PAPER, Claim, Experiment, Found, Named, Part, below
from fvs_lab.figures import legend, medians, panels
from fvs_lab.results import Metric, Results, table
from fvs_lab.statistics import Interval
from fvs_lab.style import COLOURS

#: Two filters that differ by less than this are one, m/rad.
_SAME_M_RAD = 1e-9

#: What is shown of a run.
SHOWN = {
    "t1_m": Metric("T1, mm", 1e3, 3),
    "t1_share": Metric("T1, % of motion", 1e2, 1),
    "t1_first_m": Metric(f"T1 in the first {FIRST_S:g} s, mm", 1e3),
    "t2_final_m": Metric("T2 at the end, mm", 1e3, 1),
    "t2_max_m": Metric("T2 at most, mm", 1e3, 1),
    "jacobian_error": Metric("Jacobian error, %", 1e2, 1),
}

#: Those that the paper compares the proposed one with, in all their starts.
_FILTERS = ("lkf_explored", "lkf_model", "lkf_zero", "ukf_explored", "ukf_model")
_RLS = ("rls_explored", "rls_model")
_OTHERS = (*_FILTERS, *_RLS)

# ---- claims ---------------------------------------------------------------------------------


class _Judge:
    """Compares contestants in a world by the medians of a criterion."""

    def __init__(self, runs: Results) -> None:
        self._runs = runs.groups("world", "name")

    def middle(self, world: World, name: str, criterion: str) -> float:
        return self._runs[world.name, name].median(criterion).value

    def best(self, world: World, criterion: str, names: Sequence[str]) -> str:
        # Those that are equal except for rounding stay in their order.
        return min(names, key=lambda name: float(f"{self.middle(world, name, criterion):.9g}"))

    def ratio(self, world: World, one: str, other: str, criterion: str) -> Interval:
        return self._runs[world.name, one].over(self._runs[world.name, other], criterion)

    def part(self, world: World, one: str, other: str, criterion: str) -> Part:
        words = {"t2_max_m": "largest T2", "jacobian_error": "Jacobian error"}.get(criterion, "T1")
        label = f"{words} of {CONTESTANTS[one].label} over {CONTESTANTS[other].label}"
        return below(f"{label}, {world.label}", self.ratio(world, one, other, criterion), 1.0)


def claims(found: Found) -> Iterator[Claim]:
    """The paper's claims on the estimators."""
    judge_of, worlds = _Judge(found.runs), found.extra["worlds"]
    turned = [world for world in worlds if world.turn_deg > 0.0]

    def against_best(world: World, criterion: str) -> Part:
        other = judge_of.best(world, criterion, _OTHERS)
        return judge_of.part(world, "rbf", other, criterion)

    yield Claim("unmoved", PAPER, [against_best(NOISE, one) for one in ("t1_m", "t2_max_m")])
    for criterion, title in (("t1_m", "T1"), ("t2_max_m", "the largest T2")):
        parts = [against_best(world, criterion) for world in turned]
        yield Claim("rotated", PAPER, parts, given={"criterion": title})
    parts = []
    for world in (NOISE, *turned):
        rls, other = (judge_of.best(world, "t1_m", names) for names in (_RLS, _FILTERS))
        worst = max((other, "rbf"), key=lambda name: judge_of.middle(world, name, "t1_m"))
        parts.append(judge_of.part(world, worst, rls, "t1_m"))
    yield Claim("rls", PAPER, parts)
    yield Claim("ukf", PAPER, _ukf_parts(found.runs, judge_of))
    other = judge_of.best(CLEAN, "t1_late_m", (*_OTHERS, "lkf_fast"))
    yield Claim("bound", PAPER, [judge_of.part(CLEAN, other, "frozen", "t1_late_m")])
    parts = [
        judge_of.part(world, "rbf", "frozen", criterion)
        for world in turned
        for criterion in ("t1_m", "jacobian_error")
    ]
    yield Claim("update", PAPER, parts)
    yield Claim("cost", OURS, [judge_of.part(NOISE, "rbf", "frozen", "t1_m")])
    yield Claim("proof", PAPER, [_proof_part(found.runs, (NOISE, *turned))])


def _ukf_parts(runs: Results, judge_of: _Judge) -> list[Part]:
    difference = max(runs.those(lambda row: row["method"] == "ukf").values("lkf_difference_m_rad"))
    if difference < _SAME_M_RAD:
        text = f"{difference:.1g} m/rad: they are the same filter"
        return [Part("largest difference of any entry of their Jacobians", text, False)]
    starts = ("explored", "model")
    return [judge_of.part(NOISE, f"ukf_{start}", f"lkf_{start}", "t1_m") for start in starts]


def disagreements(first: Mapping[str, float], second: Mapping[str, float]) -> tuple[int, int]:
    """How often two criteria do not agree which of two contestants is better.

    Parameters
    ----------
    first, second : mapping of str to float
        The criteria, by contestant.

    Returns
    -------
    tuple of int
        Pairs on which they disagree, and all pairs.
    """
    pairs = list(combinations(first, 2))
    wrong = sum((first[a] - first[b]) * (second[a] - second[b]) < 0.0 for a, b in pairs)
    return wrong, len(pairs)


def _proof_part(runs: Results, worlds: Sequence[World]) -> Part:
    """Without one of the two filters that are the same, and without the oracle."""
    counts = []
    for world in worlds:
        chosen = runs.where(world=world.name).those(
            lambda row: row["method"] not in ("ukf", "oracle")
        )
        t1_m, error = (
            {name: ones.median(criterion).value for name, ones in chosen.groups("name").items()}
            for criterion in ("t1_m", "jacobian_error")
        )
        counts.append(disagreements(t1_m, error))
    wrong, total = (sum(count) for count in zip(*counts, strict=True))
    label = "pairs of estimators of which the one with the smaller T1 has the worse Jacobian"
    return Part(label, f"{wrong} of {total}, asked: none", wrong == 0)


# ---- tables and figures ---------------------------------------------------------------------


def tables(found: Found) -> Iterator[Named]:
    """A table per world, best T1 first, and the tuning."""
    for world in found.extra["worlds"]:
        runs = found.runs.where(world=world.name)
        t1_m = {name: ones.median("t1_m").value for name, ones in runs.groups("name").items()}
        ranked = sorted(runs, key=lambda row: float(f"{t1_m[row['name']]:.9g}"))
        rows = table(Results(ranked), {"estimator": "estimator"}, list(SHOWN), known=SHOWN)
        yield "world", rows, {"world": world.label}
    if found.extra["tuning"]:
        yield "tuning", [_tuning_row(*one) for one in found.extra["tuning"].items()]


def _tuning_row(name: str, one: Mapping[str, Any]) -> dict[str, str]:
    tried = zip(one["values"], one["t1_m"], strict=True)
    return {
        "estimator": CONTESTANTS[name].label,
        "parameter": one["parameter"],
        "chosen": f"{one['chosen']:g}",
        "tried: T1, mm": ", ".join(f"{value:g}: {1e3 * t1_m:.3g}" for value, t1_m in tried),
    }


#: Estimators that are drawn, with style and width (points) of the line.
_LINES = {
    "rbf": ("-", 2.6),
    "rbf_fast": ("--", 1.6),
    "frozen": ("-", 2.2),
    "lkf_explored": ("-", 1.6),
    "ukf_explored": ("-", 6.0),
    "lkf_model": ("--", 1.6),
    "lkf_zero": (":", 1.6),
    "rls_explored": ("-", 1.6),
    "broyden_explored": ("-", 1.6),
}


def _look(name: str) -> dict[str, Any]:
    one, (style, width) = CONTESTANTS[name], _LINES[name]
    look = {"linestyle": style, "linewidth": width, "color": COLOURS[one.method]}
    # The UKF broad and pale, behind the LKF's.
    return look | {"label": one.label} | ({"alpha": 0.45} if one.method == "ukf" else {})


def figures(found: Found) -> Iterator[Named]:
    """Figures 6 and 7 of the paper, and T1 and the Jacobian's error against the rotation."""
    for criterion, label in (("t1_m", "T1, mm"), ("t2_m", "T2, mm")):
        figure, (axes,) = panels(1, len(DRAWN), (12.5, 5.6), sharey=True)
        for axis, world in zip(axes, DRAWN, strict=True):
            for name in _LINES:
                runs = found.runs.where(world=world.name, name=name)
                curves = np.array([series[criterion] for series in runs.values("series")])
                middle = np.ma.median(np.ma.masked_invalid(curves), axis=0).filled(np.nan)
                time_s = runs.rows[0]["series"]["time_s"]
                axis.semilogy(time_s, 1e3 * middle, **_look(name))
            axis.set(title=world.label, xlabel="time, s")
        axes[0].set_ylabel(label)
        legend(figure, axes[0])
        yield criterion[:2], figure
    figure, (axes,) = panels(1, 2, (12.5, 5.6))
    noisy = found.runs.those(lambda row: row["world"] != CLEAN.name)
    for axis, metric in zip(axes, ("t1_m", "jacobian_error"), strict=True):
        for name in _LINES:
            medians(axis, noisy.where(name=name), "turn_deg", metric, known=SHOWN, **_look(name))
        axis.set(yscale="log", xlabel="camera rotated since training by, °")
    legend(figure, axes[0])
    yield "rotation", figure


EXPERIMENT = Experiment("estimators", measure, claims, tables, figures)
