"""The data set: ball positions and the joints at their exposures, in a ``.npz`` file."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from fvs_estimator_node.npz_file import NpzFile, write_npz
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_ros.timeline import Sample
from fvs_ros.vectors import check_arrays

_FORMAT, _MAX_BYTES = "fvs_dataset", 2**30
_SHAPES = {"stamps_s": ("k",), "joints_rad": ("k", "n"), "ball_m": ("k", "m"), "segment": ("k",)}


@dataclass(frozen=True)
class DataSet:
    """k ball positions and the joints at their exposures.

    Parameters
    ----------
    stamps_s : ndarray, shape (k,)
        Exposure times, s; rising within a segment.
    joints_rad : ndarray, shape (k, n)
        Joint positions at exposure, rad.
    ball_m : ndarray, shape (k, m)
        Ball positions in the feature frame, m.
    segment : ndarray of int, shape (k,)
        Number of the continuous run a sample belongs to; never falls.
    joint_names : tuple of str
        Names of the columns of ``joints_rad``.
    feature_frame : str
        Frame of the ball positions.
    provenance : dict
        Where it comes from; anything that JSON can hold.

    Raises
    ------
    ValueError
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
        object.__setattr__(self, "joint_names", tuple(self.joint_names))
        check_arrays(self, _SHAPES, {"n": len(self.joint_names)})
        with np.errstate(invalid="ignore"):
            object.__setattr__(self, "segment", self.segment.astype(np.int64))
        if np.any(np.diff(self.segment) < 0):
            raise ValueError("segment numbers go back, expected runs one after the other")
        same = np.diff(self.segment) == 0
        if np.any(np.diff(self.stamps_s)[same] <= 0.0):
            raise ValueError("stamps_s do not rise within a segment")

    def __len__(self) -> int:
        return len(self.stamps_s)

    def runs(self) -> list[slice]:
        """The continuous runs, one after the other."""
        ends = [0, *(np.flatnonzero(np.diff(self.segment)) + 1).tolist(), len(self)]
        return [slice(a, b) for a, b in pairwise(ends)]


def data_set_of(samples: Sequence[Sample], **particulars: Any) -> DataSet:
    """A data set of samples; ``particulars`` are its other fields."""
    stamps_s, joints_rad, ball_m, run = (np.array(column) for column in zip(*samples, strict=True))
    return DataSet(stamps_s, joints_rad, ball_m, run, **particulars)


def save_data_set(path: str | os.PathLike[str], data: DataSet) -> None:
    """Write a data set in one piece."""
    write_npz(path, _FORMAT, asdict(data))


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
    FileError
        If anything is not as expected; the text names the file, the fault and what was expected.
    """
    content = NpzFile(path, _FORMAT, _MAX_BYTES, joint_names, feature_frame)
    arrays = {name: content.array(name) for name in _SHAPES}
    names, frame = content.texts("joint_names"), content.text("feature_frame")
    try:
        return DataSet(
            **arrays, joint_names=names, feature_frame=frame, provenance=content.json("provenance")
        )
    except ValueError as error:
        raise content.refusal(f"is not a data set: {error}") from None
