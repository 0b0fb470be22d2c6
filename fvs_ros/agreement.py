"""Does the image follow the arm? What was seen, summed up, against what was predicted.

Both ways are kept from an anchor on, exposure by exposure: p, where ``sum J dr`` has the feature,
and s, where it was seen. One sum of both answers three questions, however fast the arm goes:

- the share of p that is seen, in whatever direction (the camera may have been turned): next to
  nothing for a frozen picture, or for a red thing that is not the ball;
- how much of the motion is predicted wrongly: a wrong Jacobian, a camera that was moved;
- nothing at all as long as too little moved for the noise of the images.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from fvs_ros.vectors import length

#: Nothing is said before p has come this far, m: the arm may creep so far behind a frozen picture.
_LEAST_M = 0.012
#: ... nor before the seen share is known to this deviation ...
_DEVIATION = 0.12
#: ... nor sooner than this, s: with stamps that are late by less the ball starts late.
_LEAST_S = 0.25
#: Positions nearer than this to the first of their cell are averaged, m.
_CELL_M = _LEAST_M / 8.0
#: Cells that are kept; beyond, the two neighbours nearest to each other become one.
_CELLS = 32


@dataclass(frozen=True)
class Verdict:
    """What the last way says.

    Parameters
    ----------
    predicted_m : float
        How far the feature was predicted to come, m.
    seen_share : float
        Share of that which was seen, in whatever direction.
    error_ratio : float
        Error of the prediction over the larger one of predicted and seen motion, rms: 0 is
        perfect, 1 no better than predicting rest, 2 the opposite.
    time_s : float
        Within this time, s.
    """

    predicted_m: float
    seen_share: float
    error_ratio: float
    time_s: float


class Agreement:
    """Compares seen and predicted ways."""

    def __init__(self) -> None:
        self._newest_s = -inf
        self.restart()

    def restart(self) -> None:
        """Begin anew."""
        self._cells: list[_Cell] = []
        self._verdict: Verdict | None = None

    @property
    def verdict(self) -> Verdict | None:
        """What the last way says; None while too little has moved."""
        return self._verdict

    def add(self, stamp_s: float, seen_m: np.ndarray, moved_m: np.ndarray, noise_m: float) -> None:
        """Tell an image.

        Parameters
        ----------
        stamp_s : float
            Exposure, s.
        seen_m, moved_m : ndarray, shape (m,)
            The feature as seen, and what the joints have moved it by then, from any origin, m.
        noise_m : float
            Standard deviation of a coordinate of an image, m.
        """
        if stamp_s <= self._newest_s:  # the clock stepped back, which forgives nothing
            for cell in self._cells:
                cell.stamp_s += stamp_s - self._newest_s
        self._newest_s = stamp_s
        if not self._cells or length(moved_m - self._cells[-1].anchor_m) > _CELL_M:
            self._cells.append(_Cell(stamp_s, moved_m, 1, moved_m, seen_m))
        else:
            self._cells[-1].add(1, moved_m, seen_m)
        if len(self._cells) > _CELLS:
            self._merge()
        verdict = self._judge(0, noise_m)
        while verdict is not None and (later := self._judge(1, noise_m)) is not None:
            self._cells.pop(0)
            verdict = later
        self._verdict = verdict

    def _merge(self) -> None:
        means = np.array([cell.moved_sum_m / cell.images for cell in self._cells])
        first = int(np.linalg.norm(np.diff(means, axis=0), axis=1).argmin())
        later = self._cells.pop(first + 1)
        self._cells[first].add(later.images, later.moved_sum_m, later.seen_sum_m)
        self._cells[first].anchor_m = later.anchor_m

    def _judge(self, first: int, noise_m: float) -> Verdict | None:
        """The verdict of the cells from one on; None where they do not suffice for one."""
        cells = self._cells[first:]
        if len(cells) < 2 or self._newest_s - cells[0].stamp_s < _LEAST_S:
            return None
        images = np.array([float(cell.images) for cell in cells])
        moved = np.array([cell.moved_sum_m for cell in cells]) / images[:, None]
        predicted_m = float(np.linalg.norm(moved - moved[-1], axis=1).max())
        if predicted_m < _LEAST_M:
            return None
        weights = images / images.sum()
        moved -= weights @ moved
        power = float(images @ np.square(moved).sum(axis=1))
        if noise_m**2 > _DEVIATION**2 * power:
            return None
        seen = np.array([cell.seen_sum_m for cell in cells]) / images[:, None]
        seen -= weights @ seen
        share = float(np.linalg.norm((seen * images[:, None]).T @ moved, "nuc")) / power
        noise_m2 = seen.shape[1] * (len(cells) - 1) * noise_m**2
        off = max(0.0, float(images @ np.square(seen - moved).sum(axis=1)) - noise_m2)
        seen_power = float(images @ np.square(seen).sum(axis=1)) - noise_m2
        ratio = (off / max(power, seen_power)) ** 0.5
        return Verdict(predicted_m, share, ratio, self._newest_s - cells[0].stamp_s)


@dataclass
class _Cell:
    """Images that the joints' motion has nearly in one place."""

    stamp_s: float
    anchor_m: np.ndarray
    images: int
    moved_sum_m: np.ndarray
    seen_sum_m: np.ndarray

    def add(self, images: int, moved_sum_m: np.ndarray, seen_sum_m: np.ndarray) -> None:
        self.images += images
        self.moved_sum_m = self.moved_sum_m + moved_sum_m
        self.seen_sum_m = self.seen_sum_m + seen_sum_m
