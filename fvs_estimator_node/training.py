"""Offline training of the networks from a data set of ball positions and joints.

The paper trains on steps between neighbouring images, ``dx = J(r) dr``: little motion, much noise.
But the ball's position is a function of the joints, so *any* two images a and b teach, with the
signal of the whole box over the noise of one position:

    x_b - x_a = sum_i W_i int_0^1 theta_i(r_a + t (r_b - r_a)) dt (r_b,i - r_a,i),

linear in the weights, with the integral along a straight line by Gauss-Legendre quadrature. Pairs
drawn at random also show that the columns belong to one function.

``ridge`` draws the centres from the data and solves for the weights. ``varpro`` (variable
projection) moves centres and widths as well, by Adam, and solves for the weights inside: at their
optimum the gradient is the one with the weights held fixed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from fvs_estimator_node.chain_start import MAX_OFFSET_S, STILL_RAD
from fvs_estimator_node.dataset import DataSet
from fvs_estimator_node.model_file import TrainedModel, boxes_of
from fvs_estimator_node.rbf import RbfModel, rbf_features

METHODS = ("varpro", "ridge")
_MIN_SAMPLES = 60
#: Pieces that a data set is cut into, and how many are kept back to choose and to judge with each.
_PIECES, _KEPT_BACK = 60, 6
#: Images that fit worse than this many times the median are left out, compared with the median of
#: this many neighbours.
_OUTLIER_FACTOR, _NEIGHBOURS = 6.0, 7
#: Width of all neurons at first, in standard deviations of the training joints (mean over the
#: joints); 7 is 3.5 times the half width of an evenly filled box, over two.
_WIDTH_FACTOR = 7.0
#: Ridge relative to the mean diagonal: a hundred times more or less changes the error by a tenth.
RIDGE = 1e-10
#: Distance of the nodes of a line, rad.
_NODE_SPACING_RAD = 0.8
#: Pairs of a batch, Adam's first step for centres (rad) and log widths, and iterations between
#: looks at the validation error, which often rises for a while after the first, large steps.
_BATCH, _LEARNING_RATE, _CHECK_EVERY = 2048, 0.1, 20
#: Passes of the search for the stamps' offset, and fewest images of a run for it.
_ALIGNMENTS, _SHORTEST_RUN = 4, 30
#: Offsets of the images' stamps below this are not worth a word, s.
_NOTABLE_OFFSET_S = 0.003
#: Networks that miss a larger share of the ball's motion are doubtful.
_DOUBTFUL = 0.15

#: Centres, rad, (n, k, n), and widths, rad, (n, k).
Neurons = tuple[np.ndarray, np.ndarray]
#: Told the iterations done and to do and the best validation error; True ends them early.
Progress = Callable[[int, int, float], bool]


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


def train(
    data: DataSet, options: TrainingOptions | None = None, progress: Progress | None = None
) -> TrainedModel:
    """Train the networks.

    Parameters
    ----------
    data : DataSet
        Ball positions and joints.
    options : TrainingOptions, optional
        How.
    progress : callable, optional
        Called after each iteration.

    Returns
    -------
    TrainedModel
        Ready to be saved. Its ``errors`` are those of networks that have not seen the held-out
        images; the weights are then fitted once more, to all images. ``pair_error_m`` is the root
        mean square prediction error between two of those images, with the noise of both, m.

    Raises
    ------
    TrainingError
        If the data cannot teach anything.
    """
    options = options if options is not None else TrainingOptions()
    pairs = _Pairs(data, np.random.default_rng(options.seed))
    parts = _split(len(data), pairs.rng)
    neurons = pairs.first_neurons(parts[0], options.neurons)
    offset_s = _align(pairs, neurons, data, parts[0])
    good = _good_images(pairs, neurons, parts[0])
    fitting, validation, held_out = (part[good[part]] for part in parts)
    outliers = int(np.count_nonzero(~good))
    errors: dict[str, Any] = {"iterations": 0, "time_offset_s": offset_s, "outliers": outliers}
    if options.method == "varpro":
        neurons, errors["iterations"] = _refined(
            pairs, neurons, fitting, validation, options.iterations, progress
        )
    judged = _model(neurons, pairs.solve(neurons, fitting))
    errors |= _judge_pairs(pairs, judged, held_out)
    everything = np.flatnonzero(good)
    errors |= {"samples": len(everything), "held_out_samples": len(held_out)}
    return TrainedModel(
        model=_model(neurons, pairs.solve(neurons, everything)),
        **boxes_of(pairs.joints[everything], pairs.ball[everything], pairs.rng),
        joint_names=data.joint_names,
        feature_frame=data.feature_frame,
        errors=errors,
        provenance={
            "method": options.method,
            "options": asdict(options),
            "data": dict(data.provenance),
            "notes": _notes(data, errors),
        },
    )


class _Pairs:
    """Pairs of images of a data set, and the least squares over them."""

    def __init__(self, data: DataSet, rng: np.random.Generator) -> None:
        if len(data) < _MIN_SAMPLES:
            raise TrainingError(
                f"the data set has {len(data)} images, expected at least {_MIN_SAMPLES}"
            )
        self.joints, self.ball, self.rng = data.joints_rad, data.ball_m, rng
        spread = self.joints.std(axis=0)
        if spread.max() < STILL_RAD:
            raise TrainingError("the joints hardly move in the data set, so there is no Jacobian")
        if np.linalg.norm(self.ball.std(axis=0)) < 1e-4:
            raise TrainingError("the ball does not move in the data set, so there is no Jacobian")
        self.width_rad = _WIDTH_FACTOR * float(np.sqrt(np.mean(spread**2)))
        widest_rad = float(np.ptp(self.joints, axis=0).max())
        self.nodes = int(np.clip(math.ceil(widest_rad / _NODE_SPACING_RAD), 2, 8))

    def first_neurons(self, images: np.ndarray, count: int) -> Neurons:
        """Centres at joints of the data, all widths alike."""
        n = self.joints.shape[1]
        replace = len(images) < count
        chosen = [self.joints[self.rng.choice(images, count, replace=replace)] for _ in range(n)]
        return np.stack(chosen), np.full((n, count), self.width_rad)

    def draw(self, images: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Random pairs in which every image appears about equally often."""
        rounds = max(1, math.ceil(count / len(images)))
        first = np.tile(images, rounds)
        second = np.concatenate([self.rng.permutation(images) for _ in range(rounds)])
        different = np.flatnonzero(first != second)
        if len(different) > count:
            different = self.rng.permutation(different)[:count]
        return first[different], second[different]

    def equations(
        self, neurons: Neurons, first: np.ndarray, second: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Regressors, (p, n k), and the ball's motion, (p, m), of pairs."""
        regressors = line_regressors(neurons, self.joints[first], self.joints[second], self.nodes)
        return regressors, self.ball[second] - self.ball[first]

    def solve(self, neurons: Neurons, images: np.ndarray) -> np.ndarray:
        """The weights, (n k, m), that fit some images best."""
        count = int(np.clip(2 * len(images), 4000, 10_000))
        return ridge_weights(*self.equations(neurons, *self.draw(images, count)))


# ---- least squares --------------------------------------------------------------------------


def quadrature(nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Places in [0, 1] and their shares."""
    places, shares = np.polynomial.legendre.leggauss(nodes)
    return 0.5 * (places + 1.0), 0.5 * shares


def line_regressors(neurons: Neurons, start: np.ndarray, end: np.ndarray, nodes: int) -> np.ndarray:
    """What multiplies the weights in the ball's motion from joints to joints, rad, (p, n) each.

    Integrals of theta_i along the line times the motion of joint i, network by network, (p, n k).
    """
    motion = end - start
    total = np.zeros((len(start), *neurons[1].shape))
    for place, share in zip(*quadrature(nodes), strict=True):
        total += share * rbf_features(*neurons, start + place * motion)
    total *= motion[:, :, None]
    return total.reshape(len(start), -1)


def ridge_weights(regressors: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Weights, shape (n k, m), by a ridge relative to the mean diagonal."""
    gram = regressors.T @ regressors
    gram[np.diag_indices_from(gram)] += RIDGE * np.trace(gram) / len(gram)
    return np.linalg.solve(gram, regressors.T @ motion)


def _relative_error(regressors: np.ndarray, motion: np.ndarray, weights: np.ndarray) -> float:
    return float(np.linalg.norm(regressors @ weights - motion) / np.linalg.norm(motion))


def _model(neurons: Neurons, weights: np.ndarray) -> RbfModel:
    """Networks of weights as they are solved for, shape (n k, m)."""
    stacked = weights.reshape(*neurons[1].shape, -1)
    return RbfModel(*neurons, stacked.transpose(0, 2, 1))


# ---- the recipe -----------------------------------------------------------------------------


def _split(images: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Indices to fit, to choose and to judge with: whole pieces of the motion."""
    pieces = np.array_split(np.arange(images), _PIECES)
    order = rng.permutation(_PIECES)
    parts = order[2 * _KEPT_BACK :], order[_KEPT_BACK : 2 * _KEPT_BACK], order[:_KEPT_BACK]
    return [np.sort(np.concatenate([pieces[i] for i in part])) for part in parts]


def _align(pairs: _Pairs, neurons: Neurons, data: DataSet, fitting: np.ndarray) -> float:
    """Find and undo a constant offset between the stamps of images and joints, s.

    A position that lags by tau is off by -tau times the ball's velocity, in which the equations
    are linear again. The networks can mimic a part of the lag, so tau is fitted together with the
    weights: to the part of the velocity that the networks cannot explain.
    """
    stamps, recorded, m = data.stamps_s, data.joints_rad, data.ball_m.shape[1]
    joint_velocity = np.full_like(recorded, np.nan)
    runs = [run for run in data.runs() if run.stop - run.start >= _SHORTEST_RUN]
    for run in runs:
        joint_velocity[run] = np.gradient(recorded[run], stamps[run], axis=0)
    fitting = fitting[np.isfinite(joint_velocity[fitting, 0])]
    if len(fitting) < _MIN_SAMPLES // 2:
        return 0.0
    offset_s, joints = 0.0, recorded.copy()
    weights = pairs.solve(neurons, fitting)
    for _ in range(_ALIGNMENTS):
        model = _model(neurons, weights)
        chosen = pairs.draw(fitting, 4000)
        regressors, motion = pairs.equations(neurons, *chosen)
        first, second = (
            np.einsum("nki,ni->nk", model.jacobian(pairs.joints[i]), joint_velocity[i])
            for i in chosen
        )
        both = np.concatenate([motion, second - first], axis=1)
        solved = ridge_weights(regressors, both)
        left = both - regressors @ solved
        size = np.linalg.norm(left[:, :m], axis=1)
        left_motion, left_change = np.split(left[size <= 3.0 * np.median(size)], [m], axis=1)
        power = max(float(np.vdot(left_change, left_change)), 1e-12)
        offset_s -= float(np.vdot(left_change, left_motion)) / power
        offset_s = float(np.clip(offset_s, -MAX_OFFSET_S, MAX_OFFSET_S))
        weights = solved[:, :m]
        for run in runs:
            joints[run] = np.stack(
                [np.interp(stamps[run] - offset_s, stamps[run], q) for q in recorded[run].T], 1
            )
        pairs.joints = joints
    return offset_s


def _good_images(pairs: _Pairs, neurons: Neurons, fitting: np.ndarray) -> np.ndarray:
    """Which images fit to their neighbours in time.

    The networks' own error changes slowly along a motion, an outlier comes and goes; so it is the
    residual's distance from its neighbours' median that counts.
    """
    from scipy.ndimage import median_filter

    weights = pairs.solve(neurons, fitting)
    middle = np.broadcast_to(pairs.joints[fitting].mean(axis=0), pairs.joints.shape)
    moved = line_regressors(neurons, middle, pairs.joints, pairs.nodes) @ weights
    residual = pairs.ball - moved
    usual = median_filter(residual, (_NEIGHBOURS, 1), mode="nearest")
    distance = np.linalg.norm(residual - usual, axis=1)
    return distance <= max(_OUTLIER_FACTOR * float(np.median(distance)), 1e-9)


def _refined(
    pairs: _Pairs,
    neurons: Neurons,
    fitting: np.ndarray,
    validation: np.ndarray,
    iterations: int,
    progress: Progress | None,
) -> tuple[Neurons, int]:
    """Neurons moved by Adam, the weights being solved for in every iteration; iterations done."""
    try:
        from fvs_estimator_node.varpro import Batch, refine
    except ImportError as error:
        raise TrainingError(
            "the method varpro needs torch: pip install torch, or use the method ridge"
        ) from error
    judged_on, solved_on = pairs.draw(validation, 3000), pairs.draw(fitting, 6000)

    def score(present: Neurons) -> float:
        weights = ridge_weights(*pairs.equations(present, *solved_on))
        return _relative_error(*pairs.equations(present, *judged_on), weights)

    best_score, best = score(neurons), neurons

    def draw() -> Batch:
        first, second = pairs.draw(fitting, _BATCH)
        return pairs.joints[first], pairs.joints[second], pairs.ball[second] - pairs.ball[first]

    def report(iteration: int, centres: np.ndarray, widths: np.ndarray) -> bool:
        nonlocal best_score, best
        if iteration % _CHECK_EVERY == 0 or iteration == iterations:
            present = score((centres, widths))
            if present < best_score:
                best_score, best = present, (centres.copy(), widths.copy())
        return progress is not None and progress(iteration, iterations, best_score)

    done = refine(neurons, draw, quadrature(pairs.nodes), RIDGE, _LEARNING_RATE, iterations, report)
    return best, done


def _judge_pairs(pairs: _Pairs, model: RbfModel, held_out: np.ndarray) -> dict[str, float]:
    """Root mean square of the held-out pair error, m and over the ball's motion."""
    neurons = model.centres, model.widths
    regressors, motion = pairs.equations(neurons, *pairs.draw(held_out, 3000))
    weights = model.weights.transpose(0, 2, 1).reshape(-1, motion.shape[1])
    error = regressors @ weights - motion
    error_m, motion_m = (float(np.sqrt(np.mean(np.sum(one**2, axis=1)))) for one in (error, motion))
    return {"pair_error_m": error_m, "pair_error_relative": error_m / motion_m}


# ---- notes ----------------------------------------------------------------------------------


def still_joints(data: DataSet) -> str:
    """The joints that stood still in a data set, by name, of which nothing is learned."""
    spread = data.joints_rad.std(axis=0)
    return ", ".join(
        name for name, one in zip(data.joint_names, spread, strict=True) if one < STILL_RAD
    )


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


def _notes(data: DataSet, errors: dict[str, Any]) -> list[str]:
    still, outliers, missed = still_joints(data), errors["outliers"], errors["pair_error_relative"]
    notes = (
        f"{still} did not move in the data set: their columns are not learned" if still else "",
        late_stamps_note(errors["time_offset_s"]),
        f"{outliers} of {len(data)} images do not fit and were left out" if outliers else "",
        f"the networks miss {100.0 * missed:.0f} % of the ball's motion; collect longer or in a "
        "wider box, with one robot and one detector publishing"
        if missed > _DOUBTFUL
        else "",
    )
    return [note for note in notes if note]
