"""Teach and repeat: targets relative to an object, beside calibrated cameras and the URDF."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache, partial
from itertools import product
from typing import Any

import cv2
import numpy as np

from fvs_controller_node.references import Reference
from fvs_detector_node.tags import Tag
from fvs_estimator_node.camera import PoeEstimator
from fvs_estimator_node.chain_fit import fit_chain
from fvs_lab import contestants as who
from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab.arms import collect
from fvs_lab.calibration import TAUGHT, arm, motion, zeros_rad
from fvs_lab.results import Results
from fvs_lab.robustness import EVERYDAY
from fvs_lab.trials import (
    BOX_RAD,
    HOME_RAD,
    Case,
    Conditions,
    Joints,
    Trial,
    Vector,
    along,
    make_cases,
    outcome,
    placed,
    simulation_of,
)
from fvs_ros.chain import SerialChain
from fvs_ros.kinds.pose import Pose
from fvs_sim_node.camera import RigidPose
from fvs_sim_node.simulation import Observation, Simulation
from fvs_tools.score import FINAL_S

KIND = Pose()
#: Who repeats: our schemes with a relative target; the classic ways; ours with an absolute target.
OURS = ("best", "proposed")
LOOK, SERVO, VISP = CLASSIC = ("look, then move", "URDF, law of best", "URDF, exponential law")
TRAINED = "best, trained there"
ABSOLUTE = tuple(f"{name}, absolute" for name in OURS)
#: Gain of the exponential law: of 2, 4, 6, 8, 12 and 16/s it settled six other tasks soonest.
VISP_1_S = 16.0
#: What is asked of a repeated relation, m and degrees.
GOOD_M, GOOD_DEG = 0.001, 0.3
#: Columns of pegs by degrees of freedom and clearance, mm; their length, m.
PEGS = {(free, mm): f"{mm:g} mm in {free}" for free, mm in product((3, 4, 6), (0.2, 0.5, 1.0))}
PEG_M = 0.03
#: Times in which all is seen at rest before a run, of a run to an object at rest, before an object
#: begins to move, while it moves, and from then until its lag counts, s.
SEEN_S, REST_S, STILL_S, MOVING_S, CATCH_UP_S = 1.0, 3.0, 1.0, 2.5, 1.0
#: Images at rest that the classic ways average, exact or rendered: these differ less.
AVERAGED = {False: 10, True: 2}
#: OpenCV 5.0.0 lacks it in Python; without it, the classic ways have no rows.
_SOLVE: Any = getattr(cv2, "calibrateRobotWorldHandEye", None)


# ---- the world ------------------------------------------------------------------------------


class Scene(Simulation):
    """A simulation whose exact camera may have an undeclared lens, and wrong prints."""

    config: View

    def look(self, number: int = 0) -> Observation:
        """Expose an image."""
        image, view = super().look(number), self.config
        if view.rendered:
            return image
        z = view.shown(image.z, view.tool_print)
        return replace(image, z=z, object_z=view.shown(image.object_z, view.object_print))


@dataclass(frozen=True)
class View(Conditions):
    """Conditions with an object and, if images are not rendered, errors of k1 and of prints."""

    simulation = Scene
    feature: str = Pose.name
    position_noise_m: float = 3e-4
    rendered: bool = False
    object_tag_id: int = 10
    object_tag_size_m: float = Tag.tag_size_m
    object_tag_layout: str = Tag.tag_layout
    #: A coefficient k1 that nobody states.
    radial: float = 0.0
    #: True sizes of the prints over those stated, less 1.
    tool_print: float = 0.0
    object_print: float = 0.0

    def shown(self, z: np.ndarray | None, print_: float) -> np.ndarray | None:
        """What is measured of a pose, (12,), with these errors."""
        if z is None or not (self.radial or print_):
            return z
        nearer = np.append(z[:3] / (1.0 + print_), z[3:])
        return np.asarray(KIND.through_lens(nearer[None], 0.0, self.radial)[0])


def seen_from(camera: RigidPose, z: np.ndarray) -> np.ndarray:
    """A pose in the world's frame as a camera sees it, both (12,)."""
    return KIND.of_body(camera.to_own(z[:3]), camera.rotation.T @ KIND.rotation(z))


