"""A tag's pose: how fast and how exactly every scheme reaches it, beside a calibrated camera."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np

from fvs_detector_node.tag_pose import TagPose
from fvs_detector_node.tags import Tag
from fvs_estimator_node.base import Estimator
from fvs_lab import contestants as who
from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab.floor import Limits, fastest
from fvs_lab.outcome import BOUNDS_M, Outcome
from fvs_lab.results import Results
from fvs_lab.trials import (
    PRELUDE_S,
    Bump,
    Case,
    Conditions,
    Trial,
    along,
    make_cases,
    sees_all,
    simulation_of,
)
from fvs_ros.chain import SerialChain
from fvs_ros.kinds.pose import Pose
from fvs_ros.rotations import rotation_from_vector
from fvs_sim_node.config import SimConfig
from fvs_sim_node.simulation import Simulation
from fvs_tools.closed_loop import ClosedLoop
from fvs_tools.score import FINAL_S

_LIMITS = Limits(who.SPEED_RAD_S, who.ACCELERATION_RAD_S2)
_KIND = Pose()
#: Noise of each coordinate of an exact camera, m: like that of rendered images.
NOISE_M = 3e-4
#: How the tag is seen.
EXACT = Conditions(Pose.name, rendered=False, position_noise_m=NOISE_M)
IMAGES = Conditions(Pose.name, position_noise_m=0.0)
#: Schemes that are run with images, too.
SEEN = (who.BEST, who.EXTENDED, "proposed")
#: Calibrated cameras: rotation, degrees, and place, m, that the extrinsics are off by.
CALIBRATED = {"exact": (0.0, 0.0), "1° and 5 mm off": (1.0, 0.005), "5° and 2 cm off": (5.0, 0.02)}
#: Bodies whose rest is measured, of which the last two fill an A4 page, and distances of the
#: camera, m.
ONE, PLATE = "one of 60 mm", "plate of 4 x 75 mm"
BODIES = {
    ONE: Tag(tag_size_m=0.06),
    "one of 100 mm": Tag(tag_size_m=0.1),
    PLATE: Tag(tag_size_m=0.075, tag_layout="plate"),
    "cube of 50 mm": Tag(tag_size_m=0.05, tag_layout="cube"),
}
DISTANCES_M = (0.7, 1.0, 1.4)
#: Images that a rest is held against: those of the last second.
LAST_IMAGES = 30
#: By how much the camera is turned on the spot and moved, degrees and m.
MOVED = (20.0, 0.1)
#: Largest median time over the floor, and final errors, m and degrees.
OVER_FLOOR, REST_M, REST_DEG = 1.15, 0.0005, 0.1
#: The same at 1 m with the plate; over the bound; time over the undisturbed one, in this share.
BODY_M, OVER_BOUND, MOVED_SLOWER, MOVED_SHARE = 0.0003, 1.3, 1.3, 0.95


class Calibrated(Estimator):
    """The robot's true kinematics behind a camera whose pose was measured."""

    learns = False

    def __init__(self, chain: SerialChain) -> None:
        super().__init__(_KIND)
        self._chain = chain

    @property
    def chain(self) -> SerialChain:
        """The arm as the measured camera would see it."""
        return self._chain

    def jacobian(self, joints_rad: np.ndarray, z: np.ndarray | None = None) -> np.ndarray:
        """Of the chain, m/rad, (d, n)."""
        return self.kind.moved_by(*self._chain.motion(joints_rad))


@dataclass(frozen=True)
class CalibratedTrial(Trial):
    """A trial of the law of ``best`` with a calibrated camera, which is off by degrees and m."""

    off: tuple[float, float] = (0.0, 0.0)

    def loop(self, simulation: Simulation) -> ClosedLoop:
        """The whole loop in a simulation that has been reset."""
        axis, way = np.random.default_rng(self.case.seed).normal(size=(2, 3))
        turn = rotation_from_vector(np.array(along(axis, np.radians(self.off[0]))))
        shift_m = np.array(along(way, self.off[1]))
        chain = simulation.true_chain(_KIND).moved(turn, shift_m)
        values = {"law": self.variant.law, **self.variant.controller_values}
        return ClosedLoop(simulation, Calibrated(chain), values)


