"""Image points of webcams of which nothing is known: every scheme, noise, lenses, random arms."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import product
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from fvs_detector_node.tags import Tag
from fvs_estimator_node.base import Estimator, Estimators
from fvs_estimator_node.chain_fit import ChainFitError
from fvs_estimator_node.pixel_fit import PixelFit, fit_pixels
from fvs_estimator_node.registry import create_estimator
from fvs_estimator_node.training import TrainingOptions, train
from fvs_lab import contestants as who
from fvs_lab import estimators as judge
from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab.arms import HELD_BELOW, held_near_singular
from fvs_lab.correntropy import CorrentropyConfig, CorrentropyEstimator
from fvs_lab.floor import Limits, least_time_s
from fvs_lab.results import Results
from fvs_lab.room import Noise, Room, before
from fvs_lab.trials import BOX_RAD, HOME_RAD, Case, Trial, drive, relative_errors
from fvs_ros.chain import SerialChain
from fvs_ros.kinds.points import Points
from fvs_ros.pixel_chain import Webcam
from fvs_ros.rotations import rotation_from_vector
from fvs_sim_node.camera import CAMERAS, RigidPose
from fvs_sim_node.config import SimConfig
from fvs_sim_node.world import World
from fvs_tools.closed_loop import make_estimator
from fvs_tools.schemes import SCHEMES, Scheme
from fvs_tools.score import SETTLED_ERROR_M, settling_time_s

#: What is settled is within 1 px, rms of all points: as many deviations as of a ball.
SETTLED_PX = SETTLED_ERROR_M / Points.pixel_m
#: Side of the tag whose corners are four points, m: it fills an A4 page. Its corners beside the
#: first, in sides to the right and down.
TAG_M, CORNERS = 0.2, np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
#: Of the collector's motion, and of a run, which ends where it has been settled for a time, s.
MOTION_S, RUN_S, STAYS_S = 60.0, 4.0, 1.2
#: Of two webcams before the UR5.
POSES = (CAMERAS["front"], CAMERAS["side"])
LENSES = (Webcam(544.0, (307.0, 254.0)), Webcam(620.0, (330.0, 229.0)))
USUAL, K1, K1S = "0.3 px", -0.2, (0.0, -0.2, -0.3)
WHITE_PX = (0.2, 0.3, 1.0, 3.0)
#: Those with heavy tails, and all.
HEAVY = {"alpha-stable, 1.5": Noise(exponent=1.5), "2 % off by 20 px": Noise(outliers=0.02)}
NOISES = {
    **{f"{white_px:g} px": Noise(white_px) for white_px in WHITE_PX},
    **HEAVY,
    "encoders, 0.5 mrad": Noise(encoder_rad=5e-4),
}
ONE, FOUR, TWO = "one point, one camera", "four points, one camera", "one point, two cameras"
FAR = "four points, further away"
#: The tasks, by the share of the data's box that starts and targets are from.
TASKS = {ONE: 1.0, FOUR: 0.4, TWO: 1.0, FAR: 1.0}
#: Least way of a point from start to target, rms, px: some 0.2 m before the UR5; of random arms.
WAY_PX, LITTLE_PX = 80.0, 20.0
#: Random lenses: focal length and spread of the centre, px; where the cameras are: distance, m,
#: azimuth and height, rad.
FOCAL_PX, CENTRE_PX = (500.0, 700.0), 15.0
AWAY_M, AZIMUTH_RAD, HEIGHT_RAD = (1.0, 1.5), (-1.2, 1.2), (0.1, 1.0)
#: Count of random arms, of their joints, lengths of links, m, and half width of the box, rad.
WORLDS, JOINTS, LINKS_M, REACH_RAD = 500, (3, 7), (0.1, 0.35), 0.3
#: The published filter in place of the UKF.
MCKF = Scheme("mckf+mpc", "mckf", "mpc", "")
CONTESTANTS = {
    **{name: who.CONTESTANTS[name] for name in (*SCHEMES, who.ORACLE, "oracle, law of best")},
    MCKF.name: MCKF,
    "best": who.CONTESTANTS["best"],
}
#: Those that run in all conditions.
FEW = ("proposed", "rbf+pid", "ukf+mpc", MCKF.name, "best")
#: Estimators of a recording; the published one has the best of eight settings on other paths, too.
JUDGED = (
    judge.Contestant(judge.FROZEN, "frozen"),
    judge.Contestant(judge.PROPOSED, "rbf"),
    *(rival for rival in judge.RIVALS if rival.method != "ukf" and not rival.hears_prelude),
    judge.Contestant("MCKF", MCKF.method, {"process_noise": 0.03, "bandwidth": 4.0}),
    judge.Contestant("chain", "poe"),
)
PATHS, PATH_S = 6, 20.0


# ---- worlds ---------------------------------------------------------------------------------


class Task(NamedTuple):
    """What is seen, and how."""

    name: str = ONE
    noise: str = USUAL
    k1: float = K1


@lru_cache(maxsize=2)
def _ur5(points: int) -> SerialChain:
    """The UR5's axes and its points, world frame."""
    config = SimConfig(feature=Points.name, points=Points(points), tag=Tag(tag_size_m=TAG_M))
    world = World(config)
    chain = world.chain_with(config.kind)
    world.close()
    return chain


