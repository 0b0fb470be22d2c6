"""The camera on the arm: learned before one tag, servoed to others, beside a hand-eye."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fvs_detector_node.tags import Tag
from fvs_estimator_node.chain_fit import fit_chain
from fvs_estimator_node.collecting import CollectorConfig
from fvs_estimator_node.on_arm import OnArmPoeEstimator
from fvs_estimator_node.training import learned
from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab.arms import HELD_BELOW, collect, described, floor_s, held_near_singular
from fvs_lab.pose import rest
from fvs_lab.relative import VISP_1_S, joints_at
from fvs_lab.results import Results, median
from fvs_lab.trials import (
    Bump,
    Case,
    Joints,
    Trial,
    Vector,
    along,
    built,
    drive,
    placed,
    relative_errors,
)
from fvs_ros.chain import SerialChain
from fvs_ros.filter import Image
from fvs_ros.kinds.ball import Ball
from fvs_ros.kinds.pose import Pose
from fvs_ros.rotations import rotation_from_vector
from fvs_ros.vectors import length
from fvs_ros.view import ViewConfig
from fvs_sim_node.camera import RigidPose
from fvs_sim_node.config import SimConfig
from fvs_sim_node.robot import ROBOTS, moving_joints
from fvs_sim_node.simulation import Simulation
from fvs_tools.schemes import scheme

#: An exact camera whose noise is like that of rendered images so near.
ROOM = SimConfig(
    camera_mount="arm",
    rendered=False,
    position_noise_m=3e-4,
    tag=Tag(tag_size_m=0.05),
    ahead_m=0.3,
    physics_rate_hz=SimConfig.joint_state_rate_hz,
)
KIND = Pose(camera_mount=ROOM.camera_mount)
#: Duration of the collector's motion, s, and its half width, rad.
MOTION_S, RANGE_RAD = 60.0, 0.3
#: Least way of the object from start to target, m; its largest rotation from facing a camera, rad.
WAY_M, ASLANT_RAD = 0.05, 0.5
#: A blow to the bracket, degrees and m, and when, as a share of the undisturbed time.
BLOW_DEG, BLOW_M, BLOW_AT = 10.0, 0.02, 0.4
#: What a measured hand-eye is off by, degrees and m.
HAND_EYES = {"exact": (0.0, 0.0), "5°, 20 mm off": (5.0, 0.02), "15°, 50 mm off": (15.0, 0.05)}
OURS, FIXED, VISP = "best, no hand-eye", "law of best, hand-eye", "exponential law, hand-eye"
#: Time of a run, s; a belt's speed, m/s.
RUN_S, BELT_M_S = 3.0, 0.1
#: The view of the simulated camera, and of what it sees; and its least distance, m.
VIEW = ViewConfig(view_half_angles_deg=(27.0, 21.0), view_radius_m=0.045)
NEAR = {"workspace_min_m": (-1.0, -1.0, 0.1), **vars(VIEW)}
#: A view without ends: the object is not kept in it.
FREE = "best, view not kept"
OPEN = {"view_half_angles_deg": (89.0, 89.0), "view_distance_m": (0.0, 9.0), "view_radius_m": 0.0}
#: Distance from camera to object, m, their middle as published; the largest angles of the camera
#: off the object's normal, and of its further roll and tilts, degrees.
CNS_M, CNS_OFF_DEG, CNS_ROLL_DEG, CNS_TILT_DEG = 0.275 / 0.7 * np.array([0.5, 0.9]), 20.0, 15.0, 5.0
#: Where it lies on a table, world frame: no such view of it is near a singularity of the UR5, nor
#: near an end of the joint that rolls the camera.
TABLE = RigidPose(
    np.array([0.45, 0.1, 0.0]), rotation_from_vector(np.array([0.0, 0.0, -0.5 * np.pi]))
)
#: Of a tag that faces a camera.
FACING = np.diag([1.0, -1.0, -1.0])
BUMPED, BELT, CNS = "bracket bumped", "belt", "starts of CNS"
IMAGES = "rendered images"


def _simulation(arm: str, feature: str) -> Simulation:
    """The process's simulated arm with its camera, which nobody has bumped."""
    config = replace(ROOM, robot=arm, feature=feature)
    simulation = built(config)
    simulation.configure(config)
    return simulation


