"""Collect, train and servo on a stranger without ROS: the nodes' own objects, in lock step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from stranger import REACH_RAD, Stranger

from fvs_estimator_node.collecting import CollectionRun, RunConfig, State
from fvs_estimator_node.dataset import DataSet
from fvs_estimator_node.motion import MotionConfig, RandomMotion
from fvs_estimator_node.rbf import RbfModel
from fvs_estimator_node.registry import create_estimator
from fvs_lab.lockstep import LockStep

#: Time for each target, and its end over which the rms is taken, s.
TARGET_S, FINAL_S = 5.0, 2.0


def collect(stranger: Stranger, duration_s: float, speed_rad_s: float = 0.65) -> DataSet:
    """Move it at random as the collector does, and return what was recorded."""
    motion = MotionConfig(
        duration_s=duration_s,
        joint_range_rad=tuple(REACH_RAD),
        max_joint_velocity_rad_s=speed_rad_s,
    )
    run = CollectionRun(
        RunConfig(speed_rad_s, motion.max_joint_acceleration_rad_s2),
        lambda start_rad: RandomMotion(start_rad, motion, np.random.default_rng(0)),
    )
    while not run.ended:
        step = stranger.advance()
        for seen in step.observations:
            run.ball(step.time_s, seen.stamp_s, seen.detection.position_m)
        run.joint_states(step.time_s, step.time_s, step.joints_rad)
        stranger.command(run.tick(step.time_s, stranger.period_s))
    assert run.state is State.DONE, run.reason
    return DataSet(
        stamps_s=np.array([sample.stamp_s for sample in run.samples]),
        joints_rad=np.array([sample.joints_rad for sample in run.samples]),
        ball_m=np.array([sample.ball_m for sample in run.samples]),
        segment=np.array([sample.run for sample in run.samples]),
    )


def draw_targets(
    stranger: Stranger, rng: np.random.Generator, count: int = 5, within_m: float = 0.3
) -> list[np.ndarray]:
    """Targets that the ball can be at, each within a distance of the one before, m."""
    kinematics, targets = stranger.kinematics, [stranger.ball_m]
    while len(targets) <= count:
        joints = kinematics.home_rad + 0.9 * REACH_RAD * rng.uniform(-1.0, 1.0, 6)
        target = kinematics.ball(joints)
        if 0.05 < np.linalg.norm(target - targets[-1]) < within_m:
            targets.append(target)
    return targets[1:]


def jacobian_error(model: RbfModel, stranger: Stranger, rng: np.random.Generator) -> float:
    """Median relative Frobenius error at joints all over the box."""
    kinematics = stranger.kinematics
    errors = []
    for joints in kinematics.home_rad + REACH_RAD * rng.uniform(-1.0, 1.0, (200, 6)):
        true = kinematics.jacobian(joints)
        errors.append(np.linalg.norm(model.jacobian(joints) - true) / np.linalg.norm(true))
    return float(np.median(errors))


@dataclass(frozen=True)
class Arrival:
    """How one target went: start distance, m; time to stay within 5 mm, s (inf: never); rms, m."""

    distance_m: float
    settled_s: float
    final_rms_m: float


def servo(stranger: Stranger, model: RbfModel, targets: list[np.ndarray]) -> list[Arrival]:
    """Take the ball to one target after the other."""
    loop = LockStep(stranger, create_estimator("rbf", model, {}))
    loop.run(0.5)  # until every input is fresh
    arrivals = []
    for target in targets:
        loop.set_target(target)
        errors = []
        for _ in range(round(TARGET_S / stranger.period_s)):
            loop.tick()
            errors.append(np.linalg.norm(stranger.ball_m - target))
        arrivals.append(judge(np.array(errors), stranger.period_s))
    return arrivals


def judge(errors_m: np.ndarray, period_s: float) -> Arrival:
    """Judge the true distances from a target, m, evenly in time."""
    above = np.flatnonzero(errors_m > 0.005)
    settled_s = 0.0 if len(above) == 0 else (above[-1] + 1) * period_s
    final = errors_m[-round(FINAL_S / period_s) :]
    return Arrival(
        float(errors_m[0]),
        float(settled_s) if settled_s < TARGET_S - FINAL_S else np.inf,
        float(np.sqrt(np.mean(final**2))),
    )
