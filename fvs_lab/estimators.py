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
from fvs_lab.smooth_motion import SPEED_RAD_S, WIGGLE_S, Recording, Track, judge, record
from fvs_lab.trials import Conditions, simulation_of
from fvs_tools.closed_loop import make_estimator

#: Tuning motions are numbered from here, far from any scored motion's number.
TUNING_SEEDS = (9001, 9002, 9003)
#: Length of one point of a curve against time, s.
_BIN_S = 0.5
#: A faster update than the default, and a filter that hardly believes in noise, for comparison.
FAST_N1, FAST_PROCESS_NOISE = 3.0, 10.0
#: Standard deviation of an entry of a Jacobian that begins at zero, m/rad.
IGNORANCE_M_RAD = 0.5

# ---- contestants ----------------------------------------------------------------------------

_FILTER_GRID = ("online.process_noise", (1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1))
#: Each method's one free parameter of the node, and eight values that it is tuned over.
GRIDS: Mapping[str, tuple[str, tuple[float, ...]]] = {
    "rbf": ("rbf.n1", (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)),
    "lkf": _FILTER_GRID,
    "ukf": _FILTER_GRID,
    "rls": ("online.forgetting", (0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98)),
    "broyden": ("online.gain", (0.03, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.8)),
}


@dataclass(frozen=True)
class Contestant:
    """An estimator with a start."""

    #: In the data, and for readers.
    name: str
    label: str
    #: By the estimators' registry's name, and parameters of the node that are not tuned.
    method: str
    values: Mapping[str, Any] = field(default_factory=dict)
    #: The contestant whose tuned value it takes, itself or another; empty for none.
    tuned_as: str = ""
    #: Whether it learns from the wiggling before the scored motion.
    hears_prelude: bool = True

    def with_value(self, value: float) -> Contestant:
        """The same with another value of the parameter that may be tuned."""
        return replace(self, values={**self.values, GRIDS[self.method][0]: value})

    def judged(self, recording: Recording, conditions: Conditions) -> Track:
        """How well it does on a recording."""
        estimator = make_estimator(self.method, simulation_of(conditions), self.values)
        return judge(estimator, recording, self.hears_prelude)


_LABELS = {"lkf": "LKF", "ukf": "UKF", "rls": "RLS", "broyden": "Broyden"}
_STARTS = {"explored": "explored", "model": "networks' start", "zero": "from zero"}


def _started(method: str, start: str, tuned_as: str = "") -> Contestant:
    """A method with one of three starts; tuned by itself unless another's value is named."""
    values: dict[str, Any] = {}
    if start != "model":
        values["online.initial"] = "zero"
        if method != "broyden":  # which has no notion of how wrong it may be
            values["online.initial_deviation_m_rad"] = IGNORANCE_M_RAD
    name, label = f"{method}_{start}", f"{_LABELS[method]}, {_STARTS[start]}"
    return Contestant(name, label, method, values, tuned_as or name, start == "explored")


_EXPLORED = _started("lkf", "explored")
_FAST_LABEL = f"LKF, explored, process noise {FAST_PROCESS_NOISE:g}"
_FAST = replace(_EXPLORED, name="lkf_fast", label=_FAST_LABEL, tuned_as="")
#: All of them, by name; a UKF takes the LKF's tuned value, for they are one filter.
CONTESTANTS = {
    one.name: one
    for one in (
        Contestant("rbf", f"proposed, n1 = {RbfConfig.n1:g}", "rbf"),
        Contestant("rbf_fast", f"proposed, n1 = {FAST_N1:g}", "rbf", {"rbf.n1": FAST_N1}),
        Contestant("rbf_tuned", "proposed, n1 tuned", "rbf", tuned_as="rbf_tuned"),
        Contestant("frozen", "networks, frozen", "frozen"),
        _EXPLORED,
        _started("ukf", "explored", "lkf_explored"),
        _started("lkf", "model"),
        _started("ukf", "model", "lkf_model"),
        _started("lkf", "zero", "lkf_explored"),
        _FAST.with_value(FAST_PROCESS_NOISE),
        _started("rls", "explored"),
        _started("rls", "model"),
        _started("broyden", "explored"),
        _started("broyden", "model"),
        Contestant("oracle", "true Jacobian (oracle)", "oracle"),
    )
}
#: Those that have a search of their own.
SEARCHED = tuple(one for one in CONTESTANTS.values() if one.tuned_as == one.name)
#: Those that the paper compares the proposed one with, in all their starts.
_FILTERS = ("lkf_explored", "lkf_model", "lkf_zero", "ukf_explored", "ukf_model")
_RLS = ("rls_explored", "rls_model")
_OTHERS = (*_FILTERS, *_RLS)

