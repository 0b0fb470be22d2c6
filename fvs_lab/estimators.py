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
from fvs_lab.results import Results
from fvs_lab.smooth_motion import SPEED_RAD_S, WIGGLE_S, judge, record
from fvs_lab.trials import Conditions, simulation_of
from fvs_tools.closed_loop import make_estimator

#: Length of one point of a curve against time, s.
_BIN_S = 0.5
#: A filter that hardly believes in noise, for comparison.
FAST_PROCESS_NOISE = 10.0
#: Standard deviation of an entry of a Jacobian that begins at zero, m/rad.
IGNORANCE_M_RAD = 0.5

# ---- contestants ----------------------------------------------------------------------------

#: The free parameter of each method by its start: of eight values the one with the least median T1
#: on three other paths, with 1 mm of noise and an exact camera.
TUNED: Mapping[str, tuple[str, Mapping[str, float]]] = {
    "lkf": ("online.process_noise", {"explored": 0.01, "model": 0.01, "zero": 0.01}),
    "ukf": ("online.process_noise", {"explored": 0.01, "model": 0.01}),
    "rls": ("online.forgetting", {"explored": 0.85, "model": 0.7}),
}


@dataclass(frozen=True)
class Contestant:
    """An estimator with a start."""

    #: In the data, and for readers.
    name: str
    label: str
    #: By the estimators' registry's name, and parameters of the node.
    method: str
    values: Mapping[str, Any] = field(default_factory=dict)
    #: Whether it learns from the wiggling before the scored motion.
    hears_prelude: bool = True


_LABELS = {"lkf": "LKF", "ukf": "UKF", "rls": "RLS"}
_STARTS = {"explored": "explored", "model": "networks' start", "zero": "from zero"}


def _started(method: str, start: str) -> Contestant:
    """A method with one of three starts."""
    parameter, tuned = TUNED[method]
    values: dict[str, Any] = {parameter: tuned[start]}
    if start != "model":
        values["online.initial"] = "zero"
        values["online.initial_deviation_m_rad"] = IGNORANCE_M_RAD
    label = f"{_LABELS[method]}, {_STARTS[start]}"
    return Contestant(f"{method}_{start}", label, method, values, start == "explored")


_EXPLORED = _started("lkf", "explored")
#: All of them, by name.
ESTIMATORS = {
    one.name: one
    for one in (
        Contestant("rbf", f"proposed, n1 = {RbfConfig.n1:g}", "rbf"),
        Contestant("frozen", "networks, frozen", "frozen"),
        *(_started(method, start) for method, (_, starts) in TUNED.items() for start in starts),
        replace(
            _EXPLORED,
            name="lkf_fast",
            label=f"LKF, explored, process noise {FAST_PROCESS_NOISE:g}",
            values={**_EXPLORED.values, "online.process_noise": FAST_PROCESS_NOISE},
        ),
        Contestant("oracle", "true Jacobian (oracle)", "oracle"),
    )
}
#: Those that the paper compares the proposed one with, in all their starts.
_FILTERS = ("lkf_explored", "lkf_model", "lkf_zero", "ukf_explored", "ukf_model")
_RLS = ("rls_explored", "rls_model")
_OTHERS = (*_FILTERS, *_RLS)

# ---- worlds and runs ------------------------------------------------------------------------


@dataclass(frozen=True)
class Disturbance:
    """A condition that is compared."""

    #: In the data, and for readers.
    name: str
    label: str
    #: Whether there is 1 mm of noise and the depth camera's own.
    noisy: bool = True
    #: Angle by which the camera was carried round the scene, degrees.
    turn_deg: float = 0.0

    def conditions(self, context: lab.Context, seed: int) -> Conditions:
        """The laboratory's conditions in this world; the axis of the rotation is the seed's."""
        axis = np.random.default_rng([seed, 2]).normal(size=3)
        axis *= self.turn_deg / np.linalg.norm(axis)
        turned = context.conditions(camera_turn_deg=tuple(float(one) for one in axis))
        return turned if self.noisy else replace(turned, position_noise_m=0.0, depth_noise=0.0)


def _turned(turn_deg: float) -> Disturbance:
    label = f"1 mm noise, camera rotated by {turn_deg:g}°"
    return Disturbance(f"turned_{turn_deg:g}", label, turn_deg=turn_deg)


