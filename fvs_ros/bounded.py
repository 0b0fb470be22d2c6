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
    contradict each other, u is between them. By the active set of Lawson and Hanson (Solving Least
    Squares Problems, ch. 23).
    """
    missing, pushes = least - rows.dot(wanted), np.zeros(len(rows))
    if missing.max() <= 0.0:
        return wanted, pushes
    coupling = rows.dot(rows.T) + _DAMPING * np.eye(len(rows))
    active = missing == missing.max()
    for _ in range(9 * len(rows)):  # in practice, twice as many as push
        trial = np.zeros(len(rows))
        trial[active] = np.linalg.solve(coupling[np.ix_(active, active)], missing[active])
        drop = active & (trial <= 0.0)
        if drop.any():  # go there until the first pushes no more
            pushes += (pushes[drop] / (pushes[drop] - trial[drop])).min() * (trial - pushes)
            active &= pushes > 1e-12
            continue
        pushes, left = trial, np.where(active, 0.0, missing - coupling.dot(trial))
        if left.max() <= 1e-9:
            break
        active[left.argmax()] = True
    return wanted + pushes.dot(rows), pushes