def _put(simulation: Simulation, pose: RigidPose, velocity_m_s: Vector = (0.0, 0.0, 0.0)) -> None:
    """Put the object there, world frame, from the next reset on, before an unbumped camera."""
    config = placed(simulation.config, pose)
    simulation.configure(replace(config, object_velocity_m_s=velocity_m_s))


def _view(simulation: Simulation, joints_rad: Joints, bump: Bump | None) -> np.ndarray | None:
    """Where the object is in the picture from there; None if it is not seen, also after a blow."""
    simulation.reset(joints_rad)
    view = simulation.views[0]
    mounted, first = view.mounted, simulation.look()
    for blow in (None, bump):
        if blow is not None:
            blow.strike(simulation)
        z = simulation.true_feature()
        seen = simulation.look().z is not None and not VIEW.out_of_view(simulation.kind, z)
        if not seen:
            break
    view.mounted = mounted
    return first.true_position_m if seen else None


@dataclass(frozen=True)
class Arm:
    """An arm, and what a minute before one object tells of it."""

    name: str
    feature: str
    chain: SerialChain
    #: Where its joints were, rad, (2, n).
    box_rad: np.ndarray
    #: Median relative error of the camera's twist there; a radian counts as 0.3 m.
    error: float
    #: The controller's parameter of when to hold it.
    held: Mapping[str, float]

    def trial(self, case: Case, **labels: Any) -> Trial:
        """The scheme best with this chain, in a case."""
        return Trial(
            scheme("best"),
            labels={"part": "ur5", "scheme": OURS, "case": case.name, **labels},
            case=case,
            duration_s=RUN_S,
            record=True,
            estimator_of=lambda simulation, _: OnArmPoeEstimator(self.chain, None, simulation.kind),
        ).changed(controller={**NEAR, **self.held})


def learn(
    name: str, feature: str, duration_s: float, servos: Mapping[str, Any] | None = None
) -> Arm:
    """Move an arm as the collector does before the first object; with servos."""
    simulation = _simulation(name, feature)
    simulation.configure(replace(simulation.config, **(servos or {})))
    names, where = simulation.world.joint_names, ROOM.camera_mount
    asked = CollectorConfig(joint_names=names, duration_s=duration_s, seed=1, feature=feature)
    asked = replace(asked, camera_mount=where, joint_range_rad=(RANGE_RAD,))
    data = collect(simulation, CollectorConfig.from_values(described(simulation, asked)))
    chain = fit_chain(data).chain
    box_rad = np.array([data.joints_rad.min(axis=0), data.joints_rad.max(axis=0)])
    joints_rad = np.random.default_rng(2).uniform(box_rad[0], box_rad[1], (500, len(box_rad.T)))
    scale = np.repeat([KIND.lever_arm_m, 1.0], 3)[:, None]
    ours, true = (scale * learned(each, joints_rad) for each in (chain, simulation.true_chain()))
    error = float(np.median(relative_errors(ours, true)))
    held = held_near_singular(simulation, simulation.world.start_rad(ROOM), HELD_BELOW)
    return Arm(name, feature, chain, box_rad, error, held)


def second_object(arm: Arm, number: int, bump: Bump | None = None) -> tuple[Simulation, Case]:
    """An object elsewhere, as a function of its number, and a way before it that shows it."""
    simulation = _simulation(arm.name, arm.feature)
    rng = np.random.default_rng([431, number])
    middle, (low, high) = simulation.world.start_rad(ROOM), arm.box_rad
    while True:
        simulation.reset(0.5 * (middle + rng.uniform(low, high)))
        rotation = FACING @ rotation_from_vector(rng.uniform(-ASLANT_RAD, ASLANT_RAD, 3))
        ahead = RigidPose(np.array([0.0, 0.0, ROOM.ahead_m]), rotation)
        _put(simulation, simulation.camera.pose_from_own(ahead))
        for _ in range(100):  # may be seen from nowhere else
            start, goal = map(tuple, rng.uniform(low, high, (2, low.size)).tolist())
            first, last = (_view(simulation, joints, bump) for joints in (start, goal))
            if first is not None and last is not None and length(last - first) > WAY_M:
                return simulation, Case(f"{arm.name} {number}", start, goal, number)


