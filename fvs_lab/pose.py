"""A tag's pose: how fast and how exactly every scheme reaches it, beside a calibrated camera."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from fvs_detector_node.tags import Tag
from fvs_estimator_node.base import Estimator
from fvs_estimator_node.camera import PoeEstimator
from fvs_lab import contestants as who
from fvs_lab import experiment as lab
from fvs_lab.results import Results
from fvs_lab.trials import Case, Conditions, Trial, along, crossed, make_cases, simulation_of
from fvs_ros.kinds.pose import Pose
from fvs_ros.rotations import rotation_from_vector
from fvs_sim_node.simulation import Simulation
from fvs_tools.score import FINAL_S

#: How the tag is seen; the noise of an exact camera is like that of rendered images, m.
EXACT = Conditions(feature=Pose.name, rendered=False, position_noise_m=3e-4)
IMAGES = Conditions(feature=Pose.name, position_noise_m=0.0)
#: Schemes that are run with images, too.
SEEN = ("best", "extended", "proposed")
#: Bodies whose rest is measured, of which the last two fill an A4 page.
BODIES = {
    "one of 60 mm": Tag(tag_size_m=0.06),
    "one of 100 mm": Tag(tag_size_m=0.1),
    "plate of 4 x 75 mm": Tag(tag_size_m=0.075, tag_layout="plate"),
    "cube of 50 mm": Tag(tag_size_m=0.05, tag_layout="cube"),
}


def _true_chain(off_deg: float, off_m: float, simulation: Simulation, case: Case) -> Estimator:
    """The robot's true kinematics behind a camera whose pose was measured.

    It is off by degrees and m in random directions.
    """
    axis, direction = np.random.default_rng(case.seed).normal(size=(2, 3))
    rotation = rotation_from_vector(np.array(along(axis, np.radians(off_deg))))
    chain = simulation.true_chain(Pose()).moved(rotation, np.array(along(direction, off_m)))
    return PoeEstimator(chain, kind=Pose())


def calibrated(off_deg: float, off_m: float, conditions: Conditions) -> Trial:
    """The law of ``best`` with a calibrated camera, which is off by degrees and m."""
    best = who.variant("best", conditions)
    return best.changed(learns=False, estimator_of=partial(_true_chain, off_deg, off_m))


def rest(row: Mapping[str, Any]) -> dict[str, float]:
    """Final errors of position, m, and angle, degrees, rms over the last second."""
    kind, series, target_m = Pose(), row["series"], np.array(row["target_m"])
    last = series["time_s"] > series["time_s"][-1] - FINAL_S
    parts = kind.parts_m(
        np.array([kind.minus(pose, target_m) for pose in series["feature_m"][last]])
    )
    position_m, arc_m = (float(np.sqrt(np.mean(part**2))) for part in parts.values())
    return {"rest_m": position_m, "rest_deg": float(np.degrees(arc_m / kind.unit[-1]))}


def at_rest(count: int) -> Iterator[Trial]:
    """Bodies before a camera 1 m away, until they rest."""
    for body, tag in BODIES.items():
        near = replace(IMAGES, camera_distance_m=1.0, tag=tag)
        cases = make_cases("D", count, 421, 0.05, 0.2, near)
        trial = calibrated(0.0, 0.0, near).changed({"part": "rest", "body": body}, record=True)
        yield from crossed([trial], cases)


def measure(context: lab.Context) -> Results:
    """Run every scheme with an exact camera, some with images, and calibrated cameras."""
    cases = make_cases("P", context.count(60), 420, conditions=Conditions(feature=Pose.name))
    chain = simulation_of(EXACT).world.chain_with(Pose())
    floors_s = context.map(who.floor_s, [(case, chain) for case in cases], "the floor")
    floors = dict(zip([case.name for case in cases], floors_s, strict=True))
    schemes = (*SEEN, *(name for name in who.CONTESTANTS if name not in SEEN))
    variants = [
        who.variant(name, conditions, camera=camera)
        for name in context.first(schemes, 2)
        for camera, conditions in (("exact", EXACT), ("images", IMAGES))
        if camera == "exact" or name in SEEN
    ]
    for name, off_deg, off_m in (
        ("calibrated exactly", 0.0, 0.0),
        ("calibrated, 1° and 5 mm off", 1.0, 0.005),
        ("calibrated, 5° and 2 cm off", 5.0, 0.02),
    ):
        camera = calibrated(off_deg, off_m, EXACT)
        variants.append(camera.changed({"camera": "exact", "scheme": name}))
    labelled = [trial.changed({"part": "schemes"}, record=True) for trial in variants]
    runs = context.run(crossed(labelled, cases), "poses").adding(
        lambda row: {**rest(row), "over_5mm": row["to_5mm_s"] / floors[row["case"]]}
    )
    bodies = () if context.quick else at_rest(max(1, len(cases) // 3))
    return Results([*runs, *context.run(bodies, "rest").adding(rest)])


def claims(runs: Results) -> Iterator[lab.Claim]:
    """The chain's speed over the floor, and its rest."""
    schemes = runs.where(part="schemes")
    best = schemes.where(scheme="best")
    for camera, group in best.groups("camera").items():
        part = lab.below("time over the floor", group.median("over_5mm"), 1.15)
        yield lab.ours("fast", part, camera=camera)
    plate = runs.where(part="rest", body="plate of 4 x 75 mm")
    for name, group, rest_m in (
        ("rest", best.where(camera="images"), 0.0005),
        ("body", plate, 0.0003),
    ):
        if group:
            position = lab.below("final position", group.median("rest_m"), rest_m, 1e3, " mm")
            yield lab.ours(name, position, lab.below("angle", group.median("rest_deg"), 0.1))
    parts = [
        lab.kept(f"targets reached by {name}", group.values("settled"), 0.98)
        for name, group in schemes.where(camera="exact").groups("scheme").items()
        if name in SEEN
    ]
    yield lab.ours("settles", *parts)


TABLES = (
    lab.Table(
        "schemes",
        ("camera", "scheme"),
        ("over_5mm", "rest_m:half", "rest_deg:half", "settled:of"),
        {"part": "schemes"},
    ),
    lab.Table("rest", ("body",), ("rest_m:half", "rest_deg:half", "settled:of"), {"part": "rest"}),
)
EXPERIMENT = lab.Experiment("pose", measure, claims, TABLES, globals(), model=Pose().model)