# ---- worlds and runs ------------------------------------------------------------------------


@dataclass(frozen=True)
class World:
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


def _turned(turn_deg: float) -> World:
    label = f"1 mm noise, camera rotated by {turn_deg:g}°"
    return World(f"turned_{turn_deg:g}", label, turn_deg=turn_deg)


CLEAN, NOISE = World("clean", "no noise", noisy=False), World("noise", "1 mm noise")
#: Worlds that are drawn against time, which are also those of a quick run.
DRAWN = (CLEAN, NOISE, _turned(20.0))
_WORLDS = (CLEAN, NOISE, *map(_turned, (10.0, 20.0, 30.0)))


@dataclass(frozen=True)
class Job:
    """One recording and those who are judged on it."""

    world: World
    conditions: Conditions
    seed: int
    duration_s: float
    contestants: tuple[Contestant, ...]


def judge_all(job: Job) -> list[dict[str, Any]]:
    """Make a recording, judge all on it, and return their rows."""
    recording = record(job.seed, job.conditions, job.duration_s)
    tracks = {one.name: one.judged(recording, job.conditions) for one in job.contestants}
    rows = []
    for one in job.contestants:
        track = tracks[one.name]
        row = {
            "world": job.world.name,
            "name": one.name,
            "estimator": one.label,
            "method": one.method,
            "case": job.seed,
            **track.summary(),
            "median_step_m": float(np.median(track.motion_m)),
            "visible_share": recording.visible_share,
            "position_error_rms_m": recording.position_error_m,
            "series": track.means(job.duration_s, _BIN_S),
        }
        twin = tracks.get(one.name.replace("ukf", "lkf"))
        if one.method == "ukf" and twin is not None:
            row["lkf_difference_m_rad"] = float(np.abs(track.jacobian - twin.jacobian).max())
        rows.append(row)
    return rows


def _tuning_t1_m(job: Job) -> dict[str, list[float]]:
    """T1, m, of each value of each contestant's grid, on one tuning motion."""
    recording = record(job.seed, job.conditions, job.duration_s)
    return {
        one.name: [
            one.with_value(value).judged(recording, job.conditions).summary()["t1_m"]
            for value in GRIDS[one.method][1]
        ]
        for one in job.contestants
    }


def _tune(context: lab.Context, duration_s: float) -> dict[str, dict[str, Any]]:
    """Choose the free number of each on motions that are not scored, with the exact camera."""
    exact = replace(context, rendered=False)
    jobs = [
        Job(NOISE, NOISE.conditions(exact, seed), seed, duration_s, SEARCHED)
        for seed in TUNING_SEEDS
    ]
    results = context.map(_tuning_t1_m, jobs, "estimators: tuning")
    tuning = {}
    for one in SEARCHED:
        parameter, values = GRIDS[one.method]
        t1_m = np.median([result[one.name] for result in results], axis=0)
        chosen = values[int(np.argmin(t1_m))]
        tuning[one.name] = {
            "parameter": parameter, "values": values, "t1_m": t1_m, "chosen": chosen
        }  # fmt: skip
    return tuning


def measure(context: lab.Context) -> lab.Found:
    """Record, tune and judge."""
    duration_s = 8.0 if context.quick else 20.0
    seeds = range(1, context.count(default=6, quick=1) + 1)
    worlds = DRAWN if context.quick else _WORLDS
    tuning = {} if context.quick else _tune(context, duration_s)
    contestants = tuple(
        one.with_value(tuning[one.tuned_as]["chosen"]) if one.tuned_as in tuning else one
        for one in CONTESTANTS.values()
        if one.name != "rbf_tuned" or tuning  # untuned, it would only be the first one again
    )
    jobs = [
        Job(world, world.conditions(context, seed), seed, duration_s, contestants)
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
        "tuning": len(TUNING_SEEDS) if tuning else 0,
        "largest_turn_deg": max(world.turn_deg for world in worlds),
        "labels": {world.name: world.label for world in worlds},
    }
    data = {"seeds": list(seeds), "tuning": tuning, "contestants": contestants, "worlds": worlds}
    return lab.Found(runs, facts, data)


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

    def part(self, world: World, one: str, other: str, criterion: str) -> lab.Part:
        words = {"t2_max_m": "largest T2", "jacobian_error": "Jacobian error"}.get(criterion, "T1")
        label = f"{words} of {CONTESTANTS[one].label} over {CONTESTANTS[other].label}"
        ratio = self._runs[world.name, one].over(self._runs[world.name, other], criterion)
        return lab.below(f"{label}, {world.label}", ratio, 1.0)


