"""Which depth image belongs to which colour image, by their stamps."""

from __future__ import annotations

import math
from collections import deque
from typing import Any, NamedTuple


class Pair(NamedTuple):
    """A colour image with its exposure, s, and the depth image nearest to it, if there is one."""

    stamp_s: float
    colour: Any
    depth: Any


class _Stream:
    """The newest images of one topic that are not paired yet, oldest first."""

    def __init__(self) -> None:
        self.images: deque[tuple[float, Any]] = deque(maxlen=6)  # 0.2 s at 30 Hz
        self.newest_s = -math.inf
        self.repeats = self.behind = 0

    def add(self, stamp_s: float, image: Any) -> bool:
        """Take an image in; False if it is late or a repetition."""
        if stamp_s > self.newest_s:
            self.images.append((stamp_s, image))
            self.newest_s, self.repeats, self.behind = stamp_s, 0, 0
            return True
        self.repeats += 1
        # Streams deliver out of order by less than half a second.
        self.behind = self.behind + 1 if stamp_s < self.newest_s - 0.5 else 0
        return False


class Pairing:
    """Pairs two streams; the newest wins, and no colour image is paired after a later one.

    Stamps may repeat, arrive out of order, freeze or jump; a single wrong stamp has no effect.
    ``tolerance_s`` is the largest difference of the two stamps. If depth is not needed, no colour
    image waits for it.
    """

    def __init__(self, tolerance_s: float, needs_depth: bool = True) -> None:
        self._tolerance_s, self._needs_depth = tolerance_s, needs_depth
        #: How often the clock was set back; earlier pairs have another time base.
        self.restarts = -1
        self._restart()

    def _restart(self) -> None:
        self.restarts += 1
        self._colour, self._depth = _Stream(), _Stream()
        #: Stamp of depth minus colour for the closest images in the last comparison.
        self.offset_s: float | None = None

    @property
    def repeats(self) -> int:
        """How many images in a row, of colour or of depth, had a stamp that did not advance."""
        return max(self._colour.repeats, self._depth.repeats)

    def add(self, kind: str, stamp_s: float, image: Any) -> Pair | None:
        """Take in an image of ``colour`` or ``depth`` with its exposure, s; the pair, if any."""
        # Three consecutive old stamps mean that the clock was set back.
        if max(self._colour.behind, self._depth.behind) >= 3:
            self._restart()
        stream = self._colour if kind == "colour" else self._depth
        if not stream.add(stamp_s, image):
            return None
        if self._needs_depth:
            return self._pair()
        return self._alone(stamp_s, image) if kind == "colour" else None

    def _alone(self, colour_s: float, colour: Any) -> Pair:
        """A colour image with the newest depth image, if that is near enough."""
        depth = None
        if self._depth.images and abs(self._depth.newest_s - colour_s) <= self._tolerance_s:
            depth = self._depth.images[-1][1]
        return Pair(colour_s, colour, depth)

    def _pair(self) -> Pair | None:
        """The newest colour image that has its depth image."""
        colours, depths = self._colour.images, self._depth.images
        for colour_s, colour in reversed(colours):
            if not depths:
                return None
            depth_s, depth = min(depths, key=lambda one: abs(one[0] - colour_s))
            self.offset_s = depth_s - colour_s
            if abs(self.offset_s) <= self._tolerance_s:
                for waiting, stamp_s in ((colours, colour_s), (depths, depth_s)):
                    while waiting and waiting[0][0] <= stamp_s:
                        waiting.popleft()
                return Pair(colour_s, colour, depth)
        return None
