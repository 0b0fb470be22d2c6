"""Calibration and chains on recordings of real arms, which others published, beside OpenCV.

``python -m bench real [./FOLDER]``, by default ``../shared/real`` beside the repository, with what
their authors published in ``jazzy_apriltag`` (robgineer/cobot, offline_hand_eye), ``ur3a_webcams``
(alimedlej00/robot-hand-eye-calibration-experiments), ``ethz_arm`` (ethz-asl/hand_eye_calibration)
and ``justin`` (dlr-alr/dlr-elastic-calibration). What is fitted to 70 % of the images predicts
where the camera sees the target in the others, which the detector knows with a noise of its own.
"""

from __future__ import annotations

import json
import re
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.tag_detector import TagDetector
from fvs_detector_node.tags import SQUARE, Tag
from fvs_estimator_node.chain_fit import fit_chain
from fvs_estimator_node.files import DataSet
from fvs_ros.camera import camera_model
from fvs_ros.rotations import rotation_from_vector
from fvs_ros.urdf import Kinematics
from fvs_tools.calibration import calibrate
from fvs_tools.table import read_table

FOLDER = Path(__file__).resolve().parents[2] / "shared" / "real"
#: Of the splits; the first is that of the authors of ur3a_webcams.
SEEDS, SHARE = (7, 1, 2, 3, 4), 0.7
SOLVERS = ("TSAI", "PARK", "HORAUD", "ANDREFF", "DANIILIDIS")
#: Pieces of a motion that are fitted or held out; most poses for the solvers, which take all pairs.
PIECES, MOST = 10, 100
COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")


class Recording(NamedTuple):
    """An arm before a camera, or with one on its hand."""

    name: str
    data: DataSet
    arm: Kinematics
    seen: np.ndarray  # poses of the target in the camera, (k, 4, 4)
    #: For errors in the image: points of the target, m, and the camera's matrix.
    points_m: np.ndarray | None = None
    matrix: np.ndarray | None = None
    wrong: np.ndarray | bool = False  # images that are known to be wrong, (k,)
    on_arm: bool = False


def matrices(places_m, rotations):
    """Poses, (k, 4, 4)."""
    poses = np.tile(np.eye(4), (*np.shape(places_m)[:-1], 1, 1))
    poses[..., :3, :3], poses[..., :3, 3] = rotations.as_matrix(), places_m
    return poses


def as_rows(poses):
    return np.hstack([poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3]).as_quat()])


def hands_of(arm, joints):
    """Poses of the tip."""
    turns, places = arm.tip_at(joints)
    return matrices(places, Rotation.from_matrix(np.swapaxes(turns, 1, 2)))


def of_table(names, rows):
    """A data set, and an arm, as from a user's table that ends with the target's poses."""
    lines = [["" if np.isnan(one) else repr(float(one)) for one in row] for row in rows]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "poses.csv"
        path.write_text("\n".join(",".join(line) for line in [[*names, *COLUMNS], *lines]))
        return read_table(path)


def arm_of(model):
    """The axes of an arm that is told by Denavit-Hartenberg parameters."""
    pose, axes, points_m = np.eye(4), [], []
    for joint in model:
        axes.append(pose[:3, 2])
        points_m.append(pose[:3, 3])
        for axis, angle, shift in ((2, "theta_offset", "d"), (0, "alpha", "a")):
            step = np.eye(4)
            step[:3, :3] = rotation_from_vector(joint[angle] * np.eye(3)[axis])
            step[axis, 3] = joint[shift]
            pose = pose @ step
    names = tuple(f"joint_{i + 1}" for i in range(len(model)))
    axes, points_m, tip = np.array(axes), np.array(points_m), (pose[:3, :3], pose[:3, 3])
    return Kinematics("base", "flange", names, axes, points_m, np.zeros(len(model)), *tip)


# --- the recordings ---


