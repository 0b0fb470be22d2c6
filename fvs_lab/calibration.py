"""The camera's pose from a minute of motion, beside the classic hand-eye solvers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2

from fvs_detector_node.tags import Tag
from fvs_estimator_node.collecting import CollectorConfig
from fvs_lab import experiment as lab
from fvs_lab.arms import collect
from fvs_lab.results import METRICS, Results
from fvs_lab.trials import BOX_RAD, HOME_RAD, Conditions, simulation_of
from fvs_ros.kinds.ball import Ball
from fvs_ros.kinds.pose import Pose
from fvs_ros.rotations import rotation_from_vector, vector_from_rotation_rad
from fvs_ros.urdf import read_joints
from fvs_sim_node.robot import robot_of
from fvs_sim_node.simulation import Simulation
from fvs_tools.calibration import calibrate
from fvs_tools.hand_eye_model import registration
from fvs_tools.kinematics import Kinematics, kinematics

#: Duration of the motion, s.
MOTION_S = 60.0
#: Largest errors, m and degrees, by the size of the errors of the joints' zeros, degrees.
LIMITS = {0.0: (0.001, 0.1), 1.0: (0.003, 0.3)}
#: Poses that are taught for the classic solvers, and the board that they see.
TAUGHT, BOARD = 20, Tag(tag_size_m=0.075, tag_layout="plate")
#: OpenCV's, by their authors.
SOLVERS = ("Tsai", "Park", "Horaud", "Andreff", "Daniilidis")
#: Python lacks it in OpenCV 5.0.0, by a fault of the binding that is mended upstream (pull request
#: 29584); without it, the solvers have no rows.
_SOLVE: Any = getattr(cv2, "calibrateHandEye", None)


@lru_cache(maxsize=1)
def arm() -> Kinematics:
    """Of the UR5's URDF."""
    return kinematics(read_joints(robot_of("ur5").file().read_text("utf-8")))


def zeros_rad(seed: int, size_deg: float) -> np.ndarray:
    """Errors of the joints' zeros: what has to be added to what is reported."""
    signs = np.random.default_rng([seed, 7]).choice([-1.0, 1.0], len(HOME_RAD))
    return np.asarray(np.radians(size_deg) * signs)


def errors(
    simulation: Simulation, zeros: np.ndarray, rotation: np.ndarray, position_m: np.ndarray
) -> np.ndarray:
    """Of a camera's pose in the arm's frame: position, m, and rotation, rad, (6,).

    An error of the first joint's zero rotates the arm's frame as such.
    """
    reported_from_true = rotation_from_vector(-zeros[0] * arm().axes[0])
    camera = simulation.camera
    error_rad = vector_from_rotation_rad(rotation @ (reported_from_true @ camera.rotation).T)
    return np.append(position_m - reported_from_true @ camera.position_m, error_rad)


def _row(scheme: str, zeros_deg: float, error: np.ndarray, **columns: Any) -> dict[str, Any]:
    position_m, angle_rad = np.linalg.norm(error.reshape(2, 3), axis=1).tolist()
    labels = {"scheme": scheme, "zeros_deg": zeros_deg, **columns}
    return {**labels, "position_m": position_m, "angle_deg": float(np.degrees(angle_rad))}


def motion(seed: int, feature: str, duration_s: float = MOTION_S) -> CollectorConfig:
    """How the collector moves the arm."""
    return CollectorConfig(
        duration_s=duration_s,
        seed=seed,
        feature=feature,
        joint_range_rad=(0.5,) * len(HOME_RAD),
        max_joint_velocity_rad_s=0.65,
    )


def by_motion(seed: int, feature: str, duration_s: float) -> list[dict[str, Any]]:
    """Collect as the collector does, and calibrate: a row for each size of zeros."""
    simulation = simulation_of(Conditions(feature=feature, position_noise_m=0.0))
    data = collect(simulation, motion(seed, feature, duration_s))
    rows = []
    for size_deg in LIMITS:
        zeros = zeros_rad(seed, size_deg)
        estimate = calibrate(replace(data, joints_rad=data.joints_rad - zeros), arm())
        pose = estimate.base_from_camera
        error = errors(simulation, zeros, pose[:3, :3], pose[:3, 3])
        inside = bool(error @ np.linalg.solve(estimate.covariance, error) < chi2.ppf(0.95, 6))
        rows.append(_row(f"motion, {feature}", size_deg, error, seed=seed, inside=inside))
    return rows


