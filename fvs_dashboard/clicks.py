"""Clicks in the pictures of webcams: where the target is, or what the detector follows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fvs_dashboard.board import Action
from fvs_ros import topics
from fvs_ros.kinds import Kind

#: The detector's parameter with the points that it follows.
TRACK = f"{topics.DETECTOR}/track_px"


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
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        #: What is still to be clicked on, in words.
        self.words = ""
        #: By camera, px: where the target is to be, while others miss it; and points to track.
        self.aimed: dict[int, list[float]] = {}
        self._marked: dict[int, list[float]] = {}

    def take(self, camera: int, at_px: Sequence[float], track: bool) -> Action | None:
        """Take a click in a camera's picture; a target, or points to track, once all are there.

        The points to track in the other cameras stay where they were clicked last.
        """
        count = self._kind.parts[camera].numbers if track else 2
        clicked = self._marked if track else self.aimed
        before = clicked.get(camera, [])
        clicked[camera] = [*(before if len(before) < count else []), *at_px]
        for i, name in enumerate(self._kind.cameras):
            done = len(clicked.get(i, []))
            if done < count:
                what = f"on point {done // 2 + 1}" if track else "where it shall be"
                self.words = f"now click {what}" + f" in {name}" * bool(name)
                return None
        numbers = tuple(number for i in sorted(clicked) for number in clicked[i])
        self.words, self.aimed = "", {}
        return Action(TRACK if track else "target", numbers)
