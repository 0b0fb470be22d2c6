"""Arms by other authors, learned and servoed with no line about any of them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from itertools import islice
from typing import Any

import numpy as np

from fvs_estimator_node.collecting import CollectionRun, CollectorConfig
from fvs_estimator_node.files import DataSet, TrainedModel, data_set_of
from fvs_estimator_node.registry import create_estimator
from fvs_estimator_node.training import TrainingOptions, train
from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab.floor import Limits, least_time_s
from fvs_lab.results import Results, median
from fvs_lab.trials import Case, Trial, apart, crossed, drive, photo, relative_errors
from fvs_ros.chain import SerialChain
from fvs_ros.interface import POSITION, PositionPath
from fvs_ros.limits import JointLimits, with_urdf_limits
from fvs_ros.params import Parameters
from fvs_sim_node.config import SimConfig
from fvs_sim_node.robot import ROBOTS
from fvs_sim_node.simulation import Simulation
from fvs_tools.schemes import scheme
from fvs_tools.score import SETTLED_ERROR_M

#: Duration of the collector's motion, s.
MOTION_S = 60.0
#: Share of the ball's whole way in the data that a target is away, at least.
FAR = 0.3


@lru_cache(maxsize=1)
def _simulation(arm: str) -> Simulation:
    """The process's simulated arm, before an exact camera with 1 mm of noise."""
    return Simulation(SimConfig(robot=arm, rendered=False, position_noise_m=0.001))


def described(simulation: Simulation, values: Parameters) -> dict[str, Any]:
    """Values of a node's parameters, the limits filled in from the arm's URDF."""
    return with_urdf_limits(vars(values), {joint.name: joint for joint in simulation.world.joints})


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


def learn(arm: str, duration_s: float) -> tuple[TrainedModel, float]:
    """Move the arm as the collector does, and train; also the Jacobian's error in the box."""
    simulation = _simulation(arm)
    names = simulation.world.joint_names
    asked = CollectorConfig(joint_names=names, duration_s=duration_s, seed=1)
    data = collect(simulation, CollectorConfig.from_values(described(simulation, asked)))
    trained = train(data, TrainingOptions("poe", seed=1))
    assert trained.chain is not None
    low, high = trained.joint_box_rad
    joints_rad = np.random.default_rng(2).uniform(low, high, (500, len(names)))
    true = np.array(list(map(simulation.true_jacobian, joints_rad)))
    return trained, float(np.median(relative_errors(trained.chain.jacobian(joints_rad), true)))


def servo(task: tuple[str, int, float]) -> list[dict[str, Any]]:
    """Learn an arm from a motion, s, and servo it to a number of random targets: a row for each.

    Targets are in the box of the data, where the ball is seen and far away.
    """
    arm, count, duration_s = task
    trained, error = learn(arm, duration_s)
    simulation = _simulation(arm)
    best = scheme("best")
    variant = Trial(
        best,
        labels={"arm": arm, "joints": len(simulation.world.joint_names), "learned": error},
        estimator_of=lambda *_: create_estimator(
            best.method, best.estimator_values, lambda: trained
        ),
    )
    rng, (low, high) = np.random.default_rng(3), trained.joint_box_rad
    least_m = FAR * float(np.ptp(trained.z_samples, axis=0).max())
    pairs = apart(simulation, lambda: rng.uniform(low, high, (2, low.size)), least_m)
    rows = []
    for number, pair in enumerate(islice(pairs, count)):
        case = Case(f"{arm} {number + 1}", *pair, number)
        (trial,) = crossed([variant], [case])
        run = drive(trial, simulation)
        least_s = floor_s(simulation, case, simulation.world.chain)
        rows.append({**run, "over_5mm": run["to_5mm_s"] / least_s})
    return rows


def measure(context: lab.Context) -> Results:
    """Measure every arm that is installed."""
    arms = [arm for arm, robot in ROBOTS.items() if robot.installed]
    duration_s = 10.0 if context.quick else MOTION_S
    tasks = [(arm, context.count(50), duration_s) for arm in context.first(arms, 1)]
    return Results(row for rows in context.map(servo, tasks, "arms") for row in rows)


def claims(runs: Results) -> Iterator[lab.Claim]:
    """Judge what is learned, whether it settles, and how fast redundant arms are."""
    arms = runs.groups("arm")
    fewest = min((group.values("settled") for group in arms.values()), key=np.mean)
    yield lab.ours("settles", lab.kept("targets reached, fewest of all arms", fewest, 0.98))
    errors = median([group.values("learned")[0] for group in arms.values()])
    yield lab.ours("learned", lab.below("error of the Jacobian", errors, 0.002, 100.0, " %"))
    redundant = runs.where(joints=7)
    if redundant:
        yield lab.ours("fast", lab.below("over the floor", redundant.median("over_5mm"), 1.1))


TABLES = (
    lab.Table(
        "arms",
        ("arm", "joints"),
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
