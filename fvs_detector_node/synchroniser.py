"""Which depth image belongs to which colour image, by their stamps."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar

C = TypeVar("C")
D = TypeVar("D")
T = TypeVar("T")

#: Images kept of a stream that wait for their partner.
_KEPT = 6
#: So many images in a row from further back than this are a clock that was set back.
_JUMP_S, _JUMP_IMAGES = 0.5, 3


@dataclass(frozen=True)
class Pair(Generic[C, D]):
    """A colour image and the depth image nearest to it.

    Parameters
    ----------
    stamp_s, depth_stamp_s : float
        Their exposures, s.
    colour, depth
        What was given with the stamps.
    """

    stamp_s: float
    colour: C
    depth_stamp_s: float
    depth: D


class _Stream(Generic[T]):
    """The newest images of one topic that are not paired yet, oldest first."""

    def __init__(self) -> None:
        self.repeats = 0
        self.clear()

    def clear(self) -> None:
        self.images: deque[tuple[float, T]] = deque(maxlen=_KEPT)
        self.newest_s: float | None = None
        self.period_s = 0.0
        self._behind: list[float] = []

    def add(self, stamp_s: float, image: T) -> bool:
        """Take an image in; False if it is late or a repetition."""
        newest_s = self.newest_s
        if newest_s is None or stamp_s > newest_s:
            self.period_s = 0.0 if newest_s is None else stamp_s - newest_s
            self.newest_s = stamp_s
            self.images.append((stamp_s, image))
            self._behind.clear()
            self.repeats = 0
            return True
        self.repeats += 1
        if stamp_s >= newest_s - _JUMP_S or (self._behind and stamp_s < self._behind[-1]):
            self._behind.clear()
        if stamp_s < newest_s - _JUMP_S and stamp_s not in self._behind:
            self._behind.append(stamp_s)
        return False

    @property
    def jumped_back(self) -> bool:
        """Whether the newest images go on advancing from a time well before the others."""
        return len(self._behind) >= _JUMP_IMAGES

    def drop_until(self, stamp_s: float) -> None:
        while self.images and self.images[0][0] <= stamp_s:
            self.images.popleft()


class Synchroniser(Generic[C, D]):
    """Pairs two streams; the newest wins, and no colour image is paired after a later one.

    Stamps may repeat, come out of order, stand still or jump; a single wrong stamp does no harm.

    Parameters
    ----------
    tolerance_s : float
        Largest difference of the two stamps, s.

    Attributes
    ----------
    restarts : int
        How often the clock was set back: what was paired before then is of another time.
    offset_s : float or None
        Depth's stamp less colour's, of the nearest that were compared last, s.
    """

    def __init__(self, tolerance_s: float) -> None:
        self.tolerance_s = tolerance_s
        self.restarts = 0
        self._colour: _Stream[C] = _Stream()
        self._depth: _Stream[D] = _Stream()
        self._restart()

    def _restart(self) -> None:
        self._colour.clear()
        self._depth.clear()
        self.offset_s: float | None = None

    @property
    def repeats(self) -> int:
        """How many images in a row, of colour or of depth, had a stamp that did not advance."""
        return max(self._colour.repeats, self._depth.repeats)

    def add_colour(self, stamp_s: float, image: C) -> Pair[C, D] | None:
        """Take a colour image in, with its exposure, s; the pair that it completes, if any."""
        return self._pair() if self._take(self._colour, stamp_s, image) else None

    def add_depth(self, stamp_s: float, image: D) -> Pair[C, D] | None:
        """Take a depth image in, with its exposure, s; the pair that it completes, if any."""
        return self._pair() if self._take(self._depth, stamp_s, image) else None

    def _take(self, stream: _Stream[T], stamp_s: float, image: T) -> bool:
        if stream.add(stamp_s, image):
            return True
        if not stream.jumped_back:
            return False
        self.restarts += 1
        self._restart()
        return stream.add(stamp_s, image)

    def _pair(self) -> Pair[C, D] | None:
        """The newest colour image that has its depth image."""
        for colour_s, colour in reversed(self._colour.images):
            near = min(self._depth.images, key=lambda d: abs(d[0] - colour_s), default=None)
            if near is None:
                return None
            depth_s, depth = near
            self.offset_s = depth_s - colour_s
            if abs(self.offset_s) > self.tolerance_s or self._nearer_may_come(colour_s, depth_s):
                continue
            self._colour.drop_until(colour_s)
            self._depth.drop_until(depth_s)
            return Pair(colour_s, colour, depth_s, depth)
        return None

    def _nearer_may_come(self, colour_s: float, depth_s: float) -> bool:
        """Whether the depth image after the newest may be the nearer one."""
        is_newest = depth_s == self._depth.newest_s
        return is_newest and 2.0 * (colour_s - depth_s) > self._depth.period_s > 0.0
