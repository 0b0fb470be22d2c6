"""The structured way to a model: fit a chain to the data, and distil it into the networks.

The chain knows the Jacobian everywhere, so that the networks learn from as many exact samples as
wanted: a linear least-squares problem for each, of a fraction of a second.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from fvs_estimator_node.chain_fit import ChainFit, fit_chain
from fvs_estimator_node.chain_path import MAX_OFFSET_S
from fvs_estimator_node.chain_start import STILL_RAD
from fvs_estimator_node.dataset import DataSet, late_stamps_note
from fvs_estimator_node.line_fit import ridge_path
from fvs_estimator_node.model_file import TrainedModel, box_of
from fvs_estimator_node.rbf import RbfModel, rbf_features
from fvs_ros.chain import SerialChain

#: Neurons of each network where nothing else is said; more cost little where samples are free.
NEURONS = 100
#: Samples of a lesson for each neuron, and of the examination.
_LESSON, _EXAMINATION = 80, 1000
#: Width of the neurons over the box's rms half width, the share by which lessons go beyond the
#: box, and the ridge relative to the mean diagonal: the least error of some tried.
_WIDTH_FACTOR, _BEYOND, _RIDGE = 4.0, 1.1, 1e-11
#: Ball positions kept as places that the arm can reach.
_BALL_SAMPLES = 500
#: A Jacobian known worse than this, in the median over the box, is worth a word.
_DOUBTFUL = 0.01
#: Images that do not fit are not worth a word up to this share.
_NOTABLE_OUTLIERS = 0.01
#: Images that scatter by more, a median, m, are worth a word: no depth camera is that bad.
_NOTABLE_NOISE_M = 0.01


@dataclass(frozen=True)
class DistilledModel:
    """What came of a structured training.

    Parameters
    ----------
    trained : TrainedModel
        Chain and networks, ready to be saved.
    fit : ChainFit
        The fit of the chain.
    jacobian_deviation : float
        Relative standard deviation of the chain's Jacobian in the box, median; as the camera sees.
    distillation_error : float
        Relative error of the networks against the chain at fresh joints in the box, median.
    notes : tuple of str
        What a user should know, in words.
    """

    trained: TrainedModel
    fit: ChainFit
    jacobian_deviation: float
    distillation_error: float
    notes: tuple[str, ...]


def train_structured(
    data: DataSet,
    neurons: int = NEURONS,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> DistilledModel:
    """Fit a chain to a data set and distil the networks from it.

    Parameters
    ----------
    data : DataSet
        A minute of motion of all joints, or more.
    neurons : int
        Neurons of each network, m.
    seed : int
        Equal data, neurons and seed give equal models.
    progress : callable, optional
        Told what is being done, in words.

    Raises
    ------
    ValueError
        If ``neurons`` is less than 1, or no chain can be fitted (ChainFitError).
    """
    if neurons < 1:
        raise ValueError(f"neurons must be at least 1, got {neurons}")
    rng = np.random.default_rng(seed)
    fit = fit_chain(data, rng, progress)
    if progress is not None:
        progress("distilling the networks")
    box = box_of(data.joints_rad)
    model = distil(fit.chain, box, neurons, rng)
    places = _within(box, rng, _EXAMINATION)
    truth = fit.chain.jacobian(places)
    size = np.linalg.norm(truth, axis=(1, 2))
    error = np.linalg.norm(model.jacobian(places) - truth, axis=(1, 2)) / size
    deviation = float(np.median(fit.jacobian_deviation(places[: _EXAMINATION // 10])))
    named = ("misfit", "residual_m", "noise_m", "ray_noise_m", "lateral_noise_m", "time_offset_s")
    counted = ("time_offset_deviation_s", "outliers", "samples")
    figures = {name: getattr(fit, name) for name in (*named, *counted)}
    figures |= {"jacobian_deviation": deviation, "distillation_error": float(np.median(error))}
    order = rng.permutation(len(data))[:_BALL_SAMPLES]
    trained = TrainedModel(
        model=model,
        joint_box_rad=box,
        ball_box_m=box_of(data.ball_m),
        ball_samples_m=data.ball_m[order],
        joint_names=data.joint_names,
        feature_frame=data.feature_frame,
        errors=_known(figures),
        provenance={
            "method": "poe",
            "options": {"neurons": neurons, "seed": seed},
            "data": dict(data.provenance),
        },
        chain=fit.chain,
    )
    return DistilledModel(
        trained, fit, deviation, float(np.median(error)), _notes(fit, deviation, data)
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
    places = _within(trained.joint_box_rad, np.random.default_rng(seed), _EXAMINATION // 10)
    try:
        fit = fit_chain(data, np.random.default_rng(seed))
        deviation = float(np.median(fit.jacobian_deviation(places)))
    except ValueError as error:  # also of numpy's linear algebra
        return trained, f"no chain: {error}"
    if not fit.is_chain or deviation > _DOUBTFUL:
        return trained, f"no chain: {_notes(fit, deviation, data)[0]}"
    found = {
        "chain_jacobian_deviation": deviation,
        "chain_misfit": fit.misfit,
        "chain_time_offset_s": fit.time_offset_s,
    }
    return (
        replace(trained, chain=fit.chain, errors={**trained.errors, **_known(found)}),
        f"chain of {len(fit.chain.axes)} revolute joints: fits, Jacobian known to "
        f"{100.0 * deviation:.3f} %",
    )


def _known(figures: dict[str, float]) -> dict[str, float]:
    """Those that could be told: a model file holds no NaN."""
    return {name: value for name, value in figures.items() if math.isfinite(value)}


def distil(
    chain: SerialChain, box_rad: np.ndarray, neurons: int, rng: np.random.Generator
) -> RbfModel:
    """Networks that say in a box what a chain says.

    Parameters
    ----------
    chain : SerialChain
        The chain.
    box_rad : ndarray, shape (2, n)
        Least and greatest joint positions, rad.
    neurons : int
        Neurons of each network.
    rng : numpy Generator
        Draws centres and samples.
    """
    n = box_rad.shape[1]
    half = 0.5 * (box_rad[1] - box_rad[0])
    width = max(_WIDTH_FACTOR * math.sqrt(float(np.mean(half**2))), 1e-3)
    wide = box_rad + (_BEYOND - 1.0) * np.stack([-half, half])
    joints = _within(wide, rng, _LESSON * neurons)
    columns = np.moveaxis(chain.jacobian(joints), -1, 0)
    centres = np.stack([_within(wide, rng, neurons) for _ in range(n)])
    widths = np.full((n, neurons), width)
    weights = []
    for i, column in enumerate(columns):
        theta = rbf_features(centres[[i]], widths[[i]], joints)[:, 0]
        weights.append(ridge_path(theta, column, (_RIDGE,))[0].T)
    return RbfModel(centres, widths, np.stack(weights))


def _within(box_rad: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.uniform(box_rad[0], box_rad[1], (count, box_rad.shape[1]))


def _notes(fit: ChainFit, deviation: float, data: DataSet) -> tuple[str, ...]:
    spread = data.joints_rad.std(axis=0)
    still = [name for name, one in zip(data.joint_names, spread, strict=True) if one < STILL_RAD]
    noise_m = fit.residual_m if math.isnan(fit.noise_m) else fit.noise_m
    off, noise = f"{1e3 * fit.residual_m:.1f} mm", f"{1e3 * noise_m:.1f} mm"
    late = late_stamps_note(fit.time_offset_s)
    notes = (
        (
            bool(still),
            f"{', '.join(still)} did not move in the data set: nothing is known there",
        ),
        (
            fit.offset_at_limit,
            f"the images seem to be stamped {1e3 * MAX_OFFSET_S:.0f} ms "
            f"{'late' if fit.time_offset_s > 0.0 else 'early'} or more: do not trust this fit; "
            "set the clocks (NTP), or add the delay to stamp_delay_s of fvs_detector_node",
        ),
        (
            not fit.is_chain and math.isnan(fit.misfit),
            "whether the ball moves on a rigid chain of revolute joints cannot be told: images are "
            f"{off} off it; collect with five images a second or more",
        ),
        (
            not fit.is_chain and not math.isnan(fit.misfit),
            f"the ball does not move on a rigid chain of revolute joints: images are {off} off, "
            f"noise explains {noise}; check that nothing moved the camera or the ball on its tool, "
            "check joint names and signs, or train with another method",
        ),
        (
            noise_m > _NOTABLE_NOISE_M,
            f"ball positions scatter by {1e3 * noise_m:.0f} mm (median); check depth, lighting and "
            "that nothing else is taken for the ball",
        ),
        (
            deviation > _DOUBTFUL and not still,
            f"the Jacobian is known to {100.0 * deviation:.1f} % only; collect longer or in a "
            "wider box, and see that the camera is calibrated",
        ),
        (bool(late) and not fit.offset_at_limit, late),
        (
            fit.outliers > _NOTABLE_OUTLIERS * fit.samples,
            f"{fit.outliers} of {fit.samples} images do not fit",
        ),
    )
    return tuple(text for holds, text in notes if holds)
