"""Offline training of the six networks from a data set of ball positions and joints.

The paper trains on steps between neighbouring images, ``dx = J(r) dr``: little motion, much noise.
But the ball's position is a function of the joints, whatever path they took, so for *any* two
images a and b of the data set

    x_b - x_a = integral of J along the straight line from r_a to r_b
              = sum_i W_i int_0^1 theta_i(r_a + t (r_b - r_a)) dt (r_b,i - r_a,i),

which is linear in the weights too, needs no small motion, and has the signal of the whole box
over the noise of one position. The integral is done by Gauss-Legendre quadrature. Pairs drawn at
random over all images also tell the networks what a single path cannot: that their columns belong
to one function.

``ridge`` draws the centres from the data and solves for the weights. ``varpro`` (variable
projection) moves centres and widths as well, by Adam with one learning rate a network, and solves
for the weights inside: at their optimum the gradient is the one with the weights held fixed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from fvs_estimator_node.dataset import DataSet, late_stamps_note
from fvs_estimator_node.model_file import TrainedModel
from fvs_estimator_node.rbf import N_FEATURES, RbfModel, rbf_features
from fvs_estimator_node.reference import reference_jacobian
from fvs_ros.joints import N_JOINTS

METHODS = ("varpro", "ridge")
MIN_SAMPLES = 60
REFERENCE_IMAGES = 1200
BALL_SAMPLES = 500
_MAX_OFFSET_S = 0.2
_ALIGNMENTS = 4
_SHORTEST_RUN = 30
NODE_SPACING_RAD = 0.8
_NEIGHBOURS = 3


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
        Neurons of each network, m.
    seed : int
        Seed of everything random: equal data, options and seed give equal networks.
    width_factor : float
        Initial width of all neurons, in standard deviations of the training joints (mean over
        the joints); 7 is 3.5 times the half width of an evenly filled box, over two.
    ridges : tuple of float
        Ridge weights to choose from on the validation samples, relative to the mean diagonal.
    iterations : int
        Adam iterations of ``varpro``.
    batch : int
        Pairs of images in one iteration.
    learning_rates : tuple of float
        Adam's first step for centres (rad) and log widths, one a network; it falls to zero.
    check_every : int
        Iterations between looks at the validation error; the best of them is kept. (Stopping at
        once when it rises would be wrong: the first, large steps often make it worse for a while.)
    held_out, validation : float
        Shares of the data that are kept back for the reported errors, and for choosing.
    block_s : float
        Continuous motion is kept back in blocks of this length, s, not by single images.
    outlier_factor : float
        Images that fit worse than this many times the median are left out.
    """

    method: str = "varpro"
    neurons: int = 50
    seed: int = 0
    width_factor: float = 7.0
    ridges: tuple[float, ...] = (1e-12, 1e-11, 1e-10, 1e-9, 1e-8, 1e-7)
    iterations: int = 300
    batch: int = 2048
    learning_rates: tuple[float, ...] = (0.1,) * N_JOINTS
    check_every: int = 20
    held_out: float = 0.1
    validation: float = 0.1
    block_s: float = 2.0
    outlier_factor: float = 6.0

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise TrainingError(
                f"unknown training method {self.method!r}; known are {', '.join(METHODS)}"
            )
        if not 1 <= self.neurons <= 1000:
            raise TrainingError(f"neurons must lie between 1 and 1000, got {self.neurons}")
        if len(self.learning_rates) != N_JOINTS:
            raise TrainingError(f"learning_rates must be {N_JOINTS} numbers, one a network")
        if not self.ridges or min(self.ridges) <= 0.0:
            raise TrainingError("ridges must be positive")
        if min(self.held_out, self.validation) <= 0.0 or self.held_out + self.validation > 0.8:
            raise TrainingError("held_out and validation must be positive, at most 0.8 together")


