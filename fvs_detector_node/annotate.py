"""The picture with what was found in it, for the person beside the camera."""

from __future__ import annotations

import textwrap

import cv2
import numpy as np

from fvs_detector_node.detector import Sighting
from fvs_ros.camera import Intrinsics

_FOUND, _REFUSED, _TEXT = (60, 230, 60), (255, 170, 0), (255, 255, 255)


def annotate(rgb: np.ndarray, sighting: Sighting, camera: Intrinsics) -> np.ndarray:
    """Draw the ball's outline, centre and quality, or why it is not seen.

    Parameters
    ----------
    rgb : ndarray of uint8, shape (H, W, 3)
        Colour image without distortion; it is not changed.
    sighting : Sighting
        What was found in it.
    camera : Intrinsics
        Of the image.

    Returns
    -------
    ndarray of uint8, shape (H, W, 3)
        A copy with the drawing.
    """
    picture = np.array(rgb)
    scale = max(picture.shape[1] / 640.0, 0.4)
    thick = max(1, round(1.5 * scale))
    lines = textwrap.wrap(sighting.problem, 66)
    ball = sighting.ball
    if ball is not None:
        colour = _REFUSED if sighting.problem else _FOUND
        # Sixteenths of a pixel: the drawing moves with the ball, not in steps.
        centre = np.round(16.0 * camera.project(ball.position_m)).astype(int).tolist()
        cv2.circle(picture, centre, round(16 * ball.radius_px), colour, thick, cv2.LINE_AA, 4)
        size = max(8, round(0.7 * ball.radius_px))
        middle = [round(pixel / 16) for pixel in centre]
        cv2.drawMarker(picture, middle, colour, cv2.MARKER_CROSS, size, thick, cv2.LINE_AA)
        x, y, z = ball.position_m
        lines.insert(
            0,
            f"quality {ball.quality:.2f}  visible {ball.visible_fraction:.0%}  "
            f"x {x:+.3f} y {y:+.3f} z {z:.3f} m",
        )
    elif sighting.miss is not None and sighting.miss.box is not None:
        box = sighting.miss.box
        cv2.rectangle(picture, (box.u0, box.v0, box.width, box.height), _REFUSED, thick)
    # White on a darkened band: readable before anything.
    band = picture[: round((8 + 20 * len(lines)) * scale)]
    band //= 4
    for row, line in enumerate(lines):
        at = (round(10 * scale), round((20 + 20 * row) * scale))
        font = cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(picture, line, at, font, 0.5 * scale, _TEXT, thick, cv2.LINE_AA)
    return picture