def jazzy(folder):
    """Still images of a tag on the arm, and the inverse pose of the hand."""
    about = json.loads((folder / "frames.json").read_text())
    camera, frames, hands, seen = about["camera"], about["frames"], [], []
    model = camera_model(*(camera[one] for one in ("width", "height", "k", "model", "d")))
    tag = Tag(tag_id=about["tag"]["id"], tag_size_m=about["tag"]["size_m"])
    detector = TagDetector(DetectorConfig(feature="pose", tag=tag))
    for number, frame in enumerate(frames):
        image = cv2.cvtColor(cv2.imread(str(folder / frame["image"])), cv2.COLOR_BGR2RGB)
        found = detector.look(float(number), image, None, model).detection
        if found is not None:
            place, turn = (list(one.values()) for one in frame["base_to_tcp"].values())
            hands.append(np.linalg.inv(matrices(place, Rotation.from_quat(turn))))
            seen.append(matrices(found.position_m, Rotation.from_matrix(found.rotation)))
    seen, names = np.array(seen), [f"hand_{one}" for one in COLUMNS]
    data, arm = of_table(names, np.hstack([as_rows(np.array(hands)), as_rows(seen)]))
    name = f"tag, read in {len(seen)} of {len(frames)} images"
    yield Recording(name, data, arm, seen, tag.tag_size_m * SQUARE, np.reshape(camera["k"], (3, 3)))


def webcams(folder):
    """Still images of a chessboard on the hand, from several cameras, and joints in degrees."""
    arm = arm_of(json.loads(next(folder.glob("robot_model*.json")).read_text())["joints"])
    poses = json.loads(next(folder.glob("dataset*.json")).read_text())["poses"]
    for path in sorted(folder.glob("intrinsics_cam*.json")):
        name, about = path.stem.removeprefix("intrinsics_"), json.loads(path.read_text())
        size = tuple(about["pattern_size_inner_corners"].values())
        points_m = np.insert(np.mgrid[: size[0], : size[1]].T.reshape(-1, 2), 2, 0.0, axis=1)
        points_m = about["square_size_m"] * (points_m - points_m.mean(axis=0))
        numbers, joints, seen = [], [], []
        for pose in sorted(poses, key=lambda one: one["images"][name]):
            for image in folder.glob(f"{pose['images'][name]}.*"):
                grey = cv2.imread(str(image), cv2.IMREAD_GRAYSCALE)
                read, corners_px = cv2.findChessboardCornersSB(grey, size)
                if read:
                    matrix, lens = scaled(about, grey.shape[1])
                    turn, place = cv2.solvePnP(points_m, corners_px, matrix, lens)[1:]
                    seen.append(matrices(place[:, 0], Rotation.from_rotvec(turn[:, 0])))
                    joints.append(np.radians(list(pose["joint_angles_deg"].values())))
                    numbers.append(pose["pose_id"])
        if seen:
            seen = upright(hands_of(arm, np.array(joints)), np.array(seen))
            data, _ = of_table(arm.names, np.hstack([joints, as_rows(seen)]))
            wrong = np.isin(numbers, [25, 26])
            name = f"{name}, board read in {len(seen)} images"
            yield Recording(name, data, arm, seen, points_m, matrix, wrong)


def scaled(about, width):
    """Camera matrix and distortion for images of another width."""
    scale = width / about["image_size_wh"]["width"]
    matrix = np.array(about["intrinsics_K"]["matrix_3x3"])
    matrix[:2] *= scale
    matrix[:2, 2] += 0.5 * (scale - 1.0)  # integer coordinates are the pixels' middles
    return matrix, np.array(about["distortion"]["coefficients"])


def upright(hands, seen):
    """A board of 9 x 7 corners looks alike upside down; the hand turns by the board's angle."""
    flipped = seen @ np.diag([-1.0, -1.0, 1.0, 1.0])
    of_hand, of_seen, of_flipped = (
        Rotation.from_matrix(first[:3, :3].T @ poses[:, :3, :3]).magnitude()
        for first, poses in ((hands[0], hands), (seen[0], seen), (seen[0], flipped))
    )
    other = np.abs(of_flipped - of_hand) < np.abs(of_seen - of_hand)
    return np.where(other[:, None, None], flipped, seen)


