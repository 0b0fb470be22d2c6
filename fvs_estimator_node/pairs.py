"""Networks from pairs of images: the least squares behind the methods ``ridge`` and ``varpro``.

The paper trains on steps between neighbouring images, ``dx = J(r) dr``: little motion, much noise.
But the ball's position is a function of the joints, so *any* two images a and b count, with the
signal of the whole box over the noise of one position:

    x_b - x_a = sum_i W_i int_0^1 theta_i(r_a + t (r_b - r_a)) dt (r_b,i - r_a,i),

linear in the weights, with the integral along a straight line by Gauss-Legendre quadrature. Pairs
drawn at random also force the columns to belong to one function.

``ridge`` draws the centres from the data and solves for the weights. ``varpro`` (variable
projection) moves centres and widths as well, by Adam, and solves for the weights inside: at their
optimum the gradient is the one with the weights held fixed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from fvs_estimator_node.rbf import RbfModel, rbf_features

_MIN_SAMPLES = 60
#: Pieces of a data set, and number of pieces held out for validation and for test, each.
_PIECES, _KEPT_BACK = 60, 6
#: An outlier's residual deviates from the median of its neighbours by more than this multiple of
#: the median deviation; number of neighbours.
_OUTLIER_FACTOR, _NEIGHBOURS = 6.0, 7
#: Width of all neurons at first, in standard deviations of the training joints (mean over the
#: joints); 7 is 3.5 times the half width of an evenly filled box, over two.
_WIDTH_FACTOR = 7.0
#: Ridge relative to the mean diagonal: a hundred times more or less changes the error by a tenth.
_RIDGE = 1e-10
#: Distance of the nodes of a line, rad.
_NODE_SPACING_RAD = 0.8
#: Pairs of a batch, Adam's first step for centres (rad) and log widths, and iterations between
#: looks at the validation error, which often rises for a while after the first, large steps.
_BATCH, _LEARNING_RATE, _CHECK_EVERY = 2048, 0.1, 20

#: Centres, rad, (n, k, n), and widths, rad, (n, k).
Neurons = tuple[np.ndarray, np.ndarray]
#: Called with iterations done, iterations planned and best validation error.
Progress = Callable[[int, int, float], None]


class TrainingError(ValueError):
    """Data or options that nothing can be trained with; the text says why."""


class Pairs:
    """Pairs of k images, joints, rad, (k, n), and features, m, (k, m), and their least squares.

    Raises TrainingError if they determine nothing.
    """

    def __init__(
        self, joints_rad: np.ndarray, features_m: np.ndarray, rng: np.random.Generator
    ) -> None:
        if len(features_m) < _MIN_SAMPLES:
            raise TrainingError(
                f"the data set has {len(features_m)} images, expected at least {_MIN_SAMPLES}"
            )
        self.joints, self._z, self._rng = joints_rad, features_m, rng
        spread = self.joints.std(axis=0)
        if spread.max() < 1e-3:
            raise TrainingError("the joints hardly move in the data set, so there is no Jacobian")
        if np.linalg.norm(self._z.std(axis=0)) < 1e-4:
            raise TrainingError(
                "what was seen does not move in the data set, so there is no Jacobian"
            )
        self._width_rad = _WIDTH_FACTOR * float(np.sqrt(np.mean(spread**2)))
        widest_rad = float(np.ptp(self.joints, axis=0).max())
        self._nodes = int(np.clip(math.ceil(widest_rad / _NODE_SPACING_RAD), 2, 8))

    def train(
        self, count: int, iterations: int, progress: Progress | None
    ) -> tuple[RbfModel, np.ndarray, dict[str, Any]]:
        """Train networks of ``neurons`` neurons, refined in ``iterations`` (0: the ridge alone).

        Also returns which images are inliers, (k,), and the errors on held-out images. The weights
        are finally fitted to all inliers.
        """
        parts = self._split()
        neurons = self._first_neurons(parts[0], count)
        good = self._good_images(neurons, parts[0])
        fitting, validation, held_out = (part[good[part]] for part in parts)
        if iterations:
            neurons = self._refined(neurons, fitting, validation, iterations, progress)
        weights = self._solve(neurons, fitting)
        regressors, motion = self._equations(neurons, *self._draw(held_out, 3000))
        missed, moved = (
            float(np.sqrt(np.mean(np.sum(motions**2, axis=1))))
            for motions in (regressors @ weights - motion, motion)
        )
        errors = {
            "pair_error_m": missed,
            "pair_error_relative": missed / moved,
            "samples": len(good),
            "outliers": int(np.count_nonzero(~good)),
        }
        weights = self._solve(neurons, np.flatnonzero(good)).reshape(*neurons[1].shape, -1)
        return RbfModel(*neurons, weights.transpose(0, 2, 1)), good, errors

    def _split(self) -> list[np.ndarray]:
        """Indices to fit, to choose and to judge with: whole pieces of the motion."""
        pieces = np.array_split(np.arange(len(self._z)), _PIECES)
        order = self._rng.permutation(_PIECES)
        parts = order[2 * _KEPT_BACK :], order[_KEPT_BACK : 2 * _KEPT_BACK], order[:_KEPT_BACK]
        return [np.sort(np.concatenate([pieces[i] for i in part])) for part in parts]

    def _first_neurons(self, images: np.ndarray, count: int) -> Neurons:
        """Centres at joints of the data, all widths alike."""
        n = self.joints.shape[1]
        replace = len(images) < count
        chosen = [self.joints[self._rng.choice(images, count, replace=replace)] for _ in range(n)]
        return np.stack(chosen), np.full((n, count), self._width_rad)

    def _draw(self, images: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Random pairs in which every image appears about equally often."""
        rounds = max(1, math.ceil(count / len(images)))
        first = np.tile(images, rounds)
        second = np.concatenate([self._rng.permutation(images) for _ in range(rounds)])
        different = np.flatnonzero(first != second)
        if len(different) > count:
            different = self._rng.permutation(different)[:count]
        return first[different], second[different]

    def _equations(
        self, neurons: Neurons, first: np.ndarray, second: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Regressors, (p, n k), and the ball's motion, (p, m), of pairs."""
        regressors = line_regressors(neurons, self.joints[first], self.joints[second], self._nodes)
        return regressors, self._z[second] - self._z[first]

    def _solve(self, neurons: Neurons, images: np.ndarray) -> np.ndarray:
        """The weights, (n k, m), that fit some images best."""
        count = int(np.clip(2 * len(images), 4000, 10_000))
        return ridge_weights(*self._equations(neurons, *self._draw(images, count)))

    def _good_images(self, neurons: Neurons, fitting: np.ndarray) -> np.ndarray:
        """Which images fit to their neighbours in time, bool (k,).

        The networks' own error changes slowly along a motion, an outlier is short. So the test uses
        the distance of the residual from its neighbours' median.
        """
        weights = self._solve(neurons, fitting)
        middle = np.broadcast_to(self.joints[fitting].mean(axis=0), self.joints.shape)
        moved = line_regressors(neurons, middle, self.joints, self._nodes) @ weights
        residual = self._z - moved
        usual = median_filter(residual, (_NEIGHBOURS, 1), mode="nearest")
        distance = np.linalg.norm(residual - usual, axis=1)
        good: np.ndarray = distance <= max(_OUTLIER_FACTOR * float(np.median(distance)), 1e-9)
        return good

    def _refined(
        self,
        neurons: Neurons,
        fitting: np.ndarray,
        validation: np.ndarray,
        iterations: int,
        progress: Progress | None,
    ) -> Neurons:
        """Neurons moved by Adam, the weights being solved for in each iteration.

        Those of the least validation error are kept.
        """
        try:
            from fvs_estimator_node.varpro import Batch, refine
        except ImportError as error:
            raise TrainingError(
                "the method varpro needs torch: pip install torch, or use the method ridge"
            ) from error
        judged_on, solved_on = self._draw(validation, 3000), self._draw(fitting, 6000)

        def score(present: Neurons) -> float:
            weights = ridge_weights(*self._equations(present, *solved_on))
            regressors, motion = self._equations(present, *judged_on)
            return float(np.linalg.norm(regressors @ weights - motion) / np.linalg.norm(motion))

        def draw() -> Batch:
            first, second = self._draw(fitting, _BATCH)
            return self.joints[first], self.joints[second], self._z[second] - self._z[first]

        best_score, best = score(neurons), neurons
        nodes = quadrature(self._nodes)
        refined = refine(neurons, draw, nodes, _RIDGE, _LEARNING_RATE, iterations)
        for iteration, present in enumerate(refined, 1):
            if iteration % _CHECK_EVERY == 0 or iteration == iterations:
                present_score = score(present)
                if present_score < best_score:
                    best_score, best = present_score, present
            if progress is not None:
                progress(iteration, iterations, best_score)
        return best


def quadrature(nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes in [0, 1] and their weights."""
    nodes_at, weights = np.polynomial.legendre.leggauss(nodes)
    return 0.5 * (nodes_at + 1.0), 0.5 * weights


def line_regressors(neurons: Neurons, start: np.ndarray, end: np.ndarray, nodes: int) -> np.ndarray:
    """Regressors of the weights for ball motion between joints ``start`` and ``end``, rad, (p, n).

    Integrals of theta_i along the line times the motion of joint i, network by network, (p, n k).
    """
    motion = end - start
    total = np.zeros((len(start), *neurons[1].shape))
    for node, weight in zip(*quadrature(nodes), strict=True):
        total += weight * rbf_features(*neurons, start + node * motion)
    total *= motion[:, :, None]
    return total.reshape(len(start), -1)


def ridge_weights(regressors: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Weights, shape (n k, m), by a ridge relative to the mean diagonal."""
    gram = regressors.T @ regressors
    gram[np.diag_indices_from(gram)] += _RIDGE * np.trace(gram) / len(gram)
    return np.linalg.solve(gram, regressors.T @ motion)
