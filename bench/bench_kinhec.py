"""Calibration on KinHEC, a published benchmark of hand-eye methods, beside its own solvers.

``python -m bench kinhec``, with ``pip install kinhec``. Its generator makes joint motion of five
arms for 30 s, before and with the camera in the hand, at three levels of camera noise; all methods
get the same frames, and exact joints. Theirs get the flange's poses, ours the joints and the axes
of the arm. FVS_BENCH_KINHEC sets how many sequences there are of each kind (2).
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np
import yaml

from fvs_estimator_node.files import DataSet
from fvs_estimator_node.hand_eye import calibrate
from fvs_ros.feature import PoseFeature, rotation_angle_rad, rotation_matrix
from fvs_ros.urdf import Kinematics

REPEATS = int(os.environ.get("FVS_BENCH_KINHEC", "2"))
ROBOTS = ("ur5e", "panda", "iiwa7", "irb120", "puma560")
LEVELS = ("c1", "c2", "c3")
POSE = PoseFeature(0.3)


def plan(repeats):
    """Their configuration: of their noise track the continuous motion alone."""
    from kinhec import config

    text = (Path(config.__file__).parent / "configs" / "smoke.yaml").read_text()
    plan = yaml.safe_load(text)
    family = {"family": "joint_sinusoid", "mode": "continuous", "duration_s": 30}
    noise = {
        "robots": list(ROBOTS),
        "configurations": ["eye_in_hand", "eye_to_hand"],
        "families": [{**family, "camera_rate_hz": 30}],
        "robot_levels": ["r0"],
        "camera_levels": list(LEVELS),
        "repeats": repeats,
    }
    plan["tracks"] = {"noise": noise}
    return plan


def arm_of(robot):
    """The axes of a robot that is told by Denavit-Hartenberg parameters."""
    axes, points, pose = [], [], np.eye(4)

    def step(axis, turn, shift):
        one = np.eye(4)
        one[:3, :3], one[:3, 3] = rotation_matrix(turn * axis), shift * axis
        return one

    for a, d, alpha, offset, sign in zip(
        robot.a, robot.d, robot.alpha, robot.theta_offset, robot.sign, strict=True
    ):
        along = step(np.eye(3)[0], alpha, a)
        if robot.convention == "modified":
            pose = pose @ along
        axes.append(sign * pose[:3, 2])
        points.append(pose[:3, 3])
        pose = pose @ step(np.eye(3)[2], offset, d)
        if robot.convention == "standard":
            pose = pose @ along
    pose = pose @ robot.tool_matrix
    names = tuple(f"joint_{i + 1}" for i in range(robot.dof))
    return Kinematics(
        "base", "flange", names, np.array(axes), np.array(points), np.zeros(robot.dof),
        pose[:3, :3], pose[:3, 3],
    )  # fmt: skip


def errors(rotation, place_m, truth):
    """Degrees and mm."""
    turn = np.degrees(rotation_angle_rad(rotation.T @ truth[:3, :3]))
    return turn, 1e3 * np.linalg.norm(place_m - truth[:3, 3])


def ours(sequence):
    from kinhec.robots import get_robot

    arm, seen = arm_of(get_robot(sequence.manifest["robot"])), sequence.camera
    some = seen.has_measurement
    poses, stamps_s = seen.T_cam_target_meas[some], seen.t[some]
    joints = np.array(
        [np.interp(stamps_s, sequence.robot.t, column) for column in sequence.robot.q_meas.T]
    ).T
    features = np.array([POSE.of(one[:3, 3], one[:3, :3]) for one in poses])
    segment = np.zeros(len(stamps_s), int)
    data = DataSet(stamps_s, joints, features, segment, arm.names, feature="pose")
    found = calibrate(data, arm, sequence.eye_in_hand)
    truth = sequence.X if sequence.eye_in_hand else sequence.Y
    return errors(found.rotation, found.translation_m, truth)


def theirs(sequence):
    """By solver, of those that give what is wanted."""
    from kinhec.benchmark import SOLVERS, evaluate_sequence

    which = "X" if sequence.eye_in_hand else "Y"
    rows = evaluate_sequence(sequence, [name for name in SOLVERS if "scale" not in name])
    return {
        row["solver"]: (row[f"{which}_rot_err_deg"], row[f"{which}_trans_err_mm"])
        for row in rows
        if row["ok"] and f"{which}_rot_err_deg" in row
    }


def main():
    try:
        from kinhec import pipeline
        from kinhec.io import iter_sequences
    except ImportError:
        print("skipped: it needs the published benchmark, pip install kinhec")
        return
    with tempfile.TemporaryDirectory() as folder:
        config, root = Path(folder) / "plan.yaml", Path(folder) / "data"
        config.write_text(yaml.safe_dump(plan(REPEATS)))
        pipeline.generate_dataset(
            str(config), root, work_dir=Path(folder) / "work", write_card=False, progress=False
        )
        found = {}
        for sequence in iter_sequences(root):
            kind = "eye in hand" if sequence.eye_in_hand else "eye to hand"
            level = sequence.manifest["level"]
            for name, values in {"fvs_calibrate": ours(sequence), **theirs(sequence)}.items():
                found.setdefault((kind, level), {}).setdefault(name, []).append(values)
    for (kind, level), solvers in sorted(found.items()):
        print(f"{kind}, {level}: median of {len(solvers['fvs_calibrate'])} sequences, deg and mm")
        for name, values in sorted(solvers.items(), key=lambda one: np.median(one[1], axis=0)[1]):
            turn, way = np.median(values, axis=0)
            print(f"  {name:<20} {turn:8.4f} {way:8.3f}")
