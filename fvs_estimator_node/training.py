"""Offline training: from ball positions and joints to a chain, and to networks.

A serial chain is fitted to every data set. ``poe`` distils the networks from it: the
chain knows the Jacobian everywhere, so that they learn from as many exact samples as wanted.
``ridge`` and ``varpro`` assume no chain and fit networks to pairs of images; they take from the
chain how late the images are stamped, and keep it if it fits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from fvs_estimator_node.chain_fit import ChainFit, Workers, fit_chain
from fvs_estimator_node.files import DataSet, TrainedModel, range_of
from fvs_estimator_node.joint_path import MAX_OFFSET_S, STILL_RAD, behind_play
from fvs_estimator_node.pairs import Pairs, Progress, TrainingError, ridge_weights
from fvs_estimator_node.pixel_fit import WEBCAM_FIGURES, PixelFit, fit_pixels
from fvs_estimator_node.rbf import RbfModel, rbf_features
from fvs_ros.chain import SerialChain
from fvs_ros.kinds import Kind
from fvs_ros.pixel_chain import AnyChain, PixelChain, PixelChains
from fvs_ros.topics import DETECTOR

#: Each method with its usual number of neurons, which cost little where samples are free.
METHODS = {"varpro": 50, "ridge": 50, "poe": 100}
#: Samples of the chain for each neuron, and to judge with.
_SAMPLES, _JUDGED = 80, 1000
#: Width of the neurons over the box's rms half width, and the box of samples over that of the
#: data: the least error of some tried.
_WIDTH_FACTOR, _BEYOND = 4.0, 1.1
#: Limits above which a note is shown: relative deviation of the Jacobian (median over the box);
#: noise, m (no depth camera is that bad); offset of the stamps, s; share of the motion that the
#: networks miss.
_NOTABLE_DEVIATION, _NOTABLE_NOISE_M = 0.01, 0.01
_NOTABLE_OFFSET_S, _NOTABLE_ERROR = 0.003, 0.15

AnyFit = ChainFit | PixelFit


@dataclass(frozen=True)
class TrainingOptions:
    """How to train."""

    #: One of ``METHODS``.
    method: str = "varpro"
    #: Of each network; by default as many as is usual for the method.
    neurons: int | None = None
    #: Of everything random: equal data, options and seed give equal networks.
    seed: int = 0
    #: Adam iterations of ``varpro``.
    iterations: int = 300

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise TrainingError(
                f"unknown training method {self.method!r}; known are {', '.join(METHODS)}"
            )
        if not 1 <= self.count <= 1000:
            raise TrainingError(f"neurons must lie between 1 and 1000, got {self.count}")

    @property
    def count(self) -> int:
        """Neurons of each network."""
        return METHODS[self.method] if self.neurons is None else self.neurons


def train(
    data: DataSet,
    options: TrainingOptions | None = None,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
    workers: Workers = map,
) -> TrainedModel:
    """Train the networks, and fit a chain.

    Parameters
    ----------
    data : DataSet
        A minute of motion of all joints, or more.
    options : TrainingOptions, optional
        Method, size and seed.
    progress : callable, optional
        Called after each iteration of ``varpro``.
    say : callable, optional
        Called with a sentence at each step.
    workers : callable, optional
        Try the starts of a chain; the result does not depend on them.

    Returns
    -------
    TrainedModel
        With ``errors``: the figures of the chain's fit; ``jacobian_deviation``, the relative
        standard deviation of its Jacobian in the box (median); ``distillation_error``, the
        networks' relative error against the chain (median); of several cameras, each figure of a
        fit for each, with the camera's name before it; and for networks from pairs
        ``pair_error_m``, the rms error between two held-out images, with the noise of both, m.

    Raises
    ------
    ValueError
        If the data determine nothing (TrainingError), or ``poe`` finds no chain.
    """
    options, say = options or TrainingOptions(), say or (lambda words: None)
    rng = np.random.default_rng(options.seed)
    poe = options.method == "poe"
    if data.kind.on_arm and not poe:
        raise TrainingError(
            "pairs of images of one object do not tell how a camera on the arm sees another: train "
            "with the method poe"
        )
    if len(data.cameras) > 1:
        if not poe:
            raise TrainingError("pairs of images are of one camera: train with the method poe")
        return _of_several(data, options, rng, say, workers)
    fit, why = _fitted(data, say, workers, needed=poe)
    if fit is not None and fit.chain.play_rad.any():
        data = behind_play(data, fit.chain.play_rad)
    model, trained_on, errors = _networks(data, fit, options, rng, progress, say)
    faults: list[str] = []
    if fit is not None:
        judged_rad = _within(trained_on["joint_box_rad"], rng, _JUDGED)
        errors = {**_figures(fit, model, judged_rad, data.kind.learned), **errors}
        faults = _chain_faults(fit, errors["jacobian_deviation"], data.kind)
        why = faults[0] if faults and not poe else ""
    notes = _notes(data, errors, faults if poe else [])
    if isinstance(fit, ChainFit) and fit.chain.lens.any():
        notes.append(
            f"{lens_text(errors)}: calibrate the camera; with the method poe, targets in the frame "
            "of an object allow for it"
        )
    if fit is not None and fit.chain.play_rad.any():
        plays = zip(data.joint_names, np.degrees(fit.chain.play_rad), strict=True)
        text = ", ".join(f"{name} {play:.1f}" for name, play in plays if play)
        notes.append(f"play between motors and joints, allowed for by poe, degrees: {text}")
    chain: Any = fit.chain if fit is not None and not why else None
    if isinstance(chain, PixelChain):
        chain = PixelChains((chain,))
    came_from = {"method": options.method, "options": asdict(options), "no_chain": why}
    return TrainedModel(
        model,
        **trained_on,
        joint_names=data.joint_names,
        feature_frame=data.feature_frame,
        feature=data.feature,
        camera_mount=data.camera_mount,
        cameras=data.cameras,
        errors=errors,
        provenance={**came_from, "data": dict(data.provenance), "notes": notes},
        chain=chain,
    )


def _of_several(
    data: DataSet,
    options: TrainingOptions,
    rng: np.random.Generator,
    say: Callable[[str], None],
    workers: Workers,
) -> TrainedModel:
    """Networks of all cameras at once, distilled from a chain before each."""
    each = list[TrainedModel]()
    for camera, part in zip(data.cameras, data.parts, strict=True):
        say(f"camera {camera}")
        try:
            each.append(train(part, options, say=say, workers=workers))
        except ValueError as error:
            raise TrainingError(f"{camera}: {error}") from error
    chains = (trained.chain for trained in each)
    chain = PixelChains(tuple(one.each[0] for one in chains if isinstance(one, PixelChains)))
    # What all would show at once, each within what it has shown.
    z = chain.position(data.joints_rad)
    least, most = (
        np.concatenate([end(trained.z_samples, axis=0) for trained in each])
        for end in (np.min, np.max)
    )
    in_view = np.all((least <= z) & (z <= most), axis=1)
    if not in_view.any():
        raise TrainingError(f"all cameras never see the {data.kind.what} at once: move one")
    trained_on = range_of(data.joints_rad[in_view], z[in_view], rng)
    model = distil(chain, trained_on["joint_box_rad"], options.count, rng)
    several = replace(each[0], model=model, **trained_on, cameras=data.cameras, chain=chain)
    judged_rad = _within(trained_on["joint_box_rad"], rng, _JUDGED)
    errors, notes = dict[str, Any](), list[str]()
    for camera, trained in zip(data.cameras, each, strict=True):
        own = several.seen_by((camera,))
        missed = _missed(own.model, own.chain, judged_rad, own.kind.learned)
        figures = {**trained.errors, "distillation_error": missed}
        errors |= {f"{camera}/{name}": value for name, value in figures.items()}
        notes += [f"{camera}: {note}" for note in trained.notes]
    return replace(several, errors=errors, provenance={**several.provenance, "notes": notes})


def _fitted(
    data: DataSet, say: Callable[[str], None], workers: Workers, needed: bool
) -> tuple[AnyFit | None, str]:
    """The chain's fit, or why there is none; a ``ValueError`` if one is needed."""
    try:
        if not data.kind.rigid:
            return fit_pixels(data, say, workers), ""
        fit = fit_chain(data, say, workers)
        carried = data.kind.nearest(fit.chain.feature_m)  # it was fitted number by number
        return replace(fit, chain=replace(fit.chain, feature_m=carried)), ""
    except ValueError as error:  # also of numpy's linear algebra
        if needed:
            raise
        return None, str(error)


