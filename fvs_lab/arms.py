"""Arms by other authors, learned and servoed by what cameras see, with no line about any arm."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np

from fvs_controller_node.config import SupervisorConfig
from fvs_estimator_node.collecting import CollectionRun, CollectorConfig
from fvs_estimator_node.files import DataSet, TrainedModel, data_set_of
from fvs_estimator_node.registry import create_estimator
from fvs_estimator_node.training import TrainingOptions, train
from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab.floor import Limits, least_time_s
from fvs_lab.results import Results, median
from fvs_lab.trials import Case, Trial, apart, built, crossed, drive, photo, relative_errors
from fvs_ros.chain import SerialChain
from fvs_ros.interface import POSITION, PositionPath
from fvs_ros.kinds import KindConfig
from fvs_ros.kinds.ball import Ball
from fvs_ros.kinds.points import Points
from fvs_ros.kinds.pose import Pose
from fvs_ros.limits import JointLimits, with_urdf_limits
from fvs_ros.params import Parameters
from fvs_sim_node.config import SimConfig
from fvs_sim_node.robot import ROBOTS
from fvs_sim_node.simulation import Simulation
from fvs_tools.schemes import scheme
from fvs_tools.score import SETTLED_ERROR_M

#: Duration of the collector's motion, s.
MOTION_S = 60.0
#: Share of the flange's whole way in the data that a target is away, at least.
FAR = 0.3
#: The arm is held below this share of the smallest singular value at home; a UR5 by default is.
HELD_BELOW = 0.25


#: What is seen, by exact cameras with noise: 1 mm, what rendered tags have, and 0.3 px.
BALL, TAG, WEBCAM, WEBCAMS = Ball.name, "tag", "one webcam", "two webcams"
EXACT = SimConfig(rendered=False, position_noise_m=0.001)
BY_WEBCAM = replace(EXACT, feature=Points.name, position_noise_m=0.3 * Points.pixel_m)
FEATURES = {
    BALL: EXACT,
    TAG: replace(EXACT, feature=Pose.name, position_noise_m=3e-4),
    WEBCAM: BY_WEBCAM,
    WEBCAMS: replace(BY_WEBCAM, points=Points(cameras=("front", "side"))),
}
#: How much of a tag's pose is servoed with fewer than six joints.
TASKS = {4: "position", 5: "position_y"}


def described(simulation: Simulation, values: Parameters) -> dict[str, Any]:
    """Values of a node's parameters, the limits filled in from the arm's URDF."""
    return with_urdf_limits(vars(values), {joint.name: joint for joint in simulation.world.joints})


def held_near_singular(
    simulation: Simulation, home_rad: np.ndarray, share: float
) -> dict[str, float]:
    """The controller's parameter that holds an arm below a share of the value at home."""
    home, freedom = simulation.true_jacobian(home_rad), simulation.kind.freedom
    smallest_m_rad = share * float(np.linalg.svd(home, compute_uv=False)[:freedom].min())
    return {"singular_hold_m_rad": min(SupervisorConfig.singular_hold_m_rad, smallest_m_rad)}


def floor_s(simulation: Simulation, case: Case, chain: SerialChain) -> float:
    """Least time until it is within 5 mm for good, by the arm's limits and a chain, s."""
    asked = JointLimits(joint_names=simulation.world.joint_names)
    limits = JointLimits.from_values(described(simulation, asked))
    equal = Limits(limits.max_joint_velocity_rad_s, limits.max_joint_acceleration_rad_s2)
    return least_time_s(case, equal, SETTLED_ERROR_M, chain, limits.share)


def collect(simulation: Simulation, config: CollectorConfig, late_s: float = 0.0) -> DataSet:
    """Move an arm as the collector does, from where it begins, and keep what is seen.

    Images are stamped late by some time, s.
    """
    simulation.reset(None, config.seed)
    run = CollectionRun(config)
    period_s, path = 1.0 / simulation.config.joint_state_rate_hz, PositionPath()
    while not run.ended:
        out = simulation.advance()
        for image in out.observations:
            if image.z is not None:
                run.image(out.time_s, image.stamp_s + late_s, image.z, image.number)
        run.joint_states(out.time_s, out.time_s, out.joints_rad)
        command = run.tick(out.time_s, period_s)
        if simulation.config.command_interface == POSITION:
            command = path.advance(command, out.joints_rad, period_s, config)
        simulation.command(command)
    names = simulation.world.joint_names
    seen = {"feature": config.feature, "camera_mount": config.camera_mount}
    cameras = config.kind.cameras
    return data_set_of(*run.samples, joint_names=names, cameras=cameras, **seen)


