"""Detection of the ball, or why it is not seen."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from fvs_detector_node.detection import BallColour, BallDetection, Miss, colour_mask, detect_ball
from fvs_detector_node.detector import Detector
from fvs_detector_node.sighting import Sighting
from fvs_ros.camera import Intrinsics

#: Below this saturation and value the hue of a pixel is only noise.
_LEAST = BallColour(min_saturation=40, min_value=12)


class BallDetector(Detector):
    """Looks for the ball."""

    needs_depth = True
    measured = ("quality", "visible_fraction", "residual_m", "radius_px")

    def search(
        self, stamp_s: float, rgb: np.ndarray, depth_m: np.ndarray | None, camera: Intrinsics
    ) -> Sighting:
        """Look for the ball; ``stamp_s`` does not matter."""
        assert depth_m is not None
        config = self._config
        ball, miss = detect_ball(rgb, depth_m, camera, config.ball_radius_m, config.colour)
        if ball is None:
            return self._explained(rgb, depth_m, camera, miss)
        problem = ""
        if not ball.quality >= config.min_quality:
            problem = (
                f"quality {ball.quality:.2f} of the ball, {ball.visible_fraction:.0%} of it "
                f"visible, is below min_quality {config.min_quality:g}"
            )
        return Sighting(ball, problem)

    def _explained(
        self, rgb: np.ndarray, depth_m: np.ndarray, camera: Intrinsics, miss: Miss | None
    ) -> Sighting:
        """Why no ball was found: with wider limits of its colour it may be."""
        colour = self._config.colour
        relaxed = replace(
            colour,
            min_saturation=min(_LEAST.min_saturation, colour.min_saturation),
            min_value=min(_LEAST.min_value, colour.min_value),
        )
        ball, _ = detect_ball(rgb, depth_m, camera, self._config.ball_radius_m, relaxed)
        if ball is not None:
            return _off_colour(rgb, ball, camera, relaxed, colour)
        if miss is not None:
            return Sighting(None, miss.reason, miss.box)
        text = "nothing in view has the ball's colour: is it out of view, or hue wrong?"
        return Sighting(None, text)


def _off_colour(
    rgb: np.ndarray,
    ball: BallDetection,
    camera: Intrinsics,
    relaxed: BallColour,
    colour: BallColour,
) -> Sighting:
    """Suggest limits of the colour that this ball keeps."""
    box = ball.box(camera).grown(0, camera)
    disc = np.ascontiguousarray(rgb[box.part])
    pixels = cv2.cvtColor(disc, cv2.COLOR_RGB2HSV)[colour_mask(disc, relaxed) > 0]
    # With room for the ball's shaded side.
    _, saturation, value = (0.7 * np.percentile(pixels, 5, axis=0)).astype(int)
    problem = (
        "the ball is too dark or too pale: lower min_value to "
        f"{min(value, colour.min_value)} and min_saturation to "
        f"{min(saturation, colour.min_saturation)}, or change light and exposure"
    )
    return Sighting(None, problem, box)