def run(trial: Trial, simulation: Simulation) -> dict[str, Any]:
    """Run a trial: its row, with its rest."""
    row = drive(trial, simulation)
    size = {"rest_m": row["final_rms_m"]} if simulation.kind.name == Ball.name else rest(row)
    return {**row, **size, "series": {}}


def over_floor(row: dict[str, Any], simulation: Simulation, case: Case) -> dict[str, Any]:
    """A row with its settling time over the least time."""
    simulation.reset(case.goal_rad)
    seen = simulation.true_chain().weighted(simulation.kind.weights)
    return {**row, "over_5mm": row["to_5mm_s"] / floor_s(simulation, case, seen)}


def to_second(arm: Arm, number: int) -> dict[str, Any]:
    """Servo to a second object: the row."""
    simulation, case = second_object(arm, number)
    labels = {"part": "arms", "arm": arm.name, "joints": len(case.goal_rad), "learned": arm.error}
    return over_floor(run(arm.trial(case, **labels), simulation), simulation, case)


def with_images(arm: Arm, number: int) -> dict[str, Any]:
    """As to the second object, with rendered images in place of the exact camera: the row."""
    simulation, case = second_object(arm, number)
    simulation.configure(replace(simulation.config, rendered=True, position_noise_m=0.0))
    return run(arm.trial(case, setting=IMAGES), simulation)


class Calibrated(OnArmPoeEstimator):
    """The robot's kinematics and a measured hand-eye, in which nothing is corrected."""

    def observe(self, image: Image, noise_m: float) -> None:
        """See where the object is."""
        self._chain = self._fitted.anchored(image.joints_rad, image.z)
        self.updates += 1


def with_hand_eyes(arm: Arm, number: int) -> list[dict[str, Any]]:
    """Servo by the URDF and hand-eyes that are off: a row each."""
    simulation, case = second_object(arm, number)
    axis, way = np.random.default_rng([432, number]).normal(size=(2, 3))
    free = arm.trial(case, setting="none", scheme=FREE).changed(controller=OPEN)
    rows = [run(free, simulation)]
    for name, (off_deg, off_m) in HAND_EYES.items():
        turned = rotation_from_vector(np.array(along(axis, np.radians(off_deg))))
        off = simulation.true_chain().moved(turned, np.array(along(way, off_m)))
        known = Calibrated(off, None, simulation.kind)
        fixed = arm.trial(case, setting=name, scheme=FIXED)
        fixed = replace(fixed, estimator_of=lambda *_, known=known: known)
        law = {"law": "proportional", "proportional_gain_1_s": VISP_1_S}
        rows.append(run(fixed, simulation))
        known.reset()
        rows.append(run(fixed.changed({"scheme": VISP}, controller=law), simulation))
    return rows


def bumped(arm: Arm, number: int) -> dict[str, Any]:
    """Servo undisturbed, then with a blow to the bracket on the way: the row of the second."""
    rng = np.random.default_rng([433, number])
    blow = along(rng.normal(size=3), BLOW_DEG), along(rng.normal(size=3), BLOW_M)
    simulation, case = second_object(arm, number, Bump(0.0, *blow))
    trial = arm.trial(case, setting=BUMPED)
    undisturbed_s = run(trial, simulation)["to_5mm_s"]
    row = run(replace(trial, bump=Bump(BLOW_AT * min(undisturbed_s, 1.0), *blow)), simulation)
    return {**row, "over_undisturbed": row["to_5mm_s"] / undisturbed_s}