def sees(
    view: View, robot: SerialChain, camera: RigidPose, joints_rad: np.ndarray, object_z: np.ndarray
) -> bool:
    """Whether a camera sees the tags of arm and object, and the arm is not near singular."""
    tool, angular, linear_m = robot.motion(joints_rad)
    if np.linalg.svd(KIND.moved_by(tool, angular, linear_m), compute_uv=False)[-1] < 0.08:
        return False
    lens = view.lens()
    size_px = np.array([lens.width, lens.height])
    for pose, tag in ((tool, view.tag), (object_z, view.object_tag)):
        assert tag is not None
        z = seen_from(camera, pose)
        rotation = KIND.rotation(z)
        corners_m = np.concatenate([face.corners_m for face in tag.faces.values()])
        points_m = corners_m @ rotation.T + z[:3]
        if -rotation[:, 2] @ z[:3] < 0.5 * np.linalg.norm(z[:3]) or points_m[:, 2].min() < 0.3:
            return False
        points_px = lens.project(points_m)
        if points_px.min() < 10.0 or (points_px > size_px - 10.0).any():
            return False
    return True


def joints_at(chain: SerialChain, z: np.ndarray, start_rad: np.ndarray) -> np.ndarray | None:
    """Joints, rad, at which a chain carries its tag at z, (12,); None if they are not near."""
    joints = start_rad.copy()
    for _ in range(50):
        error_m = KIND.minus(z, chain.position(joints))
        if np.linalg.norm(error_m) < 1e-9:
            return joints
        step = np.linalg.lstsq(KIND.moved_by(*chain.motion(joints)), error_m, rcond=1e-3)[0]
        joints += step * min(1.0, 0.3 / np.abs(step).max())
    return None


# ---- what is repeated -----------------------------------------------------------------------