@lru_cache(maxsize=2)
def learned_room(task: Task) -> tuple[Room, Sequence[Any]]:
    """A UR5 before its webcams, and networks and chain of each camera by a minute of motion."""
    arm = _ur5(4 if task.name in (FOUR, FAR) else 1)
    lenses = [replace(lens, k1=task.k1) for lens in LENSES[: 1 + (task.name == TWO)]]
    chains = [before(arm, pose, lens) for pose, lens in zip(POSES, lenses, strict=False)]
    room = Room(chains, HOME_RAD, BOX_RAD, NOISES[task.noise])
    sets = room.collect(1, MOTION_S)
    trained: list[Any] = [train(data, TrainingOptions("poe")) for data in sets]
    return room, [replace(model, chain=model.chain.each[0]) for model in trained]


def drawn_camera(
    target_m: np.ndarray, k1: float, rng: np.random.Generator
) -> tuple[RigidPose, Webcam]:
    """A webcam anywhere about a point, which is not quite in mid-picture."""
    azimuth, height = rng.uniform(*AZIMUTH_RAD), rng.uniform(*HEIGHT_RAD)
    out = np.array([np.cos(azimuth) * np.cos(height), np.sin(azimuth) * np.cos(height)])
    eye_m = target_m + rng.uniform(*AWAY_M) * np.append(out, np.sin(height))
    aim_m = target_m + 0.08 * rng.normal(size=3)
    pose = RigidPose.looking(tuple(eye_m), tuple(aim_m)).rotated(0.2 * rng.normal(size=3))
    centre = np.array([320.0, 240.0]) + CENTRE_PX * rng.normal(size=2)
    return pose, Webcam(rng.uniform(*FOCAL_PX), tuple(centre.tolist()), k1)