def on_belt(arm: Arm, number: int) -> dict[str, Any]:
    """Stay before an object on a belt: the row, whose distance is that of the last second."""
    simulation = _simulation(arm.name, arm.feature)
    angle = np.random.default_rng([434, number]).uniform(0.0, 2.0 * np.pi)
    velocity_m_s = along(np.array([np.cos(angle), np.sin(angle), 0.0]), BELT_M_S)
    home, middle = simulation.world.start_rad(ROOM), simulation.world.placed_object(ROOM)
    _put(simulation, middle)
    simulation.reset(home)
    seen = simulation.true_feature()
    _put(simulation, middle.moved(-0.5 * RUN_S * np.array(velocity_m_s)), velocity_m_s)
    simulation.reset(home)
    joints = joints_at(simulation.true_chain(), seen, home)
    assert joints is not None
    start = tuple(joints.tolist())
    trial = arm.trial(Case(f"belt {number}", start, start, number), setting=BELT)
    return run(trial.changed(controller={"object_moves": True}), simulation)


def view(rng: np.random.Generator) -> np.ndarray:
    """What a camera sees that is drawn as in the benchmark, (12,)."""
    azimuth = rng.uniform(-np.pi, np.pi)
    height = rng.uniform(np.cos(np.radians(CNS_OFF_DEG)), 1.0)
    level = np.sqrt(1.0 - height**2)
    away = np.array([level * np.cos(azimuth), level * np.sin(azimuth), height])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    rotation = np.column_stack([right, np.cross(-away, right), -away])
    for axis, most_deg in enumerate((CNS_TILT_DEG, CNS_TILT_DEG, CNS_ROLL_DEG)):
        turn_rad = np.radians(rng.uniform(-most_deg, most_deg)) * np.eye(3)[axis]
        rotation = rotation @ rotation_from_vector(turn_rad)
    return KIND.inverse(KIND.of_body(rng.uniform(*CNS_M) * away, rotation))


def cns(arm: Arm, number: int) -> list[dict[str, Any]]:
    """Servo between two such views of a tag on a table, kept in view or not: a row each."""
    simulation = _simulation(arm.name, arm.feature)
    rng, home = np.random.default_rng([435, number]), simulation.world.start_rad(ROOM)
    _put(simulation, TABLE)
    simulation.reset(home)
    chain, middle = simulation.true_chain(), KIND.of_body(CNS_M.mean() * np.eye(3)[2], FACING)
    ends = [_joints(chain, middle, home)]
    for z in (view(rng), view(rng)):
        ends.append(_joints(chain, z, ends[-1]))
    _, start, goal = (tuple(joints.tolist()) for joints in ends)
    case = Case(f"view {number}", start, goal, number)
    trial = replace(arm.trial(case, setting=CNS), duration_s=8.0, stop_after_s=1.5)
    free = trial.changed({"scheme": FREE}, controller=OPEN)
    return [over_floor(run(each, simulation), simulation, case) for each in (trial, free)]


def _joints(chain: SerialChain, z: np.ndarray, near_rad: np.ndarray) -> np.ndarray:
    """The joints, rad, (n,), that see an object at z with the least motion from others."""
    rolls_rad = np.outer(np.linspace(-np.pi, np.pi, 9), np.eye(near_rad.size)[-1])
    tried = [joints_at(chain, z, near_rad + roll_rad) for roll_rad in rolls_rad]
    return min(
        (joints for joints in tried if joints is not None),
        key=lambda joints: np.abs(joints - near_rad).max(),
    )


# ---- the experiment -------------------------------------------------------------------------


