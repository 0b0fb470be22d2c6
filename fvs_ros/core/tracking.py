"""Where in the image to look for the ball next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fvs_ros.core.camera import Intrinsics
from fvs_ros.core.detection import BallDetection


@dataclass(frozen=True)
class Region:
    """A part of the image: first pixel (u0, v0) and size, pixels."""

    u0: int
    v0: int
    width: int
    height: int


class WindowTracker:
    """Chooses the part of the image to look at: where the ball will be, going on as it went.

    Parameters
    ----------
    intrinsics : Intrinsics
        The full image.
    radius_m : float
        Radius of the ball, m.
    """

    #: The window's half width is this many ball radii, and this many pixels at 640 across.
    _RADII, _MARGIN = 1.4, 22.0

    def __init__(self, intrinsics: Intrinsics, radius_m: float) -> None:
        self._camera = intrinsics
        self._radius_m = radius_m
        self._last: tuple[float, np.ndarray] | None = None
        self._velocity_m_s = np.zeros(3)

    def update(self, stamp_s: float, detection: BallDetection | None) -> None:
        """Take in what was seen at a time, s."""
        if detection is None:
            self._last = None
            return
        self._velocity_m_s = np.zeros(3)
        if self._last is not None and stamp_s > self._last[0]:
            self._velocity_m_s = (detection.position_m - self._last[1]) / (stamp_s - self._last[0])
        self._last = (stamp_s, detection.position_m)

    def region(self, stamp_s: float) -> Region | None:
        """Choose the part to look at; None if the ball is lost."""
        if self._last is None:
            return None
        expected = self._last[1] + (stamp_s - self._last[0]) * self._velocity_m_s
        if expected[2] < 2.0 * self._radius_m:
            return None
        camera = self._camera
        u, v = camera.project(expected)
        ball_px = self._radius_m * camera.fx / expected[2]
        half = self._RADII * ball_px + self._MARGIN * camera.width / 640.0
        size = min(8 * int(np.ceil(half / 4.0)), camera.width, camera.height)
        u0 = int(np.clip(round(u - size / 2), 0, camera.width - size))
        v0 = int(np.clip(round(v - size / 2), 0, camera.height - size))
        return Region(u0, v0, size, size)
