"""Arms by other authors, learned and servoed with no line about any of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice
from typing import Any

import numpy as np

from fvs_estimator_node.collecting import CollectionRun, CollectorConfig
from fvs_estimator_node.files import DataSet, TrainedModel, data_set_of
from fvs_estimator_node.registry import create_estimator
from fvs_estimator_node.training import TrainingOptions, train
from fvs_lab import figures as draw
from fvs_lab.experiment import Claim, Context, Drawn, Experiment, Found, TableOf, below, kept, ours
from fvs_lab.floor import Limits, Scaled, fastest
from fvs_lab.outcome import BOUNDS_M
from fvs_lab.results import Results, median
from fvs_lab.trials import Case, Trial, Variant, apart, drive, relative_errors
from fvs_ros.limits import JointLimits, with_urdf_limits
from fvs_ros.params import Parameters
from fvs_sim_node.config import SimConfig
from fvs_sim_node.robot import ROBOTS
from fvs_sim_node.simulation import Simulation
from fvs_tools.closed_loop import ClosedLoop
from fvs_tools.schemes import scheme

#: Duration of the collector's motion, s.
MOTION_S = 60.0
#: Share of the ball's whole way in the data that a target is away, at least.
_FAR = 0.3
#: Places in the box of the data where the Jacobian is compared.
_PLACES = 500
#: Success in servoing, largest error of the Jacobian, and of a redundant arm's time over the floor.
SETTLED, ERROR, OVER_FLOOR = 0.98, 0.002, 1.1
_REDUNDANT = 7


@lru_cache(maxsize=1)
def _simulation(arm: str) -> Simulation:
    """The process's simulated arm, before an exact camera with 1 mm of noise."""
    return Simulation(SimConfig(robot=arm, rendered=False, position_noise_m=0.001))


def _described(arm: str, values: Parameters) -> dict[str, Any]:
    """Values of a node's parameters, the limits filled in from the arm's URDF."""
    return with_urdf_limits(vars(values), {one.name: one for one in _simulation(arm).world.joints})


def collect(simulation: Simulation, config: CollectorConfig) -> DataSet:
    """Move an arm as the collector does, from where it begins, and keep what is seen."""
    simulation.reset(None, config.seed)
    run = CollectionRun(config)
    period_s = 1.0 / simulation.config.joint_state_rate_hz
    while not run.ended:
        out = simulation.advance()
        for seen in out.observations:
            if seen.z is not None:
                run.image(out.time_s, seen.stamp_s, seen.z)
        run.joint_states(out.time_s, out.time_s, out.joints_rad)
        simulation.command(run.tick(out.time_s, period_s))
    return data_set_of(
        run.samples,
        joint_names=simulation.world.joint_names,
        feature=config.feature,
    )


def collected(arm: str, duration_s: float, seed: int) -> tuple[Simulation, DataSet]:
    """The simulation of an arm, and what the collector collects there."""
    simulation = _simulation(arm)
    names = simulation.world.joint_names
    asked = CollectorConfig(joint_names=names, duration_s=duration_s, seed=seed)
    return simulation, collect(simulation, CollectorConfig.from_values(_described(arm, asked)))


def learn(arm: str) -> tuple[TrainedModel, float]:
    """Move the arm as the collector does, and train; also the Jacobian's error in the box."""
    simulation, data = collected(arm, MOTION_S, 1)
    names = simulation.world.joint_names
    trained = train(data, TrainingOptions("poe", seed=1))
    assert trained.chain is not None
    low, high = trained.joint_box_rad
    places = np.random.default_rng(2).uniform(low, high, (_PLACES, len(names)))
    true = np.array([simulation.true_jacobian(one) for one in places])
    return trained, float(np.median(relative_errors(trained.chain.jacobian(places), true)))


def draw_cases(arm: str, trained: TrainedModel, count: int) -> list[Case]:
    """Draw starts and goals in the box of the data whose balls are seen and far apart."""
    rng, (low, high) = np.random.default_rng(3), trained.joint_box_rad
    least_m = _FAR * float(np.ptp(trained.ball_box_m, axis=0).max())
    pairs = apart(_simulation(arm), lambda: rng.uniform(low, high, (2, low.size)), least_m)
    return [Case(f"{arm} {n + 1}", *pair, n) for n, pair in enumerate(islice(pairs, count))]