def ethz(folder):
    """A camera on the arm in motion: its pose before the target, and the pose of the hand."""
    hand, camera = (
        np.loadtxt(next(folder.glob(one)), delimiter=",") for one in ("*base_link*", "*target*")
    )
    seen = np.linalg.inv(matrices(camera[:, 1:4], Rotation.from_quat(camera[:, 4:])))
    rows = np.full((len(hand) + len(camera), 15), np.nan)
    rows[: len(hand), :8] = hand
    rows[len(hand) :, 0], rows[len(hand) :, 8:] = camera[:, 0], as_rows(seen)
    data, arm = of_table(["stamp_s", *(f"hand_{one}" for one in COLUMNS)], rows)
    seen = seen[np.isin(camera[:, 0], data.stamps_s)]
    yield Recording("camera on the arm", data, arm, seen, on_arm=True)


# --- what is fitted, and what it predicts ---


def splits(count):
    """Which of some pieces to fit, bool (count,)."""
    for seed in SEEDS:
        order = np.arange(count)
        np.random.default_rng(seed).shuffle(order)
        yield np.isin(np.arange(count), order[: round(SHARE * count)])


def part(data, some):
    """The images of a mask; runs end where others are left out."""
    names = ("stamps_s", "joints_rad", "ball_m")
    segment = (data.segment + np.cumsum(np.diff(some, prepend=False)))[some]
    return replace(data, segment=segment, **{name: getattr(data, name)[some] for name in names})


def by_us(one, some):
    """Where the calibration of some images has the target in all."""
    data, estimate = one.data, calibrate(part(one.data, some), one.arm, one.on_arm)
    delay_s = estimate.mean.delay_s.item()
    exposed_s = data.stamps_s - (0.0 if data.still else delay_s)
    columns = data.joints_rad.T[:: -1 if one.on_arm else 1]
    joints = np.array([np.interp(exposed_s, data.stamps_s, column) for column in columns]).T
    features = estimate.model.at(joints, estimate.mean)
    turns = Rotation.from_matrix(np.swapaxes(features[:, 3:].reshape(-1, 3, 3), 1, 2))
    return matrices(features[:, :3], turns), delay_s


