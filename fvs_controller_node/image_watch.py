"""Does the image follow the arm? A frozen picture, or a red thing that is not the ball, does not.

Its positions are fresh and finite, and all alike: the arm would go on by joint motion alone.
Compared are, exposure by exposure, where the ball was seen and where ``sum J dr`` would have it.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

#: Images are looked back on for so long, and further for a slow arm, s ...
_LOOK_S, _LONGEST_S = 0.4, 4.0
#: ... until the ball should have come this far, m.
_LEAST_PREDICTED_M = 0.07
#: The ball follows if it is seen to make this share of the way, whatever its direction: a camera
#: that was turned, or a Jacobian that learns, is no frozen picture.
_LEAST_SHARE = 0.15
#: After a longer gap between two exposures it begins anew; nearer ones say nothing new, s.
_GAP_S, _NEXT_S = 0.5, 0.025


class Image(NamedTuple):
    """One image, and the arm's motion up to it.

    Parameters
    ----------
    stamp_s : float
        Exposure, s.
    position_m : ndarray, shape (3,)
        The ball as seen, m.
    moved_m : ndarray, shape (3,)
        What the joints have moved the ball by then, ``sum J dr``, from any origin, m.
    """

    stamp_s: float
    position_m: np.ndarray
    moved_m: np.ndarray


@dataclass(frozen=True)
class Unmoved:
    """A ball that should have moved, and did not.

    Parameters
    ----------
    predicted_m, seen_m : float
        Its way by the joints' motion, and as seen, m.
    time_s : float
        Within so long, s.
    """

    predicted_m: float
    seen_m: float
    time_s: float


class ImageWatch:
    """Compares the ways of the last images."""

    def __init__(self) -> None:
        self._images: deque[Image] = deque()
        self._unmoved: Unmoved | None = None  # judged once an image: ticks are more frequent

    def restart(self) -> None:
        """Begin anew: a start."""
        self._images.clear()
        self._unmoved = None

    def add(self, image: Image) -> None:
        """Tell the newest image; one that was told already changes nothing."""
        if self._images:
            passed_s = image.stamp_s - self._images[-1].stamp_s
            if 0.0 <= passed_s < _NEXT_S:
                return
            if not 0.0 < passed_s <= _GAP_S:
                self.restart()
        self._images.append(image)
        while len(self._images) > 1 and self._can_spare_the_oldest():
            self._images.popleft()
        self._unmoved = self._judged()

    def _can_spare_the_oldest(self) -> bool:
        second, newest = self._images[1], self._images[-1]
        if newest.stamp_s - self._images[0].stamp_s > _LONGEST_S:
            return True
        if newest.stamp_s - second.stamp_s < _LOOK_S:
            return False
        way = newest.moved_m - second.moved_m
        return float(way @ way) >= _LEAST_PREDICTED_M**2

    @property
    def unmoved(self) -> Unmoved | None:
        """The ball that does not follow; None while it does, or too little moves to say."""
        return self._unmoved

    def _judged(self) -> Unmoved | None:
        if len(self._images) < 2:
            return None
        time_s = self._images[-1].stamp_s - self._images[0].stamp_s
        if time_s < _LOOK_S:
            return None
        predicted_m = _way_m([image.moved_m for image in self._images])
        if predicted_m < _LEAST_PREDICTED_M:
            return None
        seen_m = _way_m([image.position_m for image in self._images])
        return Unmoved(predicted_m, seen_m, time_s) if seen_m < _LEAST_SHARE * predicted_m else None


def _way_m(places_m: list[np.ndarray]) -> float:
    """Length of the straight way, walked evenly, that is as widely spread as places, m.

    Noise hardly adds to it, and to and fro does not cancel.
    """
    places = np.array(places_m)
    places -= places.mean(axis=0)
    flat = places.ravel()
    return (12.0 * float(flat @ flat) / len(places)) ** 0.5
