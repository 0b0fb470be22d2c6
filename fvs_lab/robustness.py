"""Hundreds of random worlds: the usual kind, and one in which everything goes wrong at once."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np

from fvs_lab import experiment as lab
from fvs_lab.contestants import CONTESTANTS, ORACLE
from fvs_lab.results import Results
from fvs_lab.trials import Bump, Conditions, Trial, along, make_cases, sees_all
from fvs_ros.kinds import KINDS
from fvs_ros.kinds.ball import Ball
from fvs_ros.kinds.pose import Pose
from fvs_tools.schemes import BEYOND, SCHEMES, Scheme, scheme
from fvs_tools.score import FINAL_S

#: The contestants, with the defaults of the nodes.
COMPARED = {name: CONTESTANTS[name] for name in (*SCHEMES, ORACLE, *BEYOND)}


@dataclass(frozen=True)
class Worlds:
    """Random worlds of a kind."""

    #: Of the experiment, and the seed of all its worlds.
    name: str
    seed: int
    #: Ranges that everything except start and target is drawn from, evenly.
    ranges: Mapping[str, tuple[float, float]]
    #: Shares of the worlds in which the camera is bumped, and in which the noise has heavy tails.
    bumped_share: float = 0.0
    heavy_share: float = 0.0
    #: What the arm carries.
    feature: str = Ball.name
    #: Least and largest distance of start and target, m.
    distance_m: tuple[float, float] = (0.1, 0.5)
    #: Length of a trial, s; the last second must be within 5 mm.
    duration_s: float = 6.0

    def draw(self, number: int) -> Trial:
        """Draw a world, as a trial of the proposed scheme: a pure function of its number.

        All magnitudes come from the ranges alone. Start, target and directions are drawn again
        until the ball is visible at both ends, before and after any bump of the camera.
        """
        rng = np.random.default_rng([self.seed, number])
        amount = {name: float(rng.uniform(*range_)) for name, range_ in self.ranges.items()}
        bumped, heavy = rng.random() < self.bumped_share, rng.random() < self.heavy_share
        names = {item.name for item in fields(Conditions)}
        changes: dict[str, Any] = {name: amount[name] for name in amount if name in names}
        changes["speed_scaling_percent"] = 100.0 * amount["drive_gain"]
        if not heavy:
            changes["noise_exponent"] = Conditions.noise_exponent
        while True:
            seed = int(rng.integers(2**31))
            plain = Conditions(feature=self.feature)
            case = make_cases(f"R{number}-", 1, seed, *self.distance_m, plain)[0]
            vectors = ("camera_carried_deg", "bump_rotation_deg", "bump_shift_m")
            rotation_deg, *blow = (along(rng.normal(size=3), amount[name]) for name in vectors)
            bump = Bump(amount["bump_time_s"], *blow) if bumped else None
            carried = Conditions(feature=self.feature, camera_carried_deg=rotation_deg)
            if sees_all(carried, (case.start_rad, case.goal_rad), bump):
                # Images would change little, and take three times as long.
                changes |= {"camera_carried_deg": rotation_deg, "rendered": False}
                world = replace(carried, **changes)
                labels = {"world": number, "case": case.name}
                return Trial(
                    conditions=world,
                    labels=labels,
                    case=case,
                    duration_s=self.duration_s,
                    bump=bump,
                )


#: Every disturbance at the same time.
HARSH = Worlds(
    "robustness",
    304,
    {
        "camera_carried_deg": (0.0, 30.0),
        "bump_rotation_deg": (0.0, 10.0),
        "bump_shift_m": (0.0, 0.1),
        "bump_time_s": (0.3, 2.0),
        "position_noise_m": (0.0002, 0.002),
        "noise_exponent": (1.5, 1.8),
        "latency_s": (0.0, 0.1),
        "dropout": (0.0, 0.2),
        "image_rate_hz": (8.0, 60.0),
        "focal_error": (-0.02, 0.02),
        "depth_error": (-0.02, 0.02),
        "encoder_noise_rad": (0.0, 0.0005),
        "joint_lag_s": (0.0, 0.1),
        "dead_time_s": (0.008, 0.06),
        "drive_gain": (0.8, 1.0),
    },
    bumped_share=1 / 3,
    heavy_share=1 / 2,
)
#: What a laboratory has: a usual sensor, real drives, a camera that was moved since the training.
EVERYDAY = Worlds(
    "everyday",
    305,
    {
        **HARSH.ranges,
        "position_noise_m": (0.001, 0.001),
        "latency_s": (0.05, 0.05),
        "dropout": (0.1, 0.1),
        "image_rate_hz": (15.0, 60.0),
        "focal_error": (-0.005, 0.005),
        "depth_error": (-0.005, 0.005),
        "encoder_noise_rad": (0.0, 0.0002),
        "joint_lag_s": (0.0, 0.05),
        "dead_time_s": (0.008, 0.04),
        "drive_gain": (0.9, 1.0),
    },
)


def schemes_called(names: Sequence[str]) -> list[Scheme]:
    """The schemes of these names, or all contestants; a ``ValueError`` lists those known."""
    return [COMPARED.get(name) or scheme(name) for name in names] or [*COMPARED.values()]


def trials_in(world: Trial, schemes: Sequence[Scheme]) -> list[Trial]:
    """The trials of schemes in a world."""
    return [replace(world.changed({"scheme": scheme.name}), scheme=scheme) for scheme in schemes]


def judged(row: Mapping[str, Any], duration_s: float) -> dict[str, Any]:
    """Columns that also count as failure a ball that settled only within the last second."""
    if row["failure"] or row["to_5mm_s"] <= duration_s - FINAL_S:
        return {}
    failure = "reached 5 mm, but did not stay"
    return {"failure": failure, "settled": False, "to_5mm_s": math.inf, "to_2mm_s": math.inf}


def measure(worlds: Worlds, context: lab.Context) -> Results:
    """Draw worlds of a kind, and run every scheme in all of them."""
    schemes = schemes_called(context.schemes or (("proposed", ORACLE) if context.quick else ()))
    drawn = context.map(worlds.draw, range(1, context.count(500) + 1), "worlds")
    trials = [trial for world in drawn for trial in trials_in(world, schemes)]
    runs = context.run(trials, worlds.name, quick_s=worlds.duration_s)
    return runs.adding(lambda row: judged(row, worlds.duration_s))


def claims(runs: Results) -> Iterator[lab.Claim]:
    """Judge the schemes worth using."""
    for name, group in runs.groups("scheme").items():
        if name in ("proposed", *BEYOND):
            part = lab.share_above("trials that settle", group.share(), 0.99)
            yield lab.ours("enough", part, scheme=name)


TABLES = (
    lab.Table(
        "schemes",
        ("scheme",),
        ("settled:of", "to_5mm_s:half", "to_5mm_s:90 %", "final_rms_m:half", "failure:causes"),
    ),
)
EXPERIMENTS = {
    worlds.name: lab.Experiment(
        worlds.name,
        partial(measure, worlds),
        claims,
        TABLES,
        {**globals(), "kind": worlds},
        model=KINDS[worlds.feature]().model,
    )
    for worlds in (EVERYDAY, HARSH, replace(EVERYDAY, name="tags", seed=306, feature=Pose.name))
}
