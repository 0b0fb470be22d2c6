"""Clicks in the pictures of webcams: where the target is, or what the detectors follow."""

from __future__ import annotations

import numpy as np

from fvs_dashboard.board import Action
from fvs_ros import topics
from fvs_ros.kinds import Kind


def detector_of(camera: str) -> str:
    """The node that detects in the images of a camera."""
    return topics.of_camera(topics.DETECTOR_STATUS, camera).name.removesuffix("/status")


def shifted(z: np.ndarray | None, firsts_px: np.ndarray, kind: Kind) -> np.ndarray | None:
    """Image points, (m,), shifted so that in each camera the first is at u and v, (2 C,).

    None if there are others, and they are not seen.
    """
    firsts_px = firsts_px.reshape(-1, 1, 2)
    if z is None:
        return firsts_px.ravel() if firsts_px.size == kind.numbers else None
    points_px = z.reshape(len(firsts_px), -1, 2)
    return (points_px + (firsts_px - points_px[:, :1])).ravel()


class Clicks:
    """Collects clicks until they make an action."""

    def __init__(self, kind: Kind) -> None:
        self._kind = kind
        #: What is still to be clicked on, in words.
        self.words = ""
        #: By camera, px, where the target is to be, while others miss it.
        self.aimed: dict[int, np.ndarray] = {}
        self._marked: dict[int, list[float]] = {}

    def forget(self) -> None:
        """Begin anew."""
        self.words, self.aimed, self._marked = "", {}, {}

    def aim(self, camera: int, at_px: np.ndarray) -> Action | None:
        """Take the first point's target in a camera; the target once all cameras have theirs."""
        names = self._kind.cameras
        self.aimed[camera] = at_px
        missing = [name for i, name in enumerate(names) if i not in self.aimed]
        if missing:
            self.words = f"now click where it shall be in {' and '.join(missing)}"
            return None
        target = np.concatenate([self.aimed[i] for i in range(len(names))])
        self.forget()
        return Action("target", tuple(target.tolist()))

    def mark(self, camera: int, at_px: np.ndarray) -> Action | None:
        """Take the next point to follow in a camera; the detector's setting once all are there."""
        marked = self._marked.setdefault(camera, [])
        marked += at_px.tolist()
        count = self._kind.parts[camera].numbers
        if len(marked) < count:
            self.words = f"now click on point {len(marked) // 2 + 1} of {count // 2}"
            return None
        self.forget()
        return Action(f"{detector_of(self._kind.cameras[camera])}/track_px", tuple(marked))