def measure(context: lab.Context) -> Results:
    """Learn every arm that is installed, and servo."""
    installed = [name for name, robot in ROBOTS.items() if robot.installed]
    duration_s, tasks = 15.0 if context.quick else MOTION_S, []
    for name in context.first(installed, 1):
        few = len(moving_joints(ROBOTS[name])[1]) < KIND.least_joints
        tasks.append((name, Ball.name if few else Pose.name, duration_s))
    arms = context.map(learn, tasks, "one object")
    count = context.count(20)
    pairs = [(arm, number) for arm in arms for number in range(1, 1 + count)]
    first, starts = pairs[:count], [(arms[0], 1 + k) for k in range(context.count(150))]
    rows = context.map(to_second, pairs, "another object")
    for part, numbered in ((with_hand_eyes, first), (cns, starts)):
        rows += context.rows(part, numbered, part.__name__)
    for each in (bumped, on_belt, with_images):
        rows += context.map(each, first, each.__name__)
    ours = [row for row in rows if row.get("arm") == arms[0].name]
    return Results([*({**row, "part": "ur5", "setting": "none"} for row in ours), *rows])


def claims(runs: Results) -> Iterator[lab.Claim]:
    """What is learned; other objects; a bump, a belt; the benchmark; wrong hand-eyes."""
    there = runs.where(part="arms")
    arms = there.groups("arm")
    errors = median([group.values("learned")[0] for group in arms.values()])
    yield lab.ours("learned", lab.below("error of the twist", errors, 0.003, 100.0, " %"))
    parts = [lab.kept(f"by {arm}", group.values("settled"), 1.0) for arm, group in arms.items()]
    yield lab.ours("settles", *parts)
    poses = there.those(lambda row: "rest_deg" in row)
    position = lab.below("position", poses.median("rest_m"), 0.0002, 1e3, " mm")
    angle = lab.below("angle, degrees", poses.median("rest_deg"), 0.05)
    yield lab.ours("rest", position, angle)
    yield lab.ours("fast", lab.below("over the floor", there.median("over_5mm"), 1.15))
    parts_of = runs.where(part="ur5").groups("setting")
    starts = parts_of[CNS].where(scheme=OURS)
    exact = [row["rest_m"] < 3e-4 and row["rest_deg"] < 0.1 for row in starts]
    converged = lab.kept("converged", starts.values("settled"), 1.0)
    yield lab.ours("cns", converged, lab.kept("within 0.1° and 0.3 mm", exact, 1.0))
    soon = [ratio <= 1.5 for ratio in parts_of[BUMPED].values("over_undisturbed")]
    yield lab.ours("bump", lab.kept("runs", soon, 0.95))
    lag = parts_of[BELT].median("rest_m")
    yield lab.ours("belt", lab.below("distance, rms", lag, 0.001, 1e3, " mm"))
    none, (first, *_, last) = parts_of["none"].where(scheme=OURS), HAND_EYES
    for name, setting, which, most in (("exact", first, FIXED, 1.05), ("wrong", last, VISP, 1.0)):
        ratio = none.over(parts_of[setting].where(scheme=which), "to_5mm_s")
        yield lab.ours(name, lab.below("time over that", ratio, most))


_REST = ("rest_m:half", "rest_m:largest", "rest_deg:half", "rest_deg:largest")
_ARMS = ("learned:half", "settled:of", "over_5mm:half", *_REST, "failure:causes")
_UR5 = (
    "settled:of",
    "to_5mm_s:half",
    "over_5mm:half",
    "over_undisturbed:95 %",
    *_REST,
    "failure:causes",
)
TABLES = (
    lab.Table("arms", ("arm", "joints"), _ARMS, {"part": "arms"}),
    lab.Table("ur5", ("setting", "scheme"), _UR5, {"part": "ur5"}),
)


def figures(runs: Results) -> Iterator[lab.Drawn]:
    """Time and rest, by arm."""
    figure, ((time_axis, rest_axis),) = draw.grid(1, 2, (12.0, 4.5), sharey=True)
    there = runs.where(part="arms")
    draw.dots_of(time_axis, there, "arm", "over_5mm", 3.0)
    draw.dots_of(rest_axis, there, "arm", "rest_m", 10.0)
    draw.plain_ticks(rest_axis, (0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10))
    yield "arms", figure, {}


EXPERIMENT = lab.Experiment("hand", measure, claims, TABLES, globals(), figures, model="")
