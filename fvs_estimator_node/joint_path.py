"""The joints at any time of a recording, and the images that a fit takes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from fvs_estimator_node.files import DataSet
from fvs_ros.interface import Backlash

#: Largest stamp offset in the search, late or early, s; the ends of each run are cut by it.
MAX_OFFSET_S = 0.2
#: Fewest images of a run.
LEAST_RUN = 5
#: A joint with a smaller standard deviation, rad, is at rest: its axis is unknown.
STILL_RAD = 1e-3
#: Largest number of images in a fit, and size of the blocks they are taken in: more images change
#: the Jacobian by less than its deviation.
_MOST_SAMPLES, _BLOCK = 6000, 50


class Path:
    """Joints at any time of each continuous run, from those at the exposures.

    ``indices`` are the images that are fitted, in blocks where there are too many, ``stamps_s``
    their stamps, s, both of shape (k,). Of still poses every image counts, whenever it was exposed.
    """

    def __init__(self, data: DataSet) -> None:
        stamps = data.stamps_s
        inside, splines = [np.arange(len(data) if data.still else 0)], []
        for run in () if data.still else data.runs():
            time_s = stamps[run]
            early, late = time_s[0] + MAX_OFFSET_S, time_s[-1] - MAX_OFFSET_S
            fitted = run.start + np.flatnonzero((time_s >= early) & (time_s <= late))
            if len(time_s) >= LEAST_RUN and len(fitted):
                inside.append(fitted)
                splines.append((run, CubicSpline(time_s, data.joints_rad[run])))
        self.indices = _thinned(np.concatenate(inside))
        self.stamps_s, self._joints = stamps[self.indices], data.joints_rad[self.indices]
        self._splines: list[tuple[slice, Any]] = [
            (slice(*np.searchsorted(self.indices, [run.start, run.stop])), spline)
            for run, spline in splines
        ]

    def joints_and_velocities(self, offset_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Joints and their velocities at the stamps minus an offset, (k, n) each."""
        joints, velocity = self._joints.copy(), np.zeros_like(self._joints)
        for part, spline in self._splines:
            time_s = self.stamps_s[part] - offset_s
            joints[part], velocity[part] = spline(time_s), spline(time_s, 1)
        return joints, velocity


def behind_play(data: DataSet, play_rad: np.ndarray) -> DataSet:
    """The same with the joints of motors with play, rad, (n,); of still poses it is not known."""
    backlash, joints_rad = Backlash(), data.joints_rad
    if not data.still and play_rad.any():
        joints_rad = np.array([backlash.joints(motors, play_rad) for motors in joints_rad])
    return replace(data, joints_rad=joints_rad)


def _thinned(indices: np.ndarray) -> np.ndarray:
    """Blocks of neighbours, evenly spread over all, no more than are worth their time."""
    if len(indices) <= _MOST_SAMPLES:
        return indices
    starts = np.linspace(0, len(indices) - _BLOCK, _MOST_SAMPLES // _BLOCK).astype(int)
    return indices[(starts[:, None] + np.arange(_BLOCK)).ravel()]