@lru_cache(maxsize=1)
def _arm() -> SerialChain:
    """The true kinematics, world frame."""
    return simulation_of(EXACT).world.chain_with(_KIND)


def floor_s(case: Case) -> float:
    """Least time until the tag stays within 5 mm, by the joints' limits, s."""
    return fastest(case, _LIMITS, BOUNDS_M["5 mm"], _arm()).time_s


def rest(outcome: Outcome) -> dict[str, float]:
    """Final errors of way, m, and turn, degrees, rms over the last second."""
    series, target_m = outcome.series, np.array(outcome.target_m)
    last = series["time_s"] > series["time_s"][-1] - FINAL_S
    parts = [_KIND.status_values(_KIND.minus(one, target_m)) for one in series["ball_m"][last]]
    way_m, angle_rad = np.array([[one["way_m"], one["angle_rad"]] for one in parts]).T
    return {"rest_m": _rms(way_m), "rest_deg": float(np.degrees(_rms(angle_rad)))}


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def bound_at_goal(run: tuple[Case, Conditions]) -> dict[str, float]:
    """Errors of the corners at a case's goal, and the bound of way, m, and turn, degrees.

    It is that of Cramer and Rao for the images of the last second, in which the errors that stay
    from image to image do not average out.
    """
    case, conditions = run
    simulation = simulation_of(conditions)
    simulation.reset(case.goal_rad, case.seed)
    faces, pose = conditions.tag.faces, simulation.true_tag_pose()

    def corners_px(numbers: tuple[int, ...], moved: np.ndarray) -> np.ndarray:
        turn = rotation_from_vector(moved[3:]) @ pose.rotation
        points_m = np.concatenate([faces[number].corners_m for number in numbers])
        return simulation.intrinsics.project(points_m @ turn.T + pose.position_m + moved[:3])

    looks = [simulation.look().detection for _ in range(LAST_IMAGES)]
    tags = [one for one in looks if isinstance(one, TagPose)]
    numbers = max((one.numbers for one in tags), key=[one.numbers for one in tags].count)
    true_px = corners_px(numbers, np.zeros(6))
    off_px = np.array(
        [one.corners_px.reshape(-1, 2) - true_px for one in tags if one.numbers == numbers]
    )
    step = 1e-6
    slopes = [
        (corners_px(numbers, one) - corners_px(numbers, -one)).ravel() / (2.0 * step)
        for one in step * np.eye(6)
    ]
    same_px2 = float(np.square(off_px.mean(axis=0)).mean())
    noise_px2 = float(off_px.var(axis=0, ddof=1).mean())
    bound = np.linalg.inv(np.array(slopes) @ np.transpose(slopes)).diagonal()
    bound = bound * (same_px2 + noise_px2 / LAST_IMAGES)
    return {
        "corner_px": (same_px2 + noise_px2) ** 0.5,
        "bound_m": float(bound[:3].sum() ** 0.5),
        "bound_deg": float(np.degrees(bound[3:].sum() ** 0.5)),
    }