def drawn_room(number: int) -> tuple[Room, str]:
    """A random arm before random webcams, which see all of its box; and its task."""
    rng = np.random.default_rng([441, number])
    joints = int(rng.integers(JOINTS[0], JOINTS[1] + 1))
    task = str(rng.choice([ONE] + [TWO] * (joints >= 4) + [FOUR] * (joints >= 6)))
    home, box = np.zeros(joints), np.full(joints, REACH_RAD)
    samples = REACH_RAD * rng.uniform(-1.0, 1.0, (200, joints))
    while True:
        axes, links_m = rng.normal(size=(2, joints + 1, 3))
        links_m *= rng.uniform(*LINKS_M, (joints + 1, 1)) / np.linalg.norm(links_m, axis=1)[:, None]
        points_m, k1 = np.cumsum(links_m, axis=0), rng.uniform(min(K1S), max(K1S))
        cameras = [drawn_camera(points_m[-1], k1, rng) for _ in range(1 + (task == TWO))]
        tag = cameras[0][0].rotation @ rotation_from_vector(0.4 * rng.normal(size=3))
        ways_m = TAG_M * CORNERS @ tag[:, :2].T if task == FOUR else np.empty(0)
        arm = SerialChain(axes[:-1], points_m[:-1], np.append(points_m[-1], ways_m), home)
        room = Room([before(arm, *camera) for camera in cameras], home, box, NOISES[USUAL])
        if room.sees(samples).all():
            return room, task


# ---- runs -----------------------------------------------------------------------------------


def estimator_of(room: Room, models: Sequence[Any], scheme: Scheme) -> Estimator:
    """A scheme's estimator, from what was learned."""
    if scheme.method == "oracle":
        return make_estimator(scheme.method, room)  # type: ignore[arg-type]

    def of_camera(model: Any, part: Any) -> Estimator:
        values = scheme.estimator_values
        if scheme.method == MCKF.method:
            return CorrentropyEstimator(model.model, CorrentropyConfig(**values), part)
        return create_estimator(scheme.method, values, lambda: model, part)

    each = tuple(map(of_camera, models, room.kind.parts))
    return each[0] if len(each) == 1 else Estimators(each, room.kind)


def cases_in(
    room: Room, share: float, count: int, seed: int, way_px: float = WAY_PX
) -> Iterator[Case]:
    """Starts and goals from a share of the box, at least so far apart, px."""
    rng = np.random.default_rng([442, seed])
    while count:
        drawn = share * room.box_rad * rng.uniform(-1.0, 1.0, (2, room.box_rad.size))
        ends = room.home_rad + drawn
        apart_px = np.linalg.norm(np.diff(room.true_chain().position(ends), axis=0))
        if room.sees(ends).all() and apart_px > way_px * (room.kind.numbers / 2) ** 0.5:
            start, goal = map(tuple, ends.tolist())
            yield Case(f"{seed}-{count}", start, goal, 1000 * seed + count)
            count -= 1


def floor_s(room: Room, case: Case) -> float | None:
    """Least time until it is settled, s; None where the optimiser fails."""
    chain: Any = room.true_chain()
    within_px = SETTLED_PX * (room.kind.numbers / 2) ** 0.5
    try:
        return least_time_s(case, Limits(*who.CLIPPED.values()), within_px, chain)
    except RuntimeError:
        return None


def servo(room: Room, models: Sequence[Any], name: str, case: Case) -> dict[str, Any]:
    """Servo by a scheme of the contestants: the row."""
    held = held_near_singular(room, room.home_rad, HELD_BELOW)  # type: ignore[arg-type]
    trial = Trial(
        CONTESTANTS[name],
        case=case,
        duration_s=RUN_S,
        stop_after_s=STAYS_S,
        record=True,
        estimator_of=lambda *_: estimator_of(room, models, CONTESTANTS[name]),
    ).changed(controller={**who.CLIPPED, **held})
    row = drive(trial, room)  # type: ignore[arg-type]
    series, each = row["series"], (room.kind.numbers / 2) ** -0.5
    settled_s = settling_time_s(series["time_s"], each * series["error_m"], SETTLED_ERROR_M)
    return {
        "scheme": name,
        "case": case.name,
        "settled": settled_s is not None,
        "to_1px_s": float("inf") if settled_s is None else settled_s,
        "rest_px": each * row["final_rms_m"] / Points.pixel_m,
        "failure": row["failure"] if settled_s is None else "",
    }


