"""Offline training of the networks from a data set of ball positions and joints.

The paper trains on steps between neighbouring images, ``dx = J(r) dr``: little motion, much noise.
But the ball's position is a function of the joints, so *any* two images teach
(:mod:`fvs_estimator_node.line_fit`), with the signal of the whole box over the noise of one
position. Pairs drawn at random over all images also tell the networks what a single path cannot:
that their columns belong to one function.

``ridge`` draws the centres from the data and solves for the weights. ``varpro`` (variable
projection) moves centres and widths as well, by Adam, and solves for the weights inside: at their
optimum the gradient is the one with the weights held fixed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from fvs_estimator_node.dataset import DataSet, late_stamps_note
from fvs_estimator_node.line_fit import (
    as_matrix,
    as_model,
    line_regressors,
    quadrature,
    relative_error,
    ridge_path,
)
from fvs_estimator_node.model_file import TrainedModel, box_of
from fvs_estimator_node.rbf import RbfModel
from fvs_estimator_node.reference import reference_jacobian

METHODS = ("varpro", "ridge")
MIN_SAMPLES = 60
#: Shares of the data that are kept back for the reported errors, and for choosing.
_HELD_OUT, _VALIDATION = 0.1, 0.1
#: Continuous motion is kept back in blocks of this length, s, not by single images.
_BLOCK_S = 2.0
#: Images that fit worse than this many times the median are left out, and the neighbours to each
#: side that an image is compared with.
_OUTLIER_FACTOR, _NEIGHBOURS = 6.0, 3
#: Width of all neurons at first, in standard deviations of the training joints (mean over the
#: joints); 7 is 3.5 times the half width of an evenly filled box, over two.
_WIDTH_FACTOR = 7.0
#: Ridges to choose from on the validation images; one that is used before; distance of nodes, rad.
_RIDGES, _FIRST_RIDGE, _NODE_SPACING_RAD = (1e-12, 1e-11, 1e-10, 1e-9, 1e-8, 1e-7), 1e-9, 0.8
#: Pairs of a batch, Adam's first step for centres (rad) and log widths, and iterations between
#: looks at the validation error. (To stop at once when it rises would be wrong: the first, large
#: steps often make it worse for a while.)
_BATCH, _LEARNING_RATE, _CHECK_EVERY = 2048, 0.1, 20
#: Most that the stamps of the images are searched for, s; passes, and images of a run for it.
_MAX_OFFSET_S, _ALIGNMENTS, _SHORTEST_RUN = 0.2, 4, 30
#: Images of the reference, and ball positions that are kept in the model.
_REFERENCE_IMAGES, _BALL_SAMPLES = 1200, 500


class TrainingError(ValueError):
    """Data or options that nothing can be trained with; the text says why."""


@dataclass(frozen=True)
class TrainingOptions:
    """How to train.

    Parameters
    ----------
    method : str
        ``varpro`` or ``ridge``.
    neurons : int
        Neurons of each network.
    seed : int
        Seed of everything random: equal data, options and seed give equal networks.
    iterations : int
        Adam iterations of ``varpro``.
    """

    method: str = "varpro"
    neurons: int = 50
    seed: int = 0
    iterations: int = 300

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise TrainingError(
                f"unknown training method {self.method!r}; known are {', '.join(METHODS)}"
            )
        if not 1 <= self.neurons <= 1000:
            raise TrainingError(f"neurons must lie between 1 and 1000, got {self.neurons}")


@dataclass(frozen=True)
class NetworkError:
    """How wrong one network is at held-out joints, as far as data can tell.

    The yardstick is the slope of a smooth fit to the positions (see
    :mod:`fvs_estimator_node.reference`), which in good data is itself a percent off: smaller
    errors than that do not show.

    Parameters
    ----------
    column_m_rad : float
        Root mean square length of the column, m/rad.
    error_m_rad : float
        Root mean square length of the difference, m/rad.
    relative : float or None
        Error over column; None where the joint does not move the ball (its column is less than a
        hundredth of the Jacobian).
    """

    column_m_rad: float
    error_m_rad: float
    relative: float | None


@dataclass(frozen=True)
class TrainingResult:
    """The trained networks and everything worth knowing about the training.

    The errors are those of networks that have not seen the held-out images; the weights of
    ``trained`` are then fitted once more, to all images.

    Parameters
    ----------
    trained : TrainedModel
        Ready to be saved. Its ``errors`` hold ``pair_error_m``, the root mean square prediction
        error between two held-out images with the noise of both, m; ``pair_error_relative``, the
        same over the ball's motion; ``validation_error``; the chosen ``ridge``; ``iterations``;
        images used, kept back and left out (``samples``, ``held_out_samples``, ``outliers``); and
        ``time_offset_s``, how much later than the joints they show the images are stamped.
    networks : tuple of NetworkError
        One per joint.
    notes : tuple of str
        What a user should know, in words.
    """

    trained: TrainedModel
    networks: tuple[NetworkError, ...]
    notes: tuple[str, ...]


#: Told the iterations done and to do and the best validation error; True ends them early.
Progress = Callable[[int, int, float], bool]


def train(
    data: DataSet, options: TrainingOptions | None = None, progress: Progress | None = None
) -> TrainingResult:
    """Train the networks.

    Parameters
    ----------
    data : DataSet
        Ball positions and joints.
    options : TrainingOptions, optional
        How.
    progress : callable, optional
        Called after each iteration.

    Raises
    ------
    TrainingError
        If the data cannot teach anything.
    """
    options = options if options is not None else TrainingOptions()
    if len(data) < MIN_SAMPLES:
        raise TrainingError(f"the data set has {len(data)} images, expected at least {MIN_SAMPLES}")
    return _Training(data, options).run(progress)


class _Training:
    """One training run: the data, split, and the steps of the recipe."""

    def __init__(self, data: DataSet, options: TrainingOptions) -> None:
        self._data = data
        self._options = options
        self._rng = np.random.default_rng(options.seed)
        self._joints = data.joints_rad
        self._runs = _runs(data.segment)
        self._ball = data.ball_m
        spread = self._joints.std(axis=0)
        if spread.max() < 1e-3:
            raise TrainingError("the joints hardly move in the data set, so there is no Jacobian")
        if np.linalg.norm(self._ball.std(axis=0)) < 1e-4:
            raise TrainingError("the ball does not move in the data set, so there is no Jacobian")
        self._scale_rad = float(np.sqrt(np.mean(spread**2)))
        widest = float(np.ptp(self._joints, axis=0).max())
        self._nodes = int(np.clip(math.ceil(widest / _NODE_SPACING_RAD), 2, 8))
        self._spread = spread

    def run(self, progress: Progress | None) -> TrainingResult:
        options = self._options
        fitting, validation, held_out = self._split()
        centres, widths = self._initial_neurons(fitting)
        offset_s = self._align(centres, widths, fitting)
        good = self._good_images(centres, widths, fitting)
        outliers = int(np.count_nonzero(~good))
        fitting, validation, held_out = (
            part[good[part]] for part in (fitting, validation, held_out)
        )
        iterations = 0
        if options.method == "varpro":
            centres, widths, iterations = self._variable_projection(
                centres, widths, fitting, validation, progress
            )
        weights, ridge, validation_error = self._choose_ridge(centres, widths, fitting, validation)
        judged = as_model(centres, widths, weights)
        pair_error, motion = self._judge_pairs(judged, held_out)
        everything = np.flatnonzero(good)
        networks = self._judge_networks(judged, everything, held_out, pair_error)
        weights = self._solve(centres, widths, everything, (ridge,))[0]
        errors: dict[str, Any] = {
            "pair_error_m": pair_error,
            "pair_error_relative": pair_error / motion,
            "validation_error": validation_error,
            "ridge": ridge,
            "iterations": iterations,
            "samples": len(everything),
            "held_out_samples": len(held_out),
            "outliers": outliers,
            "time_offset_s": offset_s,
            "column_m_rad": [n.column_m_rad for n in networks],
            "column_error_m_rad": [n.error_m_rad for n in networks],
            "column_error_relative": [n.relative for n in networks],
        }
        trained = TrainedModel(
            model=as_model(centres, widths, weights),
            joint_box_rad=box_of(self._joints[everything]),
            ball_box_m=box_of(self._ball[everything]),
            ball_samples_m=self._ball[self._rng.permutation(everything)[:_BALL_SAMPLES]],
            joint_names=self._data.joint_names,
            feature_frame=self._data.feature_frame,
            errors=errors,
            provenance={
                "method": options.method,
                "options": asdict(options),
                "data": dict(self._data.provenance),
            },
        )
        return TrainingResult(trained, networks, self._notes(outliers, offset_s))

    def _split(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Indices to fit, to choose and to judge with, in blocks of segments and time."""
        data = self._data
        first = np.searchsorted(data.segment, data.segment, side="left")
        # no more than a tenth of the whole in a block, however short the data set is
        length_s = sum(data.stamps_s[run.stop - 1] - data.stamps_s[run.start] for run in self._runs)
        block_s = min(_BLOCK_S, max(length_s / 20.0, 1e-3))
        piece = np.floor((data.stamps_s - data.stamps_s[first]) / block_s)
        change = (np.diff(data.segment) != 0) | (np.diff(piece) != 0)
        block = np.concatenate([[0], np.cumsum(change)])
        order = self._rng.permutation(block[-1] + 1)
        rank = np.empty_like(order)
        rank[order] = np.arange(len(order))
        place = (rank[block] + 0.5) / len(order)
        held_out = place < _HELD_OUT
        validation = ~held_out & (place < _HELD_OUT + _VALIDATION)
        parts = tuple(
            np.flatnonzero(part) for part in (~held_out & ~validation, validation, held_out)
        )
        if min(len(part) for part in parts) < 6:
            raise TrainingError(
                f"the data set of {len(data)} images in {len(order)} pieces is too small to keep "
                "some back; record for longer"
            )
        return parts[0], parts[1], parts[2]

    def _initial_neurons(self, fitting: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        k, n = self._options.neurons, self._joints.shape[1]
        chosen = [
            self._joints[self._rng.choice(fitting, k, replace=len(fitting) < k)] for _ in range(n)
        ]
        widths = np.full((n, k), _WIDTH_FACTOR * self._scale_rad)
        return np.stack(chosen), widths

    def _pairs(self, images: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Random pairs in which every image appears about equally often."""
        rounds = max(1, math.ceil(count / len(images)))
        first = np.tile(images, rounds)
        second = np.concatenate([self._rng.permutation(images) for _ in range(rounds)])
        different = np.flatnonzero(first != second)
        if len(different) > count:
            different = self._rng.permutation(different)[:count]
        return first[different], second[different]

    def _equations(
        self, centres: np.ndarray, widths: np.ndarray, pairs: tuple[np.ndarray, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        first, second = pairs
        regressors = line_regressors(
            centres, widths, self._joints[first], self._joints[second], self._nodes
        )
        return regressors, self._ball[second] - self._ball[first]

    def _solve(
        self,
        centres: np.ndarray,
        widths: np.ndarray,
        images: np.ndarray,
        ridges: tuple[float, ...],
        count: int | None = None,
    ) -> list[np.ndarray]:
        if count is None:
            count = int(np.clip(2 * len(images), 4000, 10_000))
        regressors, motion = self._equations(centres, widths, self._pairs(images, count))
        return ridge_path(regressors, motion, ridges)

    def _align(self, centres: np.ndarray, widths: np.ndarray, fitting: np.ndarray) -> float:
        """Find and undo a constant offset between the stamps of images and joints, s.

        A position that lags by tau is off by -tau times the ball's velocity, in which the
        equations are linear again. The networks can mimic a part of the lag, so tau is fitted
        together with the weights: to the part of the velocity that the networks cannot explain.
        """
        stamps, m = self._data.stamps_s, self._ball.shape[1]
        runs = [run for run in self._runs if run.stop - run.start >= _SHORTEST_RUN]
        moving = np.zeros(len(stamps), dtype=bool)
        joint_velocity = np.zeros_like(self._joints)
        for run in runs:
            moving[run] = True
            joint_velocity[run] = np.gradient(self._joints[run], stamps[run], axis=0)
        if not np.all(moving[fitting]):
            return 0.0
        recorded, offset_s = self._joints, 0.0
        model = as_model(
            centres, widths, self._solve(centres, widths, fitting, (_FIRST_RIDGE,), 4000)[0]
        )
        for _ in range(_ALIGNMENTS):
            ball_velocity = np.einsum("nki,ni->nk", model.jacobian(self._joints), joint_velocity)
            pairs = self._pairs(fitting, 4000)
            regressors, motion = self._equations(centres, widths, pairs)
            change = ball_velocity[pairs[1]] - ball_velocity[pairs[0]]
            both = np.concatenate([motion, change], axis=1)
            weights = ridge_path(regressors, both, (_FIRST_RIDGE,))[0]
            left = both - regressors @ weights
            size = np.linalg.norm(left[:, :m], axis=1)
            left = left[size <= 3.0 * np.median(size)]
            left_motion, left_change = left[:, :m], left[:, m:]
            power = float(np.vdot(left_change, left_change))
            offset_s -= float(np.vdot(left_change, left_motion)) / max(power, 1e-12)
            offset_s = float(np.clip(offset_s, -_MAX_OFFSET_S, _MAX_OFFSET_S))
            model = as_model(centres, widths, weights[:, :m])
            self._joints = recorded.copy()
            for run in runs:
                for i in range(recorded.shape[1]):
                    self._joints[run, i] = np.interp(
                        stamps[run] - offset_s, stamps[run], recorded[run, i]
                    )
        return offset_s

    def _residual(
        self, centres: np.ndarray, widths: np.ndarray, weights: np.ndarray, fitting: np.ndarray
    ) -> np.ndarray:
        """Ball positions minus those of the networks, up to a constant, m, shape (n, 3)."""
        middle = np.broadcast_to(self._joints[fitting].mean(axis=0), self._joints.shape)
        return self._ball - (
            line_regressors(centres, widths, middle, self._joints, self._nodes) @ weights
        )

    def _good_images(
        self, centres: np.ndarray, widths: np.ndarray, fitting: np.ndarray
    ) -> np.ndarray:
        """Which images fit to their neighbours in time.

        The networks' own error changes slowly along a motion, an outlier comes and goes; so it is
        the residual's distance from its neighbours' median that counts.
        """
        weights = self._solve(centres, widths, fitting, (_FIRST_RIDGE,), 5000)[0]
        residual = self._residual(centres, widths, weights, fitting)
        n, segment = len(residual), self._data.segment
        shifts = [k for k in range(-_NEIGHBOURS, _NEIGHBOURS + 1) if k != 0]
        neighbours = np.full((len(shifts), *residual.shape), np.nan)
        for row, shift in zip(neighbours, shifts, strict=True):
            here, there = (
                (slice(0, n - shift), slice(shift, n))
                if shift > 0
                else (slice(-shift, n), slice(0, n + shift))
            )
            same = (segment[here] == segment[there])[:, None]
            row[here] = np.where(same, residual[there], np.nan)
        alone = np.isnan(neighbours[:, :, 0]).all(axis=0)
        neighbours[0, alone] = np.median(residual, axis=0)
        distance = np.linalg.norm(residual - np.nanmedian(neighbours, axis=0), axis=1)
        limit = _OUTLIER_FACTOR * float(np.median(distance))
        return distance <= max(limit, 1e-9)

    def _choose_ridge(
        self,
        centres: np.ndarray,
        widths: np.ndarray,
        fitting: np.ndarray,
        validation: np.ndarray,
    ) -> tuple[np.ndarray, float, float]:
        """Weights with the largest ridge that is as good as the best, within half a percent."""
        candidates = self._solve(centres, widths, fitting, _RIDGES)
        regressors, motion = self._equations(centres, widths, self._pairs(validation, 3000))
        scores = [relative_error(regressors, motion, weights) for weights in candidates]
        limit = 1.005 * min(scores)
        best = max(i for i, score in enumerate(scores) if score <= limit)
        return candidates[best], _RIDGES[best], scores[best]

    def _variable_projection(
        self,
        centres: np.ndarray,
        widths: np.ndarray,
        fitting: np.ndarray,
        validation: np.ndarray,
        progress: Progress | None,
    ) -> tuple[np.ndarray, np.ndarray, int]:
        """Adam on centres and log widths, the weights being solved for in every iteration."""
        try:
            from fvs_estimator_node.varpro import Batch, refine
        except ImportError as error:
            raise TrainingError(
                "the method varpro needs torch: pip install torch, or use the method ridge"
            ) from error
        options = self._options
        ridge = _RIDGES[2]
        judged_on = self._pairs(validation, 3000)
        solved_on = self._pairs(fitting, 6000)

        def score(centres: np.ndarray, widths: np.ndarray) -> float:
            weights = ridge_path(*self._equations(centres, widths, solved_on), (ridge,))[0]
            return relative_error(*self._equations(centres, widths, judged_on), weights)

        best_score, best = score(centres, widths), (centres, widths)

        def draw() -> Batch:
            first, second = self._pairs(fitting, _BATCH)
            motion = self._ball[second] - self._ball[first]
            return self._joints[first], self._joints[second], motion

        def report(iteration: int, centres: np.ndarray, widths: np.ndarray) -> bool:
            nonlocal best_score, best
            if iteration % _CHECK_EVERY == 0 or iteration == options.iterations:
                present = score(centres, widths)
                if present < best_score:
                    best_score, best = present, (centres.copy(), widths.copy())
            return progress is not None and progress(iteration, options.iterations, best_score)

        done = refine(
            centres,
            widths,
            draw,
            quadrature(self._nodes),
            ridge,
            _LEARNING_RATE,
            options.iterations,
            report,
        )
        return best[0], best[1], done

    def _judge_pairs(self, model: RbfModel, held_out: np.ndarray) -> tuple[float, float]:
        """Root mean squares of the held-out pair error and of the ball's motion, m."""
        regressors, motion = self._equations(
            model.centres, model.widths, self._pairs(held_out, 3000)
        )
        error = regressors @ as_matrix(model) - motion
        return (
            float(np.sqrt(np.mean(np.sum(error**2, axis=1)))),
            float(np.sqrt(np.mean(np.sum(motion**2, axis=1)))),
        )

    def _judge_networks(
        self, model: RbfModel, everything: np.ndarray, held_out: np.ndarray, pair_error_m: float
    ) -> tuple[NetworkError, ...]:
        """Differences to the reference at held-out joints."""
        known = self._rng.permutation(everything)[:_REFERENCE_IMAGES]
        at = self._joints[self._rng.permutation(held_out)[:_REFERENCE_IMAGES]]
        reference = reference_jacobian(
            self._joints[known],
            self._ball[known],
            at,
            # a pair's error has the noise of two images in three coordinates
            noise_m=max(pair_error_m / math.sqrt(2.0 * self._ball.shape[1]), 1e-5),
            scale_rad=2.0 * _WIDTH_FACTOR * self._scale_rad,
        )
        columns = np.sqrt(np.mean(np.sum(reference**2, axis=1), axis=0))
        difference = model.jacobian(at) - reference
        errors = np.sqrt(np.mean(np.sum(difference**2, axis=1), axis=0))
        whole = float(np.linalg.norm(columns))
        return tuple(
            NetworkError(float(c), float(e), float(e / c) if c > 0.01 * whole else None)
            for c, e in zip(columns, errors, strict=True)
        )

    def _notes(self, outliers: int, offset_s: float) -> tuple[str, ...]:
        notes = []
        names = self._data.joint_names
        still = [name for name, s in zip(names, self._spread, strict=True) if s < 1e-3]
        if still:
            notes.append(
                f"{', '.join(still)} did not move in the data set: their columns are not learned"
            )
        late = late_stamps_note(offset_s)
        if late:
            notes.append(late)
        if outliers:
            notes.append(f"{outliers} of {len(self._data)} images do not fit and were left out")
        return tuple(notes)


def _runs(segment: np.ndarray) -> list[slice]:
    """The continuous runs, one after the other."""
    ends = [0, *(np.flatnonzero(np.diff(segment)) + 1).tolist(), len(segment)]
    return [slice(a, b) for a, b in pairwise(ends)]