def by_solvers(seed: int) -> list[dict[str, Any]]:
    """Teach poses before a rendered board, and give them to OpenCV's solvers."""
    simulation = simulation_of(Conditions(feature=Pose.name, position_noise_m=0.0, tag=BOARD))
    rng = np.random.default_rng([seed, 8])
    joints: list[np.ndarray] = []
    boards: list[tuple[np.ndarray, np.ndarray]] = []
    while len(joints) < TAUGHT:
        drawn = HOME_RAD + rng.uniform(-1.0, 1.0, HOME_RAD.size) * BOX_RAD
        simulation.reset(drawn, seed)
        z = simulation.look().z
        if z is not None:
            joints.append(drawn)
            boards.append((Pose().rotation(z), z[:3]))
    rows = []
    for size_deg in LIMITS:
        zeros = zeros_rad(seed, size_deg)
        reported = np.array(joints) - zeros
        error = errors(simulation, zeros, *least_squares_pose(reported, boards))
        rows.append(_row("least squares with zeros", size_deg, error, seed=seed))
        # The solvers are for a camera in the hand; for one beside it, the base moves as the tip
        # sees it.
        tip_from_base, tips_m = arm().tip_at(reported)
        bases_m = [-rot @ tip_m for rot, tip_m in zip(tip_from_base, tips_m, strict=True)]
        for name in SOLVERS if _SOLVE else ():
            method = getattr(cv2, f"CALIB_HAND_EYE_{name.upper()}")
            rotation, position_m = _SOLVE(
                list(tip_from_base), bases_m, *map(list, zip(*boards, strict=True)), method=method
            )
            error = errors(simulation, zeros, rotation, position_m.ravel())
            rows.append(_row(name, size_deg, error, seed=seed))
    return rows


def least_squares_pose(
    reported_rad: np.ndarray, boards: list[tuple[np.ndarray, np.ndarray]]
) -> tuple[np.ndarray, np.ndarray]:
    """A camera's rotation and position, m, by least squares with the joints' zeros as unknowns.

    Of boards at reported joints, rad, (k, n), with rotations and positions, m, from images.
    Rotations count by their arcs at 0.3 m. The zero of the first joint counts as the base's.
    """
    kind = Pose(0.3)
    measured = np.array([kind.of_body(position, rotation) for rotation, position in boards])
    start, board = registration(arm(), reported_rad, measured)

    def camera(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return rotation_from_vector(values[3:6]) @ start[:3, :3], start[:3, 3] + values[:3]

    def residuals(values: np.ndarray) -> np.ndarray:
        rotation, position_m = camera(values)
        chain = arm().chain(kind.retract(board, kind.unit * values[6:12]))
        joints = reported_rad + np.append(0.0, values[12:])
        vectors = chain.position(joints).reshape(len(joints), -1, 3)
        vectors[:, 0] -= position_m
        features = (vectors @ rotation).reshape(measured.shape)
        return np.ravel(kind.weights * (features - measured))

    return camera(least_squares(residuals, np.zeros(11 + len(arm().names))).x)


def measure(context: lab.Context) -> Results:
    """Calibrate by motion and by taught poses, with many seeds."""
    seeds = range(1, 1 + context.count(20))
    duration_s = 8.0 if context.quick else MOTION_S
    features = context.first((Ball.name, Pose.name), 1)
    tasks = [(seed, feature, duration_s) for feature in features for seed in seeds]
    motion = context.rows(by_motion, tasks, "motion")
    return Results([*motion, *context.rows(by_solvers, seeds, "taught poses")])


def claims(runs: Results) -> Iterator[lab.Claim]:
    """Accuracy, honesty, and the classic solvers."""
    motion = runs.those(lambda row: "inside" in row)
    taught = runs.those(lambda row: "inside" not in row)
    for zeros_deg, (position_m, angle_deg) in LIMITS.items():
        group = motion.where(zeros_deg=zeros_deg)
        good = [row["position_m"] < position_m and row["angle_deg"] < angle_deg for row in group]
        yield lab.ours("exact" if zeros_deg == 0.0 else "zeros", lab.kept("runs", good, 1.0))
        rivals = taught.where(zeros_deg=zeros_deg).groups("scheme").values()
        parts = []
        for column in ("position_m", "angle_deg"):
            least, metric = min(rival.median(column).value for rival in rivals), METRICS[column]
            parts.append(lab.below(metric.label, group.median(column), least, metric.factor))
        yield lab.ours("solvers", *parts, zeros=zeros_deg)
    yield lab.ours("honest", lab.kept("runs", motion.values("inside"), 0.9))


TABLES = (
    lab.Table(
        "schemes",
        ("scheme",),
        (
            "position_m:half",
            "position_m:largest",
            "angle_deg:half",
            "inside:of",
        ),
        across="zeros_deg",
    ),
)


EXPERIMENT = lab.Experiment("calibration", measure, claims, TABLES, globals())
