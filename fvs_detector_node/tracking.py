"""Where in the image to look for the ball next."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np

from fvs_detector_node.detection import BallDetection
from fvs_ros.camera import Intrinsics


@dataclass(frozen=True)
class Region:
    """A part of the image: first pixel (u0, v0) and size, pixels."""

    u0: int
    v0: int
    width: int
    height: int

    def cuts_off(self, detection: BallDetection, camera: Intrinsics) -> bool:
        """Whether this part's border, but not the image's, cuts a ball off."""
        u, v = detection.pixel
        reach = detection.radius_px + 2.0
        return (
            (u - reach < self.u0 and self.u0 > 0)
            or (v - reach < self.v0 and self.v0 > 0)
            or (u + reach > self.u0 + self.width < camera.width)
            or (v + reach > self.v0 + self.height < camera.height)
        )


class WindowTracker:
    """Chooses the part of the image to look at: where the ball will be, going on as it went.

    Parameters
    ----------
    intrinsics : Intrinsics
        The full image.
    radius_m : float
        Radius of the ball, m.
    """

    #: Half the window is what the detection looks at, ball radii (an outline far off the axis is a
    #: fifth longer) and pixels, and the way that the ball may have gone astray. Whoever cuts the
    #: ball off all the same searches the image.
    _RADII, _MARGIN_PX = 1.2, 3.0
    #: A UR5 reaches 0.85 m: its drives, 15 rad/s^2, and its joints, together 2 rad/s, so much.
    _ACCELERATION_M_S2, _SPEED_M_S = 12.0, 2.0

    def __init__(self, intrinsics: Intrinsics, radius_m: float) -> None:
        self._camera = intrinsics
        self._radius_m = radius_m
        self._last: tuple[float, np.ndarray] | None = None
        self._velocity_m_s: np.ndarray | None = None

    def update(self, stamp_s: float, detection: BallDetection | None) -> None:
        """Take in what was seen at a time, s."""
        if detection is None:
            self._last = None
            return
        self._velocity_m_s = None
        if self._last is not None and stamp_s > self._last[0]:
            self._velocity_m_s = (detection.position_m - self._last[1]) / (stamp_s - self._last[0])
        self._last = (stamp_s, detection.position_m)

    def region(self, stamp_s: float) -> Region | None:
        """Choose the part to look at; None if the ball is lost."""
        if self._last is None:
            return None
        since_s, expected = stamp_s - self._last[0], self._last[1]
        if self._velocity_m_s is None:
            astray_m = self._SPEED_M_S * since_s
        else:
            expected = expected + since_s * self._velocity_m_s
            astray_m = self._ACCELERATION_M_S2 * since_s**2
        if expected[2] < 2.0 * self._radius_m:
            return None
        camera = self._camera
        u, v = camera.project(expected).tolist()
        half_m = self._RADII * self._radius_m + astray_m
        half = half_m * camera.fx / expected[2] + self._MARGIN_PX
        size = min(2 * ceil(half), camera.width, camera.height)
        u0 = min(max(round(u - size / 2), 0), camera.width - size)
        v0 = min(max(round(v - size / 2), 0), camera.height - size)
        return Region(u0, v0, size, size)
