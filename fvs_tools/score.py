"""How runs are judged, the same in the demo, in the laboratory and of a recording."""

from __future__ import annotations

import numpy as np


def settling_time_s(times_s: np.ndarray, errors_m: np.ndarray, bound_m: float) -> float | None:
    """When the error went below a bound for good.

    Parameters
    ----------
    times_s, errors_m : ndarray, shape (n,)
        The record.
    bound_m : float
        The bound, m.

    Returns
    -------
    float or None
        Time of the first sample of the last stretch below the bound, s; None if the record
        ends above it.
    """
    above = np.flatnonzero(~(errors_m < bound_m))  # an unknown error is not below
    if above.size == 0:
        return float(times_s[0])
    if above[-1] + 1 >= len(errors_m):
        return None
    return float(times_s[above[-1] + 1])


def jitter_rad_s(commands_rad_s: np.ndarray) -> float:
    """How much a command changes from tick to tick.

    Parameters
    ----------
    commands_rad_s : ndarray, shape (n, joints)
        Commanded joint velocities, one row a tick, rad/s.

    Returns
    -------
    float
        Rms of the changes of the worst joint, rad/s.
    """
    return float(np.sqrt(np.mean(np.diff(commands_rad_s, axis=0) ** 2, axis=0)).max())


def criteria(wrong_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The paper's criteria, eqs (40) to (42), of errors of predicted ball motions.

    Parameters
    ----------
    wrong_m : ndarray, shape (n, 3)
        dx - J dr of each step, m.

    Returns
    -------
    t1_m : ndarray, shape (n,)
        Length of each error, m.
    t2_m : ndarray, shape (n,)
        Length of the sum of all errors up to each step, m.
    """
    return np.linalg.norm(wrong_m, axis=1), np.linalg.norm(np.cumsum(wrong_m, axis=0), axis=1)