def _at_rest(context: lab.Context) -> Iterator[Mapping[str, Any]]:
    """Rows of bodies at rest, with the bound of what their images hold."""
    runs: list[tuple[dict[str, Any], Trial]] = []
    for body, tag in list(BODIES.items())[: 1 if context.quick else None]:
        for distance_m in DISTANCES_M[1:2] if context.quick else DISTANCES_M:
            seen = Conditions(
                Pose.name, position_noise_m=0.0, camera_distance_m=distance_m, tag=tag
            )
            count = max(1, context.count(60, 1) // 3)
            for case in make_cases("D", count, 421, 0.05, 0.2, seen):
                labels = {"part": "rest", "body": body, "distance_m": distance_m, "case": case.name}
                trial = CalibratedTrial(who.variant(who.BEST), case, seen, record=True)
                runs.append((labels, trial))
    looks = [(trial.case, trial.conditions) for _, trial in runs]
    bounds = context.map(bound_at_goal, looks, "corners")
    rows = context.score(runs, "rest", rest)
    yield from ({**row, **bound} for row, bound in zip(rows, bounds, strict=True))


def _moved_cameras(context: lab.Context, cases: list[Case]) -> Iterator[Mapping[str, Any]]:
    """Rows of ``best`` whose camera is turned and moved before the target is given."""
    runs = []
    simulation = simulation_of(EXACT)
    for case in cases:
        rng = np.random.default_rng(case.seed)
        # A camera that no longer sees the tag is another matter: draw until it does.
        for _ in range(100):
            axis, way = rng.normal(size=(2, 3))
            bump = Bump(0.0, along(axis, MOVED[0]), along(way, MOVED[1]))
            simulation_of(EXACT)  # puts the camera back
            bump.strike(simulation)
            if sees_all(simulation, (case.start_rad, case.goal_rad)):
                break
        labels = {"part": "moved", "scheme": who.BEST, "camera": "exact", "case": case.name}
        trial = who.variant(who.BEST).trial(case, EXACT, record=True, before=partial(_move, bump))
        runs.append((labels, trial))
    yield from context.score(runs, "moved cameras", rest)


def _move(bump: Bump, one: ClosedLoop) -> None:
    bump.strike(one.simulation)
    one.run(PRELUDE_S)


def measure(context: lab.Context) -> lab.Found:
    """Run every scheme with an exact camera, some with images, and calibrated cameras."""
    cases = make_cases("P", context.count(60, 1), 420, conditions=Conditions(Pose.name))
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
    over = [{**row, "over_5mm": row["to_5mm_s"] / floors[row["case"]]} for row in scored]
    alone = {
        row["case"]: row["to_5mm_s"]
        for row in scored.where(part="schemes", scheme=who.BEST, camera="exact")
    }
    moved = [
        {**row, "over_undisturbed": row["to_5mm_s"] / alone[row["case"]]}
        for row in _moved_cameras(context, cases)
    ]
    results = Results([*over, *moved, *_at_rest(context)])
    return lab.Found(results, {"count": len(cases), "tag_m": SimConfig().tag.tag_size_m})


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
    at_1_m = found.runs.where(part="rest", distance_m=1.0)
    plate = at_1_m.where(body=PLATE)
    if plate:
        yield lab.ours(
            "body",
            lab.below("final way, mm", plate.median("rest_m"), BODY_M, 1e3),
            lab.below("final turn, degrees", plate.median("rest_deg"), REST_DEG),
        )
    one = at_1_m.where(body=ONE)
    yield lab.ours(
        "bound",
        lab.below("way over bound", one.rms("rest_m", "bound_m"), OVER_BOUND),
        lab.below("turn over bound", one.rms("rest_deg", "bound_deg"), OVER_BOUND),
    )
    moved = found.runs.where(part="moved").values("over_undisturbed")
    yield lab.ours(
        "moved",
        lab.kept("runs", sum(one <= MOVED_SLOWER for one in moved), len(moved), MOVED_SHARE),
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
    lab.TableOf(
        "rest",
        ("body", "distance_m"),
        ("corner_px", "rest_m", "bound_m", "rest_deg", "bound_deg", "settled:of"),
        {"part": "rest"},
    ),
    lab.TableOf(
        "moved",
        ("scheme",),
        ("over_undisturbed", "over_undisturbed:90 %", *_COLUMNS[2:]),
        {"part": "moved"},
    ),
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


EXPERIMENT = lab.Experiment("pose", measure, claims, TABLES, figures, globals(), model=Pose.model)
