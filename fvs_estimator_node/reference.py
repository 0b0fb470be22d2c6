"""A second opinion on the Jacobian: the slope of a smooth fit to the ball's positions.

Nobody tells the training the true Jacobian, and prediction errors alone do not tell which of the
six networks is to blame. A Gaussian process fitted to positions, not to motions, and with no
networks in it, gives each column by itself. It is used to judge, not to teach.
"""

from __future__ import annotations

import numpy as np


def reference_jacobian(
    joints_rad: np.ndarray,
    ball_m: np.ndarray,
    at_rad: np.ndarray,
    noise_m: float,
    scale_rad: float,
    size_m: float = 4.0,
) -> np.ndarray:
    """Slope of a Gaussian process through ball positions.

    Parameters
    ----------
    joints_rad : ndarray, shape (n, 6)
        Joint positions of n images, rad; the time taken grows with the cube of n.
    ball_m : ndarray, shape (n, 3)
        Ball positions, m.
    at_rad : ndarray, shape (k, 6)
        Where to evaluate, rad.
    noise_m : float
        Standard deviation of one coordinate of a position, m.
    scale_rad : float
        Length over which the positions change their character, rad.
    size_m : float
        How large such changes are, m.

    Returns
    -------
    ndarray, shape (k, 3, 6)
        Jacobians, m/rad.
    """
    known, wanted = joints_rad / scale_rad, at_rad / scale_rad
    covariance = _kernel(known, known) + 1.0  # the constant: where the ball is on the whole
    covariance[np.diag_indices_from(covariance)] += (noise_m / size_m) ** 2
    coefficients = np.linalg.solve(covariance, ball_m - ball_m.mean(axis=0))
    kernel = _kernel(wanted, known)
    level = kernel @ coefficients
    columns = [
        kernel @ (coefficients * known[:, [i]]) - level * wanted[:, [i]]
        for i in range(known.shape[1])
    ]
    return np.stack(columns, axis=-1) * (2.0 / scale_rad)


def _kernel(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    squares = np.sum(a * a, axis=1)[:, None] + np.sum(b * b, axis=1) - 2.0 * (a @ b.T)
    return np.exp(-np.maximum(squares, 0.0))
