"""The camera's picture, small, with ball and target drawn in."""

from __future__ import annotations

from collections import deque
from math import atan, inf

import cv2
import numpy as np

from fvs_ros.camera import Intrinsics

BALL_RGB, TARGET_RGB = (255, 214, 0), (86, 180, 233)
_WIDTH_PX = 320
BLANK = np.full((240, _WIDTH_PX, 3), 90, np.uint8)
#: Least depth of points that are drawn, m.
_NEAREST_M = 0.05
_CROSS_PX = 14
#: Number of stored ball positions, because images arrive late, and largest difference of stamps
#: between a ball position and its image, s.
_MEMORY, _SAME_IMAGE_S = 600, 0.02
#: Age above which a picture shows its age, s.
_OLD_S = 2.0


class Picture:
    """The newest image as it is shown."""

    def __init__(self, ball_radius_m: float) -> None:
        #: Of the images; without, nothing is drawn into them.
        self.intrinsics: Intrinsics | None = None
        #: Reason why there is no picture yet, in words.
        self.waits_for = ""
        self._ball_radius_m = ball_radius_m
        self._seen: deque[tuple[float, np.ndarray]] = deque(maxlen=_MEMORY)
        self._new: tuple[float, float, np.ndarray] | None = None
        self._exposed_s = inf

    def add_feature(self, stamp_s: float, position_m: np.ndarray) -> None:
        """Add a feature's position, camera frame, m, shape (3,), and its exposure's stamp."""
        self._seen.append((stamp_s, position_m))

    def add_image(self, exposed_s: float, stamp_s: float, image_rgb: np.ndarray) -> None:
        """Add a camera image, uint8, shape (height, width, 3), exposed then (steady clock)."""
        self._new = exposed_s, stamp_s, image_rgb

    @property
    def field_of_view(self) -> tuple[float, float]:
        """The camera's vertical field of view, rad, and its image's width over height."""
        camera = self.intrinsics
        if camera is None:
            return 0.743, 4.0 / 3.0  # a RealSense's, until the camera's own is known
        return 2.0 * atan(0.5 * camera.height / camera.fy), camera.width / camera.height

    def words(self, now_s: float) -> str:
        """The age of an old picture, or why there is none; empty for a new one."""
        if self._exposed_s == inf:
            return self.waits_for
        age_s = now_s - self._exposed_s
        return f"the picture is {age_s:.0f} s old" if age_s > _OLD_S else ""

    def newest(self, target_m: np.ndarray | None) -> np.ndarray | None:
        """The picture, uint8, shape (height, width, 3), if it changed since the last call.

        A circle marks the ball found in this very image, a cross the target (camera frame, m).
        """
        new, self._new = self._new, None
        if new is None:
            return None
        self._exposed_s, stamp_s, image = new
        ball_m = min(self._seen, key=lambda one: abs(one[0] - stamp_s), default=(inf, None))
        found = abs(ball_m[0] - stamp_s) <= _SAME_IMAGE_S
        return self._draw(image, ball_m[1] if found else None, target_m)

    def _draw(
        self, image: np.ndarray, ball_m: np.ndarray | None, target_m: np.ndarray | None
    ) -> np.ndarray:
        """Draw ball and target at full size, then scale down."""
        image = image.copy()
        scale = max(1.0, image.shape[1] / _WIDTH_PX)
        look = round(scale), cv2.LINE_AA
        at = self._pixel(target_m)
        if at is not None:
            size = round(_CROSS_PX * scale)
            cv2.drawMarker(image, at, TARGET_RGB, cv2.MARKER_CROSS, size, *look)
        at = self._pixel(ball_m)
        if at is not None and self.intrinsics is not None and ball_m is not None:
            radius = round(self.intrinsics.fx * self._ball_radius_m / ball_m[2])
            cv2.circle(image, at, radius, BALL_RGB, *look)
        size = (round(image.shape[1] / scale), round(image.shape[0] / scale))
        return cv2.resize(image, size, interpolation=cv2.INTER_AREA)

    def _pixel(self, point_m: np.ndarray | None) -> tuple[int, int] | None:
        """Where a point is in the image; None if it is not near it."""
        camera = self.intrinsics
        if camera is None or point_m is None or point_m[2] < _NEAREST_M:
            return None
        u, v = np.round(camera.project(point_m)).astype(int).tolist()
        return (u, v) if max(abs(u), abs(v)) < 2 * camera.width else None