CLEAN, NOISE = Disturbance("clean", "no noise", noisy=False), Disturbance("noise", "1 mm noise")
#: Disturbances that are drawn against time, which are also those of a quick run.
DRAWN = (CLEAN, NOISE, _turned(20.0))
_WORLDS = (CLEAN, NOISE, *map(_turned, (10.0, 20.0, 30.0)))


def judge_all(job: tuple[Disturbance, Conditions, int, float]) -> list[dict[str, Any]]:
    """Make a recording (world, its conditions, seed, length in s), and judge all on it."""
    world, conditions, seed, duration_s = job
    recording = record(seed, conditions, duration_s)
    rows, tracks = [], {}
    for one in ESTIMATORS.values():
        estimator = make_estimator(one.method, simulation_of(conditions), one.values)
        track = tracks[one.name] = judge(estimator, recording, one.hears_prelude)
        row = {
            "world": world.name,
            "name": one.name,
            "estimator": one.label,
            "method": one.method,
            "case": seed,
            **track.summary(),
            "median_step_m": float(np.median(track.motion_m)),
            "visible_share": recording.visible_share,
            "position_error_rms_m": recording.position_error_m,
            "series": track.means(duration_s, _BIN_S),
        }
        if one.method == "ukf":
            twin = tracks[one.name.replace("ukf", "lkf")]
            row["lkf_difference_m_rad"] = float(np.abs(track.jacobian - twin.jacobian).max())
        rows.append(row)
    return rows


def measure(context: lab.Context) -> lab.Found:
    """Record and judge."""
    duration_s = 8.0 if context.quick else 20.0
    seeds = range(1, context.count(default=6, quick=1) + 1)
    worlds = DRAWN if context.quick else _WORLDS
    jobs = [
        (world, world.conditions(context, seed), seed, duration_s)
        for world in worlds
        for seed in seeds
    ]
    judged = context.map(judge_all, jobs, "estimators: recordings")
    runs = Results(row for rows in judged for row in rows)
    facts = {
        "duration_s": duration_s,
        "speed_rad_s": SPEED_RAD_S,
        "wiggle_s": WIGGLE_S,
        "paths": len(seeds),
        "rendered": context.rendered,
        "errors_mm": {
            name: 1e3 * float(np.median(runs.where(world=name).values("position_error_rms_m")))
            for name in ("clean", "noise")
        },
        "step_mm": 1e3 * float(np.median(runs.where(world="noise").values("median_step_m"))),
        "visible_percent": 100 * min(runs.values("visible_share")),
        "largest_turn_deg": max(world.turn_deg for world in worlds),
        "labels": {world.name: world.label for world in worlds},
    }
    data = {"seeds": list(seeds), "contestants": ESTIMATORS, "worlds": worlds}
    return lab.Found(runs, facts, data)


# ---- claims ---------------------------------------------------------------------------------


#: Words for the criteria.
_CRITERIA = {"t1_m": "T1", "t1_late_m": "T1", "t2_max_m": "largest T2",
             "jacobian_error": "Jacobian error"}  # fmt: skip
#: Runs by world and estimator.
Groups = Mapping[tuple[str, str], Results]


def _best(runs: Groups, world: Disturbance, criterion: str, names: Sequence[str]) -> str:
    """The estimator with the least median."""

    def rounded(name: str) -> float:  # those that are equal but for rounding stay in their order
        return float(f"{runs[world.name, name].median(criterion).value:.9g}")

    return min(names, key=rounded)


def _below(runs: Groups, world: Disturbance, one: str, other: str, criterion: str) -> lab.Part:
    """Whether an estimator's median is below that of another."""
    names = f"{ESTIMATORS[one].label} over {ESTIMATORS[other].label}"
    ratio = runs[world.name, one].over(runs[world.name, other], criterion)
    return lab.below(f"{_CRITERIA[criterion]} of {names}, {world.label}", ratio, 1.0)