@dataclass(frozen=True)
class Setting:
    """What differs between teaching and repeating, and what is wrong all the time."""

    name: str
    view: View = field(default_factory=View)
    #: Who repeats it.
    who: tuple[str, ...] = ("best", LOOK)
    #: Largest motion of the object in between, m and degrees; that of the camera.
    object_moved: tuple[float, float] = (0.2, 60.0)
    camera_moved: tuple[float, float] = (0.0, 0.0)
    #: Errors of the URDF: joints' zeros, degrees, and links, m.
    zeros_deg: float = 0.0
    links_m: float = 0.0
    #: Motion of the object: a belt, m/s, or a turntable, degrees/s.
    belt_m_s: float = 0.0
    turntable_deg_s: float = 0.0
    #: Least and largest distance between tool and object, m.
    apart_m: tuple[float, float] = (0.1, 0.2)

    def task(self, number: int) -> Task:
        """Draw a task: a function of its number.

        Magnitudes come from the ranges; places and directions are drawn again until the arm
        reaches all places and the camera sees both tags there.
        """
        rng = np.random.default_rng([430, number])
        apart_m = rng.uniform(*self.apart_m)
        moved_m, moved_deg = (most * rng.uniform() for most in self.object_moved)
        exact = replace(self.view, rendered=False)
        world = simulation_of(self.view).world.chain_with(KIND)
        while True:
            seed = int(rng.integers(2**31))
            (case,) = make_cases(f"{number}-", 1, seed, conditions=exact)
            start, goal = np.array(case.start_rad), np.array(case.goal_rad)
            first = simulation_of(self.view).camera
            shift_m, turn_deg = (along(rng.normal(size=3), size) for size in self.camera_moved)
            camera = first.rotated(np.radians(turn_deg)).moved(np.array(shift_m))
            # Beside the tool, as the camera sees it, and turned a little.
            angle = rng.uniform(0.0, 2.0 * np.pi)
            beside = camera.rotation @ [np.cos(angle), np.sin(angle), rng.uniform(-0.3, 0.3)]
            turn_m = KIND.lever_arm_m * np.radians(along(rng.normal(size=3), rng.uniform(0, 20)))
            tool = world.position(goal)
            place = KIND.retract(tool, np.append(along(beside, apart_m), turn_m))
            relation = KIND.relative(tool, place)
            if self.moves:  # the goal is in mid-way; taught where the object begins
                angle, sign = rng.uniform(0.0, 2.0 * np.pi), rng.choice([-1.0, 1.0])
                belt_m_s = self.belt_m_s * np.array([np.cos(angle), np.sin(angle), 0.0])
                speed = tuple(belt_m_s.tolist()), float(sign * self.turntable_deg_s)
                taught_place, last = (carried(place, *speed, s * MOVING_S) for s in (-0.5, 0.5))
            else:
                speed, last = ((0.0, 0.0, 0.0), 0.0), place
                way_m = along(rng.normal(size=3), moved_m)
                arc_m = along(rng.normal(size=3), KIND.lever_arm_m * np.radians(moved_deg))
                taught_place = KIND.retract(place, np.array([*way_m, *arc_m]))
            taught, end = (
                joints_at(world, KIND.absolute(relation, z), goal) for z in (taught_place, last)
            )
            if taught is None or end is None:
                continue
            if self.moves:
                start, place = taught, taught_place
            looks = [(first, taught, taught_place), (camera, start, place), (camera, end, last)]
            task = Task(
                self,
                replace(case, start_rad=tuple(start.tolist()), goal_rad=tuple(end.tolist())),
                tuple(taught.tolist()),
                relation,
                (first, camera),
                (taught_place, place),
                speed,
            )
            if all(sees(self.view, world, *look) for look in looks) and task.is_seen():
                return task

    @property
    def moves(self) -> bool:
        """Whether the object moves."""
        return bool(self.belt_m_s or self.turntable_deg_s)


def carried(z: np.ndarray, velocity_m_s: Vector, rate_deg_s: float, time_s: float) -> np.ndarray:
    """Where belt or turntable have carried a pose, world frame, (12,)."""
    turn_m = np.array([0.0, 0.0, KIND.lever_arm_m * np.radians(rate_deg_s)])
    return KIND.retract(z, time_s * np.append(velocity_m_s, turn_m))


