"""Image points, px, in the images of any camera: a ball's centre, or the corners of tags."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from fvs_detector_node.ball_detector import blobs, colour_mask
from fvs_detector_node.detector import Detector, Sighting
from fvs_detector_node.images import Region
from fvs_detector_node.sphere import ACCEPT, fit_circle
from fvs_detector_node.tag_pose import TagDetector
from fvs_ros.camera import Intrinsics


@dataclass(frozen=True)
class PointsDetection:
    """Points that were seen, in the pixels of the whole image, (K, 2)."""

    px: np.ndarray
    radius_px: float = 0.0  # of what is about each

    visible_fraction = 1.0

    def box(self, camera: Intrinsics) -> Region:
        """The part of a camera's image that shows them."""
        px = camera.project(np.insert(self.px, 2, 1.0, axis=1))
        return Region.around(np.concatenate([px - self.radius_px, px + self.radius_px]))

    def draw(self, picture: np.ndarray, camera: Intrinsics, style: dict[str, Any]) -> str:
        """Draw a circle about each; returns the first in words."""
        for middle in np.round(16.0 * self.px).astype(int).tolist():
            cv2.circle(picture, middle, round(16 * max(self.radius_px, 3.0)), **style)
        return "u {:.1f} v {:.1f} px".format(*self.px[0])


class CentreDetector(Detector):
    """Detects the centre of the ball's outline: of the largest one that is a circle."""

    needs_calibration = False

    def detect_in(
        self, stamp_s: float, rgb: np.ndarray, depth_m: np.ndarray | None, camera: Intrinsics
    ) -> Sighting:
        """Detect the ball's centre in an image or a part of it."""
        coloured = blobs(colour_mask(rgb, self._config.colour))
        for blob in coloured:
            outline, last_px = blob.outline, np.array(rgb.shape[1::-1]) - 1
            inside = outline[np.all((outline > 0) & (outline < last_px), axis=1)]
            circle = fit_circle(inside, ACCEPT.circle_px)
            # The image's edge must not cut off much.
            if circle is not None and circle[2] * len(inside) >= ACCEPT.on_outline * len(outline):
                middle, radius_px, _ = circle
                return Sighting(PointsDetection(middle[None] - [camera.cx, camera.cy], radius_px))
        if coloured:
            return Sighting(None, "the ball's colour is not round: uncover it", coloured[0].box)
        return Sighting(None, "nothing in view has the ball's colour: is hue right?")


class CornerDetector(TagDetector):
    """Detects all corners of the tags, clockwise from the upper left, by the tags' numbers."""

    needs_calibration, measured = False, ()

    def detect_in(
        self, stamp_s: float, rgb: np.ndarray, depth_m: np.ndarray | None, camera: Intrinsics
    ) -> Sighting:
        """Detect the corners in an image or a part of it; a little distortion does not matter."""
        corners, problem = self._reader.read(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY))
        missing = self._tag.faces.keys() - corners.keys()
        if missing:
            return Sighting(None, problem or f"tag {min(missing)} is not seen: uncover it")
        px = np.concatenate([corners[number].px for number in self._tag.faces])
        return Sighting(PointsDetection(px - [camera.cx, camera.cy]))
