"""What is nearest within linear bounds."""

import numpy as np

#: As the damping of the pseudo inverse: a bound that hardly any motion changes, or that contradicts
#: others, is kept less well.
_DAMPING = 1e-4


def nearest(
    wanted: np.ndarray, rows: np.ndarray, least: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find the u that is nearest to what is wanted, (n,), with ``rows @ u >= least``.

    It is ``wanted + rows' p``; also p, (k,): how much each of the k bounds pushes. Where they
    contradict each other, u is between them. What cannot be found is not a number.
    """
    from scipy.optimize import nnls  # takes 0.4 s; only a camera on the arm needs it

    missing = least - rows.dot(wanted)
    if missing.max() <= 0.0:
        return wanted, np.zeros(len(rows))
    try:
        factor = np.linalg.cholesky(rows.dot(rows.T) + _DAMPING * np.eye(len(rows)))
        pushes, _ = nnls(factor.T, np.linalg.solve(factor, missing), maxiter=100 * len(rows))
    except (RuntimeError, ValueError):
        pushes = np.full(len(rows), np.nan)
    return wanted + pushes.dot(rows), pushes