@dataclass(frozen=True)
class Task:
    """A relation to teach, and to repeat from the case's start."""

    setting: Setting
    case: Case
    taught_rad: Joints
    #: The tool in the object's frame, (12,).
    relation: np.ndarray
    #: At teaching and at repeating: the camera, and the object in the world's frame, (12,).
    cameras: tuple[RigidPose, RigidPose]
    places: tuple[np.ndarray, np.ndarray]
    #: How the object moves in the end, m/s and degrees/s about its vertical.
    speed: tuple[Vector, float]

    def prepare(self, when: int, joints_rad: np.ndarray | Joints, seed: int) -> Simulation:
        """The scene at teaching (0) or repeating (1), all at rest, the arm at joints, rad."""
        place = self.places[when]
        pose = RigidPose(place[:3], KIND.rotation(place))
        scene = simulation_of(placed(self.setting.view, pose))
        scene.camera = self.cameras[when]
        scene.reset(joints_rad, seed)
        return scene

    def is_seen(self) -> bool:
        """Whether both tags are detected at teaching, at the start and in the end."""
        ends = (0, self.taught_rad), (1, self.case.start_rad), (1, self.case.goal_rad)
        if not self.setting.view.rendered:
            return True  # what hides them is not simulated
        looks = [self.prepare(*end, self.case.seed).look() for end in ends]
        return all(look.z is not None and look.object_z is not None for look in looks)

    def taught(self, trial: Trial) -> Reference | None:
        """What a controller keeps of the relation; None if it refuses for three seconds."""
        scene = self.prepare(0, self.taught_rad, self.case.seed)
        loop = trial.loop(scene)
        loop.run(1.2)
        for _ in range(10):
            with suppress(ValueError):  # noise may look like motion
                return loop.loop.teach(loop.simulation.time_s)
            loop.run(0.2)
        return None

    @cached_property
    def calibrated(self) -> tuple[SerialChain, SerialChain]:
        """The URDF's arm as the calibrated camera sees it, at teaching and at repeating."""
        first = self._calibrate(0)
        return first, self._calibrate(1) if any(self.setting.camera_moved) else first

    def _calibrate(self, when: int) -> SerialChain:
        setting, robot = self.setting, arm()
        zeros = zeros_rad(self.case.seed, setting.zeros_deg)
        rng = np.random.default_rng([self.case.seed, 9])
        shifts = rng.normal(size=(len(zeros), 3))
        shifts *= setting.links_m / np.linalg.norm(shifts, axis=1, keepdims=True)
        shifts_m = np.cumsum(shifts, axis=0)
        points_m, tip_m = robot.points_m + shifts_m, robot.tip_m + shifts_m[-1]
        robot = replace(robot, points_m=points_m, tip_m=tip_m)
        tips: list[tuple[np.ndarray, np.ndarray]] = []
        boards: list[tuple[np.ndarray, np.ndarray]] = []
        while len(tips) < TAUGHT:
            drawn = HOME_RAD + rng.uniform(-1.0, 1.0, HOME_RAD.size) * BOX_RAD
            z, _ = self.measured(when, drawn, int(rng.integers(2**31)))
            if z is not None:
                tip_from_base, tip_at_m = robot.tip_at(drawn - zeros)
                tips.append((tip_from_base.T, tip_at_m))
                boards.append((KIND.rotation(z), z[:3]))
        # The solver is for a camera in the hand: here the tag is its world, and the tip its base.
        tag_from_tip, tip_in_tag_m, camera_from_base, base_m = _SOLVE(
            *map(list, zip(*boards, strict=True)), *map(list, zip(*tips, strict=True))
        )
        rotation = robot.tip_rotation @ tag_from_tip.T
        carries = KIND.of_body(robot.tip_m - rotation @ tip_in_tag_m.ravel(), rotation)
        chain = replace(robot.chain(carries), reference_rad=zeros)
        return chain.moved(camera_from_base, base_m.ravel())

    def measured(
        self, when: int, joints_rad: np.ndarray | Joints, seed: int
    ) -> tuple[np.ndarray | None, ...]:
        """Tool and object at rest, (12,), averaged; None for what is not seen."""
        scene = self.prepare(when, joints_rad, seed)
        looks = [scene.look() for _ in range(AVERAGED[scene.config.rendered])]
        images = zip(*((look.z, look.object_z) for look in looks), strict=True)
        seen = ([z for z in body if z is not None] for body in images)
        return tuple(
            KIND.nearest(np.mean(body, axis=0)) if len(body) == len(looks) else None
            for body in seen
        )


# ---- who repeats it -------------------------------------------------------------------------


@lru_cache(maxsize=4)
def trained_chain(view: View) -> SerialChain:
    """The chain that a minute of motion before this camera gives."""
    return fit_chain(collect(simulation_of(view), motion(1, Pose.name))).chain


def ours(name: str) -> Trial:
    """A scheme of ours; the arm may hide the object for a while."""
    return who.variant(name, View()).changed(controller={"object_may_be_hidden_s": 2.0})


def by_chain(chain: SerialChain, learns: bool = False, **law: Any) -> Trial:
    """Servoing by a chain that is known: with the law of best, or another."""
    return ours("best").changed(
        controller=law, learns=learns, estimator_of=lambda *_: PoeEstimator(chain, kind=KIND)
    )


def failed(cause: str) -> dict[str, Any]:
    """The columns of a run that did not begin."""
    never = dict.fromkeys(("to_5mm_s", "rest_m", "rest_deg"), np.inf)
    return {**never, "good": False, "failure": cause}


