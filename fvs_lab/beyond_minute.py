"""A minute of motion: what a fitted chain makes of it, and what the paper's training does."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from fvs_estimator_node.chain_fit import fit_chain
from fvs_estimator_node.dataset import DataSet, data_set_of
from fvs_estimator_node.distilling import train_structured
from fvs_estimator_node.motion import MotionConfig, RandomMotion
from fvs_estimator_node.training import TrainingOptions, train
from fvs_lab.trials import BOX_RAD, HOME_RAD, Conditions, relative_errors, simulation_of
from fvs_ros.timeline import Sample, Timeline

MINUTE_S = 60.0
#: The images of a seed are stamped late by as much as this, drawn evenly, s.
MOST_LATE_S = 0.1
#: Share of the ball that must be seen for joints to belong to the workspace.
_VISIBLE = 0.9
#: How the paper trains, and what is left of it where torch is not installed.
PAPERS_METHOD = "varpro" if find_spec("torch") else "ridge"

#: What may err in a plant, and how its conditions differ: the calibration by as much as that of a
#: depth camera off the shelf, encoders and drives far worse than a UR's.
ERRING: Mapping[str, Mapping[str, Any]] = {
    "nothing": {},
    "focal length told 1 % too long": {"focal_error": 0.01},
    "focal length told 1 % too short": {"focal_error": -0.01},
    "depths told 0.5 % too large": {"depth_error": 0.005},
    "0.2 mrad of noise on the joints": {"encoder_noise_rad": 0.0002},
    "drives that lag by 100 ms": {"joint_lag_s": 0.1},
}


@dataclass(frozen=True)
class Minute:
    """A recording to learn from.

    Parameters
    ----------
    seed : int
        Of the motion, the noise and the lateness.
    duration_s : float
        Length of the motion, s.
    conditions : Conditions
        The world.
    places : mapping of str to ndarray, shape (n, joints)
        Joints at which Jacobians are judged, rad, as of :func:`draw_places`.
    papers_method : str
        How the paper's networks are trained.
    """

    seed: int
    duration_s: float
    conditions: Conditions
    places: Mapping[str, np.ndarray]
    papers_method: str = PAPERS_METHOD


def draw_places(seed: int, count: int) -> dict[str, np.ndarray]:
    """Draw joints of ``box`` M, and of the whole ``workspace`` that the camera sees, rad.

    Parameters
    ----------
    seed : int
        Of the draw.
    count : int
        How many of each.
    """
    rng = np.random.default_rng(seed)
    box = HOME_RAD + rng.uniform(-1.0, 1.0, (count, HOME_RAD.size)) * BOX_RAD
    simulation = simulation_of(Conditions())
    seen: list[np.ndarray] = []
    while len(seen) < count:
        joints = rng.uniform(-np.pi, np.pi, HOME_RAD.size)
        simulation.reset(joints)
        detection = simulation.look().detection
        if detection is not None and detection.visible_fraction >= _VISIBLE:
            seen.append(joints)
    return {"box": box, "workspace": np.array(seen)}


def record(minute: Minute) -> tuple[DataSet, float]:
    """Let the simulated arm move as the collector does, and record as it does.

    Returns
    -------
    DataSet
        Ball positions and the joints at the stamps.
    float
        How late the images are stamped, s.
    """
    rng = np.random.default_rng([minute.seed, 1])
    late_s = float(rng.uniform(0.0, MOST_LATE_S))
    simulation = simulation_of(minute.conditions)
    simulation.reset(HOME_RAD, minute.seed)
    motion = RandomMotion(HOME_RAD, MotionConfig(minute.duration_s), rng)
    matcher = Timeline()
    samples: list[Sample] = []
    joints = simulation.joints_rad
    while simulation.time_s < minute.duration_s:
        simulation.command(motion.command(simulation.time_s, joints))
        out = simulation.advance()
        joints = out.joints_rad
        samples += matcher.add_joints(out.time_s, joints)
        for seen in out.observations:
            if seen.detection is not None:
                samples += matcher.add_ball(seen.stamp_s + late_s, seen.detection.position_m)
    return data_set_of(samples), late_s


def learn(minute: Minute) -> dict[str, Any]:
    """Record a minute, fit, distill and train, and compare with the true Jacobian.

    Returns
    -------
    dict
        A row: relative errors of the Jacobians (medians over the places) of the chain, of the
        networks distilled from it and of those that the paper's training makes of the same data, in
        box M and over the workspace; ``fit_s`` of one core for chain and distillation; how late the
        images were stamped, and what the fit says.
    """
    data, late_s = record(minute)
    began_s = time.process_time()
    distilled = train_structured(data, seed=minute.seed)
    fit_s = time.process_time() - began_s
    trained = train(data, TrainingOptions(method=minute.papers_method, seed=minute.seed))
    simulation = simulation_of(minute.conditions)
    row = {
        "part": "minute",
        "seed": minute.seed,
        "images": len(data),
        "fit_s": fit_s,
        "late_s": late_s,
        "found_late_s": distilled.errors["time_offset_s"],
        "late_error_s": abs(distilled.errors["time_offset_s"] - late_s),
    }
    assert distilled.chain is not None
    for where, joints in minute.places.items():
        true = np.array([simulation.true_jacobian(one) for one in joints])
        for who, model in (
            ("chain", distilled.chain),
            ("distilled", distilled.model),
            ("paper", trained.model),
        ):
            errors = relative_errors(model.jacobian(joints), true)
            row[f"{who}_{where}"] = float(np.median(errors))
    return row


def assess(task: tuple[str, Minute]) -> dict[str, Any]:
    """Record a minute of a plant, fit a chain, and compare its error with what the fit says.

    Returns
    -------
    dict
        A row: what errs, the error ``stated`` by the fit, and the errors against the Jacobian of
        where the camera sees the ball (``seen``) and of where it is (``metric``), medians in box M.
    """
    plant, minute = task
    fit = fit_chain(record(minute)[0])
    simulation = simulation_of(minute.conditions)
    joints = minute.places["box"]
    metric = np.array([simulation.true_jacobian(one) for one in joints])
    # how the camera errs is linear
    seen = np.stack([simulation.as_seen(one) for one in np.eye(metric.shape[1])], axis=1) @ metric
    found = fit.chain.jacobian(joints)
    stated = float(np.median(fit.jacobian_deviation(joints)))
    errors = {
        name: float(np.median(relative_errors(found, true)))
        for name, true in (("seen", seen), ("metric", metric))
    }
    return {
        "part": "assessment",
        "plant": plant,
        "stated": stated,
        **errors,
        "honesty": stated / errors["seen"],
    }