def by_opencv(one, some, method):
    """The same by a solver of OpenCV, with the mean of what it does not solve for."""
    hands = hands_of(one.arm, one.data.joints_rad)
    # They are for a camera in the hand; for one beside it, the base moves as the hand sees it.
    hands = hands if one.on_arm else np.linalg.inv(hands)
    few = np.flatnonzero(some)[:: max(1, np.count_nonzero(some) // MOST)]
    pairs = (poses[few, :3, part] for poses in (hands, one.seen) for part in (slice(3), 3))
    method = getattr(cv2, f"CALIB_HAND_EYE_{method}")
    rotation, place = cv2.calibrateHandEye(*pairs, method=method)
    camera = matrices(place.T, Rotation.from_matrix(rotation[None]))
    there = hands[few] @ camera @ one.seen[few]
    turn = Rotation.from_matrix(there[:, :3, :3]).mean()
    return np.linalg.inv(hands @ camera) @ matrices(there[:, :3, 3].mean(axis=0)[None], turn)


def errors(one, poses, held):
    """Rms over held-out images: mm, degrees and, with a camera matrix, pixels."""
    poses, seen = poses[held], one.seen[held]
    turns = np.swapaxes(poses[:, :3, :3], 1, 2) @ seen[:, :3, :3]
    off = [1e3 * (poses - seen)[:, :3, 3], np.degrees(Rotation.from_matrix(turns).as_rotvec())]
    if one.matrix is not None:
        both = np.stack([poses, seen])[..., :3, :] @ np.insert(one.points_m, 3, 1.0, axis=1).T
        image = one.matrix @ both
        predicted, found = image[..., :2, :] / image[..., 2:, :]
        off.append(np.swapaxes(predicted - found, 1, 2).reshape(-1, 2))
    return [np.sqrt(np.mean(np.sum(each**2, axis=1))) for each in off]


def compare(one, use):
    """Print the errors on the held-out of the images that are used."""
    solvers = SOLVERS if hasattr(cv2, "calibrateHandEye") else ()
    rows, count = {}, len(one.data)
    pieces = np.arange(count) * (count if one.data.still else PIECES) // count
    for fitted in splits(pieces[-1] + 1):
        some, held = use & fitted[pieces], use & ~fitted[pieces]
        poses, delay_s = by_us(one, some)
        rows.setdefault("fvs_calibrate", []).append(errors(one, poses, held))
        for method in solvers:
            poses = by_opencv(one, some, method)
            rows.setdefault(f"OpenCV {method.title()}", []).append(errors(one, poses, held))
    print(f"  {one.name}; fitted {np.count_nonzero(some)}, held out {np.count_nonzero(held)}")
    for name, off in rows.items():
        each = zip(np.median(off, axis=0), off[0], ("mm", "deg", "px"), strict=False)
        print(
            f"    {name:<20}", *(f"{half:7.2f} ({first:.2f}) {unit}" for half, first, unit in each)
        )
    if not one.data.still:
        print(f"    images stamped {1e3 * delay_s:.1f} ms late by fvs_calibrate")


def justin(folder):
    """Chains of a humanoid's two arms from still poses, without a model."""
    words = re.split(r"\n(?=\d+,\[)", (folder / "measurements.csv").read_text())[1:]
    table = np.array([re.findall(r"-?\d\.\d*(?:e[+-]\d+)?", one) for one in words], float)
    # The torso's fourth joint is no column: it turns back what the second and the third turn.
    torso = np.column_stack([table[:, :3], -table[:, 1] - table[:, 2]])
    for name, arm, marker in (("right", slice(3, 10), 19), ("left", slice(10, 17), 22)):
        joints, seen_m = np.hstack([torso, table[:, arm]]), table[:, marker : marker + 3]
        means, k = [], np.arange(len(table))
        for some in splits(len(table)):
            data = DataSet(k[some] * 1.0, joints[some], seen_m[some], k[some], still=True)
            off_m = fit_chain(data).chain.position(joints[~some]) - seen_m[~some]
            means.append(1e3 * np.linalg.norm(off_m, axis=1).mean())
        print(f"  {name} arm, mean of {np.count_nonzero(~some)}: {np.median(means):.2f} mm")


NOTES = {
    "jazzy_apriltag": "by any detector the corners are 0.1 to 0.7 px from those of a square",
    "ur3a_webcams": "authors, one camera, first split: 8.0 mm, without pose 25 5.1 mm and 1.9 deg",
    "ethz_arm": "the stamps are known to be 15 to 20 ms late",
    "justin": "authors: nominal 21 mm, with elasticity 3.1 mm; a chain is rigid",
}


def main():
    folder = Path(sys.argv[1]) if sys.argv[1:] else FOLDER
    print(f"rms of what is held out, median of {len(SEEDS)} splits (and of the first)")
    if not hasattr(cv2, "calibrateHandEye"):
        print("OpenCV 5's Python lacks calibrateHandEye; its rows need 'opencv-python-headless<5'")
    for name, read in zip(NOTES, (jazzy, webcams, ethz, justin), strict=True):
        if not (folder / name).is_dir():
            print(f"{name} skipped: there is no folder {folder / name}")
            continue
        print(f"{name}: {NOTES[name]}", flush=True)
        for one in read(folder / name) or ():
            compare(one, np.ones(len(one.data), bool))
            if np.any(one.wrong):
                compare(one._replace(name="without poses 25 and 26, which are wrong"), ~one.wrong)