def of_task(part: str, task: Task, count: int) -> list[dict[str, Any]]:
    """The contestants in a part's task, for some targets: their rows."""
    room, models = learned_room(task)
    condition = task.noise if task.k1 == K1 else f"k1 = {task.k1:g}"
    labels = {"part": part, "task": task.name, "condition": condition}
    rows = []
    for case in cases_in(room, TASKS[task.name], count, 1):
        least_s = floor_s(room, case)
        for name in CONTESTANTS if part == "schemes" else FEW:
            row = servo(room, models, name, case)
            if least_s is not None:
                row |= {"over_1px": row["to_1px_s"] / least_s, "late_s": row["to_1px_s"] - least_s}
            rows.append({**labels, **row})
    return rows


def fit_or_why(room: Room, seed: int) -> tuple[list[PixelFit], str]:
    """What a minute of motion tells, of each camera; or why it tells nothing."""
    try:
        return [fit_pixels(data) for data in room.collect(seed, MOTION_S)], ""
    except ChainFitError as error:
        return [], str(error).partition(",")[0]


def fitted(noise_px: float, k1: float, seed: int) -> dict[str, Any]:
    """Fit a chain before a random webcam: how far off it is."""
    rng, arm = np.random.default_rng([443, seed]), _ur5(1)
    samples = HOME_RAD + BOX_RAD * rng.uniform(-1.0, 1.0, (500, len(HOME_RAD)))
    while True:
        true = before(arm, *drawn_camera(arm.position(HOME_RAD), k1, rng))
        room = Room([true], HOME_RAD, BOX_RAD, Noise(noise_px))
        if room.sees(samples).mean() > 0.9:
            break
    fits, why = fit_or_why(room, seed)
    row = {"part": "fit", "noise": f"{noise_px:g} px", "k1": k1, "case": seed}
    for chain in (fit.chain for fit in fits):
        off = relative_errors(chain.jacobian(samples), true.jacobian(samples))
        row |= {"learned": float(np.median(off)), "k1_off": abs(chain.webcam.k1 - k1)}
        row["focal"] = abs(chain.webcam.focal_px / true.webcam.focal_px - 1.0)
    return {**row, "settled": bool(fits), "failure": why}


def world(number: int) -> dict[str, Any]:
    """A random arm before random webcams, learned and servoed to a target by best: the row."""
    room, task = drawn_room(number)
    fits, why = fit_or_why(room, number)
    row = {"part": "worlds", "task": task, "joints": len(room.home_rad), "case": number}
    if why:
        return {**row, "settled": False, "failure": why}
    (case,) = cases_in(room, 1.0, 1, number, LITTLE_PX)
    return {**servo(room, [SimpleNamespace(chain=fit.chain) for fit in fits], "best", case), **row}


def judge_all(noise: str, seed: int) -> list[dict[str, Any]]:
    """Judge estimators on a recording with a noise, by its name: their rows."""
    room, models = learned_room(Task(noise=noise))
    recording = judge.record(seed, room, PATH_S)  # type: ignore[arg-type]
    rows = []
    for each in JUDGED:
        estimator = estimator_of(room, models, Scheme("", each.method, "", "", each.values))
        score = judge.score(recording, judge.jacobians_of(estimator, recording, False), PATH_S)
        labels = {"part": "estimators", "estimator": each.name, "condition": noise, "case": seed}
        rows.append({**labels, "t1_px": score["t1_m"] / Points.pixel_m})
    return rows


# ---- the experiment -------------------------------------------------------------------------


def measure(context: lab.Context) -> Results:
    """Measure all parts; each row names its ``part``."""
    count = context.count(20)
    conditions = [*(Task(TWO, noise) for noise in NOISES), *(Task(TWO, k1=k1) for k1 in K1S[::2])]
    tasks = [("schemes", Task(name), count) for name in TASKS]
    tasks += [("conditions", task, count) for task in conditions]
    seeds = range(1, 1 + count)
    worlds = range(1, 1 + context.count(WORLDS))
    rows = context.rows(of_task, tasks[2:6:3] if context.quick else tasks, "schemes")
    paths = product(context.first(NOISES, 1), range(1, 1 + context.count(PATHS)))
    rows += context.rows(judge_all, paths, "estimators")
    rows += context.map(fitted, context.first(product(WHITE_PX, K1S, seeds), 2), "fits")
    return Results([*rows, *context.map(world, worlds, "worlds")])


