"""The data set: ball positions and the joints at their exposures, in a ``.npz`` file."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fvs_estimator_node.npz_file import NpzFile, check_same, write_npz
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_ros.timeline import Sample

DATA_SET_FORMAT = "fvs_dataset"
DATA_SET_VERSION = 1
MAX_DATA_SET_BYTES = 2**30


class DataSetError(ValueError):
    """A data set that cannot be used; the text says what was wrong and what was expected."""


@dataclass(frozen=True)
class DataSet:
    """Ball positions and the joints at their exposures.

    Parameters
    ----------
    stamps_s : ndarray, shape (n,)
        Exposure times, s; rising within a segment.
    joints_rad : ndarray, shape (n, joints)
        Joint positions at exposure, rad.
    ball_m : ndarray, shape (n, m)
        Ball positions in the feature frame, m.
    segment : ndarray of int, shape (n,)
        Number of the continuous run a sample belongs to; never falls.
    joint_names : tuple of str
        Names of the columns of ``joints_rad``.
    feature_frame : str
        Frame of the ball positions.
    provenance : dict
        Where it comes from; anything that JSON can hold.

    Raises
    ------
    DataSetError
        If shapes do not fit, something is not finite, or stamps or segments go back.
    """

    stamps_s: np.ndarray
    joints_rad: np.ndarray
    ball_m: np.ndarray
    segment: np.ndarray
    joint_names: tuple[str, ...] = UR_JOINT_NAMES
    feature_frame: str = CAMERA_FRAME
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = len(self.stamps_s)
        wanted = {
            "stamps_s": (n,),
            "joints_rad": (n, len(self.joint_names)),
            "ball_m": (n, *np.shape(self.ball_m)[1:2]),
            "segment": (n,),
        }
        for name, shape in wanted.items():
            value = np.asarray(getattr(self, name))
            value = value.astype(np.int64 if name == "segment" else float)
            if value.shape != shape:
                raise DataSetError(f"{name} has shape {value.shape}, expected {shape}")
            if not np.all(np.isfinite(value)):
                raise DataSetError(f"{name} holds a number that is not finite")
            object.__setattr__(self, name, value)
        object.__setattr__(self, "joint_names", tuple(self.joint_names))
        if np.any(np.diff(self.segment) < 0):
            raise DataSetError("segment numbers go back, expected runs one after the other")
        same = np.diff(self.segment) == 0
        if np.any(np.diff(self.stamps_s)[same] <= 0.0):
            raise DataSetError("stamps_s do not rise within a segment")

    def __len__(self) -> int:
        return len(self.stamps_s)


def data_set_of(samples: Sequence[Sample], **particulars: Any) -> DataSet:
    """A data set of samples; ``particulars`` are its other fields."""
    return DataSet(
        stamps_s=np.array([s.stamp_s for s in samples]),
        joints_rad=np.array([s.joints_rad for s in samples]),
        ball_m=np.array([s.ball_m for s in samples]),
        segment=np.array([s.run for s in samples]),
        **particulars,
    )


#: Offsets of the images' stamps below this are not worth a word, s.
_NOTABLE_OFFSET_S = 0.003


def late_stamps_note(offset_s: float) -> str:
    """What to say of images that are stamped late (or early, if negative), s; empty if nothing."""
    if abs(offset_s) <= _NOTABLE_OFFSET_S:
        return ""
    side = "before" if offset_s > 0.0 else "after"
    clocks = "" if offset_s > 0.0 else " (if more than half an image's time: set the clocks, NTP)"
    return (
        f"the images show the joints of {1e3 * abs(offset_s):.0f} ms {side} their stamps; "
        f"corrected here, but the loop needs it, too: add {offset_s:.3f} to stamp_delay_s of "
        f"fvs_detector_node{clocks}"
    )


def save_data_set(path: str | os.PathLike[str], data: DataSet) -> None:
    """Write a data set in one piece."""
    write_npz(
        path,
        {
            "format": np.array(DATA_SET_FORMAT),
            "version": np.array(DATA_SET_VERSION),
            "joint_names": np.array(data.joint_names),
            "feature_frame": np.array(data.feature_frame),
            "stamps_s": data.stamps_s,
            "joints_rad": data.joints_rad,
            "ball_m": data.ball_m,
            "segment": data.segment,
            "provenance": np.array(json.dumps(dict(data.provenance), sort_keys=True)),
        },
    )


def load_data_set(
    path: str | os.PathLike[str],
    joint_names: Sequence[str] | None = UR_JOINT_NAMES,
    feature_frame: str | None = None,
) -> DataSet:
    """Read and check a data set.

    Parameters
    ----------
    path : path-like
        The file.
    joint_names : sequence of str, optional
        The joint order it must have; None takes any.
    feature_frame : str, optional
        The frame it must have; None takes any.

    Raises
    ------
    DataSetError
        If anything is not as expected; the text names the file, the fault and what was expected.
    """
    content = NpzFile(path, DATA_SET_FORMAT, DATA_SET_VERSION, MAX_DATA_SET_BYTES, DataSetError)
    names = content.joint_names()
    frame = content.text("feature_frame")
    check_same(DataSetError, f"{path}", names, frame, joint_names, feature_frame)
    joints = content.numbers("joints_rad", (None, len(names)), "f")
    n = len(joints)
    stamps = content.numbers("stamps_s", (n,), "f")
    ball = content.numbers("ball_m", (n, None), "f")
    segment = content.numbers("segment", (n,), "iu")
    provenance = content.json("provenance")
    try:
        return DataSet(stamps, joints, ball, segment, names, frame, provenance)
    except DataSetError as error:
        raise content.refusal(f"is not a data set: {error}") from None