def repeat(task: Task, trial: Trial, relative: bool = True) -> dict[str, Any]:
    """Repeat a taught relation, or go to where that is; the columns of the row."""
    case, moves, trial = task.case, task.setting.moves, replace(trial, case=task.case)
    taught = task.taught(trial) if relative else None
    if relative and taught is None:
        return failed("not taught")
    scene = task.prepare(1, case.start_rad, case.seed + 1)
    loop = trial.loop(scene)
    loop.run(SEEN_S)

    def target() -> np.ndarray:
        object_z = scene.true_object()
        assert object_z is not None
        return KIND.absolute(task.relation, object_z)

    if taught is not None:
        accepted, text = loop.loop.go_to(taught)
        assert accepted, text
    else:
        loop.set_target(target())
    commands, errors_m = [], []
    for tick in range(round((STILL_S + MOVING_S if moves else REST_S) / loop.period_s)):
        if moves and tick == round(STILL_S / loop.period_s):
            names = ("object_velocity_m_s", "object_turn_rate_deg_s")
            speed: dict[str, Any] = dict(zip(names, task.speed, strict=True))
            scene.configure(replace(scene.config, camera_pose=scene.camera, **speed))
        commands.append(loop.tick())
        errors_m.append(KIND.minus(loop.true_feature, target()))
    errors, times_s = np.array(errors_m), loop.period_s * np.arange(1, 1 + len(errors_m))
    judged = outcome(times_s, np.linalg.norm(errors, axis=1), commands)
    if moves:
        late_m = errors[times_s > STILL_S + CATCH_UP_S, :3]
        return {**judged, "rms_m": float(np.sqrt(np.mean(np.sum(late_m**2, axis=1))))}
    return {**judged, **rest(task, errors[times_s > times_s[-1] - FINAL_S])}


def rest(task: Task, errors_m: np.ndarray) -> dict[str, Any]:
    """Errors at rest, camera frame, m, (k, 6), summed up: rms, and which pegs they let in."""
    object_z = seen_from(task.cameras[1], task.places[1])
    parts_m = errors_m.reshape(-1, 2, 3) @ KIND.rotation(object_z)
    rms_m = np.sqrt(np.mean(parts_m**2, axis=0))
    angles_deg = np.degrees(rms_m[1] / KIND.lever_arm_m)
    rest_m, rest_deg = (float(np.linalg.norm(part)) for part in (rms_m[0], angles_deg))
    turned_deg = {3: 0.0, 4: angles_deg[2], 6: rest_deg}
    pegs = {
        name: bool(
            rms_m[0].max() <= 1e-3 * mm and turned_deg[free] <= np.degrees(1e-3 * mm / PEG_M)
        )
        for (free, mm), name in PEGS.items()
    }
    good = rest_m <= GOOD_M and rest_deg <= GOOD_DEG
    return {"rest_m": rest_m, "rest_deg": rest_deg, "good": good, **pegs}


def look_then_move(task: Task) -> dict[str, Any]:
    """One open-loop move by the URDF to where the object is seen; the columns of the row."""
    case, (before, after) = task.case, task.calibrated
    _, taught_object = task.measured(0, task.taught_rad, case.seed)
    _, object_z = task.measured(1, case.start_rad, case.seed + 1)
    assert taught_object is not None
    assert object_z is not None
    relation = KIND.relative(before.position(np.array(task.taught_rad)), taught_object)
    joints = joints_at(after, KIND.absolute(relation, object_z), np.array(case.goal_rad))
    if joints is None:
        return failed("out of reach")
    scene = task.prepare(1, joints, case.seed)
    truth = KIND.absolute(task.relation, seen_from(task.cameras[1], task.places[1]))
    return rest(task, KIND.minus(scene.true_feature(), truth)[None])


