"""A camera's picture, small, with target and image points drawn in."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

import cv2
import numpy as np

from fvs_ros.camera import Intrinsics

TARGET_RGB, MEASURED_RGB = (86, 180, 233), (60, 230, 60)
#: Widths of a picture in the panel, and in the place of the view.
PANEL_PX, VIEW_PX = 320, 640
#: No program runs for so long, s: simulated time, which begins at 0, is the stamp's or ours.
_OTHER_CLOCK_S = 1e8


def blank(width: int) -> np.ndarray:
    """What is shown before the first image."""
    return np.full((3 * width // 4, width, 3), 90, np.uint8)


class Picture:
    """The newest image as it is shown: at most ``width`` pixels wide."""

    def __init__(self, width: int = PANEL_PX) -> None:
        self._width = width
        #: Width and height of the images, px; 0 before the first.
        self.size_px = np.zeros(2)
        #: Of the images; without, no target in the camera's frame is drawn into them.
        self.intrinsics: Intrinsics | None = None
        self.published = False  #: whether a node publishes images
        #: Reason why there is no picture yet, in words.
        self.waits_for = ""
        self._image: np.ndarray | None = None
        self._exposed_s = inf
        self._shown: tuple[float, np.ndarray] = inf, np.zeros((0, 2))

    def add_image(self, exposed_s: float, image_rgb: np.ndarray) -> None:
        """Add a camera image, uint8, shape (height, width, 3), exposed then (steady clock)."""
        self._exposed_s, self._image = exposed_s, image_rgb
        self.size_px = np.array(image_rgb.shape[1::-1])

    def words(self, now_s: float, targets_px: np.ndarray) -> str:
        """Why there is no picture, or its age if it is old, and which target it does not show."""
        if self._exposed_s == inf:
            return self.waits_for
        age_s = now_s - self._exposed_s
        words = "the picture is of another clock: set use_sim_time as its camera has it"
        words = words if age_s > _OTHER_CLOCK_S else f"the picture is {age_s:.0f} s old"
        old = [words] * (age_s > 2.0)
        outside = np.any((targets_px < 0.0) | (targets_px >= self.size_px))  # false for NaN
        return "; ".join([*old, *["the target is outside the picture"] * bool(outside)])

    def pixels(self, target: np.ndarray | None) -> np.ndarray:
        """Where a target, x, y, z, m, ..., is in the image, px, (1, 2) or, unknown, (0, 2)."""
        if self.intrinsics is None or target is None:
            return np.zeros((0, 2))
        if target[2] <= 0.05:  # behind the camera, or at its plane
            return np.full((1, 2), -inf)
        return self.intrinsics.project(target[None, :3])

    def newest(self, targets_px: np.ndarray, measured_px: Sequence = ()) -> np.ndarray | None:
        """The picture, uint8, shape (height, width, 3), if it or a target changed since last.

        Crosses mark targets, (k, 2), and circles what is measured.
        """
        exposed_s, shown_px = self._shown
        same = exposed_s == self._exposed_s and np.array_equal(shown_px, targets_px, equal_nan=True)
        if self._image is None or same:
            return None
        self._shown = self._exposed_s, targets_px
        image = self._image.copy()
        scale = max(1.0, image.shape[1] / self._width)
        look = round(scale), cv2.LINE_AA
        for points_px, rgb in ((targets_px, TARGET_RGB), (measured_px, MEASURED_RGB)):
            for point in points_px:
                if np.abs(point).max() < 2 * image.shape[1]:  # false for NaN, too
                    at = np.round(point).astype(int).tolist()
                    if rgb is TARGET_RGB:
                        size = round(14 * scale)
                        cv2.drawMarker(image, at, rgb, cv2.MARKER_CROSS, size, *look)
                    else:
                        cv2.circle(image, at, round(5 * scale), rgb, *look)
        size_px = (round(image.shape[1] / scale), round(image.shape[0] / scale))
        return cv2.resize(image, size_px, interpolation=cv2.INTER_AREA)
