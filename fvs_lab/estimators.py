"""Which estimator knows the Jacobian best along a smooth motion: section 4.1 of the paper."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np

from fvs_estimator_node.rbf import RbfConfig
from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab.results import Results, label_of
from fvs_lab.smooth_motion import PRELUDE_S, SPEED_RAD_S, judge, record
from fvs_lab.trials import Conditions, along, simulation_of
from fvs_tools.closed_loop import make_estimator

#: Length of one point of a curve against time, s.
_BIN_S = 0.5
#: Standard deviation of an entry of a Jacobian that begins at zero, m/rad.
IGNORANCE_M_RAD = 0.5

# ---- contestants ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Contestant:
    """An estimator with a start."""

    #: For readers.
    name: str
    #: By the estimators' registry's name, and parameters of the node.
    method: str
    values: Mapping[str, Any] = field(default_factory=dict)
    #: Whether it learns before the scored motion, too.
    hears_prelude: bool = True


_EXPLORED, _MODEL = ", explored", ", networks' start"


def _started(name: str, method: str, start: str, parameter: str, tuned: float) -> Contestant:
    """A method with its start; its parameter is the best of eight values.

    That is the value of least median T1 on three other paths, with 1 mm of noise and an exact
    camera.
    """
    values: dict[str, Any] = {parameter: tuned}
    if start == _EXPLORED:
        values["online.initial"] = "zero"
        values["online.initial_deviation_m_rad"] = IGNORANCE_M_RAD
    return Contestant(name + start, method, values, start == _EXPLORED)


#: Those that the paper compares the proposed one with.
_FILTERS = [
    _started(method.upper(), method, start, "online.process_noise", 0.01)
    for method in ("lkf", "ukf")
    for start in (_EXPLORED, _MODEL)
]
_RLS = [
    _started("RLS", "rls", start, "online.forgetting", tuned)
    for start, tuned in ((_EXPLORED, 0.85), (_MODEL, 0.7))
]
PROPOSED = Contestant(f"proposed, n1 = {RbfConfig.n1:g}", "rbf")
FROZEN = Contestant("networks, frozen", "frozen")
ESTIMATORS = (
    PROPOSED,
    FROZEN,
    *_FILTERS,
    *_RLS,
    Contestant("true Jacobian (oracle)", "oracle"),
)

# ---- worlds and runs ------------------------------------------------------------------------

CLEAN, NOISE = "no noise", "1 mm noise"
#: Angle by which the camera was carried round the scene, degrees, by the world's name.
TURNED = {f"rotated by {one}°": one for one in (20, 30)}
WORLDS = {CLEAN: 0, NOISE: 0, **TURNED}
#: Worlds that are drawn against time, which are also those of a quick run.
DRAWN = [*WORLDS][:3]


def judge_all(job: tuple[str, Conditions, int, float]) -> list[dict[str, Any]]:
    """Make a recording (world, conditions, seed, length in s), and judge all on it."""
    world, conditions, seed, duration_s = job
    axis = np.random.default_rng([seed, 2]).normal(size=3)
    conditions = replace(conditions, camera_turn_deg=along(axis, WORLDS[world]))
    if world == CLEAN:
        conditions = replace(conditions, position_noise_m=0.0, depth_noise=0.0)
    recording = record(seed, conditions, duration_s)
    rows, tracks = [], {}
    for one in ESTIMATORS:
        estimator = make_estimator(one.method, simulation_of(conditions), one.values)
        track = tracks[one.name] = judge(estimator, recording, one.hears_prelude)
        row = {
            "world": world,
            "estimator": one.name,
            "method": one.method,
            "case": seed,
            **track.summary(),
            "median_step_m": float(np.median(track.motion_m)),
            "visible_share": recording.visible_share,
            "position_error_rms_m": recording.position_error_m,
            "series": track.means(duration_s, _BIN_S),
        }
        if one.method == "ukf":
            twin = tracks[one.name.replace("UKF", "LKF")]
            row["lkf_difference_m_rad"] = float(np.abs(track.jacobian - twin.jacobian).max())
        rows.append(row)
    return rows


def measure(context: lab.Context) -> lab.Found:
    """Record and judge."""
    duration_s = 3.0 if context.quick else 20.0
    seeds = range(1, context.count(6) + 1)
    jobs = [
        (world, context.conditions(), seed, duration_s)
        for world in (DRAWN if context.quick else WORLDS)
        for seed in seeds
    ]
    judged = context.map(judge_all, jobs, "estimators: recordings")
    runs = Results(row for rows in judged for row in rows)
    facts = {
        "duration_s": duration_s,
        "speed_rad_s": SPEED_RAD_S,
        "prelude_s": PRELUDE_S,
        "paths": len(seeds),
        "errors_mm": [
            1e3 * float(np.median(runs.where(world=name).values("position_error_rms_m")))
            for name in (NOISE, CLEAN)
        ],
        "step_mm": 1e3 * float(np.median(runs.where(world=NOISE).values("median_step_m"))),
        "visible_percent": 100 * min(runs.values("visible_share")),
    }
    return lab.Found(runs, facts, {"contestants": ESTIMATORS, "worlds": WORLDS})


# ---- claims ---------------------------------------------------------------------------------

#: Runs by world and estimator.
Groups = Mapping[tuple[str, str], Results]


def _best(runs: Groups, world: str, criterion: str, ones: Sequence[Contestant]) -> Contestant:
    """The estimator with the least median."""

    def rounded(one: Contestant) -> float:  # those that are equal but for rounding stay in order
        return float(f"{runs[world, one.name].median(criterion).value:.9g}")

    return min(ones, key=rounded)


def _below(
    runs: Groups, world: str, one: Contestant, other: Contestant, criterion: str
) -> lab.Part:
    """Whether an estimator's median is below that of another."""
    label = f"{label_of(criterion).partition(',')[0]} of {one.name} over {other.name}, {world}"
    ratio = runs[world, one.name].over(runs[world, other.name], criterion)
    return lab.below(label, ratio, 1.0)


