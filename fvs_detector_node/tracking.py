"""Tracking: the image window for the next search, and the gate for positions."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil

import numpy as np

from fvs_detector_node.detection import BallDetection
from fvs_detector_node.images import Region
from fvs_ros.camera import Intrinsics

#: Half window size, in ball radii (an outline far off the axis is a fifth longer) and pixels; the
#: possible deviation from the predicted path is added. A ball that is cut off starts a full search.
_RADII, _MARGIN_PX = 1.2, 3.0
#: Largest acceleration and speed of a UR5's ball, from its reach of 0.85 m, its drives' 15 rad/s^2,
#: and 2 rad/s of all joints together.
_ACCELERATION_M_S2, _SPEED_M_S = 12.0, 2.0
#: Number of consecutive consistent sightings that confirm a jump, and noise of two positions, m.
_REPEATS, _NOISE_M = 3, 0.01


class WindowTracker:
    """Looks for the ball where constant velocity predicts it, else everywhere.

    ``camera`` is of the full image.
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
    ) -> BallDetection | None:
        """Find the ball in an image, exposed at a stamp.

        ``detect`` searches a part of the image. ``elsewhere`` gives the part to search, if any,
        when the ball is not in the expected one.
        """
        expected = self.region(stamp_s)
        ball = None if expected is None else detect(expected)
        if expected is not None and ball is not None:
            u, v = self._camera.project(ball.position_m)
            if not expected.cuts_off(u, v, ball.radius_px, self._camera):
                return ball
        wider = elsewhere()
        return ball if wider is None else detect(wider)

    def update(self, stamp_s: float, ball: BallDetection | None) -> None:
        """Take the detection at a time, s; None if there is none."""
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


class Gate:
    """Refuses jumps without enough consecutive sightings.

    The controller rejects one wrong position but follows two that agree, and a false detection
    often occurs twice.
    """

    def __init__(self, max_speed_m_s: float) -> None:
        self.max_speed_m_s = max_speed_m_s
        self.refused = 0  # positions
        self.reset()

    def reset(self) -> None:
        """Forget all positions: the next one is accepted."""
        self._accepted: tuple[float, np.ndarray] | None = None
        self._jump: tuple[float, np.ndarray] | None = None
        self._jumps = 0

    def check(self, stamp_s: float, position_m: np.ndarray) -> str:
        """Why a position, camera frame, m, (3,), is refused; empty if it is accepted."""
        if self._accepted is not None and not self._near(self._accepted, stamp_s, position_m):
            again = self._jump is not None and self._near(self._jump, stamp_s, position_m)
            self._jump, self._jumps = (stamp_s, position_m), self._jumps + 1 if again else 1
            if self._jumps < _REPEATS:
                self.refused += 1
                last_s, last_m = self._accepted
                return (
                    f"jump of {np.linalg.norm(position_m - last_m):.2f} m in "
                    f"{stamp_s - last_s:.3f} s refused, seen {self._jumps} of {_REPEATS} times; "
                    f"raise max_ball_speed_m_s ({self.max_speed_m_s:g})?"
                )
        self._accepted, self._jump = (stamp_s, position_m), None
        return ""

    def _near(self, last: tuple[float, np.ndarray], stamp_s: float, now_m: np.ndarray) -> bool:
        allowed_m = self.max_speed_m_s * max(stamp_s - last[0], 0.0) + _NOISE_M
        return bool(np.linalg.norm(now_m - last[1]) <= allowed_m)
