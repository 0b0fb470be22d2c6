"""Where the feature is, by image and prediction, and which images are outliers.

One filter and one innovation (seen minus predicted) serve every method and law; whether the image
follows the arm, the sums of the believed images say (:mod:`fvs_ros.agreement`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fvs_ros.fusion import Fusion

#: After this many outliers in a row camera or ball is moving, even if no two of them agree.
_REPEATS = 6


class Image(NamedTuple):
    """One image, and the arm's motion up to it.

    Parameters
    ----------
    stamp_s : float
        Exposure, s.
    seen_m : ndarray, shape (3,)
        The feature as seen, m.
    moved_m : ndarray, shape (3,)
        What the joints have moved it by then, ``sum J dr``, from any origin, m.
    source : object
        What the caller wants back with it.
    """

    stamp_s: float
    seen_m: np.ndarray
    moved_m: np.ndarray
    source: Any = None


class Tracker:
    """Where the feature is at the newest image."""

    def __init__(self) -> None:
        self.fusion = Fusion()
        self.restart()

    def restart(self) -> None:
        """Forget where the feature was; what was learned of noise and prediction stays."""
        self._estimate: np.ndarray | None = None
        self._moved = np.zeros(0)
        self._outliers: list[tuple[Image, np.ndarray]] = []  # and their innovations

    @property
    def estimate_m(self) -> np.ndarray | None:
        """The feature at the newest image, m, (3,); None before the first."""
        return self._estimate

    @property
    def moved_m(self) -> np.ndarray:
        """What the joints had moved it by then, m, (3,)."""
        return self._moved

    def add(self, image: Image) -> list[Image]:
        """Take an image.

        Returns
        -------
        list of Image
            Those that are believed now, oldest first: this one; none, for an outlier; this one and
            the outliers before it, where they turn out to be true.
        """
        if self._estimate is None:
            return self._believe(image)
        motion = image.moved_m - self._moved
        self._moved = image.moved_m
        self._estimate = self._estimate + motion
        innovation = image.seen_m - self._estimate
        correction = self.fusion.correct(innovation, motion)
        if correction is not None:
            self._outliers.clear()
            self._estimate = self._estimate + correction
            return [image]
        before = self._outliers[-1][1] if self._outliers else None
        self._outliers.append((image, innovation))
        agreed = before is not None and self.fusion.agree(before, innovation, motion)
        if not agreed and len(self._outliers) < _REPEATS:
            return []
        believed = self._believe(image)
        self.fusion.doubt()
        return believed

    def _believe(self, image: Image) -> list[Image]:
        images = [outlier for outlier, _ in self._outliers] or [image]
        self._outliers = []
        self._estimate, self._moved = image.seen_m.copy(), image.moved_m
        self.fusion.restart()
        return images
