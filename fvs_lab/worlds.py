"""Random worlds: start, target, camera, noise, delay and loss, a pure function of a number."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import hypot
from typing import Any

import numpy as np

from fvs_lab.results import number_text
from fvs_lab.trials import (
    WHITE,
    Bump,
    Case,
    Conditions,
    Vector,
    along,
    make_cases,
    sees,
    simulation_of,
)
from fvs_ros.kinds.ball import Ball
from fvs_ros.kinds.pose import Pose

#: Least and largest distance of start and target, m.
DISTANCE_M = (0.1, 0.5)


@dataclass(frozen=True)
class Kind:
    """A kind of worlds."""

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


#: Every disturbance at the same time.
HARSH = Kind(
    "robustness",
    304,
    {
        "camera_turn_deg": (0.0, 30.0),
        "bump_turn_deg": (0.0, 10.0),
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
EVERYDAY = Kind(
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

#: The same for a tag's pose.
TAGS = replace(EVERYDAY, name="tags", seed=306, feature=Pose.name)

KINDS = {kind.name: kind for kind in (EVERYDAY, HARSH, TAGS)}


@dataclass(frozen=True)
class World:
    """The conditions and the case of one trial, the same for all contestants."""

    #: Of the trial, from 1.
    number: int
    case: Case
    #: From start to target, m.
    distance_m: float
    conditions: Conditions
    bump: Bump | None

    def row(self) -> dict[str, float]:
        """Columns of the tidy table: what there is of each quantity, SI units and degrees."""
        found = {one.name: getattr(self.conditions, one.name) for one in DRAWN}
        return {
            "world": self.number,
            "distance_m": self.distance_m,
            "turn_deg": hypot(*self.conditions.camera_turn_deg),
            "bump_deg": 0.0 if self.bump is None else hypot(*self.bump.rotation_deg),
            **found,
        }

    def text(self) -> str:
        """A one-line description."""
        row, bump = self.row(), self.bump
        parts = [
            f"{one.label} {number_text(one.scale * row[one.name], 2)}{one.unit}"
            for one in QUANTITIES
            if bump is not None or one.name != "bump_deg"
        ]
        if bump is not None:
            shift_mm = 1e3 * hypot(*bump.translation_m)
            parts.append(f"camera shifted {shift_mm:.0f} mm at {bump.time_s:.1f} s")
        return f"{', '.join(parts)}; noise seed {self.case.seed}"


@dataclass(frozen=True)
class Quantity:
    """Something that differs from world to world."""

    #: Its column.
    name: str
    #: For readers; the unit begins with a space where there is one.
    label: str
    unit: str = ""
    #: From the column's unit to that unit.
    scale: float = 1.0


#: Those that are fields of the conditions, drawn from a kind's ranges.
DRAWN = (
    Quantity("position_noise_m", "noise of positions", " mm", 1e3),
    Quantity("noise_exponent", "exponent of the noise"),
    Quantity("image_rate_hz", "image rate", " Hz"),
    Quantity("latency_s", "latency", " ms", 1e3),
    Quantity("dropout", "images lost", " %", 1e2),
    Quantity("focal_error", "error of the focal length", " %", 1e2),
    Quantity("depth_error", "error of the depths", " %", 1e2),
    Quantity("encoder_noise_rad", "encoder noise", " mrad", 1e3),
    Quantity("joint_lag_s", "further drive lag", " ms", 1e3),
    Quantity("dead_time_s", "dead time of the drives", " ms", 1e3),
    Quantity("drive_gain", "speed over the commanded one"),
)
QUANTITIES = (
    Quantity("distance_m", "distance", " m"),
    Quantity("turn_deg", "camera carried round", "°"),
    Quantity("bump_deg", "camera bumped in mid-run", "°"),
    *DRAWN,
)


def draw_world(kind: Kind, number: int) -> World:
    """Draw the world of a trial.

    All magnitudes come from the ranges alone. Start, target and directions are drawn again until
    the ball is visible at both ends, before and after any bump of the camera.
    """
    rng = np.random.default_rng([kind.seed, number])
    amount = {name: float(rng.uniform(*range_)) for name, range_ in kind.ranges.items()}
    bumped, heavy = rng.random() < kind.bumped_share, rng.random() < kind.heavy_share
    changes: dict[str, Any] = {one.name: amount[one.name] for one in DRAWN}
    drawn = Conditions(kind.feature, **changes)
    if not heavy:
        drawn = replace(drawn, noise_exponent=WHITE)
    while True:
        seed = int(rng.integers(2**31))
        case = make_cases(f"R{number}-", 1, seed, *DISTANCE_M, Conditions(kind.feature))[0]
        names = ("camera_turn_deg", "bump_turn_deg", "bump_shift_m")
        turn_deg, *blow = (along(rng.normal(size=3), amount[name]) for name in names)
        bump = Bump(amount["bump_time_s"], *blow) if bumped else None
        distance_m = _visible_distance_m(case, turn_deg, bump, kind.feature)
        if distance_m is not None:
            conditions = replace(drawn, camera_turn_deg=turn_deg)
            return World(number, case, distance_m, conditions, bump)


def _visible_distance_m(
    case: Case, turn_deg: Vector, bump: Bump | None, feature: str
) -> float | None:
    """Distance from start to target, m; None if ball or tag cannot be seen at either of them."""
    simulation = simulation_of(Conditions(feature, camera_turn_deg=turn_deg))
    cameras = [simulation.camera]
    if bump is not None:
        bump.strike(simulation)
        cameras.append(simulation.camera)
    ends = []
    for joints in (case.start_rad, case.goal_rad):
        for camera in cameras:
            simulation.camera = camera
            simulation.reset(np.array(joints))  # or the detector refuses the jump
            if not sees(simulation):
                return None
        ends.append(simulation.world.ball_position())
    return float(np.linalg.norm(ends[1] - ends[0]))
