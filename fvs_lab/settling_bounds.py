"""Times that can be computed before a run: the printed formula, a sharper bound, the motion."""

from __future__ import annotations

from math import inf, log

import numpy as np

from fvs_controller_node.reaching import ReachingLaw
from fvs_controller_node.settling import (
    constant_exponent_time_s,
    reaching_time_s,
    sliding_value_after,
)
from fvs_controller_node.surface import SlidingSurface
from fvs_lab.outcome import BOUNDS_M, seconds
from fvs_tools.score import settling_time_s

#: Length of a run, and as far as the theory's motion is followed, s.
DURATION_S = 6.0
BANDS = ("5 mm", "2 mm")

_PIECES = 200
_SMALLEST_M = 1e-5
_STEP_S = 0.002


def printed_sliding_time_s(y0: float, surface: SlidingSurface) -> float:
    """Sliding time of an axis by (36)-(39) as printed, s; negative where alpha2 < alpha3.

    ``a1 ln[|y|^(g-1) / (|y|^(g-1) + a2/a3)] / ((g - 1) (a2 - a3))``, summed over the exponent's two
    values; infinite for alpha2 = alpha3.

    Parameters
    ----------
    y0 : float
        Error at the beginning, m; not 0.
    surface : SlidingSurface
        The surface.
    """

    def time_s(y: float, gamma: float) -> float:
        a2, a3 = surface.alpha2, surface.alpha3
        if a2 == a3:
            return inf
        power = abs(y) ** (gamma - 1.0)
        return surface.alpha1 * log(power / (power + a2 / a3)) / ((gamma - 1.0) * (a2 - a3))

    near = surface.exponent(0.0)
    if abs(y0) <= surface.switch_error_m:
        return time_s(y0, near)
    far = surface.lambda1 - surface.lambda2
    return time_s(y0, far) + time_s(surface.switch_error_m, near)


def bound_to_band_s(
    error_m: np.ndarray, band_m: float, surface: SlidingSurface, law: ReachingLaw
) -> float:
    """Bound of the time until the error's norm is within a band, from rest, s.

    As the bound to zero: no axis moves until it has reached its surface; from there each slides
    with the larger of the exponents of a small piece of the way.

    Parameters
    ----------
    error_m : ndarray, shape (3,)
        Error at the beginning, m.
    band_m : float
        The band, m.
    surface : SlidingSurface
        The surface.
    law : ReachingLaw
        The reaching law.
    """
    times, errors = [], []
    for y0 in np.abs(error_m).tolist():
        near = min(y0, _SMALLEST_M)
        edges = np.geomspace(y0, near, _PIECES) if y0 > near else np.array([y0, y0])
        pairs = zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
        pieces = [
            constant_exponent_time_s(above, below, surface.exponent(below), surface)
            for above, below in pairs
        ]
        times.append(
            reaching_time_s(surface.value(y0, 0.0), law)
            + np.concatenate([[0.0], np.cumsum(pieces)])
        )
        errors.append(edges)
    instants = np.unique(np.concatenate([[0.0], *times]))
    squared = np.zeros(instants.size)
    for axis_times, edges in zip(times, errors, strict=True):
        # The last edge that was passed for sure; before the surface is reached, the first.
        passed = np.searchsorted(axis_times, instants, side="right") - 1
        squared += edges[np.maximum(passed, 0)] ** 2
    inside = np.flatnonzero(squared <= band_m**2)
    return float(instants[inside[0]]) if inside.size else inf


def predicted_times_s(
    errors_m: np.ndarray, surface: SlidingSurface, law: ReachingLaw
) -> dict[str, list[float]]:
    """Settling times of the theory's own motion: reaching law and surface, integrated from rest.

    Parameters
    ----------
    errors_m : ndarray, shape (n, 3)
        Errors at the beginning, m.
    surface : SlidingSurface
        The surface.
    law : ReachingLaw
        The reaching law.

    Returns
    -------
    dict of str to list of float
        By the band's name, a time for each beginning, s.
    """
    y = np.array(errors_m, dtype=float)
    start = np.vectorize(surface.value)(y, 0.0)
    value_after = np.vectorize(lambda s0, t_s: sliding_value_after(s0, t_s, law), otypes=[float])
    exponent = np.vectorize(surface.exponent, otypes=[float])
    times = np.arange(0.0, DURATION_S, _STEP_S)
    norms = np.empty((times.size, len(y)))
    for number, time_s in enumerate(times):
        norms[number] = np.linalg.norm(y, axis=1)
        s = value_after(start, time_s + 0.5 * _STEP_S)
        psi = np.sign(y) * np.abs(y) ** exponent(y)
        after = y + _STEP_S * (s - surface.alpha2 * y - surface.alpha3 * psi) / surface.alpha1
        # The attractor ends at zero; an explicit step would jump over it.
        y = np.where(after * y < 0.0, 0.0, after)
    return {
        band: [seconds(settling_time_s(times, one, BOUNDS_M[band])) for one in norms.T]
        for band in BANDS
    }