def claims(runs: Results) -> Iterator[lab.Claim]:
    """Speed and safety of the schemes; what a fit tells; the published filter; random arms."""
    parts = runs.groups("part")
    for task, group in parts["schemes"].groups("task").items():
        of = group.groups("scheme")
        yield lab.ours("settles", lab.kept("targets", of["best"].values("settled"), 1.0), task=task)
        if task == FAR:
            continue
        over = lab.below("over the floor", of["best"].median("over_1px"), 1.15)
        yield lab.ours("fast", over, task=task)
        ratios = [
            lab.below(f"time over that of {name}", of["proposed"].over(of[name], "to_1px_s"), 1.0)
            for name in SCHEMES
            if name != "proposed"
        ]
        yield lab.papers("fastest", *ratios, task=task)
    noises = parts["conditions"].where(scheme="best").groups("condition")
    kept = [lab.kept(f"targets, {name}", of.values("settled"), 1.0) for name, of in noises.items()]
    yield lab.ours("conditions", *kept)
    usual = parts["fit"].where(noise=USUAL)
    for name, column, most in (("jacobian", "learned", 0.003), ("focal", "focal", 0.02)):
        exact = [row.get(column, np.inf) <= most for row in usual]
        yield lab.ours(name, lab.kept("fits", exact, 1.0))
    heard = parts["estimators"].groups("condition", "estimator")
    for condition in HEAVY if len(parts["estimators"].groups("condition")) > 1 else ():
        kalman = next(each.name for each in JUDGED if each.method == "lkf")
        ratio = heard[condition, "MCKF"].over(heard[condition, kalman], "t1_px")
        part = lab.below("T1 over that of the LKF", ratio, 1.0)
        yield lab.Claim("mckf", [part], "Leite et al.", arguments={"condition": condition})
    yield lab.ours("worlds", lab.kept("worlds", parts["worlds"].values("settled"), 0.99))


_FITS = ("learned:half", "learned:largest", "focal:half", "focal:largest", "k1_off:half")
_RUN = ("settled:of", "to_1px_s:half", "rest_px:half", "rest_px:95 %", "failure:causes")
TABLES = (
    lab.Table("schemes", ("task", "scheme"), ("over_1px", *_RUN), {"part": "schemes"}),
    lab.Table("over", ("condition",), ("over_1px:half",), {"part": "conditions"}, "scheme"),
    lab.Table("settled", ("condition",), ("settled:of",), {"part": "conditions"}, "scheme"),
    lab.Table("t1", ("estimator",), ("t1_px:half",), {"part": "estimators"}, "condition"),
    lab.Table("fits", ("noise", "k1"), ("settled:of", *_FITS), {"part": "fit"}),
    lab.Table("worlds", ("task",), _RUN, {"part": "worlds"}),
)


def figures(runs: Results) -> Iterator[lab.Drawn]:
    """Settling over the floor, by task and scheme."""
    tasks = runs.where(part="schemes").groups("task")
    figure, (axes,) = draw.grid(1, len(tasks), (4.0 * len(tasks), 4.0), sharey=True)
    for axis, (task, group) in zip(axes, tasks.items(), strict=True):
        draw.dots_of(axis, group, "scheme", "over_1px", most=8.0)
        draw.plain_ticks(axis, (1, 1.5, 2, 3, 5, 8))
        axis.set_title(task)
    yield "schemes", figure, {}


EXPERIMENT = lab.Experiment("points", measure, claims, TABLES, globals(), figures, model="")