def rows_of(setting: Setting, number: int) -> list[dict[str, Any]]:
    """The rows of a setting's contestants in one drawn task."""
    task = setting.task(number)
    runs: dict[str, Callable[[], dict[str, Any]]] = {
        name: partial(repeat, task, ours(name)) for name in OURS
    }
    runs |= {f"{name}, absolute": partial(repeat, task, ours(name), False) for name in OURS}
    runs[TRAINED] = lambda: repeat(task, by_chain(trained_chain(setting.view), learns=True))
    if _SOLVE:
        runs[LOOK] = lambda: look_then_move(task)
        runs[SERVO] = lambda: repeat(task, by_chain(task.calibrated[1]))
        law: dict[str, Any] = {"law": "proportional", "proportional_gain_1_s": VISP_1_S}
        runs[VISP] = lambda: repeat(task, by_chain(task.calibrated[1], **law))
    names = [name for name in setting.who if name in runs]
    labels = {"setting": setting.name, "case": task.case.name}
    return [{**labels, "scheme": name, **runs[name]()} for name in names]


# ---- the experiment -------------------------------------------------------------------------

CAMERA_MOVED = (0.3, 30.0)
LENS = ("best", TRAINED, LOOK)
MOVED = Setting("object moved", who=(*OURS, *CLASSIC, *ABSOLUTE))
WRONG_URDF = Setting(
    "URDF 1° and 5 mm off", who=("best", LOOK, SERVO), zeros_deg=1.0, links_m=0.005
)
RESTS = (
    MOVED,
    Setting("camera moved, too", camera_moved=CAMERA_MOVED),
    Setting("camera moved, focal 5 % off", View(focal_error=0.05), LENS, camera_moved=CAMERA_MOVED),
    Setting("distortion -0.1", View(radial=-0.1), LENS),
    Setting("prints 2 % too large", View(tool_print=0.02, object_print=0.02)),
    Setting("the tool's print 2 % too large", View(tool_print=0.02)),
    WRONG_URDF,
)
_moving = partial(Setting, who=("best", VISP))
BELTS = tuple(_moving(f"belt, {speed:g} m/s", belt_m_s=speed) for speed in (0.05, 0.1, 0.2))
TURNTABLE = _moving("turntable, 30°/s", turntable_deg_s=30.0)
PLATE = View(
    rendered=True,
    image_rate_hz=15.0,
    position_noise_m=0.0,
    camera_distance_m=1.0,
    tag=Tag(tag_size_m=0.075, tag_layout="plate"),
    object_tag_size_m=0.075,
    object_tag_layout="plate",
)
SINGLE = replace(
    PLATE, tag=Tag(tag_size_m=0.06), object_tag_size_m=0.06, object_tag_layout="single"
)
PLATES = Setting("plates", PLATE, apart_m=(0.21, 0.25))
WRONG_LENS = replace(
    PLATES,
    name="plates, camera moved, focal 5 % off",
    view=replace(PLATE, focal_error=0.05),
    who=(TRAINED,),
    camera_moved=CAMERA_MOVED,
)
WORLDS_MOVED = (0.3, 10.0)
PARTS = {
    "rest": RESTS,
    "moving": (*BELTS, TURNTABLE),
    "images": (PLATES, WRONG_LENS, Setting("single tags of 60 mm", SINGLE)),
}


def world(number: int) -> Setting:
    """A random world: a function of its number."""
    rng = np.random.default_rng([433, number])
    ranges = {**EVERYDAY.ranges, "position_noise_m": (0.0002, 0.0005)}
    amount = {name: float(rng.uniform(*range_)) for name, range_ in ranges.items()}
    amount["speed_scaling_percent"] = 100.0 * amount["drive_gain"]
    others = ("camera_carried_deg", "noise_exponent", "depth_error")
    names = {item.name for item in fields(View)}.difference(others)
    changes: dict[str, Any] = {name: amount[name] for name in amount if name in names}
    camera_m, camera_deg = (most * rng.uniform() for most in WORLDS_MOVED)
    return Setting("worlds", View(**changes), camera_moved=(camera_m, camera_deg))


