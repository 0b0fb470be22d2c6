"""A tag's pose: how fast and how exactly every scheme reaches it, beside a calibrated camera."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from fvs_estimator_node.base import Estimator
from fvs_estimator_node.files import MODELS
from fvs_lab import contestants as who
from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab.floor import Limits, fastest
from fvs_lab.outcome import BOUNDS_M, Outcome
from fvs_lab.results import Results
from fvs_lab.trials import Case, Conditions, Trial, make_cases, simulation_of
from fvs_ros.chain import SerialChain
from fvs_ros.feature import PoseFeature, ServoedConfig, rotation_matrix
from fvs_ros.topics import POSE
from fvs_sim_node.config import SimConfig
from fvs_sim_node.simulation import Simulation
from fvs_tools.closed_loop import ClosedLoop
from fvs_tools.score import FINAL_S

_LIMITS = Limits(who.SPEED_RAD_S, who.ACCELERATION_RAD_S2)
_FEATURE = PoseFeature(ServoedConfig.lever_arm_m)
#: Noise of each coordinate of an exact camera, m: like that of rendered images.
NOISE_M = 3e-4
#: How the tag is seen.
EXACT = Conditions(POSE, rendered=False, position_noise_m=NOISE_M)
IMAGES = Conditions(POSE, position_noise_m=0.0)
#: Schemes that are run with images, too.
SEEN = (who.BEST, who.EXTENDED, "proposed")
#: Calibrated cameras: rotation, degrees, and place, m, that the extrinsics are off by.
CALIBRATED = {"exact": (0.0, 0.0), "1° and 5 mm off": (1.0, 0.005), "5° and 2 cm off": (5.0, 0.02)}
#: Largest median time over the floor, and final errors, m and degrees.
OVER_FLOOR, REST_M, REST_DEG = 1.15, 0.0005, 0.1


class Calibrated(Estimator):
    """The robot's true kinematics behind a camera whose pose was measured."""

    learns = False

    def __init__(self, chain: SerialChain) -> None:
        super().__init__()
        self._chain = chain

    @property
    def chain(self) -> SerialChain:
        """The arm as the measured camera would see it."""
        return self._chain

    def jacobian(self, joints_rad: np.ndarray) -> np.ndarray:
        """Of the chain, m/rad, (m, n)."""
        return self._chain.jacobian(joints_rad)


@dataclass(frozen=True)
class CalibratedTrial(Trial):
    """A trial of the law of ``best`` with a calibrated camera, which is off by degrees and m."""

    off: tuple[float, float] = (0.0, 0.0)

    def loop(self, simulation: Simulation) -> ClosedLoop:
        """The whole loop in a simulation that has been reset."""
        axis, way = np.random.default_rng(self.case.seed).normal(size=(2, 3))
        turn = rotation_matrix(np.radians(self.off[0]) * axis / np.linalg.norm(axis))
        shift_m = self.off[1] * way / np.linalg.norm(way)
        chain = simulation.true_chain(_FEATURE).moved(turn, shift_m)
        values = {"law": self.variant.law, **self.variant.controller_values}
        return ClosedLoop(simulation, Calibrated(chain), values)


@lru_cache(maxsize=1)
def _arm() -> SerialChain:
    """The true kinematics, world frame."""
    return simulation_of(EXACT).world.pose_chain(_FEATURE)


def floor_s(case: Case) -> float:
    """Least time until the tag stays within 5 mm, by the joints' limits, s."""
    return fastest(case, _LIMITS, BOUNDS_M["5 mm"], _arm()).time_s


