"""Estimators with their starts, the worlds, and how all are tuned and judged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fvs_estimator_node.rbf import RbfConfig
from fvs_lab.context import Context
from fvs_lab.estimators_recordings import (
    SPEED_RAD_S,
    WIGGLE_S,
    Recording,
    Track,
    binned,
    judge,
    record,
)
from fvs_lab.experiment import Found
from fvs_lab.results import Results
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
    """An estimator with a start.

    Parameters
    ----------
    name, label : str
        In the data, and for readers.
    method : str
        By the estimators' registry's name.
    values : mapping
        Parameters of the node that are not tuned.
    tuned_as : str
        The contestant whose tuned value it takes, itself or another; empty for none.
    hears_prelude : bool
        Whether it learns from the wiggling before the scored motion.
    """

    name: str
    label: str
    method: str
    values: Mapping[str, Any] = field(default_factory=dict)
    tuned_as: str = ""
    hears_prelude: bool = True

    @property
    def parameter(self) -> str:
        """The node's parameter that may be tuned."""
        return GRIDS[self.method][0]

    def with_value(self, value: float) -> Contestant:
        """The same with another value of that parameter."""
        return replace(self, values={**self.values, self.parameter: value})

    def tuned(self, chosen: Mapping[str, float]) -> Contestant:
        """The same with its tuned value, by contestant, if there is one for it."""
        return self.with_value(chosen[self.tuned_as]) if self.tuned_as in chosen else self


def _started(method: str, start: str, tuned_as: str = "") -> Contestant:
    """A method with one of three starts; tuned by itself unless another's value is named."""
    name = f"{method}_{start}"
    values: dict[str, Any] = {}
    if start != "model":
        values["online.initial"] = "zero"
        if method != "broyden":  # which has no notion of how wrong it may be
            values["online.initial_deviation_m_rad"] = IGNORANCE_M_RAD
    label = {"lkf": "LKF", "ukf": "UKF", "rls": "RLS", "broyden": "Broyden"}[method]
    words = {"explored": "explored", "model": "networks' start", "zero": "from zero"}[start]
    hears = start == "explored"
    return Contestant(name, f"{label}, {words}", method, values, tuned_as or name, hears)


_EXPLORED = _started("lkf", "explored")
_FAST = Contestant(
    "lkf_fast", f"LKF, explored, process noise {FAST_PROCESS_NOISE:g}", "lkf", _EXPLORED.values
)
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
# ---- worlds and runs ------------------------------------------------------------------------


@dataclass(frozen=True)
class World:
    """A condition that is compared.

    Parameters
    ----------
    name, label : str
        In the data, and for readers.
    noisy : bool
        Whether there is 1 mm of noise and the depth camera's own.
    turn_deg : float
        Angle by which the camera was carried round the scene, degrees.
    """

    name: str
    label: str
    noisy: bool = True
    turn_deg: float = 0.0

    def conditions(self, context: Context, seed: int) -> Conditions:
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
    tracks = {one.name: _judge_one(one, recording, job.conditions) for one in job.contestants}
    edges_s = np.linspace(0.0, job.duration_s, round(job.duration_s / _BIN_S) + 1)
    rows = []
    for one in job.contestants:
        track = tracks[one.name]
        row = {
            "world": job.world.name,
            "turn_deg": job.world.turn_deg,
            "name": one.name,
            "estimator": one.label,
            "method": one.method,
            "case": job.seed,
            **track.summary(),
            "steps": track.time_s.size,
            "median_step_m": float(np.median(track.motion_m)),
            "visible_share": recording.visible_share,
            "position_error_rms_m": recording.position_error_m,
            "series": {
                "time_s": 0.5 * (edges_s[1:] + edges_s[:-1]),
                "t1_m": binned(track.time_s, track.t1_m, edges_s),
                "t2_m": binned(track.time_s, track.t2_m, edges_s),
            },
        }
        twin = tracks.get(one.name.replace("ukf", "lkf"))
        if one.method == "ukf" and twin is not None:
            row["lkf_difference_m_rad"] = float(np.abs(track.jacobian - twin.jacobian).max())
        rows.append(row)
    return rows


def _judge_one(one: Contestant, recording: Recording, conditions: Conditions) -> Track:
    estimator = make_estimator(one.method, simulation_of(conditions), one.values)
    return judge(estimator, recording, one.hears_prelude)


def _tuning_t1_m(job: Job) -> dict[str, list[float]]:
    """T1, m, of each value of each contestant's grid, on one tuning motion."""
    recording = record(job.seed, job.conditions, job.duration_s)
    return {
        one.name: [
            _judge_one(one.with_value(value), recording, job.conditions).summary()["t1_m"]
            for value in GRIDS[one.method][1]
        ]
        for one in job.contestants
    }


def _tune(context: Context, duration_s: float) -> dict[str, dict[str, Any]]:
    """Choose the free number of each on motions that are not scored, with the exact camera."""
    exact = replace(context, rendered=False)
    jobs = [
        Job(NOISE, NOISE.conditions(exact, seed), seed, duration_s, SEARCHED)
        for seed in TUNING_SEEDS
    ]
    results = context.map(_tuning_t1_m, jobs, "estimators: tuning")
    tuning = {}
    for one in SEARCHED:
        values = GRIDS[one.method][1]
        t1_m = np.median([result[one.name] for result in results], axis=0)
        chosen = values[int(np.argmin(t1_m))]
        tuning[one.name] = {
            "parameter": one.parameter, "values": values, "t1_m": t1_m, "chosen": chosen
        }  # fmt: skip
    return tuning


def measure(context: Context) -> Found:
    """Record, tune and judge."""
    duration_s = 8.0 if context.quick else 20.0
    seeds = range(1, context.count(default=6, quick=1) + 1)
    worlds = DRAWN if context.quick else _WORLDS
    tuning = {} if context.quick else _tune(context, duration_s)
    chosen = {name: one["chosen"] for name, one in tuning.items()}
    contestants = tuple(
        one.tuned(chosen)
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
        "paths": len(seeds),
        "rendered": context.rendered,
        "errors_mm": {
            name: 1e3 * float(np.median(runs.where(world=name).values("position_error_rms_m")))
            for name in ("clean", "noise")
        },
        "step_mm": 1e3 * float(np.median(runs.where(world="noise").values("median_step_m"))),
        "visible_percent": 100 * min(runs.values("visible_share")),
        "wiggle_s": WIGGLE_S,
        "ignorance_m_rad": IGNORANCE_M_RAD,
        "values": len(GRIDS["rbf"][1]),
        "tuning": len(TUNING_SEEDS) if tuning else 0,
        "n1": RbfConfig.n1,
        "fast_n1": FAST_N1,
        "fast_process_noise": FAST_PROCESS_NOISE,
        "largest_turn_deg": max(world.turn_deg for world in worlds),
        "bin_s": _BIN_S,
    }
    data = {"seeds": list(seeds), "tuning": tuning, "contestants": contestants, "worlds": worlds}
    return Found(runs, facts, data, {"worlds": worlds, "tuning": tuning})
