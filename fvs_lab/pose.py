"""A tag's pose: how fast and how exactly every scheme reaches it, beside a calibrated camera."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from fvs_detector_node.tags import Tag
from fvs_estimator_node.base import Estimator
from fvs_lab import contestants as who
from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab.outcome import Outcome
from fvs_lab.results import Results
from fvs_lab.trials import (
    PRELUDE_S,
    Bump,
    Case,
    Conditions,
    Trial,
    Variant,
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

_KIND = Pose()
#: Noise of each coordinate of an exact camera, m: like that of rendered images.
NOISE_M = 3e-4
#: How the tag is seen.
EXACT = Conditions(Pose.name, rendered=False, position_noise_m=NOISE_M)
IMAGES = Conditions(Pose.name, position_noise_m=0.0)
#: Schemes that are run with images, too.
SEEN = (who.BEST, who.EXTENDED, "proposed")
#: Calibrated cameras: rotation, degrees, and place, m, that the extrinsics are off by.
CALIBRATED = {
    "calibrated exactly": (0.0, 0.0),
    "calibrated, 1° and 5 mm off": (1.0, 0.005),
    "calibrated, 5° and 2 cm off": (5.0, 0.02),
}
#: Bodies whose rest is measured, of which the last two fill an A4 page, and the camera's distance,
#: m.
PLATE = "plate of 4 x 75 mm"
BODIES = {
    "one of 60 mm": Tag(tag_size_m=0.06),
    "one of 100 mm": Tag(tag_size_m=0.1),
    PLATE: Tag(tag_size_m=0.075, tag_layout="plate"),
    "cube of 50 mm": Tag(tag_size_m=0.05, tag_layout="cube"),
}
DISTANCE_M = 1.0
#: By how much the camera is turned on the spot and moved, degrees and m.
MOVED = (20.0, 0.1)
#: Largest median time over the floor, and final errors, m and degrees.
OVER_FLOOR, REST_M, REST_DEG = 1.15, 0.0005, 0.1
#: The same at 1 m with the plate; time over the undisturbed one, in this share.
BODY_M, MOVED_SLOWER, MOVED_SHARE = 0.0003, 1.3, 0.95


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


def _calibrated(off: tuple[float, float], simulation: Simulation, case: Case) -> Calibrated:
    """A calibrated camera, which is off by degrees and m in random directions."""
    axis, way = np.random.default_rng(case.seed).normal(size=(2, 3))
    turn = rotation_from_vector(np.array(along(axis, np.radians(off[0]))))
    shift_m = np.array(along(way, off[1]))
    return Calibrated(simulation.true_chain(_KIND).moved(turn, shift_m))


def calibrated(off: tuple[float, float] = (0.0, 0.0)) -> Variant:
    """The law of ``best`` with a calibrated camera, which is off by degrees and m."""
    return replace(who.variant(who.BEST), estimator=partial(_calibrated, off))


def floor_s(case: Case) -> float:
    """Least time until the tag stays within 5 mm, by the joints' limits, s."""
    return who.floor_s(case, simulation_of(EXACT).world.chain_with(_KIND))


def rest(outcome: Outcome) -> dict[str, float]:
    """Final errors of way, m, and turn, degrees, rms over the last second."""
    series, target_m = outcome.series, np.array(outcome.target_m)
    last = series["time_s"] > series["time_s"][-1] - FINAL_S
    parts = [_KIND.status_values(_KIND.minus(one, target_m)) for one in series["ball_m"][last]]
    errors = np.array([[one["way_m"], one["angle_rad"]] for one in parts])
    way_m, angle_rad = np.sqrt(np.mean(errors**2, axis=0)).tolist()
    return {"rest_m": way_m, "rest_deg": float(np.degrees(angle_rad))}


