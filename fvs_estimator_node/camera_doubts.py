"""What an estimator that learns how the camera stands says of images that do not fit the arm.

Wrong stamps are found first (:mod:`fvs_estimator_node.stamp_watch`). A camera that is bumped once
is learned anew, and nobody need be told. One that seems to be bumped again and again is being
carried; or it stands, and the joints are not what they were when the model was learned.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Sequence

import numpy as np

from fvs_estimator_node.base import Estimator
from fvs_estimator_node.stamp_watch import StampWatch

#: So many bumps within so many images (10 s of them) are no accidents.
_MANY, _IMAGES = 8, 300


class CameraDoubts:
    """Counts bumps and watches stamps, image by image."""

    def __init__(self) -> None:
        self.stamps = StampWatch()
        self._images = 0
        self._bumps = 0
        self._bumped_at: deque[int] = deque(maxlen=4 * _MANY)

    @property
    def bumps(self) -> int:
        """How often the camera was found to have been moved."""
        return self._bumps

    def image(
        self,
        model_m: np.ndarray,
        seen_m: np.ndarray,
        stamp_s: float,
        rotations: Sequence[np.ndarray],
    ) -> bool:
        """Hear of an image, and say whether the stamps' lag is another now: as ``StampWatch``."""
        self._images += 1
        changed = self.stamps.add(model_m, seen_m, stamp_s, rotations)
        if changed:
            self._bumped_at.clear()  # it was the stamps
        return changed

    def bump(self) -> None:
        """Tell of a bump at the last image."""
        self._bumps += 1
        self._bumped_at.append(self._images)

    def take_back(self, bumps: int) -> None:
        """Go back to an earlier count: the last bumps were none."""
        while self._bumps > bumps:
            self._bumps -= 1
            if self._bumped_at:
                self._bumped_at.pop()

    @property
    def _bumped_often(self) -> bool:
        at = self._bumped_at
        return len(at) >= _MANY and self._images - at[-_MANY] < _IMAGES

    @property
    def remark(self) -> str:
        """What does not fit, in words; empty if all is well."""
        if self._bumped_often and not self.stamps.problem:
            return (
                "the image does not fit the arm's motion: the camera seems to have been moved "
                f"{_MANY} times and more in {_IMAGES} images; is it being carried about? If not, "
                "positions are far off again and again, or a joint has another sign, zero, scale "
                "or name than when the model was learned"
            )
        return self.stamps.remark

    @property
    def problem(self) -> str:
        """Why the arm must not move on the estimate, in words; empty if it may."""
        return self.stamps.problem


class CameraLearner(Estimator):
    """An estimator that learns how the camera stands, and doubts the images for it."""

    @property
    @abstractmethod
    def doubts(self) -> CameraDoubts:
        """What does not fit."""

    @property
    def problem(self) -> str:
        """Why the arm must not move on the estimate, in words; empty if it may."""
        return self.doubts.problem

    @property
    def remark(self) -> str:
        """What does not fit, in words; empty if all is well."""
        return self.doubts.remark

    def status_values(self) -> dict[str, float]:
        """Bumps, and how late the images are."""
        return {
            "camera_bumps": float(self.doubts.bumps),
            "images_late_s": self.doubts.stamps.lag_s,
        }