def _networks(
    data: DataSet,
    fit: AnyFit | None,
    options: TrainingOptions,
    rng: np.random.Generator,
    progress: Progress | None,
    say: Callable[[str], None],
) -> tuple[RbfModel, dict[str, Any], dict[str, Any]]:
    """The networks, what they were trained on, and the figures of their training."""
    if options.method == "poe":
        assert fit is not None
        say("training the networks")
        joints_rad = _joints_at_exposures(data, fit.time_offset_s)
        good = fit.inliers(replace(data, joints_rad=joints_rad))
        trained_on = range_of(joints_rad[good], data.z[good], rng)
        box_rad = trained_on["joint_box_rad"]
        return distil(fit.chain, box_rad, options.count, rng), trained_on, {}
    weights = data.kind.weights
    pairs = Pairs(data.joints_rad, weights * data.z, rng)
    say("training the networks")
    pairs.joints = _joints_at_exposures(data, fit.time_offset_s if fit is not None else 0.0)
    iterations = options.iterations if options.method == "varpro" else 0
    weighted, good, errors = pairs.train(options.count, iterations, progress)
    model = replace(weighted, weights=weighted.weights / weights[:, None])
    return model, range_of(pairs.joints[good], data.z[good], rng), errors


def distil(
    chain: AnyChain, box_rad: np.ndarray, neurons: int, rng: np.random.Generator
) -> RbfModel:
    """Networks distilled from a chain in a box of joints, rad, shape (2, n)."""
    n = box_rad.shape[1]
    half = 0.5 * (box_rad[1] - box_rad[0])
    width = max(_WIDTH_FACTOR * math.sqrt(float(np.mean(half**2))), 1e-3)
    wide = box_rad + (_BEYOND - 1.0) * np.stack([-half, half])
    joints = _within(wide, rng, _SAMPLES * neurons)
    columns = np.moveaxis(learned(chain, joints), -1, 0)
    centres = np.stack([_within(wide, rng, neurons) for _ in range(n)])
    widths = np.full((n, neurons), width)
    weights = []
    for i, column in enumerate(columns):
        theta = rbf_features(centres[[i]], widths[[i]], joints)[:, 0]
        weights.append(ridge_weights(theta, column).T)
    return RbfModel(centres, widths, np.stack(weights))


