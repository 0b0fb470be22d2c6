"""A target relative to an object that is seen as well: where it is now, and how it is taught.

Every image of the object sets the target anew. The goal follows it like any target that is updated
often: at rest the noise of the object averages out, and its motion is fed forward.

The relation is that of the true lens, where its error is known: its stretch changes with the view.
"""

from __future__ import annotations

from collections import deque
from contextlib import suppress

import numpy as np

from fvs_controller_node.goal import Goal
from fvs_ros.filter import GATE_M, OUTLIER
from fvs_ros.kinds import Kind
from fvs_ros.vectors import largest, length

#: ``frame_id`` of a relative target.
OBJECT_FRAME = "object"
#: Corrections of a measurement by the lens; each leaves the lens' error as a share of the last.
_CORRECTIONS = 4
#: A tool that goes this far, m, while its error stays has the object in its grip.
_RIDE_M = 0.1
#: Standard deviation of white noise over its median distance from the median.
_MAD = 1.4826
#: Teaching averages over this time, s, and over as many images at least.
_TEACH_S, _TEACH_IMAGES = 1.0, 5


class Lens:
    """Turns what is measured through a wrong lens, (m,), into the true, and back."""

    def __init__(self, kind: Kind) -> None:
        self._kind = kind
        self.error = np.zeros(2)  #: as in :class:`~fvs_ros.chain.SerialChain`

    def true(self, z: np.ndarray) -> np.ndarray:
        """What the true lens would show."""
        if not self.error.any():
            return z
        return self._kind.nearest(self._kind.without_lens(z[None], *self.error)[0])

    def measured(self, true: np.ndarray) -> np.ndarray:
        """What is measured: the inverse."""
        z = true
        for _ in range(_CORRECTIONS if self.error.any() else 0):
            z = self._kind.retract(z, self._kind.minus(true, self.true(z)))
        return z


class Relation:
    """Finds the target from the newest image of the object.

    ``kind`` is that of tool and object, m numbers; ``goal`` knows where the target is expected.
    """

    def __init__(self, kind: Kind, goal: Goal, lens: Lens) -> None:
        self._kind, self._goal, self._lens = kind, goal, lens
        self.wanted: np.ndarray | None = None  #: the target from the object, (m,), if relative
        #: How far the object was from its last place when it was seen again, m.
        self.moved_m = 0.0
        self._object: np.ndarray | None = None  # as seen last
        self._hidden = False  # before the images that do not count yet
        self._off_m: np.ndarray | None = None  # of an outlier
        self.lead: tuple[np.ndarray, float] | None = None  # the tool then, and its error, m

    def rides(self, z: np.ndarray, error_m: np.ndarray, least_m: float) -> bool:
        """Whether the tool goes on at z, (m,), and its error, m, (d,), stays: a gripped object.

        Errors below ``least_m`` are those of a tool that follows.
        """
        off_m = length(error_m)
        stays = self.lead is not None and 0.9 < off_m / max(self.lead[1], 1e-9) < 1.5
        if not stays or off_m < least_m:
            self.lead = z, off_m
        assert self.lead is not None
        return length(self._kind.minus(z, self.lead[0])) > _RIDE_M

    def add_image(self, z: np.ndarray, there_s: float, was_hidden: bool) -> np.ndarray | None:
        """Take an image of the object, (m,), and its exposure on the joint states' clock, s.

        ``was_hidden`` says that it came late. Returns the target, (m,). It is None for an absolute
        one, and for an outlier: an image that is off what was expected, and that the one before it
        does not confirm.
        """
        self.moved_m = 0.0
        self._hidden |= was_hidden
        if self.wanted is not None:
            target = self._target(self.wanted, z)
            before, self._off_m = self._off_m, self._goal.off_m(target, there_s)
            if self._off_m is not None:
                off_m = length(self._off_m)
                if before is None or length(self._off_m - before) > 0.5 * off_m:
                    return None
                if self._hidden:
                    self.moved_m = off_m
                self._off_m = None
        self._object, self._hidden = z, False
        return self.target(self.wanted)

    def target(self, wanted: np.ndarray | None) -> np.ndarray | None:
        """Where something in the object's frame, (m,), is in the camera's; None if unknown."""
        if wanted is None or self._object is None:
            return None
        return self._target(wanted, self._object)

    def _target(self, wanted: np.ndarray, object_z: np.ndarray) -> np.ndarray:
        return self._lens.measured(self._kind.absolute(wanted, self._lens.true(object_z)))