def measure(context: lab.Context) -> Results:
    """Repeat relations in all settings, and in random worlds."""
    rows = list[dict[str, Any]]()
    for part, settings in PARTS.items():
        if part == "images" and context.quick:
            continue
        drawn = product(context.first(settings, 1), range(1, 1 + context.count(60)))
        rows += [{"part": part, **row} for row in context.rows(rows_of, drawn, part)]
    jobs = [(world(number), number) for number in range(1, 1 + context.count(500))]
    for row in context.rows(rows_of, jobs, "worlds"):
        cause = "" if row["good"] else "position" if row["rest_m"] > GOOD_M else "angle"
        rows.append({"part": "worlds", **row, "failure": row.get("failure") or cause})
    return Results(rows)


def claims(runs: Results) -> Iterator[lab.Claim]:
    """Rest, with images and a wrong lens; time; random worlds; what moves."""
    for name, setting, scheme in (("rest", PLATES, "best"), ("lens", WRONG_LENS, TRAINED)):
        if group := runs.where(setting=setting.name, scheme=scheme):
            yield lab.ours(
                name,
                lab.below("median position", group.median("rest_m"), 0.0002, 1e3, " mm"),
                lab.below("median angle, degrees", group.median("rest_deg"), 0.05),
                lab.kept("runs within 1 mm and 0.3°", group.values("good"), 1.0),
            )
    moved = runs.where(setting=MOVED.name).groups("scheme")
    ratios = (moved[name].over(moved[f"{name}, absolute"], "to_5mm_s") for name in OURS)
    parts = [lab.below(name, ratio, 1.05) for name, ratio in zip(OURS, ratios, strict=True)]
    yield lab.ours("time", *parts)
    good = runs.where(part="worlds", scheme="best").values("good")
    yield lab.ours("worlds", lab.kept("worlds", good, 0.99))
    if belt := runs.where(setting=BELTS[1].name, scheme="best"):
        lag = lab.below("distance, mm rms", belt.median("rms_m"), 0.0015, 1e3, " mm")
        yield lab.ours("belt", lag)
    if SERVO in moved:
        ratio = moved["best"].over(moved[SERVO], "rest_m")
        yield lab.ours("calibrated", lab.below("final position over that", ratio, 1.1))
    off = runs.where(setting=WRONG_URDF.name).groups("scheme")
    if LOOK in off:
        ratio = off["best"].over(off[LOOK], "rest_m")
        yield lab.ours("open", lab.below("final position over that", ratio, 0.5))


_REST = tuple(
    f"{name}:{how}" for name in ("rest_m", "rest_deg") for how in ("half", "95 %", "largest")
)
_ROWS = ("setting", "scheme")
TABLES = (
    lab.Table("images", _ROWS, (*_REST, "good:of", "failure:causes"), {"part": "images"}),
    lab.Table("rest", _ROWS, (*_REST, "to_5mm_s:half", "good:of"), {"part": "rest"}),
    lab.Table("pegs", _ROWS, tuple(f"{name}:of" for name in PEGS.values()), {"part": "images"}),
    lab.Table("moving", ("setting",), ("rms_m:half", "rms_m:95 %"), {"part": "moving"}, "scheme"),
    lab.Table("worlds", ("scheme",), (*_REST, "good:of", "failure:causes"), {"part": "worlds"}),
)


def figures(runs: Results) -> Iterator[lab.Drawn]:
    """Errors at rest of best, by setting."""
    figure, ((position_axis, angle_axis),) = draw.grid(1, 2, (12.0, 4.5), sharey=True)
    rested = runs.where(scheme="best").those(lambda row: row["part"] in ("images", "rest"))
    draw.dots_of(position_axis, rested, "setting", "rest_m")
    draw.plain_ticks(position_axis, (0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20))
    draw.dots_of(angle_axis, rested, "setting", "rest_deg")
    draw.plain_ticks(angle_axis, (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1))
    yield "rest", figure, {}


EXPERIMENT = lab.Experiment(
    "relative", measure, claims, TABLES, globals(), figures, model=Pose().model
)