@dataclass(frozen=True)
class ArmTrial(Trial):
    """A trial with the scheme ``best`` and a model of the arm's own."""

    trained: TrainedModel | None = None

    def loop(self, simulation: Simulation) -> ClosedLoop:
        """The whole loop in a simulation that has been reset."""
        assert self.trained is not None
        best, chain = scheme("best"), self.trained.chain
        estimator = create_estimator(best.method, self.trained.model, best.estimator_values, chain)
        return ClosedLoop(simulation, estimator, {"law": best.law, **best.controller_values})


def servo(task: tuple[str, int]) -> list[dict[str, Any]]:
    """Learn an arm, and servo it to a number of random targets: a row for each."""
    arm, count = task
    trained, error = learn(arm)
    simulation = _simulation(arm)
    asked = JointLimits(joint_names=simulation.world.joint_names)
    limits = JointLimits.from_values(_described(arm, asked))
    equal = Limits(limits.max_joint_velocity_rad_s, limits.max_joint_acceleration_rad_s2)
    kinematics = Scaled(simulation.world.chain, limits.share)
    rows = []
    for case in draw_cases(arm, trained, count):
        outcome = drive(ArmTrial(Variant(), case, trained=trained), simulation)
        start, goal = (tuple(one / limits.share) for one in (case.start_rad, case.goal_rad))
        in_units = replace(case, start_rad=start, goal_rad=goal)
        floor_s = fastest(in_units, equal, BOUNDS_M["5 mm"], kinematics).time_s
        row = outcome.row(arm=arm, joints=len(limits.joint_names), case=case.name)
        rows.append({**row, "learned": error, "over_5mm": outcome.settled_s / floor_s})
    return rows


def measure(context: Context) -> Found:
    """Measure every arm that is installed."""
    arms = [arm for arm, robot in ROBOTS.items() if robot.installed]
    count = context.count(50, 1)
    found = context.map(
        servo, [(arm, count) for arm in arms[: 2 if context.quick else None]], "arms"
    )
    runs = Results(row for rows in found for row in rows)
    missing = [arm for arm in ROBOTS if arm not in arms]
    return Found(runs, {"count": count, "missing": missing})


def claims(found: Found) -> Iterator[Claim]:
    """Judge what is learned, whether it settles, and how fast redundant arms are."""
    parts = [
        kept(f"targets reached by {arm}", sum(runs.values("settled")), len(runs), SETTLED)
        for arm, runs in found.runs.groups("arm").items()
    ]
    yield ours("settles", *parts)
    errors = median([runs.values("learned")[0] for runs in found.runs.groups("arm").values()])
    yield ours("learned", below("error of the Jacobian, %", errors, ERROR, 100.0))
    spare = found.runs.those(lambda row: row["joints"] >= _REDUNDANT)
    if spare:
        yield ours("fast", below("over the floor", spare.median("over_5mm"), OVER_FLOOR))


TABLES = (
    TableOf(
        "arms",
        ("arm", "joints"),
        ("learned", "settled:of", "to_5mm_s", "over_5mm", "final_rms_m", "failure:causes"),
    ),
)


def figures(found: Found) -> Iterator[Drawn]:
    """Each arm as its camera sees it."""
    arms = list(found.runs.groups("arm"))
    columns = min(4, len(arms))
    rows = -(-len(arms) // columns)
    figure, axes = draw.grid(rows, columns, (3.2 * columns, 2.6 * rows))
    for axis in axes.flat:
        axis.set_axis_off()
    for axis, arm in zip(axes.flat, arms, strict=False):
        axis.imshow(photo_of(arm))
        axis.set_title(arm)
    yield "arms", figure, {}


def photo_of(arm: str) -> np.ndarray:
    """The arm with its ball at its first posture, as its camera sees it, uint8, (H, W, 3)."""
    with Simulation(SimConfig(robot=arm, depth_noise=0.0)) as simulation:
        simulation.full_frames = True
        frame = simulation.look().frame
        assert frame is not None
        return frame.rgb


EXPERIMENT = Experiment("arms", measure, claims, TABLES, figures, globals(), model="")