class Teacher:
    """Averages tool and object over the last second in which each was seen.

    ``tool`` is what each camera shows of the tool.
    """

    def __init__(self, kind: Kind, lens: Lens, tool: list[LastSecond]) -> None:
        self._kind, self._lens = kind, lens
        self._tool, self.object = tool, LastSecond(kind)

    def teach(self, relative: bool) -> tuple[np.ndarray, float]:
        """Where the tool is, (m,), in the object's frame or the camera's, and its deviation, m.

        A ``ValueError`` says why that is not known well.
        """
        means = [seen.mean(seen.kind.feature.name) for seen in self._tool]
        z, deviation_m = np.concatenate([z for z, _ in means]), max(m for _, m in means)
        if self._kind.on_arm:
            return self._kind.inverse(self._lens.true(z)), deviation_m
        if not relative:
            return z, deviation_m
        object_z, object_m = self.object.mean(self._kind.topics.object.name)
        z = self._kind.relative(self._lens.true(z), self._lens.true(object_z))
        return z, float(np.hypot(deviation_m, object_m))


class LastSecond:
    """The images of the last second of tool or object."""

    def __init__(self, kind: Kind) -> None:
        self.kind = kind
        self._images = deque[tuple[float, np.ndarray]](maxlen=256)

    def add(self, stamp_s: float, z: np.ndarray) -> None:
        """Take an image, (m,), and its exposure, s."""
        if self._images and stamp_s < self._images[-1][0]:
            self._images.clear()  # another clock
        self._images.append((stamp_s, z))
        while self._images[0][0] < stamp_s - _TEACH_S:
            self._images.popleft()

    @property
    def rests(self) -> bool:
        """Whether it was at rest when it was seen last."""
        with suppress(ValueError):
            z, deviation_m = self.mean("")
            off_m = largest(self.kind.minus(self._images[-1][1], z))
            return off_m <= OUTLIER * deviation_m * len(self._images) ** 0.5 + GATE_M
        return False

    def mean(self, name: str) -> tuple[np.ndarray, float]:
        """The mean, (m,), and its standard deviation in each coordinate, m."""
        if len(self._images) < _TEACH_IMAGES:
            count = len(self._images)
            raise ValueError(
                f"{count} images of {name} in the last second, expected {_TEACH_IMAGES}"
            )
        images = [z for _, z in self._images]
        steps_m = np.array([self.kind.minus(z, images[-1]) for z in images])
        # Without a few outliers: further from the median than noise in any coordinate.
        off_m = np.abs(steps_m - np.median(steps_m, axis=0))
        near = np.all(off_m <= OUTLIER * _MAD * np.median(off_m, axis=0) + GATE_M, axis=1)
        if np.mean(near) > 0.9:
            steps_m = steps_m[near]
        count = len(steps_m)
        # Second differences are blind to a drift, which must not count as noise.
        noise_m2 = np.mean(np.diff(steps_m, 2, axis=0) ** 2) / 6.0
        first_m, second_m = steps_m[: count // 2].mean(axis=0), steps_m[count // 2 :].mean(axis=0)
        drift_m = float(np.sqrt(np.mean((second_m - first_m) ** 2)))
        if drift_m > OUTLIER * np.sqrt(4.0 * noise_m2 / count) + 1e-9:
            moved = self.kind.length_text(2.0 * drift_m, 1)
            raise ValueError(f"{name} moved by {moved} in the last second")
        mean = self.kind.retract(images[-1], steps_m.mean(axis=0))
        return mean, float(np.sqrt(noise_m2 / count))
