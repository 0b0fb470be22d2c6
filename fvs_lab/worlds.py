"""Random worlds: start, target, camera, noise, delay and loss, a pure function of a number."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from math import hypot
from typing import Any

import numpy as np

from fvs_lab.trials import WHITE, Bump, Case, Conditions, along, make_cases, sees_all
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
    conditions: Conditions
    bump: Bump | None

    def text(self) -> str:
        """A one-line description."""
        usual, bump = Conditions(), self.bump
        parts = [
            f"{one.name} {getattr(self.conditions, one.name):.3g}"
            for one in fields(Conditions)
            if isinstance(getattr(usual, one.name), float)
        ]
        parts.append(f"camera turned by {hypot(*self.conditions.camera_turn_deg):.1f}°")
        if bump is not None:
            turn_deg, shift_mm = hypot(*bump.rotation_deg), 1e3 * hypot(*bump.translation_m)
            parts.append(f"bumped by {turn_deg:.1f}° and {shift_mm:.0f} mm at {bump.time_s:.1f} s")
        return f"{', '.join(parts)}; noise seed {self.case.seed}"


def draw_world(kind: Kind, number: int) -> World:
    """Draw the world of a trial.

    All magnitudes come from the ranges alone. Start, target and directions are drawn again until
    the ball is visible at both ends, before and after any bump of the camera.
    """
    rng = np.random.default_rng([kind.seed, number])
    amount = {name: float(rng.uniform(*range_)) for name, range_ in kind.ranges.items()}
    bumped, heavy = rng.random() < kind.bumped_share, rng.random() < kind.heavy_share
    names = {one.name for one in fields(Conditions)}
    changes: dict[str, Any] = {name: one for name, one in amount.items() if name in names}
    if not heavy:
        changes["noise_exponent"] = WHITE
    while True:
        seed = int(rng.integers(2**31))
        case = make_cases(f"R{number}-", 1, seed, *DISTANCE_M, Conditions(kind.feature))[0]
        vectors = ("camera_turn_deg", "bump_turn_deg", "bump_shift_m")
        turn_deg, *blow = (along(rng.normal(size=3), amount[name]) for name in vectors)
        bump = Bump(amount["bump_time_s"], *blow) if bumped else None
        seen = Conditions(kind.feature, camera_turn_deg=turn_deg)
        if sees_all(seen, (case.start_rad, case.goal_rad), bump):
            # Images would change little, and take three times as long.
            changes |= {"camera_turn_deg": turn_deg, "rendered": False}
            return World(number, case, replace(seen, **changes), bump)