def learned(chain: AnyChain, joints_rad: np.ndarray) -> np.ndarray:
    """What networks learn of a chain at joints, rad, (k, n): its Jacobian, or its twists."""
    if not isinstance(chain, SerialChain) or not chain.on_arm:
        return chain.jacobian(joints_rad)
    twists = np.concatenate(chain.motion(joints_rad)[1:], axis=-1)
    return np.swapaxes(twists, -1, -2)


def _within(box_rad: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.uniform(box_rad[0], box_rad[1], (count, box_rad.shape[1]))


def _joints_at_exposures(data: DataSet, offset_s: float) -> np.ndarray:
    """Joints at the true exposures, rad, (k, n), for images stamped late by an offset, s."""
    joints = data.joints_rad.copy()
    for run in data.runs():
        time_s = data.stamps_s[run]
        for of_joint, recorded in zip(joints[run].T, data.joints_rad[run].T, strict=True):
            of_joint[:] = np.interp(time_s - offset_s, time_s, recorded)
    return joints


# ---- what a user should know ----------------------------------------------------------------


def _figures(
    fit: AnyFit, model: RbfModel, joints_rad: np.ndarray, unit: np.ndarray
) -> dict[str, Any]:
    """Figures of a fit for the model file, without unknown ones (a model file holds no NaN)."""
    figures = fit.figures()
    deviation = fit.jacobian_deviation(joints_rad[: _JUDGED // 10])
    figures["jacobian_deviation"] = float(np.median(deviation))
    figures["distillation_error"] = _missed(model, fit.chain, joints_rad, unit)
    return {name: value for name, value in figures.items() if math.isfinite(value)}


def _missed(model: RbfModel, chain: Any, joints_rad: np.ndarray, unit: np.ndarray) -> float:
    """Relative error of networks against a chain, median over joints, rad, (k, n)."""
    truth = unit[:, None] * learned(chain, joints_rad)
    error = np.linalg.norm(unit[:, None] * model.jacobian(joints_rad) - truth, axis=(1, 2))
    return float(np.median(error / np.linalg.norm(truth, axis=(1, 2))))


def lens_text(errors: Mapping[str, Any]) -> str:
    """What a model's figures say of the lens, in words."""
    if "k1" in errors:  # of a webcam
        focal, u, v, k1 = (
            f"{errors[name]:.{digits}f} +- {errors[f'{name}_deviation']:.{digits}f}"
            for name, digits in zip(WEBCAM_FIGURES, (0, 0, 0, 3), strict=True)
        )
        return f"focal length {focal} px, centre ({u}, {v}) px, k1 {k1}"
    focal, deviation = 100.0 * errors["focal_error"], 100.0 * errors["focal_deviation"]
    return (
        f"focal length {abs(focal):.1f} +- {deviation:.1f} % {'longer' if focal > 0 else 'shorter'}"
        f" than camera_info says, k1 off by {errors['radial_error']:.3f} +- "
        f"{errors['radial_deviation']:.3f}"
    )


def _chain_faults(fit: AnyFit, deviation: float, kind: Kind) -> list[str]:
    """Why a chain is not to be trusted, in words; the most important first."""
    unknown, distance, what = (
        math.isnan(fit.noise_m),
        kind.length_text(fit.residual_m, 1),
        kind.what,
    )
    faults = (
        f"the images seem to be stamped {1e3 * MAX_OFFSET_S:.0f} ms "
        f"{'late' if fit.time_offset_s > 0.0 else 'early'} or more: do not trust this fit; "
        "set the clocks (NTP), or add the delay to stamp_delay_s of fvs_detector_node"
        if fit.offset_at_limit
        else "",
        f"whether the {what} moves on a rigid chain cannot be told: images are "
        f"{distance} off it; collect with five images a second or more"
        if unknown and not fit.is_chain
        else "",
        f"the {what} does not move on a rigid chain: images are {distance} distance, "
        f"noise explains {kind.length_text(fit.noise_m, 1)}; check that nothing moved the camera "
        f"or the {what} on its tool, check joint names and signs, or train with another method"
        if not unknown and not fit.is_chain
        else "",
        f"the Jacobian is known to {100.0 * deviation:.1f} % only; collect longer or in a "
        "wider box, and see that the camera is calibrated"
        if deviation > _NOTABLE_DEVIATION
        else "",
    )
    return [fault for fault in faults if fault]


def _notes(data: DataSet, errors: dict[str, Any], faults: list[str]) -> list[str]:
    """What a user should know, in words; the most important first."""
    still = ", ".join(
        name
        for name, spread in zip(data.joint_names, data.joints_rad.std(axis=0), strict=True)
        if spread < STILL_RAD
    )
    if still:
        faults = [f"{still} did not move in the data set: nothing is known there"]
    offset_s, missed = errors.get("time_offset_s", 0.0), errors.get("pair_error_relative", 0.0)
    noise_m = errors.get("noise_m", errors.get("residual_m", 0.0))
    late = f"{1e3 * abs(offset_s):.0f} ms {'before' if offset_s > 0.0 else 'after'} their stamps"
    clocks = "" if offset_s > 0.0 else " (if more than half an image's time: set the clocks, NTP)"
    allowed = "for methods other than poe, stamp them as much earlier"
    if data.kind.rigid:
        allowed = f"the loop needs it, too: add {offset_s:.3f} to stamp_delay_s of {DETECTOR}"
    outliers, samples, what = errors["outliers"], errors["samples"], data.kind.what
    notes = (
        f"{what} positions scatter by {data.kind.length_text(noise_m)} (median); check "
        f"{'depth' if data.kind.rigid else 'focus'}, lighting and that nothing else is taken for "
        f"the {what}"
        if noise_m > _NOTABLE_NOISE_M
        else "",
        f"the images show the joints of {late}; corrected here, but {allowed}{clocks}"
        if _NOTABLE_OFFSET_S < abs(offset_s) < 0.99 * MAX_OFFSET_S
        else "",
        f"{outliers} of {samples} images do not fit and were left out"
        if outliers > data.kind.outliers * samples
        else "",
        f"the networks miss {100.0 * missed:.0f} % of the {what}'s motion; collect longer or in a "
        "wider box, with one robot and one detector publishing"
        if missed > _NOTABLE_ERROR
        else "",
    )
    return faults + [note for note in notes if note]
