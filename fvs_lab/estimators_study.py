"""The measurements: everyone tuned, then judged on the same recordings in every world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fvs_lab.context import Context
from fvs_lab.estimators_contestants import (
    CONTESTANTS,
    GRIDS,
    SEARCHED,
    Contestant,
)
from fvs_lab.estimators_recordings import (
    Recording,
    Track,
    binned,
    judge,
    record,
)
from fvs_lab.lockstep import load_networks, make_estimator
from fvs_lab.statistics import Interval, median, ratio_of_medians
from fvs_lab.trials import Conditions, simulation_of

#: Tuning motions are numbered from here, far from any scored motion's number.
TUNING_SEEDS = (9001, 9002, 9003)
#: Length of one point of a curve against time, s.
BIN_S = 0.5


# ---- worlds ---------------------------------------------------------------------------------


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


CLEAN = World("clean", "no noise", noisy=False)
NOISE = World("noise", "1 mm noise")
DRAWN_TURN = _turned(20.0)
#: The worlds that are drawn against time, which are also those of a quick run.
DRAWN = (CLEAN, NOISE, DRAWN_TURN)
_WORLDS = (CLEAN, NOISE, _turned(10.0), DRAWN_TURN, _turned(30.0))


# ---- one recording --------------------------------------------------------------------------


@dataclass(frozen=True)
class Job:
    """One recording and who is judged on it."""

    conditions: Conditions
    seed: int
    duration_s: float
    contestants: tuple[Contestant, ...]


@dataclass(frozen=True)
class Judged:
    """What came of a job.

    Parameters
    ----------
    steps : int
        Number of scored steps.
    median_step_m : float
        Ball motion of a step, m.
    visible_share, position_error_rms_m : float
        As the recording has them.
    ukf_difference_m_rad : float
        Largest difference of any entry of the UKF's and LKF's Jacobians, m/rad.
    summaries : dict
        By contestant: its track in a few numbers.
    curves : dict
        By contestant: ``t1_m`` and ``t2_m`` against time, m.
    """

    steps: int
    median_step_m: float
    visible_share: float
    position_error_rms_m: float
    ukf_difference_m_rad: float
    summaries: dict[str, dict[str, float]]
    curves: dict[str, dict[str, np.ndarray]]


def judge_all(job: Job) -> Judged:
    """Make a recording and judge everyone on it."""
    recording = record(job.seed, job.conditions, job.duration_s)
    tracks = {one.name: _judge_one(one, recording, job.conditions) for one in job.contestants}
    edges_s = _edges_s(job.duration_s)
    some = next(iter(tracks.values()))
    return Judged(
        steps=some.time_s.size,
        median_step_m=float(np.median(some.motion_m)),
        visible_share=recording.visible_share,
        position_error_rms_m=recording.position_error_m,
        ukf_difference_m_rad=max(
            float(np.abs(tracks[f"ukf_{start}"].jacobian - tracks[f"lkf_{start}"].jacobian).max())
            for start in ("explored", "model")
        ),
        summaries={name: track.summary() for name, track in tracks.items()},
        curves={
            name: {
                "t1_m": binned(track.time_s, track.t1_m, edges_s),
                "t2_m": binned(track.time_s, track.t2_m, edges_s),
            }
            for name, track in tracks.items()
        },
    )


def _judge_one(one: Contestant, recording: Recording, conditions: Conditions) -> Track:
    estimator = make_estimator(one.method, simulation_of(conditions), load_networks(), one.values)
    return judge(estimator, recording, one.hears_prelude)


def _edges_s(duration_s: float) -> np.ndarray:
    return np.linspace(0.0, duration_s, round(duration_s / BIN_S) + 1)


def _tuning_t1_m(job: Job) -> dict[str, list[float]]:
    """T1, m, of each value of each contestant's grid, on one tuning motion."""
    recording = record(job.seed, job.conditions, job.duration_s)
    return {
        one.name: [
            _judge_one(one.with_value(value), recording, job.conditions).summary()["t1_m"]
            for value in GRIDS[one.method].values
        ]
        for one in job.contestants
    }


