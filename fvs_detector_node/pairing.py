"""Which depth image belongs to which colour image, by their stamps."""

from __future__ import annotations

import math
from collections import Counter, deque
from typing import Any, NamedTuple


class Pair(NamedTuple):
    """A colour image with its exposure, s, and its depth image, if one is needed."""

    stamp_s: float
    colour: Any
    depth: Any


class Pairing:
    """Pairs each colour image with the nearest depth image, and none after a later one.

    Stamps may repeat, arrive out of order, freeze or jump; a single wrong stamp has no effect.
    ``tolerance_s`` is the largest difference of the two stamps. If depth is not needed, a colour
    image alone is a pair.
    """

    def __init__(self, tolerance_s: float, needs_depth: bool = True) -> None:
        self._tolerance_s, self._needs_depth = tolerance_s, needs_depth
        self._restart()

    def _restart(self) -> None:
        # Not paired yet, oldest first: 0.2 s at 30 Hz.
        self._waiting: dict[str, deque[tuple[float, Any]]] = {
            name: deque(maxlen=6) for name in ("colour", "depth")
        }
        self._newest_s = dict.fromkeys(self._waiting, -math.inf)
        self._next_depth_s = math.inf  # when the next one is due
        self._repeats = Counter[str]()
        #: Stamp of depth minus colour for the closest images in the last comparison.
        self.offset_s: float | None = None

    @property
    def repeats(self) -> int:
        """How many images in a row, of colour or of depth, had a stamp that did not advance."""
        return max(self._repeats.values(), default=0)

    def add(self, name: str, stamp_s: float, image: Any) -> Pair | None:
        """Take in an image of ``colour`` or ``depth`` with its exposure, s; the pair, if any."""
        newest_s = self._newest_s[name]
        if stamp_s <= newest_s:
            self._repeats[name] += 1
            # Streams deliver out of order by less than half a second. The third stamp in a row
            # that is older means that the clock was set back.
            if self._repeats[name] < 3 or stamp_s >= newest_s - 0.5:
                return None
            self._restart()
        self._repeats[name] = 0
        self._newest_s[name] = stamp_s
        if name == "depth":
            self._next_depth_s = 2.0 * stamp_s - newest_s
        self._waiting[name].append((stamp_s, image))
        return self._pair()

    def _pair(self) -> Pair | None:
        """The newest colour image whose nearest depth image is here."""
        colours, depths = self._waiting["colour"], self._waiting["depth"]
        for colour_s, colour in reversed(colours):
            if not self._needs_depth:
                colours.clear()
                return Pair(colour_s, colour, None)
            if not depths:
                return None
            depth_s, depth = min(depths, key=lambda image: abs(image[0] - colour_s))
            self.offset_s = depth_s - colour_s
            due = abs(self._next_depth_s - colour_s) < abs(self.offset_s)
            if abs(self.offset_s) <= self._tolerance_s and not due:
                for waiting, stamp_s in ((colours, colour_s), (depths, depth_s)):
                    while waiting and waiting[0][0] <= stamp_s:
                        waiting.popleft()
                return Pair(colour_s, colour, depth)
        return None