def claims(found: lab.Found) -> Iterator[lab.Claim]:
    """The paper's claims on the estimators."""
    runs = found.runs.groups("world", "name")
    turned = [world for world in found.data["worlds"] if world.turn_deg > 0.0]

    def against_best(world: Disturbance, criterion: str) -> lab.Part:
        return _below(runs, world, "rbf", _best(runs, world, criterion, _OTHERS), criterion)

    yield lab.papers("unmoved", *(against_best(NOISE, one) for one in ("t1_m", "t2_max_m")))
    for criterion, title in (("t1_m", "T1"), ("t2_max_m", "the largest T2")):
        parts = [against_best(world, criterion) for world in turned]
        yield lab.papers("rotated", *parts, criterion=title)
    parts = []
    for world in (NOISE, *turned):
        rls, other = (_best(runs, world, "t1_m", names) for names in (_RLS, _FILTERS))
        worst = max((other, "rbf"), key=lambda name: runs[world.name, name].median("t1_m").value)
        parts.append(_below(runs, world, worst, rls, "t1_m"))
    yield lab.papers("rls", *parts)
    difference = max(found.runs.values("lkf_difference_m_rad"))
    label = "largest difference of any entry of their Jacobians"
    text = f"{difference:.1g} m/rad, asked: above rounding, 1e-9"
    yield lab.papers("ukf", lab.Part(label, text, None if difference > 1e-9 else False))
    other = _best(runs, CLEAN, "t1_late_m", (*_OTHERS, "lkf_fast"))
    yield lab.papers("bound", _below(runs, CLEAN, other, "frozen", "t1_late_m"))
    parts = [
        _below(runs, world, "rbf", "frozen", criterion)
        for world in turned
        for criterion in ("t1_m", "jacobian_error")
    ]
    yield lab.papers("update", *parts)
    yield lab.ours("cost", _below(runs, NOISE, "rbf", "frozen", "t1_m"))
    yield lab.papers("proof", _proof_part(found.runs, (NOISE, *turned)))


def _proof_part(runs: Results, worlds: Sequence[Disturbance]) -> lab.Part:
    """Pairs that T1 ranks wrongly, without the oracle and one of two identical filters."""
    ranked = runs.those(lambda row: row["method"] not in ("ukf", "oracle"))
    count = wrong = 0
    for world in worlds:
        ones = ranked.where(world=world.name).groups("name").values()
        medians = [[one.median(name).value for name in ("t1_m", "jacobian_error")] for one in ones]
        for one, other in combinations(medians, 2):
            count += 1
            wrong += (one[0] - other[0]) * (one[1] - other[1]) < 0.0
    label = "pairs of estimators of which the one with the smaller T1 has the worse Jacobian"
    return lab.Part(label, f"{wrong} of {count}, asked: none", wrong == 0)


# ---- tables and figures ---------------------------------------------------------------------

_COLUMNS = ("t1_m", "t1_share", "t1_first_m", "t2_final_m", "t2_max_m", "jacobian_error")
TABLES = (lab.TableOf("world", ("estimator",), _COLUMNS, each="world"),)

#: Estimators that are drawn, with style and width (points) of the line.
_LINES = {
    "rbf": ("-", 2.6),
    "frozen": ("-", 2.2),
    "lkf_explored": ("-", 1.6),
    "ukf_explored": ("-", 6.0),
    "lkf_model": ("--", 1.6),
    "lkf_zero": (":", 1.6),
    "rls_explored": ("-", 1.6),
}
_LOOKS = {
    ESTIMATORS[name].label: {
        "linestyle": style,
        "linewidth": width,
        "color": draw.COLOURS[ESTIMATORS[name].method],
        # The UKF broad and pale, behind the LKF's.
        "alpha": 0.45 if ESTIMATORS[name].method == "ukf" else 1.0,
    }
    for name, (style, width) in _LINES.items()
}
_SIGNALS: dict[str, draw.Signal] = {
    "t1": ("T1, mm", lambda row: 1e3 * row["series"]["t1_m"]),
    "t2": ("T2, mm", lambda row: 1e3 * row["series"]["t2_m"]),
}


def figures(found: lab.Found) -> Iterator[lab.Drawn]:
    """Figures 6 and 7 of the paper."""
    for name, signal in _SIGNALS.items():
        figure, (axes,) = draw.grid(1, len(DRAWN), (12.5, 5.6), sharey=True)
        for axis, world in zip(axes, DRAWN, strict=True):
            draw.over_time(axis, found.runs.where(world=world.name), signal, "estimator", _LOOKS)
            axis.set(title=world.label, xlabel="time, s", yscale="log")
        axes[0].set_ylabel(signal[0])
        draw.legend(figure)
        yield name, figure, {}


EXPERIMENT = lab.Experiment("estimators", measure, claims, TABLES, figures, globals())
