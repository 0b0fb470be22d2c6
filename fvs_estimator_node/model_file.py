"""The trained networks in a ``.npz`` file, with what they were trained on and how well they do."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fvs_estimator_node.npz_file import NpzFile, check_same, write_npz
from fvs_estimator_node.rbf import RbfModel
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.chain import SerialChain, chain_shapes
from fvs_ros.joints import UR_JOINT_NAMES

MODEL_FORMAT = "fvs_rbf_model"
MODEL_VERSION = 1
MAX_MODEL_BYTES = 64 * 2**20
#: No more notes are passed on, nor longer ones.
_MOST_NOTES, _LONGEST_NOTE = 20, 500


def box_of(values: np.ndarray) -> np.ndarray:
    """Least and greatest values, shape (2, n), of many, shape (k, n)."""
    return np.stack([values.min(axis=0), values.max(axis=0)])


class ModelFileError(ValueError):
    """A model file that cannot be used; the text says what was wrong and what was expected."""


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
        The chain that the networks were distilled from, for the method ``poe``.

    Raises
    ------
    ModelFileError
        If a box does not fit.
    """

    model: RbfModel
    joint_box_rad: np.ndarray
    ball_box_m: np.ndarray
    ball_samples_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    joint_names: tuple[str, ...] = UR_JOINT_NAMES
    feature_frame: str = CAMERA_FRAME
    errors: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    chain: SerialChain | None = None

    def __post_init__(self) -> None:
        n, m = self.model.weights.shape[:2]
        for name, shape in (("joint_box_rad", (2, n)), ("ball_box_m", (2, m))):
            value = np.asarray(getattr(self, name), dtype=float)
            if value.shape != shape or not np.all(np.isfinite(value)):
                raise ModelFileError(f"{name} must be finite and of shape {shape}")
            if np.any(value[0] > value[1]):
                raise ModelFileError(f"{name} has a least value above the greatest")
            object.__setattr__(self, name, value)
        samples = np.asarray(self.ball_samples_m, dtype=float)
        if samples.ndim != 2 or samples.shape[1] != m or not np.all(np.isfinite(samples)):
            raise ModelFileError(f"ball_samples_m must be finite and of shape (k, {m})")
        object.__setattr__(self, "ball_samples_m", samples)
        object.__setattr__(self, "joint_names", tuple(self.joint_names))

    @property
    def notes(self) -> tuple[str, ...]:
        """What the training found that a user of the model should know, a sentence each."""
        notes = self.provenance.get("notes", ())
        if not isinstance(notes, (list, tuple)):
            return ()
        return tuple(" ".join(str(note).split())[:_LONGEST_NOTE] for note in notes[:_MOST_NOTES])


def save_model(path: str | os.PathLike[str], trained: TrainedModel) -> None:
    """Write a model in one piece."""
    chain = {
        f"chain_{name}": getattr(trained.chain, name)
        for name in (chain_shapes(0) if trained.chain is not None else ())
    }
    write_npz(
        path,
        {
            "format": np.array(MODEL_FORMAT),
            "version": np.array(MODEL_VERSION),
            "joint_names": np.array(trained.joint_names),
            "feature_frame": np.array(trained.feature_frame),
            "centres": trained.model.centres,
            "widths": trained.model.widths,
            "weights": trained.model.weights,
            "joint_box_rad": trained.joint_box_rad,
            "ball_box_m": trained.ball_box_m,
            "ball_samples_m": trained.ball_samples_m,
            "errors": np.array(json.dumps(dict(trained.errors), sort_keys=True)),
            "provenance": np.array(json.dumps(dict(trained.provenance), sort_keys=True)),
            **chain,
        },
    )


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
    ModelFileError
        If anything is not as expected; the text names the file, the fault and what was expected.
    """
    content = NpzFile(path, MODEL_FORMAT, MODEL_VERSION, MAX_MODEL_BYTES, ModelFileError)
    names = content.joint_names()
    frame = content.text("feature_frame")
    check_same(ModelFileError, f"{path}", names, frame, joint_names, feature_frame)
    n = len(names)
    centres = content.numbers("centres", (n, None, n), "f")
    neurons = centres.shape[1]
    widths = content.numbers("widths", (n, neurons), "f")
    weights = content.numbers("weights", (n, None, neurons), "f")
    m = weights.shape[1]
    try:
        return TrainedModel(
            RbfModel(centres, widths, weights),
            content.numbers("joint_box_rad", (2, n), "f"),
            content.numbers("ball_box_m", (2, m), "f"),
            content.numbers("ball_samples_m", (None, m), "f"),
            names,
            frame,
            content.json("errors"),
            content.json("provenance"),
            _chain(content, n),
        )
    except ModelFileError as error:
        if str(error).startswith(str(content.path)):
            raise
        raise content.refusal(f"is not a model: {error}") from None
    except ValueError as error:
        raise content.refusal(f"is not a model: {error}") from None


def _chain(content: NpzFile, joints: int) -> SerialChain | None:
    """The chain of a file that has all fields of one; None if it has none of them."""
    shapes = chain_shapes(joints)
    if not any(content.has(f"chain_{name}") for name in shapes):
        return None
    return SerialChain(
        *(content.numbers(f"chain_{name}", shape, "f") for name, shape in shapes.items())
    )
