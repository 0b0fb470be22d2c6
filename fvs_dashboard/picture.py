"""The camera's picture, small, with the target drawn in."""

from __future__ import annotations

from math import inf

import cv2
import numpy as np

from fvs_ros.camera import Intrinsics

TARGET_RGB = (86, 180, 233)
#: Before the first image; others are shown in its width.
BLANK = np.full((240, 320, 3), 90, np.uint8)


class Picture:
    """The newest image as it is shown."""

    def __init__(self) -> None:
        #: Of the images; without, nothing is drawn into them.
        self.intrinsics: Intrinsics | None = None
        #: Reason why there is no picture yet, in words.
        self.waits_for = ""
        self._new: tuple[float, np.ndarray] | None = None
        self._exposed_s = inf

    def add_image(self, exposed_s: float, image_rgb: np.ndarray) -> None:
        """Add a camera image, uint8, shape (height, width, 3), exposed then (steady clock)."""
        self._new = exposed_s, image_rgb

    def words(self, now_s: float) -> str:
        """The age of an old picture, or why there is none; empty for a new one."""
        if self._exposed_s == inf:
            return self.waits_for
        age_s = now_s - self._exposed_s
        return f"the picture is {age_s:.0f} s old" if age_s > 2.0 else ""

    def newest(self, target_m: np.ndarray | None) -> np.ndarray | None:
        """The picture, uint8, shape (height, width, 3), if it changed since the last call.

        A cross marks the target, camera frame, m.
        """
        new, self._new = self._new, None
        if new is None:
            return None
        self._exposed_s, image = new
        scale = max(1.0, image.shape[1] / BLANK.shape[1])
        camera = self.intrinsics
        # A point behind the camera, or at its plane, has no pixel.
        if camera is not None and target_m is not None and target_m[2] > 0.05:
            at = np.round(camera.project(target_m)).astype(int)
            if np.abs(at).max() < 2 * camera.width:
                image, size = image.copy(), round(14 * scale)
                look = round(scale), cv2.LINE_AA
                cv2.drawMarker(image, at.tolist(), TARGET_RGB, cv2.MARKER_CROSS, size, *look)
        size_px = (round(image.shape[1] / scale), round(image.shape[0] / scale))
        return cv2.resize(image, size_px, interpolation=cv2.INTER_AREA)
