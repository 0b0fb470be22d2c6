"""Where in the image to look for the ball next."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil

import numpy as np

from fvs_detector_node.detection import BallDetection
from fvs_detector_node.region import Region
from fvs_ros.camera import Intrinsics

#: Half the window, ball radii (an outline far off the axis is a fifth longer) and pixels, beside
#: the way that the ball may have left its course. A ball that is cut off is searched for.
_RADII, _MARGIN_PX = 1.2, 3.0
#: A UR5 reaches 0.85 m: its drives, 15 rad/s^2, and its joints, together 2 rad/s, give these.
_ACCELERATION_M_S2, _SPEED_M_S = 12.0, 2.0


class WindowTracker:
    """Looks for the ball where it will be if it goes on as it went, else everywhere.

    Parameters
    ----------
    camera : Intrinsics
        The full image.
    radius_m : float
        Radius of the ball, m.
    """

    def __init__(self, camera: Intrinsics, radius_m: float) -> None:
        self._camera = camera
        self._radius_m = radius_m
        self._last: tuple[float, np.ndarray] | None = None
        self._velocity_m_s: np.ndarray | None = None

    def find(
        self,
        stamp_s: float,
        detect: Callable[[Region], BallDetection | None],
        elsewhere: Callable[[], Region | None],
    ) -> tuple[BallDetection | None, bool]:
        """Find the ball in an image.

        Parameters
        ----------
        stamp_s : float
            Exposure, s.
        detect : callable
            Finds the ball in a part of the image.
        elsewhere : callable
            Part of the image to search if the ball is not where it was expected; None for no part.

        Returns
        -------
        ball : BallDetection or None
            The ball.
        searched : bool
            Whether it was not where it was expected.
        """
        expected = self.region(stamp_s)
        ball = None if expected is None else detect(expected)
        if expected is not None and ball is not None:
            u, v = self._camera.project(ball.position_m)
            if not expected.cuts_off(u, v, ball.radius_px + 2.0, self._camera):
                return ball, False
        wider = elsewhere()
        return (ball if wider is None else detect(wider)), True

    def update(self, stamp_s: float, ball: BallDetection | None) -> None:
        """Take in what was seen at a time, s."""
        if ball is None:
            self._last = None
            return
        self._velocity_m_s = None
        if self._last is not None and stamp_s > self._last[0]:
            self._velocity_m_s = (ball.position_m - self._last[1]) / (stamp_s - self._last[0])
        self._last = (stamp_s, ball.position_m)

    def region(self, stamp_s: float) -> Region | None:
        """Where the ball is expected; None if it is lost."""
        if self._last is None:
            return None
        since_s, expected_m = stamp_s - self._last[0], self._last[1]
        if self._velocity_m_s is None:
            astray_m = _SPEED_M_S * since_s
        else:
            expected_m = expected_m + since_s * self._velocity_m_s
            astray_m = _ACCELERATION_M_S2 * since_s**2
        if expected_m[2] < 2.0 * self._radius_m:
            return None
        camera = self._camera
        u, v = camera.project(expected_m).tolist()
        half_m = _RADII * self._radius_m + astray_m
        half = half_m * camera.fx / expected_m[2] + _MARGIN_PX
        size = min(2 * ceil(half), camera.width, camera.height)
        u0 = min(max(round(u - size / 2), 0), camera.width - size)
        v0 = min(max(round(v - size / 2), 0), camera.height - size)
        return Region(u0, v0, size, size)
