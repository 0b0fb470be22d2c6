"""How runs are judged, the same in the demo and in the laboratory."""

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
    above = np.flatnonzero(errors_m >= bound_m)
    if above.size == 0:
        return float(times_s[0])
    if above[-1] + 1 >= len(errors_m):
        return None
    return float(times_s[above[-1] + 1])