def _at_rest(context: lab.Context) -> Iterator[Trial]:
    """Bodies at rest."""
    for body, tag in BODIES.items():
        seen = Conditions(Pose.name, position_noise_m=0.0, camera_distance_m=DISTANCE_M, tag=tag)
        for case in make_cases("D", max(1, context.count(60) // 3), 421, 0.05, 0.2, seen):
            yield calibrated().labelled(part="rest", body=body).trial(case, seen, record=True)


def _moved(case: Case) -> Trial:
    """A trial of ``best`` whose camera is turned and moved before the target is given."""
    rng = np.random.default_rng(case.seed)
    # A camera that no longer sees the tag is another matter: draw until it does.
    while True:
        axis, way = rng.normal(size=(2, 3))
        bump = Bump(0.0, along(axis, MOVED[0]), along(way, MOVED[1]))
        if sees_all(EXACT, (case.start_rad, case.goal_rad), bump):
            one = who.variant(who.BEST).labelled(part="moved")
            return one.trial(case, EXACT, record=True, before=partial(_move, bump))


def _move(bump: Bump, one: ClosedLoop) -> None:
    bump.strike(one.simulation)
    one.run(PRELUDE_S)


def measure(context: lab.Context) -> lab.Found:
    """Run every scheme with an exact camera, some with images, and calibrated cameras."""
    cases = make_cases("P", context.count(60), 420, conditions=Conditions(Pose.name))
    floors_s = context.map(floor_s, cases, "the floor")
    floors = dict(zip([one.name for one in cases], floors_s, strict=True))
    schemes = (*SEEN, *(name for name in who.PUBLISHED if name not in SEEN), who.BEST_ORACLE)
    variants = [
        (who.variant(name).labelled(part="schemes", camera=camera), conditions)
        for name in schemes[: 2 if context.quick else None]
        for camera, conditions in (("exact", EXACT), ("images", IMAGES))
        if camera == "exact" or name in SEEN
    ]
    variants += [
        (calibrated(off).labelled(part="schemes", camera="exact", scheme=words), EXACT)
        for words, off in CALIBRATED.items()
    ]
    runs = context.run(
        [one.trial(case, seen, record=True) for case in cases for one, seen in variants],
        "poses",
        rest,
    ).adding(lambda row: {"over_5mm": row["to_5mm_s"] / floors[row["case"]]})
    alone = runs.where(part="schemes", scheme=who.BEST, camera="exact").groups("case")
    moved = context.run(map(_moved, cases), "moved cameras", rest).adding(
        lambda row: {"over_undisturbed": row["to_5mm_s"] / alone[row["case"]].rows[0]["to_5mm_s"]}
    )
    at_rest = () if context.quick else context.run(_at_rest(context), "rest", rest)
    facts = {"count": len(cases), "tag_m": SimConfig().tag.tag_size_m}
    return lab.Found(Results([*runs, *moved, *at_rest]), facts)


def claims(found: lab.Found) -> Iterator[lab.Claim]:
    """The chain's speed over the floor, its rest, and what a moved camera costs."""
    schemes = found.runs.where(part="schemes")
    best = schemes.where(scheme=who.BEST)
    for seen, runs in best.groups("camera").items():
        part = lab.below("time over the floor", runs.median("over_5mm"), OVER_FLOOR)
        yield lab.ours("fast", part, camera=seen)
    plate = found.runs.where(part="rest", body=PLATE)
    for name, runs, rest_m in (("rest", best.where(camera="images"), REST_M),
                               ("body", plate, BODY_M)):  # fmt: skip
        if runs:
            way = lab.below("final way", runs.median("rest_m"), rest_m, 1e3, " mm")
            yield lab.ours(name, way, lab.below("turn", runs.median("rest_deg"), REST_DEG))
    moved = found.runs.where(part="moved").values("over_undisturbed")
    yield lab.ours("moved", lab.kept("runs", [one <= MOVED_SLOWER for one in moved], MOVED_SHARE))
    parts = [
        lab.kept(f"targets reached by {name}", runs.values("settled"), 0.98)
        for name, runs in schemes.where(camera="exact").groups("scheme").items()
        if name in SEEN
    ]
    yield lab.ours("settles", *parts)


_REST = ("rest_m:half", "rest_deg:half", "settled:of")
TABLES = (
    lab.TableOf(
        "schemes",
        ("camera", "scheme"),
        ("over_5mm", *_REST, "failure:causes"),
        {"part": "schemes"},
    ),
    lab.TableOf("rest", ("body",), _REST, {"part": "rest"}),
)


def figures(found: lab.Found) -> Iterator[lab.Drawn]:
    """Errors over time of the first case."""
    runs = found.runs.where(part="schemes", camera="exact")
    first = runs.where(case=runs.rows[0]["case"])
    figure, ((axis,),) = draw.grid(1, 1, (9.0, 5.0))
    looks = {name: {"color": draw.colour_of(name)} for name in who.CONTESTANTS}
    draw.errors_over_time(axis, first, "scheme", looks)
    axis.set(xlabel="time since the target was given, s", ylabel="error, mm", xlim=(0.0, 2.5))
    axis.legend()
    yield "errors", figure, {}


EXPERIMENT = lab.Experiment("pose", measure, claims, TABLES, figures, globals(), model=Pose.model)
