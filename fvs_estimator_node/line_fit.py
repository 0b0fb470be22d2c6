"""Networks from pairs of images: the least squares of the training, whatever the path between.

For two images a and b the ball's motion is linear in the weights,

    x_b - x_a = sum_i W_i int_0^1 theta_i(r_a + t (r_b - r_a)) dt (r_b,i - r_a,i),

an integral along the straight line between the joints, by Gauss-Legendre quadrature.
"""

from __future__ import annotations

import numpy as np

from fvs_estimator_node.rbf import RbfModel, rbf_features


def quadrature(nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Places in [0, 1] and their shares."""
    places, shares = np.polynomial.legendre.leggauss(nodes)
    return 0.5 * (places + 1.0), 0.5 * shares


def line_regressors(
    centres: np.ndarray, widths: np.ndarray, start: np.ndarray, end: np.ndarray, nodes: int
) -> np.ndarray:
    """What multiplies the weights in the ball's motion between two joint positions.

    Parameters
    ----------
    centres : ndarray, shape (n, k, n)
        Centres, rad.
    widths : ndarray, shape (n, k)
        Widths, rad.
    start, end : ndarray, shape (p, n)
        Joint positions of the first and the second image, rad.
    nodes : int
        Quadrature nodes on the line; 1 is the midpoint rule.

    Returns
    -------
    ndarray, shape (p, n k)
        Integrals of theta_i along the line times the motion of joint i, network by network.
    """
    motion = end - start
    total = np.zeros((len(start), *widths.shape))
    for place, share in zip(*quadrature(nodes), strict=True):
        total += share * rbf_features(centres, widths, start + place * motion)
    total *= motion[:, :, None]
    return total.reshape(len(start), -1)


def ridge_path(
    regressors: np.ndarray, motion: np.ndarray, ridges: tuple[float, ...]
) -> list[np.ndarray]:
    """Weights, shape (n k, m), for each ridge relative to the mean diagonal."""
    gram, wanted = regressors.T @ regressors, regressors.T @ motion
    if len(ridges) == 1:
        gram[np.diag_indices_from(gram)] += ridges[0] * np.trace(gram) / len(gram)
        return [np.linalg.solve(gram, wanted)]
    values, vectors = np.linalg.eigh(gram)
    mean, projected = float(np.mean(values)), vectors.T @ wanted
    values = np.maximum(values, 0.0)[:, None]
    return [vectors @ (projected / (values + ridge * mean)) for ridge in ridges]


def relative_error(regressors: np.ndarray, motion: np.ndarray, weights: np.ndarray) -> float:
    """Norm of the prediction error over that of the motion."""
    return float(np.linalg.norm(regressors @ weights - motion) / np.linalg.norm(motion))


def as_model(centres: np.ndarray, widths: np.ndarray, weights: np.ndarray) -> RbfModel:
    """Networks of weights as they are solved for, shape (n k, m)."""
    stacked = weights.reshape(*widths.shape, -1)
    return RbfModel(centres, widths, stacked.transpose(0, 2, 1))


def as_matrix(model: RbfModel) -> np.ndarray:
    """Weights of networks as they are solved for, shape (n k, m)."""
    return model.weights.transpose(0, 2, 1).reshape(-1, model.weights.shape[1])