def learn(arm: str, feature: str, duration_s: float) -> tuple[TrainedModel, float]:
    """Move the arm as the collector does, and train; also the Jacobian's error in the box."""
    simulation = built(replace(FEATURES[feature], robot=arm))
    kind, names = simulation.kind, simulation.world.joint_names
    asked = described(simulation, CollectorConfig(joint_names=names, duration_s=duration_s, seed=1))
    asked |= kind.values
    trained = train(
        collect(simulation, CollectorConfig.from_values(asked)), TrainingOptions("poe", seed=1)
    )
    low, high = trained.joint_box_rad
    joints_rad = np.random.default_rng(2).uniform(low, high, (500, len(names)))
    learned, true = (
        np.array([kind.along(chain, joints)[1] for joints in joints_rad])
        for chain in (trained.chain, simulation.true_chain())
    )
    return trained, float(np.median(relative_errors(learned, true)))


def servo(arm: str, feature: str, count: int, duration_s: float) -> list[dict[str, Any]]:
    """Learn an arm from a motion, and servo it to a number of random targets: a row for each.

    Targets are in the box of the data, where the feature is seen and far away.
    """
    trained, error = learn(arm, feature, duration_s)
    simulation = built(replace(FEATURES[feature], robot=arm))
    kind, chain = simulation.kind, simulation.world.chain
    axes = {"task_axes": TASKS[chain.joints]} if chain.joints in TASKS else {}
    kind = KindConfig.from_values({**kind.values, **axes}).kind
    best = scheme("best")
    variant = Trial(
        best,
        labels={"feature": feature, "arm": arm, "joints": chain.joints, "learned": error},
        estimator_of=lambda *_: create_estimator(
            best.method, best.estimator_values, lambda: trained, kind
        ),
    )
    if kind.rigid:
        home_rad = simulation.world.start_rad(simulation.config)
        variant = variant.changed(controller=held_near_singular(simulation, home_rad, HELD_BELOW))
    rng, (low, high) = np.random.default_rng(3), trained.joint_box_rad
    places_m = chain.position(np.random.default_rng(4).uniform(low, high, (500, low.size)))
    least_m = FAR * float(np.ptp(places_m, axis=0).max())
    pairs = apart(simulation, lambda: rng.uniform(low, high, (2, low.size)), least_m)
    rows = []
    for number, pair in enumerate(islice(pairs, count)):
        case = Case(f"{arm} {number + 1}", *pair, number)
        (trial,) = crossed([variant], [case])
        run = drive(trial, simulation)
        if feature == BALL:
            run["over_5mm"] = run["to_5mm_s"] / floor_s(simulation, case, chain)
        rows.append(run)
    return rows


def measure(context: lab.Context) -> Results:
    """Measure every arm that is installed."""
    arms = [arm for arm, robot in ROBOTS.items() if robot.installed]
    duration_s = 10.0 if context.quick else MOTION_S
    tasks = [
        (arm, feature, context.count(50 if feature == BALL else 20), duration_s)
        for feature in context.first(list(FEATURES), 1)
        for arm in context.first(arms, 1)
    ]
    return Results(context.rows(servo, tasks, "arms"))


def claims(runs: Results) -> Iterator[lab.Claim]:
    """Judge what is learned, whether it settles, and how fast redundant arms are."""
    for feature, runs_of in runs.groups("feature").items():
        arms = runs_of.groups("arm").values()
        fewest = min((group.values("settled") for group in arms), key=np.mean)
        part = lab.kept("targets reached, fewest of all arms", fewest, 0.98)
        yield lab.ours("settles", part, feature=feature)
    balls = runs.where(feature=BALL)
    errors = median([group.values("learned")[0] for group in balls.groups("arm").values()])
    yield lab.ours("learned", lab.below("error of the Jacobian", errors, 0.002, 100.0, " %"))
    redundant = balls.where(joints=7)
    if redundant:
        yield lab.ours("fast", lab.below("over the floor", redundant.median("over_5mm"), 1.1))


TABLES = (
    lab.Table(
        "arms",
        ("feature", "arm", "joints"),
        ("learned:half", "settled:of", "over_5mm"),
    ),
)


def figures(runs: Results) -> Iterator[lab.Drawn]:
    """Each arm with its ball at its first posture, as its camera sees it."""
    arms = list(runs.groups("arm"))
    columns = min(4, len(arms))
    rows = -(-len(arms) // columns)
    figure, axes = draw.grid(rows, columns, (3.2 * columns, 2.6 * rows))
    for axis in axes.flat:
        axis.set_axis_off()
    for axis, arm in zip(axes.flat, arms, strict=False):
        with Simulation(SimConfig(robot=arm, depth_noise=0.0)) as simulation:
            axis.imshow(photo(simulation))
        axis.set_title(arm)
    yield "arms", figure, {}


EXPERIMENT = lab.Experiment("arms", measure, claims, TABLES, globals(), figures, model="")