def claims(found: lab.Found) -> Iterator[lab.Claim]:
    """The paper's claims on the estimators."""
    judge_of = _Judge(found.runs)
    turned = [world for world in found.data["worlds"] if world.turn_deg > 0.0]

    def against_best(world: World, criterion: str) -> lab.Part:
        return judge_of.part(world, "rbf", judge_of.best(world, criterion, _OTHERS), criterion)

    yield lab.papers("unmoved", *(against_best(NOISE, one) for one in ("t1_m", "t2_max_m")))
    for criterion, title in (("t1_m", "T1"), ("t2_max_m", "the largest T2")):
        parts = [against_best(world, criterion) for world in turned]
        yield lab.papers("rotated", *parts, criterion=title)
    parts = []
    for world in (NOISE, *turned):
        rls, other = (judge_of.best(world, "t1_m", names) for names in (_RLS, _FILTERS))
        worst = max((other, "rbf"), key=lambda name: judge_of.middle(world, name, "t1_m"))
        parts.append(judge_of.part(world, worst, rls, "t1_m"))
    yield lab.papers("rls", *parts)
    yield lab.papers("ukf", *_ukf_parts(found.runs, judge_of))
    other = judge_of.best(CLEAN, "t1_late_m", (*_OTHERS, "lkf_fast"))
    yield lab.papers("bound", judge_of.part(CLEAN, other, "frozen", "t1_late_m"))
    parts = [
        judge_of.part(world, "rbf", "frozen", criterion)
        for world in turned
        for criterion in ("t1_m", "jacobian_error")
    ]
    yield lab.papers("update", *parts)
    yield lab.ours("cost", judge_of.part(NOISE, "rbf", "frozen", "t1_m"))
    yield lab.papers("proof", _proof_part(judge_of, found.runs, (NOISE, *turned)))


def _ukf_parts(runs: Results, judge_of: _Judge) -> list[lab.Part]:
    difference = max(runs.values("lkf_difference_m_rad"))
    if difference < 1e-9:  # one filter
        text = f"{difference:.1g} m/rad: they are the same filter"
        return [lab.Part("largest difference of any entry of their Jacobians", text, False)]
    starts = ("explored", "model")
    return [judge_of.part(NOISE, f"ukf_{start}", f"lkf_{start}", "t1_m") for start in starts]


def _proof_part(judge_of: _Judge, runs: Results, worlds: Sequence[World]) -> lab.Part:
    """Pairs that T1 ranks wrongly: without one of two filters that are the same, and the oracle."""
    names = runs.those(lambda row: row["method"] not in ("ukf", "oracle")).groups("name")
    pairs = [(world, *pair) for world in worlds for pair in combinations(names, 2)]
    wrong = 0
    for world, one, other in pairs:
        t1_m, error = (
            judge_of.middle(world, one, name) - judge_of.middle(world, other, name)
            for name in ("t1_m", "jacobian_error")
        )
        wrong += t1_m * error < 0.0
    label = "pairs of estimators of which the one with the smaller T1 has the worse Jacobian"
    return lab.Part(label, f"{wrong} of {len(pairs)}, asked: none", wrong == 0)


# ---- tables and figures ---------------------------------------------------------------------

_COLUMNS = ("t1_m", "t1_share", "t1_first_m", "t2_final_m", "t2_max_m", "jacobian_error")
TABLES = (lab.TableOf("world", ("estimator",), _COLUMNS, each="world"),)

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
_LOOKS = {
    CONTESTANTS[name].label: {
        "linestyle": style,
        "linewidth": width,
        "color": draw.COLOURS[CONTESTANTS[name].method],
        # The UKF broad and pale, behind the LKF's.
        "alpha": 0.45 if CONTESTANTS[name].method == "ukf" else 1.0,
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