# ---- all of them ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Study:
    """All that was measured.

    Parameters
    ----------
    worlds : tuple of World
        The conditions.
    contestants : tuple of Contestant
        Who was compared, with tuned values.
    seeds : tuple of int
        Of the scored motions, in the order of all lists.
    duration_s : float
        Length of a scored motion, s.
    tuning : dict
        By contestant: ``parameter``, ``values``, ``t1_m`` (median over the tuning motions) and
        ``chosen``; empty if nothing was tuned.
    judged : dict
        By world's name, one of each seed.
    """

    worlds: tuple[World, ...]
    contestants: tuple[Contestant, ...]
    seeds: tuple[int, ...]
    duration_s: float
    tuning: dict[str, dict[str, Any]]
    judged: dict[str, list[Judged]]

    @property
    def turned(self) -> list[World]:
        """The worlds with a rotated camera, in the order of the angle."""
        return [one for one in self.worlds if one.turn_deg > 0.0]

    @property
    def curve_time_s(self) -> np.ndarray:
        """Times of a curve's points, s, shape (m,)."""
        edges_s = _edges_s(self.duration_s)
        return 0.5 * (edges_s[1:] + edges_s[:-1])

    def curve(self, world: World, contestant: str, criterion: str) -> np.ndarray:
        """T1 or T2 against time, median over the seeds, m, shape (m,); ``t1_m`` or ``t2_m``."""
        series = np.array([one.curves[contestant][criterion] for one in self.judged[world.name]])
        return np.ma.median(np.ma.masked_invalid(series), axis=0).filled(np.nan)

    def values(self, world: World, contestant: str, criterion: str) -> list[float]:
        """A criterion of a contestant in a world, one value a seed."""
        return [one.summaries[contestant][criterion] for one in self.judged[world.name]]

    def middle(self, world: World, contestant: str, criterion: str) -> float:
        """The median over the seeds."""
        return median(self.values(world, contestant, criterion)).value

    def text(self, world: World, contestant: str, criterion: str) -> str:
        """The median over the seeds of a length, for readers."""
        return millimetres(self.middle(world, contestant, criterion))

    def ratio(self, world: World, one: str, other: str, criterion: str) -> Interval:
        """Ratio of two contestants' medians."""
        return ratio_of_medians(
            self.values(world, one, criterion), self.values(world, other, criterion)
        )

    def ranking(self, world: World, criterion: str) -> list[Contestant]:
        """All contestants, the smallest median first; equal but for rounding, in their order."""
        return sorted(
            self.contestants,
            key=lambda one: float(f"{self.middle(world, one.name, criterion):.9g}"),
        )

    def best(self, world: World, criterion: str, names: Sequence[str]) -> str:
        """The one of these contestants with the smallest median."""
        return next(one.name for one in self.ranking(world, criterion) if one.name in names)


def millimetres(length_m: float) -> str:
    """A length for readers: two digits, ``0.12 mm`` or ``135 mm``."""
    length_mm = 1e3 * length_m
    return f"{length_mm:.2g} mm" if length_mm < 10.0 else f"{length_mm:.0f} mm"


def study(context: Context) -> Study:
    """Record, tune and judge."""
    duration_s = 8.0 if context.quick else 20.0
    seeds = tuple(range(1, context.count(default=6, quick=1) + 1))
    worlds = DRAWN if context.quick else _WORLDS
    tuning = {} if context.quick else _tune(context, duration_s)
    chosen = {name: one["chosen"] for name, one in tuning.items()}
    contestants = tuple(
        one.tuned(chosen)
        for one in CONTESTANTS.values()
        if one.name != "rbf_tuned" or tuning  # untuned, it would only be the first one again
    )
    jobs = [
        Job(world.conditions(context, seed), seed, duration_s, contestants)
        for world in worlds
        for seed in seeds
    ]
    results = iter(context.map(judge_all, jobs, "estimators: recordings"))
    judged = {world.name: [next(results) for _ in seeds] for world in worlds}
    return Study(worlds, contestants, seeds, duration_s, tuning, judged)


def _tune(context: Context, duration_s: float) -> dict[str, dict[str, Any]]:
    """Choose everyone's free number on motions that are not scored, with the exact camera."""
    exact = replace(context, rendered=False)
    jobs = [Job(NOISE.conditions(exact, seed), seed, duration_s, SEARCHED) for seed in TUNING_SEEDS]
    results = context.map(_tuning_t1_m, jobs, "estimators: tuning")
    tuning = {}
    for one in SEARCHED:
        values = GRIDS[one.method].values
        t1_m = np.median([result[one.name] for result in results], axis=0)
        tuning[one.name] = {
            "parameter": one.parameter,
            "values": list(values),
            "t1_m": t1_m,
            "chosen": values[int(np.argmin(t1_m))],
        }
    return tuning
