"""What an estimator that learns how the camera stands says of images that do not fit the arm.

A camera that is bumped once is learned anew, and nobody need be told. One that seems to be bumped
again and again is being carried; or it stands, and the joints are not what they were when the model
was learned.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import deque

from fvs_estimator_node.base import Estimator

#: So many bumps within so many images (10 s of them) are no accidents.
_MANY, _IMAGES = 8, 300


class CameraDoubts:
    """Counts bumps, image by image."""

    def __init__(self) -> None:
        self._images = 0
        self._bumps = 0
        self._bumped_at: deque[int] = deque(maxlen=4 * _MANY)

    @property
    def bumps(self) -> int:
        """How often the camera was found to have been moved."""
        return self._bumps

    def image(self) -> None:
        """Tell of an image."""
        self._images += 1

    def bump(self) -> None:
        """Tell of a bump at the last image."""
        self._bumps += 1
        self._bumped_at.append(self._images)

    @property
    def _bumped_often(self) -> bool:
        at = self._bumped_at
        return len(at) >= _MANY and self._images - at[-_MANY] < _IMAGES

    @property
    def remark(self) -> str:
        """What does not fit, in words; empty if all is well."""
        if self._bumped_often:
            return (
                "the image does not fit the arm's motion: the camera seems to have been moved "
                f"{_MANY} times and more in {_IMAGES} images; is it being carried about? If not, "
                "positions are far off again and again, or a joint has another sign, zero, scale "
                "or name than when the model was learned"
            )
        return ""


class CameraLearner(Estimator):
    """An estimator that learns how the camera stands, and doubts the images for it."""

    @property
    @abstractmethod
    def doubts(self) -> CameraDoubts:
        """What does not fit."""

    @property
    def remark(self) -> str:
        """What does not fit, in words; empty if all is well."""
        return self.doubts.remark

    def status_values(self) -> dict[str, float]:
        """Bumps."""
        return {"camera_bumps": float(self.doubts.bumps)}
