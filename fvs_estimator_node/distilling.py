"""The structured way to a model: fit a chain to the data, and distil it into the networks.

The chain knows the Jacobian everywhere, so that the networks learn from as many exact samples as
wanted: a linear least-squares problem for each, of a fraction of a second.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from fvs_estimator_node.chain_fit import ChainFit, fit_chain
from fvs_estimator_node.chain_start import MAX_OFFSET_S
from fvs_estimator_node.dataset import DataSet
from fvs_estimator_node.model_file import TrainedModel, boxes_of
from fvs_estimator_node.rbf import RbfModel, rbf_features
from fvs_estimator_node.training import late_stamps_note, ridge_weights, still_joints
from fvs_ros.chain import SerialChain

#: Neurons of each network where nothing else is said; more cost little where samples are free.
NEURONS = 100
#: Samples of the chain for each neuron, and to judge with.
_SAMPLES, _JUDGED = 80, 1000
#: Width of the neurons over the box's rms half width, and the box of samples over that of the
#: data: the least error of some tried.
_WIDTH_FACTOR, _BEYOND = 4.0, 1.1
#: A user should know of a Jacobian with a larger relative deviation (median over the box), of a
#: larger share of outliers, and of larger noise, m: no depth camera is that bad.
_NOTABLE_DEVIATION, _NOTABLE_OUTLIERS, _NOTABLE_NOISE_M = 0.01, 0.01, 0.01


def train_structured(
    data: DataSet,
    neurons: int = NEURONS,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> TrainedModel:
    """Fit a chain to a data set and distil the networks from it.

    Parameters
    ----------
    data : DataSet
        A minute of motion of all joints, or more.
    neurons : int
        Neurons of each network, k.
    seed : int
        Equal data, neurons and seed give equal models.
    progress : callable, optional
        Told what is being done, in words.

    Returns
    -------
    TrainedModel
        Chain and networks. Its ``errors`` hold the figures of the fit; ``jacobian_deviation``, the
        relative standard deviation of the chain's Jacobian in the box as the camera sees it; and
        ``distillation_error``, that of the networks against the chain (medians).

    Raises
    ------
    ValueError
        If ``neurons`` is less than 1, or no chain can be fitted (ChainFitError).
    """
    if neurons < 1:
        raise ValueError(f"neurons must be at least 1, got {neurons}")
    rng = np.random.default_rng(seed)
    fit = fit_chain(data, progress)
    if progress is not None:
        progress("distilling the networks")
    boxes = boxes_of(data.joints_rad, data.ball_m, rng)
    model = distil(fit.chain, boxes["joint_box_rad"], neurons, rng)
    places = _within(boxes["joint_box_rad"], rng, _JUDGED)
    figures = _figures(fit, model, places)
    return TrainedModel(
        model=model,
        **boxes,
        joint_names=data.joint_names,
        feature_frame=data.feature_frame,
        errors=figures,
        provenance={
            "method": "poe",
            "options": {"neurons": neurons, "seed": seed},
            "data": dict(data.provenance),
            "notes": _notes(fit, figures["jacobian_deviation"], data),
        },
        chain=fit.chain,
    )


def with_chain(trained: TrainedModel, data: DataSet, seed: int = 0) -> tuple[TrainedModel, str]:
    """A model that was trained otherwise, with the chain of its data, for the methods that need it.

    Parameters
    ----------
    trained : TrainedModel
        The model.
    data : DataSet
        What it was trained on.
    seed : int
        Equal data and seed give equal chains.

    Returns
    -------
    TrainedModel
        With the chain, if there is one to be trusted.
    str
        What came of it, in words.
    """
    places = _within(trained.joint_box_rad, np.random.default_rng(seed), _JUDGED)
    try:
        fit = fit_chain(data)
        found = _figures(fit, trained.model, places)
    except ValueError as error:  # also of numpy's linear algebra
        return trained, f"no chain: {error}"
    deviation = found["jacobian_deviation"]
    if not fit.is_chain or deviation > _NOTABLE_DEVIATION:
        return trained, f"no chain: {_notes(fit, deviation, data)[0]}"
    chained = {f"chain_{name}": value for name, value in found.items()}
    return (
        replace(trained, chain=fit.chain, errors={**trained.errors, **chained}),
        f"chain of {len(fit.chain.axes)} revolute joints: fits, Jacobian known to "
        f"{100.0 * deviation:.3f} %; networks {100.0 * found['distillation_error']:.2f} % off it",
    )


def _figures(fit: ChainFit, model: RbfModel, places: np.ndarray) -> dict[str, Any]:
    """What a model file keeps of a fit; nothing that is not known, for it holds no NaN."""
    truth = fit.chain.jacobian(places)
    size = np.linalg.norm(truth, axis=(1, 2))
    error = np.linalg.norm(model.jacobian(places) - truth, axis=(1, 2)) / size
    names = ("misfit", "residual_m", "noise_m", "ray_noise_m", "lateral_noise_m", "time_offset_s")
    counts = ("time_offset_deviation_s", "outliers", "samples")
    found = {name: getattr(fit, name) for name in (*names, *counts)}
    deviation = fit.jacobian_deviation(places[: _JUDGED // 10])
    found["jacobian_deviation"] = float(np.median(deviation))
    found["distillation_error"] = float(np.median(error))
    return {name: value for name, value in found.items() if math.isfinite(value)}


def distil(
    chain: SerialChain, box_rad: np.ndarray, neurons: int, rng: np.random.Generator
) -> RbfModel:
    """Networks that say what a chain says in a box of joints, rad, shape (2, n)."""
    n = box_rad.shape[1]
    half = 0.5 * (box_rad[1] - box_rad[0])
    width = max(_WIDTH_FACTOR * math.sqrt(float(np.mean(half**2))), 1e-3)
    wide = box_rad + (_BEYOND - 1.0) * np.stack([-half, half])
    joints = _within(wide, rng, _SAMPLES * neurons)
    columns = np.moveaxis(chain.jacobian(joints), -1, 0)
    centres = np.stack([_within(wide, rng, neurons) for _ in range(n)])
    widths = np.full((n, neurons), width)
    weights = []
    for i, column in enumerate(columns):
        theta = rbf_features(centres[[i]], widths[[i]], joints)[:, 0]
        weights.append(ridge_weights(theta, column).T)
    return RbfModel(centres, widths, np.stack(weights))


def _within(box_rad: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.uniform(box_rad[0], box_rad[1], (count, box_rad.shape[1]))


def _notes(fit: ChainFit, deviation: float, data: DataSet) -> list[str]:
    """What a user should know, in words; the most important first."""
    unknown = math.isnan(fit.noise_m)
    noise_m = fit.residual_m if unknown else fit.noise_m
    off, still = f"{1e3 * fit.residual_m:.1f} mm", still_joints(data)
    notes = []
    if still:
        notes.append(f"{still} did not move in the data set: nothing is known there")
    if fit.offset_at_limit:
        notes.append(
            f"the images seem to be stamped {1e3 * MAX_OFFSET_S:.0f} ms "
            f"{'late' if fit.time_offset_s > 0.0 else 'early'} or more: do not trust this fit; "
            "set the clocks (NTP), or add the delay to stamp_delay_s of fvs_detector_node"
        )
    if not fit.is_chain and unknown:
        notes.append(
            "whether the ball moves on a rigid chain of revolute joints cannot be told: images are "
            f"{off} off it; collect with five images a second or more"
        )
    elif not fit.is_chain:
        notes.append(
            f"the ball does not move on a rigid chain of revolute joints: images are {off} off, "
            f"noise explains {1e3 * noise_m:.1f} mm; check that nothing moved the camera or the "
            "ball on its tool, check joint names and signs, or train with another method"
        )
    if noise_m > _NOTABLE_NOISE_M:
        notes.append(
            f"ball positions scatter by {1e3 * noise_m:.0f} mm (median); check depth, lighting and "
            "that nothing else is taken for the ball"
        )
    if deviation > _NOTABLE_DEVIATION and not still:
        notes.append(
            f"the Jacobian is known to {100.0 * deviation:.1f} % only; collect longer or in a "
            "wider box, and see that the camera is calibrated"
        )
    late = late_stamps_note(fit.time_offset_s)
    if late and not fit.offset_at_limit:
        notes.append(late)
    if fit.outliers > _NOTABLE_OUTLIERS * fit.samples:
        notes.append(f"{fit.outliers} of {fit.samples} images do not fit")
    return notes
