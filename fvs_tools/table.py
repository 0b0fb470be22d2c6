"""A data set from a CSV file: still poses, or motion, of joints or of a hand's pose.

The first line names the columns. ``x, y, z`` are the position of ball or tag, camera frame, m,
and ``qx, qy, qz, qw`` the tag's orientation. The others are joints, rad (m), under their names; or
``hand_x`` to ``hand_qw``, the pose of the robot's hand in its base, which needs no URDF. Without
``stamp_s`` each line is a still pose. With it lines may be of other moments for arm and camera, and
leave the other's cells empty: then the arm is interpolated to the images.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import replace
from itertools import repeat
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fvs_estimator_node.files import DataSet, data_set_of
from fvs_ros.kinds import KINDS
from fvs_ros.kinds.pose import Pose
from fvs_ros.rotations import rotation_from_quaternion
from fvs_ros.timeline import Sample, Timeline
from fvs_tools.kinematics import Kinematics

_STAMP, _HAND = "stamp_s", tuple(f"hand_{name}" for name in Pose.columns)
#: A hand whose pose is measured, as an arm: it is shifted, then turned about z, y and x.
_FREE = Kinematics(
    root="base",
    tip="hand",
    names=("hand_x", "hand_y", "hand_z", "hand_yaw", "hand_pitch", "hand_roll"),
    axes=np.concatenate([np.eye(3), np.eye(3)[::-1]]),
    points_m=np.zeros((6, 3)),
    prismatic=np.repeat([1.0, 0.0], 3),
    tip_rotation=np.eye(3),
    tip_m=np.zeros(3),
    exact=True,
)


def read_table(path: Path) -> tuple[DataSet, Kinematics | None]:
    """The data set, and the kinematics of a hand whose pose it holds.

    Raises a ``ValueError`` if the file cannot be used; the text says why.
    """
    try:
        return _data_set(path.name, *_read(path))
    except (ValueError, csv.Error) as error:
        raise ValueError(f"{path}: {error}") from None


def _read(path: Path) -> tuple[list[str], np.ndarray]:
    """The columns' names, and the numbers, NaN for an empty cell."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = file.read().rstrip().splitlines()
    names, *lines = [*csv.reader(rows, skipinitialspace=True)] or [[]]
    names = [name.strip() for name in names]
    if len(set(names)) < len(names):
        raise ValueError("the first line names a column twice")
    table = np.full((len(lines), len(names)), np.nan)
    for number, line in enumerate(lines):
        if len(line) != len(names):
            raise ValueError(f"line {number + 2} has {len(line)} cells, the first {len(names)}")
        for column, cell in enumerate(line):
            try:
                table[number, column] = float(cell.strip() or "nan")
            except ValueError:
                raise ValueError(
                    f"line {number + 2}, column {names[column][:60]}: expected a number, got "
                    f"{cell[:60]!r}"
                ) from None
    return names, table


def _part(names: Sequence[str], table: np.ndarray, wanted: Sequence[str]) -> np.ndarray:
    """Columns, with a line all NaN where it has none of them."""
    missing = [name for name in wanted if name not in names]
    if missing or not wanted:
        raise ValueError(
            f"there is no column {', '.join(missing) or 'of a joint'}; the first line names "
            f"{', '.join(names)[:300]}"
        )
    part = table[:, [names.index(name) for name in wanted]]
    ragged = np.flatnonzero(~np.isfinite(part).all(axis=1) & ~np.isnan(part).all(axis=1))
    if ragged.size:
        raise ValueError(f"line {ragged[0] + 2} lacks a number of {', '.join(wanted)[:200]}")
    return part


def _data_set(
    source: str, names: list[str], table: np.ndarray
) -> tuple[DataSet, Kinematics | None]:
    of_hand, timed = _HAND[0] in names, _STAMP in names
    # The one with most columns, if its last is there.
    kind = max(KINDS.values(), key=lambda k: len(k.columns) * (k.columns[-1] in names))()
    joint_names = tuple(name for name in names if name not in (_STAMP, *kind.columns))
    joints = _part(names, table, _HAND if of_hand else joint_names)
    images = _part(names, table, kind.columns)
    stamps_s = _part(names, table, [_STAMP])[:, 0] if timed else np.arange(float(len(table)))
    if np.isnan(stamps_s).any():
        raise ValueError(f"line {np.isnan(stamps_s).argmax() + 2} lacks a {_STAMP}")
    has_joints, has_image = np.isfinite(joints[:, 0]), np.isfinite(images[:, 0])
    joints, images, arm = joints[has_joints], images[has_image], None
    if of_hand:
        arm, joints = _as_arm(joints)
    elif timed:  # a driver may wrap its joints at half a turn
        joints = np.unwrap(joints, axis=0)
    images = np.array([kind.parse(numbers) for numbers in images])
    timeline, samples = Timeline(), list[Sample]()
    of_arm = zip(stamps_s[has_joints].tolist(), repeat(timeline.add_joints), joints)
    of_camera = zip(stamps_s[has_image].tolist(), repeat(timeline.add_image), images)
    # At equal stamps the joints first.
    for stamp_s, add, values in sorted([*of_arm, *of_camera], key=lambda event: event[0]):
        samples += add(stamp_s, values)
    if not samples or (not timed and len(samples) < len(table)):
        raise ValueError(
            f"{len(samples)} of {len(images)} images have an arm at their time, in "
            f"metres and radians ({timeline.last_reason or 'no joints'})"
        )
    data = data_set_of(
        samples,
        joint_names=joint_names if arm is None else arm.names,
        feature=kind.name,
        provenance={"table": source},
        still=not timed,
    )
    return data, arm


def _as_arm(poses: np.ndarray) -> tuple[Kinematics, np.ndarray]:
    """An arm whose joints put its tip into a hand's poses; angles count from the mean rotation."""
    rotations = Rotation.from_matrix([rotation_from_quaternion(q) for q in poses[:, 3:]])
    middle = rotations.mean()
    angles = np.unwrap((rotations * middle.inv()).as_euler("ZYX"), axis=0)
    return replace(_FREE, tip_rotation=middle.as_matrix()), np.hstack([poses[:, :3], angles])
