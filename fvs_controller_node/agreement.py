"""Whether the image follows the arm: measured against predicted motion.

From an anchor on, both paths are recorded at every exposure: p, predicted by ``sum J dr``, and s,
measured. One sum over both gives, at any speed of the arm:

- the share of p that is measured, in any direction (the camera may have been turned): almost zero
  for a frozen image, or for a red object other than the ball;
- the error of the predicted motion: a wrong Jacobian, a moved camera;
- no verdict while the motion is too small for the noise of the images.
"""

from __future__ import annotations

from math import inf
from typing import NamedTuple

import numpy as np

from fvs_controller_node.redundancy import singular_values
from fvs_ros.filter import Image
from fvs_ros.vectors import length

#: No verdict below this predicted motion, m: the arm moves this far before a frozen image shows.
_LEAST_M = 0.012
#: No verdict before the measured share is known to this standard deviation.
_DEVIATION = 0.12
#: No verdict before this time, s: a smaller stamp delay looks like a late start of the motion.
_LEAST_S = 0.25
#: Positions nearer than this to the first of their cell are averaged, m.
_CELL_M = _LEAST_M / 8.0
#: Largest number of cells.
_CELLS = 64


class Verdict(NamedTuple):
    """How seen and predicted motion agree."""

    predicted_m: float  #: predicted motion of the feature
    seen_share: float  #: measured share of it, in any direction
    #: Error of the prediction over the larger one of predicted and seen motion, rms: 0 is perfect,
    #: 1 no better than predicting rest, 2 the opposite.
    error_ratio: float
    time_s: float  #: within this time
    camera: str = ""  #: whose images these are, if it has a name

    @property
    def of(self) -> str:
        """Of which camera, in words; empty for one without a name."""
        return f" of {self.camera}" if self.camera else ""


class Agreement:
    """Compares seen and predicted motion; ``verdict`` is None while the motion is too small."""

    def __init__(self) -> None:
        self._newest_s = -inf
        self.restart()

    def restart(self) -> None:
        """Begin anew."""
        #: Of images with nearly the same predicted position: the first one's stamp, their number,
        #: and the sums of predicted and seen positions, (2 + 2 d,) each.
        self._cells = np.zeros((0, 2))
        self._anchor_m = np.zeros(0)  # predicted position that the newest cell began with
        self.verdict: Verdict | None = None

    def add(self, image: Image, noise_m: float) -> None:
        """Take an image, and the standard deviation of a coordinate of images, m."""
        stamp_s, measured_m, predicted_m = image.stamp_s, image.seen_m, image.moved_m
        if stamp_s <= self._newest_s:  # the clock stepped back: the cells remain valid
            self._cells[:, 0] += stamp_s - self._newest_s
        self._newest_s = stamp_s
        row = np.concatenate([(stamp_s, 1.0), predicted_m, measured_m])
        if len(self._cells) and length(predicted_m - self._anchor_m) <= _CELL_M:
            self._cells[-1, 1:] += row[1:]
        else:
            self._anchor_m, first = predicted_m, len(self._cells) == 0
            self._cells = row[None] if first else np.vstack([self._cells[1 - _CELLS :], row])
        self.verdict = self._judge(noise_m)

    def _judge(self, noise_m: float) -> Verdict | None:
        """The verdict of the newest cells that suffice for one, which stay; None without any."""
        cells = self._cells
        stamps_s, images = cells[:, 0].tolist(), cells[:, 1]
        predicted, measured = np.hsplit(cells[:, 2:] / images[:, None], 2)
        verdict, first = None, 0
        while len(cells) - first > 1:
            time_s, newer = self._newest_s - stamps_s[first], slice(first, None)
            later = _verdict(images[newer], predicted[newer], measured[newer], noise_m, time_s)
            if later is None:
                break
            verdict, first = later, first + 1
        self._cells = cells[max(0, first - 1) :]
        return verdict


def _verdict(
    images: np.ndarray, moved: np.ndarray, seen: np.ndarray, noise_m: float, time_s: float
) -> Verdict | None:
    """The verdict on k cells: images, (k,), predicted and seen positions, (k, d), m.

    None where they do not suffice.
    """
    if time_s < _LEAST_S:
        return None
    predicted_m = float(np.square(moved - moved[-1]).sum(axis=1).max()) ** 0.5
    if predicted_m < _LEAST_M:
        return None
    weights = images / images.sum()
    moved = moved - weights @ moved
    power = float(images @ np.square(moved).sum(axis=1))
    if noise_m**2 > _DEVIATION**2 * power:
        return None
    seen = seen - weights @ seen
    seen_share = float(singular_values((seen * images[:, None]).T @ moved).sum()) / power
    noise_m2 = seen.shape[1] * (len(images) - 1) * noise_m**2
    error_m2 = max(0.0, float(images @ np.square(seen - moved).sum(axis=1)) - noise_m2)
    seen_power = float(images @ np.square(seen).sum(axis=1)) - noise_m2
    return Verdict(predicted_m, seen_share, (error_m2 / max(power, seen_power)) ** 0.5, time_s)