def claims(found: lab.Found) -> Iterator[lab.Claim]:
    """The paper's claims on the estimators."""
    runs = found.runs.groups("world", "estimator")
    turned = [world for world in TURNED if (world, PROPOSED.name) in runs]

    def against_best(world: str, criterion: str) -> lab.Part:
        best = _best(runs, world, criterion, (*_FILTERS, *_RLS))
        return _below(runs, world, PROPOSED, best, criterion)

    yield lab.papers("unmoved", *(against_best(NOISE, one) for one in ("t1_m", "t2_max_m")))
    for criterion, title in (("t1_m", "T1"), ("t2_max_m", "the largest T2")):
        parts = [against_best(world, criterion) for world in turned]
        yield lab.papers("rotated", *parts, criterion=title)
    parts = []
    for world in (NOISE, *turned):
        rls, other = (_best(runs, world, "t1_m", ones) for ones in (_RLS, _FILTERS))
        others = (other, PROPOSED)
        worst = max(others, key=lambda one: runs[world, one.name].median("t1_m").value)
        parts.append(_below(runs, world, worst, rls, "t1_m"))
    yield lab.papers("rls", *parts)
    difference = max(found.runs.values("lkf_difference_m_rad"))
    label = "largest difference of any entry of their Jacobians"
    text = f"{difference:.1g} m/rad, asked: above rounding, 1e-9"
    yield lab.papers("ukf", lab.Part(label, text, None if difference > 1e-9 else False))
    other = _best(runs, CLEAN, "t1_late_m", (*_FILTERS, *_RLS))
    yield lab.papers("bound", _below(runs, CLEAN, other, FROZEN, "t1_late_m"))
    parts = [
        _below(runs, world, PROPOSED, FROZEN, criterion)
        for world in turned
        for criterion in ("t1_m", "jacobian_error")
    ]
    yield lab.papers("update", *parts)
    yield lab.ours("cost", _below(runs, NOISE, PROPOSED, FROZEN, "t1_m"))
    yield lab.papers("proof", _proof_part(runs, (NOISE, *turned)))


def _proof_part(runs: Groups, worlds: Sequence[str]) -> lab.Part:
    """Pairs that T1 ranks wrongly, without the oracle and one of two identical filters."""
    ranked = [one.name for one in ESTIMATORS if one.method not in ("ukf", "oracle")]
    count = wrong = 0
    for world in worlds:
        medians = [
            [runs[world, name].median(column).value for column in ("t1_m", "jacobian_error")]
            for name in ranked
        ]
        for one, other in combinations(medians, 2):
            count += 1
            wrong += (one[0] - other[0]) * (one[1] - other[1]) < 0.0
    label = "pairs of estimators of which the one with the smaller T1 has the worse Jacobian"
    return lab.Part(label, f"{wrong} of {count}, asked: none", wrong == 0)


# ---- tables and figures ---------------------------------------------------------------------

TABLES = (
    lab.TableOf(
        "criteria",
        ("estimator",),
        ("t1_m:half", "t2_max_m:half", "jacobian_error:half"),
        across="world",
    ),
)

_SIGNALS: dict[str, draw.Signal] = {
    "t1": ("T1, mm", lambda row: 1e3 * row["series"]["t1_m"]),
    "t2": ("T2, mm", lambda row: 1e3 * row["series"]["t2_m"]),
}


def figures(found: lab.Found) -> Iterator[lab.Drawn]:
    """Figures 6 and 7 of the paper."""
    looks = {
        one.name: {
            "color": draw.COLOURS[one.method],
            "linestyle": "--" if one.name.endswith(_MODEL) else "-",
            # The UKF broad and pale, behind the LKF's.
            **({"linewidth": 6.0, "alpha": 0.45} if one.method == "ukf" else {}),
        }
        for one in ESTIMATORS
        if one.method != "oracle"
    }
    for name, signal in _SIGNALS.items():
        figure, (axes,) = draw.grid(1, len(DRAWN), (12.5, 5.6), sharey=True)
        for axis, world in zip(axes, DRAWN, strict=True):
            draw.over_time(axis, found.runs.where(world=world), signal, "estimator", looks)
            axis.set(title=world, xlabel="time, s", yscale="log")
        axes[0].set_ylabel(signal[0])
        draw.legend(figure)
        yield name, figure, {}


EXPERIMENT = lab.Experiment("estimators", measure, claims, TABLES, figures, globals())
