"""The trained networks in a ``.npz`` file, with what they were trained on and how well they do."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fvs_estimator_node.npz_file import FileError, NpzFile, write_npz
from fvs_estimator_node.rbf import RbfModel
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.chain import CHAIN_SHAPES, SerialChain
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_ros.vectors import check_arrays

_FORMAT, _MAX_BYTES = "fvs_rbf_model", 64 * 2**20
_NETWORKS = ("centres", "widths", "weights")
_SHAPES: dict[str, tuple[int | str, ...]] = {
    "joint_box_rad": (2, "n"),
    "ball_box_m": (2, "m"),
    "ball_samples_m": ("k", "m"),
}
_CHAIN = tuple(f"chain_{name}" for name in CHAIN_SHAPES)
#: No more notes are passed on, nor longer ones.
_MOST_NOTES, _LONGEST_NOTE = 20, 500
#: Ball positions of the training that are kept.
_BALL_SAMPLES = 500


@dataclass(frozen=True)
class TrainedModel:
    """The networks and what one must know to use them.

    Parameters
    ----------
    model : RbfModel
        Centres, widths, weights.
    joint_box_rad : ndarray, shape (2, n)
        Least and greatest joint positions trained on, rad; outside, the networks extrapolate.
    ball_box_m : ndarray, shape (2, m)
        Least and greatest ball positions trained on, m.
    ball_samples_m : ndarray, shape (k, m)
        Some of the ball positions trained on, m: places that the arm can reach.
    joint_names : tuple of str
        The joint order.
    feature_frame : str
        Frame of the ball positions.
    errors : dict
        Error figures of the training, name to number or list of numbers.
    provenance : dict
        Where it comes from; anything that JSON can hold.
    chain : SerialChain, optional
        The chain fitted to the same data, for the method ``poe``.

    Raises
    ------
    ValueError
        If its parts do not fit together.
    """

    model: RbfModel
    joint_box_rad: np.ndarray
    ball_box_m: np.ndarray
    ball_samples_m: np.ndarray
    joint_names: tuple[str, ...] = UR_JOINT_NAMES
    feature_frame: str = CAMERA_FRAME
    errors: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    chain: SerialChain | None = None

    def __post_init__(self) -> None:
        n, m = self.model.weights.shape[:2]
        object.__setattr__(self, "joint_names", tuple(self.joint_names))
        joints = n if self.chain is None else len(self.chain.axes)
        if not len(self.joint_names) == n == joints:
            raise ValueError(
                f"{len(self.joint_names)} joint names, networks of {n} and a chain of {joints} "
                "joints do not fit together"
            )
        check_arrays(self, _SHAPES, {"n": n, "m": m})
        for name in ("joint_box_rad", "ball_box_m"):
            low, high = getattr(self, name)
            if np.any(low > high):
                raise ValueError(f"{name} has a least value above the greatest")

    @property
    def notes(self) -> tuple[str, ...]:
        """What the training found that a user of the model should know, a sentence each."""
        notes = self.provenance.get("notes", ())
        if not isinstance(notes, (list, tuple)):
            return ()
        return tuple(" ".join(str(note).split())[:_LONGEST_NOTE] for note in notes[:_MOST_NOTES])


def boxes_of(
    joints_rad: np.ndarray, ball_m: np.ndarray, rng: np.random.Generator
) -> dict[str, Any]:
    """What a model says of the data that it was trained on: its boxes, and some ball positions."""
    chosen = rng.permutation(len(ball_m))[:_BALL_SAMPLES]
    return {
        "joint_box_rad": np.stack([joints_rad.min(axis=0), joints_rad.max(axis=0)]),
        "ball_box_m": np.stack([ball_m.min(axis=0), ball_m.max(axis=0)]),
        "ball_samples_m": ball_m[chosen],
    }


def save_model(path: str | os.PathLike[str], trained: TrainedModel) -> None:
    """Write a model in one piece."""
    own = (*_SHAPES, "joint_names", "feature_frame", "errors", "provenance")
    fields = {name: getattr(trained, name) for name in own}
    fields |= {name: getattr(trained.model, name) for name in _NETWORKS}
    if trained.chain is not None:
        fields |= {f"chain_{name}": getattr(trained.chain, name) for name in CHAIN_SHAPES}
    write_npz(path, _FORMAT, fields)


def load_model(
    path: str | os.PathLike[str],
    joint_names: Sequence[str] | None = UR_JOINT_NAMES,
    feature_frame: str | None = None,
) -> TrainedModel:
    """Read and check a model.

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
    try:
        chain = None
        if any(content.has(name) for name in _CHAIN):
            chain = SerialChain(*(content.array(name) for name in _CHAIN))
        return TrainedModel(
            RbfModel(*(content.array(name) for name in _NETWORKS)),
            **{name: content.array(name) for name in _SHAPES},
            joint_names=content.texts("joint_names"),
            feature_frame=content.text("feature_frame"),
            errors=content.json("errors"),
            provenance=content.json("provenance"),
            chain=chain,
        )
    except FileError:
        raise
    except ValueError as error:
        raise content.refusal(f"is not a model: {error}") from None