def rest(outcome: Outcome) -> dict[str, float]:
    """Final errors of way, m, and turn, degrees, rms over the last second."""
    series, target_m = outcome.series, np.array(outcome.target_m)
    last = series["time_s"] > series["time_s"][-1] - FINAL_S
    parts = [_FEATURE.parts(_FEATURE.error(one, target_m)) for one in series["ball_m"][last]]
    way_m, angle_rad = np.array([[one["way_m"], one["angle_rad"]] for one in parts]).T
    return {"rest_m": _rms(way_m), "rest_deg": float(np.degrees(_rms(angle_rad)))}


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def measure(context: lab.Context) -> lab.Found:
    """Run every scheme with an exact camera, some with images, and calibrated cameras."""
    cases = make_cases("P", context.count(60, 1), 420, feature=POSE)
    names = [one.name for one in cases]
    floors = dict(zip(names, context.map(floor_s, cases, "the floor"), strict=True))
    schemes = (*SEEN, *(name for name in who.PUBLISHED if name not in SEEN), who.BEST_ORACLE)
    runs: list[tuple[dict[str, Any], Trial]] = []
    for case in cases:
        for name in schemes[:2] if context.quick else schemes:
            one = who.variant(name)
            ways = {"exact": EXACT, "images": IMAGES} if name in SEEN else {"exact": EXACT}
            for seen, conditions in ways.items():
                labels = {"part": "schemes", "scheme": name, "camera": seen, "case": case.name}
                runs.append((labels, one.trial(case, conditions, record=True)))
        for words, off in CALIBRATED.items():
            labels = {"part": "calibrated", "scheme": words, "camera": "exact", "case": case.name}
            trial = CalibratedTrial(who.variant(who.BEST), case, EXACT, record=True, off=off)
            runs.append((labels, trial))
    scored = context.score(runs, "poses", rest)
    over = Results({**row, "over_5mm": row["to_5mm_s"] / floors[row["case"]]} for row in scored)
    return lab.Found(over, {"count": len(cases), "tag_m": SimConfig().tag.tag_size_m})


def claims(found: lab.Found) -> Iterator[lab.Claim]:
    """The chain's speed over the floor, its rest, and what a wrong calibration costs."""
    schemes = found.runs.where(part="schemes")
    best = schemes.where(scheme=who.BEST)
    for seen, runs in best.groups("camera").items():
        part = lab.below("time over the floor", runs.median("over_5mm"), OVER_FLOOR)
        yield lab.ours("fast", part, camera=seen)
    images = best.where(camera="images")
    yield lab.ours(
        "rest",
        lab.below("final error, mm", images.median("rest_m"), REST_M, 1e3),
        lab.below("final angle, degrees", images.median("rest_deg"), REST_DEG),
    )
    parts = [
        lab.kept(f"targets reached by {name}", sum(runs.values("settled")), len(runs), 0.98)
        for name, runs in schemes.where(camera="exact").groups("scheme").items()
        if name in SEEN
    ]
    yield lab.ours("settles", *parts)


_COLUMNS = ("to_5mm_s", "over_5mm", "rest_m", "rest_deg", "settled:of", "failure:causes")
TABLES = (
    lab.TableOf("schemes", ("camera", "scheme"), _COLUMNS, {"part": "schemes"}),
    lab.TableOf("calibrated", ("scheme",), _COLUMNS, {"part": "calibrated"}),
)


def figures(found: lab.Found) -> Iterator[lab.Drawn]:
    """Errors over time of the first case."""
    runs = found.runs.where(part="schemes", camera="exact")
    first = runs.where(case=runs.rows[0]["case"])
    figure, ((axis,),) = draw.grid(1, 1, (9.0, 5.0))
    looks: dict[str, dict[str, Any]] = {
        name: {"color": draw.colour_of(name)} for name in first.groups("scheme")
    }
    looks.get(who.BEST_ORACLE, {})["linestyle"] = ":"
    draw.errors_over_time(axis, first, "scheme", looks)
    axis.set(xlabel="time since the target was given, s", ylabel="error, mm", xlim=(0.0, 2.5))
    axis.legend()
    yield "errors", figure, {}


EXPERIMENT = lab.Experiment("pose", measure, claims, TABLES, figures, globals(), model=MODELS[POSE])
