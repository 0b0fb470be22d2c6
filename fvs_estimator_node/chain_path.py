"""The joints at any time of a recording, for images that may be stamped late or early."""

from __future__ import annotations

from typing import Any

import numpy as np

from fvs_estimator_node.dataset import DataSet

#: Images are not looked for that are stamped later, or earlier, than this, s; ends of runs this
#: long are left out.
MAX_OFFSET_S = 0.2
#: Most images that are fitted, and how many neighbours make a block of them: more change the
#: Jacobian by less than its deviation.
_MOST_SAMPLES, _BLOCK = 6000, 50


class ChainPath:
    """Joints at any time of each continuous run, from those at the exposures.

    Attributes
    ----------
    indices : ndarray of int, shape (k,)
        The images that are fitted: blocks of all, evenly spread, where there are too many.
    stamps_s : ndarray, shape (k,)
        Their stamps, s.
    """

    def __init__(self, data: DataSet) -> None:
        from scipy.interpolate import CubicSpline

        stamps, inside, splines = data.stamps_s, [], []
        for run in np.unique(data.segment):
            first, end = np.searchsorted(data.segment, [run, run + 1])
            where = np.arange(first, end)
            early, late = stamps[first] + MAX_OFFSET_S, stamps[end - 1] - MAX_OFFSET_S
            fitted = where[(stamps[where] >= early) & (stamps[where] <= late)]
            if len(where) >= 5 and len(fitted):
                inside.append(fitted)
                spline = CubicSpline(stamps[where], data.joints_rad[where])
                splines.append((first, end, spline))
        self.indices = _thinned(np.concatenate(inside)) if inside else np.zeros(0, int)
        self.stamps_s = stamps[self.indices]
        self._n = data.joints_rad.shape[1]
        self._splines: list[tuple[slice, Any]] = [
            (slice(*np.searchsorted(self.indices, [first, end])), spline)
            for first, end, spline in splines
        ]

    def joints_and_velocities(self, offset_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Joints and their velocities at the stamps minus an offset, (k, n) each."""
        joints = np.empty((len(self.stamps_s), self._n))
        velocity = np.empty_like(joints)
        for places, spline in self._splines:
            time_s = self.stamps_s[places] - offset_s
            joints[places], velocity[places] = spline(time_s), spline(time_s, 1)
        return joints, velocity


def _thinned(indices: np.ndarray) -> np.ndarray:
    """Blocks of neighbours, evenly spread over all, no more than are worth their time."""
    if len(indices) <= _MOST_SAMPLES:
        return indices
    starts = np.linspace(0, len(indices) - _BLOCK, _MOST_SAMPLES // _BLOCK).astype(int)
    return indices[(starts[:, None] + np.arange(_BLOCK)).ravel()]