@dataclass(frozen=True)
class TrainingProgress:
    """Where the training is.

    Parameters
    ----------
    iteration, iterations : int
        Done, and at most to do.
    validation_error : float
        Best relative prediction error on the validation samples so far.
    """

    iteration: int
    iterations: int
    validation_error: float


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
        Ready to be saved.
    options : TrainingOptions
        How it was trained.
    networks : tuple of NetworkError
        One a joint.
    pair_error_m : float
        Root mean square prediction error between two held-out images, m; with the noise of both.
    pair_error_relative : float
        The same over the root mean square motion of the ball between the two.
    step_error_relative : float or None
        The same for held-out images that follow each other (at least 0.01 rad apart); mostly
        noise when the steps are small. None if there are none.
    validation_error : float
        Relative pair error on the validation images.
    ridge : float
        The chosen ridge weight, relative.
    iterations : int
        Adam iterations done.
    samples, held_out_samples, outliers : int
        Images used in all, kept back, and left out.
    time_offset_s : float
        How much later than the joints they show the images are stamped, s; found from
        continuous motion and corrected for. Zero if there is none.
    notes : tuple of str
        What a user should know, in words.
    """

    trained: TrainedModel
    options: TrainingOptions
    networks: tuple[NetworkError, ...]
    pair_error_m: float
    pair_error_relative: float
    step_error_relative: float | None
    validation_error: float
    ridge: float
    iterations: int
    samples: int
    held_out_samples: int
    outliers: int
    time_offset_s: float
    notes: tuple[str, ...]


Progress = Callable[[TrainingProgress], bool]


def line_regressors(
    centres: np.ndarray, widths: np.ndarray, start: np.ndarray, end: np.ndarray, nodes: int
) -> np.ndarray:
    """What multiplies the weights in the ball's motion between two joint positions.

    Parameters
    ----------
    centres : ndarray, shape (6, m, 6)
        Centres, rad.
    widths : ndarray, shape (6, m)
        Widths, rad.
    start, end : ndarray, shape (n, 6)
        Joint positions of the first and the second image, rad.
    nodes : int
        Quadrature nodes on the line; 1 is the midpoint rule.

    Returns
    -------
    ndarray, shape (n, 6 m)
        Integrals of theta_i along the line times the motion of joint i, network by network.
    """
    motion = end - start
    places, shares = _quadrature(nodes)
    total = np.zeros((len(start), *widths.shape))
    for place, share in zip(places, shares, strict=True):
        total += share * rbf_features(centres, widths, start + place * motion)
    total *= motion[:, :, None]
    return total.reshape(len(start), -1)


def _quadrature(nodes: int) -> tuple[np.ndarray, np.ndarray]:
    places, shares = np.polynomial.legendre.leggauss(nodes)
    return 0.5 * (places + 1.0), 0.5 * shares


def train(
    data: DataSet, options: TrainingOptions | None = None, progress: Progress | None = None
) -> TrainingResult:
    """Train the six networks.

    Parameters
    ----------
    data : DataSet
        Ball positions and joints.
    options : TrainingOptions, optional
        How.
    progress : callable, optional
        Called now and then with a :class:`TrainingProgress`; True ends the iterations early.

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
        self._ball = data.ball_m
        spread = self._joints.std(axis=0)
        if spread.max() < 1e-3:
            raise TrainingError("the joints hardly move in the data set, so there is no Jacobian")
        if np.linalg.norm(self._ball.std(axis=0)) < 1e-4:
            raise TrainingError("the ball does not move in the data set, so there is no Jacobian")
        self._scale_rad = float(np.sqrt(np.mean(spread**2)))
        widest = float(np.ptp(self._joints, axis=0).max())
        self._nodes = int(np.clip(math.ceil(widest / NODE_SPACING_RAD), 2, 8))
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
        judged = _as_model(centres, widths, weights)
        pair_error, motion = self._judge_pairs(judged, held_out)
        everything = np.flatnonzero(good)
        networks = self._judge_networks(judged, everything, held_out, pair_error)
        weights = self._solve(centres, widths, everything, (ridge,))[0]
        result: dict[str, Any] = {
            "pair_error_m": pair_error,
            "pair_error_relative": pair_error / motion,
            "step_error_relative": self._judge_steps(judged, held_out),
            "validation_error": validation_error,
            "ridge": ridge,
            "iterations": iterations,
            "samples": len(everything),
            "held_out_samples": len(held_out),
            "outliers": outliers,
            "time_offset_s": offset_s,
        }
        errors = {
            **result,
            "column_m_rad": [n.column_m_rad for n in networks],
            "column_error_m_rad": [n.error_m_rad for n in networks],
            "column_error_relative": [n.relative for n in networks],
        }
        trained = TrainedModel(
            model=_as_model(centres, widths, weights),
            joint_box_rad=_box(self._joints[everything]),
            ball_box_m=_box(self._ball[everything]),
            ball_samples_m=self._ball[self._rng.permutation(everything)[:BALL_SAMPLES]],
            joint_names=self._data.joint_names,
            feature_frame=self._data.feature_frame,
            errors=errors,
            provenance={
                "method": options.method,
                "options": asdict(options),
                "data": dict(self._data.provenance),
            },
        )
        return TrainingResult(
            trained=trained,
            options=options,
            networks=networks,
            notes=self._notes(outliers, offset_s),
            **result,
        )

    def _split(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Indices to fit, to choose and to judge with, in blocks of segments and time."""
        data, options = self._data, self._options
        first = np.searchsorted(data.segment, data.segment, side="left")
        # no more than a tenth of the whole in a block, however short the data set is
        runs = np.unique(data.segment)
        length_s = float(
            np.sum(
                data.stamps_s[np.searchsorted(data.segment, runs, "right") - 1]
                - data.stamps_s[np.searchsorted(data.segment, runs, "left")]
            )
        )
        block_s = min(options.block_s, max(length_s / 20.0, 1e-3))
        piece = np.floor((data.stamps_s - data.stamps_s[first]) / block_s)
        change = (np.diff(data.segment) != 0) | (np.diff(piece) != 0)
        block = np.concatenate([[0], np.cumsum(change)])
        order = self._rng.permutation(block[-1] + 1)
        rank = np.empty_like(order)
        rank[order] = np.arange(len(order))
        place = (rank[block] + 0.5) / len(order)
        held_out = place < options.held_out
        validation = ~held_out & (place < options.held_out + options.validation)
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
        m = self._options.neurons
        chosen = [
            self._joints[self._rng.choice(fitting, m, replace=len(fitting) < m)]
            for _ in range(N_JOINTS)
        ]
        widths = np.full((N_JOINTS, m), self._options.width_factor * self._scale_rad)
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
        return _ridge_path(regressors, motion, ridges)

    def _align(self, centres: np.ndarray, widths: np.ndarray, fitting: np.ndarray) -> float:
        """Find and undo a constant offset between the stamps of images and joints, s.

        A position that lags by tau is off by -tau times the ball's velocity, in which the
        equations are linear again. The networks can feign a part of the lag, so tau is fitted
        together with the weights: to the part of the velocity that the networks cannot explain.
        """
        segment, stamps = self._data.segment, self._data.stamps_s
        runs = [run for run in _runs(segment) if run.stop - run.start >= _SHORTEST_RUN]
        moving = np.zeros(len(segment), dtype=bool)
        joint_velocity = np.zeros_like(self._joints)
        for run in runs:
            moving[run] = True
            joint_velocity[run] = np.gradient(self._joints[run], stamps[run], axis=0)
        if not np.all(moving[fitting]):
            return 0.0
        recorded, offset_s = self._joints, 0.0
        model = _as_model(centres, widths, self._solve(centres, widths, fitting, (1e-9,), 4000)[0])
        for _ in range(_ALIGNMENTS):
            ball_velocity = np.einsum("nki,ni->nk", model.jacobian(self._joints), joint_velocity)
            pairs = self._pairs(fitting, 4000)
            regressors, motion = self._equations(centres, widths, pairs)
            change = ball_velocity[pairs[1]] - ball_velocity[pairs[0]]
            both = np.concatenate([motion, change], axis=1)
            weights = _ridge_solve(regressors, both, 1e-9)
            left = both - regressors @ weights
            size = np.linalg.norm(left[:, :N_FEATURES], axis=1)
            left = left[size <= 3.0 * np.median(size)]
            left_motion, left_change = left[:, :N_FEATURES], left[:, N_FEATURES:]
            power = float(np.vdot(left_change, left_change))
            offset_s -= float(np.vdot(left_change, left_motion)) / max(power, 1e-12)
            offset_s = float(np.clip(offset_s, -_MAX_OFFSET_S, _MAX_OFFSET_S))
            model = _as_model(centres, widths, weights[:, :N_FEATURES])
            self._joints = recorded.copy()
            for run in runs:
                for i in range(N_JOINTS):
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
        weights = self._solve(centres, widths, fitting, (1e-9,), 5000)[0]
        residual = self._residual(centres, widths, weights, fitting)
        n, segment = len(residual), self._data.segment
        shifts = [k for k in range(-_NEIGHBOURS, _NEIGHBOURS + 1) if k != 0]
        neighbours = np.full((len(shifts), n, N_FEATURES), np.nan)
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
        limit = self._options.outlier_factor * float(np.median(distance))
        return distance <= max(limit, 1e-9)

    def _choose_ridge(
        self,
        centres: np.ndarray,
        widths: np.ndarray,
        fitting: np.ndarray,
        validation: np.ndarray,
    ) -> tuple[np.ndarray, float, float]:
        """Weights with the largest ridge that is as good as the best, within half a percent."""
        ridges = tuple(sorted(self._options.ridges))
        candidates = self._solve(centres, widths, fitting, ridges)
        regressors, motion = self._equations(centres, widths, self._pairs(validation, 3000))
        scores = [_relative_error(regressors, motion, weights) for weights in candidates]
        limit = 1.005 * min(scores)
        best = max(i for i, score in enumerate(scores) if score <= limit)
        return candidates[best], ridges[best], scores[best]

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
        ridge = sorted(options.ridges)[len(options.ridges) // 3]
        judged_on = self._pairs(validation, 3000)
        solved_on = self._pairs(fitting, 6000)

        def score(centres: np.ndarray, widths: np.ndarray) -> float:
            weights = _ridge_path(*self._equations(centres, widths, solved_on), (ridge,))[0]
            return _relative_error(*self._equations(centres, widths, judged_on), weights)

        best_score, best = score(centres, widths), (centres, widths)

        def draw() -> Batch:
            first, second = self._pairs(fitting, options.batch)
            motion = self._ball[second] - self._ball[first]
            return self._joints[first], self._joints[second], motion

        def report(iteration: int, centres: np.ndarray, widths: np.ndarray) -> bool:
            nonlocal best_score, best
            if iteration % options.check_every == 0 or iteration == options.iterations:
                present = score(centres, widths)
                if present < best_score:
                    best_score, best = present, (centres.copy(), widths.copy())
            return progress is not None and progress(
                TrainingProgress(iteration, options.iterations, best_score)
            )

        done = refine(
            centres,
            widths,
            draw,
            _quadrature(self._nodes),
            ridge,
            options.learning_rates,
            options.iterations,
            report,
        )
        return best[0], best[1], done

    def _judge_pairs(self, model: RbfModel, held_out: np.ndarray) -> tuple[float, float]:
        """Root mean squares of the held-out pair error and of the ball's motion, m."""
        regressors, motion = self._equations(
            model.centres, model.widths, self._pairs(held_out, 3000)
        )
        error = regressors @ _as_matrix(model) - motion
        return (
            float(np.sqrt(np.mean(np.sum(error**2, axis=1)))),
            float(np.sqrt(np.mean(np.sum(motion**2, axis=1)))),
        )

    def _judge_networks(
        self, model: RbfModel, everything: np.ndarray, held_out: np.ndarray, pair_error_m: float
    ) -> tuple[NetworkError, ...]:
        """Differences to the reference at held-out joints."""
        known = self._rng.permutation(everything)[:REFERENCE_IMAGES]
        at = self._joints[self._rng.permutation(held_out)[:REFERENCE_IMAGES]]
        reference = reference_jacobian(
            self._joints[known],
            self._ball[known],
            at,
            # a pair's error has the noise of two images in three coordinates
            noise_m=max(pair_error_m / math.sqrt(2.0 * N_FEATURES), 1e-5),
            scale_rad=2.0 * self._options.width_factor * self._scale_rad,
        )
        columns = np.sqrt(np.mean(np.sum(reference**2, axis=1), axis=0))
        difference = model.jacobian(at) - reference
        errors = np.sqrt(np.mean(np.sum(difference**2, axis=1), axis=0))
        whole = float(np.linalg.norm(columns))
        return tuple(
            NetworkError(float(c), float(e), float(e / c) if c > 0.01 * whole else None)
            for c, e in zip(columns, errors, strict=True)
        )

    def _judge_steps(self, model: RbfModel, held_out: np.ndarray) -> float | None:
        following = held_out[:-1][
            (np.diff(held_out) == 1)
            & (self._data.segment[held_out[:-1]] == self._data.segment[held_out[1:]])
        ]
        motion = self._joints[following + 1] - self._joints[following]
        following = following[np.abs(motion).max(axis=1, initial=0.0) >= 0.01]
        if len(following) == 0:
            return None
        regressors, motion = self._equations(
            model.centres, model.widths, (following, following + 1)
        )
        return _relative_error(regressors, motion, _as_matrix(model))

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


def _ridge_solve(regressors: np.ndarray, motion: np.ndarray, ridge: float) -> np.ndarray:
    gram = regressors.T @ regressors
    gram[np.diag_indices_from(gram)] += ridge * np.trace(gram) / len(gram)
    return np.linalg.solve(gram, regressors.T @ motion)


def _ridge_path(
    regressors: np.ndarray, motion: np.ndarray, ridges: tuple[float, ...]
) -> list[np.ndarray]:
    """Weights, shape (6 m, 3), for each relative ridge, from one decomposition."""
    if len(ridges) == 1:
        return [_ridge_solve(regressors, motion, ridges[0])]
    gram = regressors.T @ regressors
    values, vectors = np.linalg.eigh(gram)
    mean = float(np.mean(values))
    projected = vectors.T @ (regressors.T @ motion)
    values = np.maximum(values, 0.0)[:, None]
    return [vectors @ (projected / (values + ridge * mean)) for ridge in ridges]


def _relative_error(regressors: np.ndarray, motion: np.ndarray, weights: np.ndarray) -> float:
    return float(np.linalg.norm(regressors @ weights - motion) / np.linalg.norm(motion))


def _as_model(centres: np.ndarray, widths: np.ndarray, weights: np.ndarray) -> RbfModel:
    m = widths.shape[1]
    return RbfModel(centres, widths, weights.reshape(N_JOINTS, m, N_FEATURES).transpose(0, 2, 1))


def _as_matrix(model: RbfModel) -> np.ndarray:
    return model.weights.transpose(0, 2, 1).reshape(-1, N_FEATURES)


def _runs(segment: np.ndarray) -> list[slice]:
    """The continuous runs, one after the other."""
    ends = [0, *(np.flatnonzero(np.diff(segment)) + 1).tolist(), len(segment)]
    return [slice(a, b) for a, b in pairwise(ends)]


def _box(values: np.ndarray) -> np.ndarray:
    return np.stack([values.min(axis=0), values.max(axis=0)])
