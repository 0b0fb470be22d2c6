"""The picture with what was found in it, for the person beside the camera."""

from __future__ import annotations

import textwrap

import cv2
import numpy as np

from fvs_detector_node.detector import Sighting

_FOUND, _REFUSED, _TEXT = (60, 230, 60), (255, 170, 0), (255, 255, 255)
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def annotate(rgb: np.ndarray, sighting: Sighting) -> np.ndarray:
    """Draw the ball's outline, centre and quality, or why it is not seen.

    Parameters
    ----------
    rgb : ndarray of uint8, shape (H, W, 3)
        Colour image without distortion; it is not changed.
    sighting : Sighting
        What was found in it.

    Returns
    -------
    ndarray of uint8, shape (H, W, 3)
        A copy with the drawing.
    """
    picture = np.array(rgb)
    scale = max(picture.shape[1] / 640.0, 0.4)
    thick = max(1, round(1.5 * scale))
    lines = []
    found = sighting.detection
    if found is not None:
        colour = _REFUSED if sighting.problem else _FOUND
        # Sixteenths of a pixel: the circle moves with the ball, not in steps.
        centre = (round(16 * found.pixel[0]), round(16 * found.pixel[1]))
        radius = round(16 * found.radius_px)
        cv2.circle(picture, centre, radius, colour, thick, cv2.LINE_AA, 4)
        arm = round(16 * max(4.0, 0.35 * found.radius_px))
        for du, dv in ((arm, 0), (0, arm)):
            start, end = (centre[0] - du, centre[1] - dv), (centre[0] + du, centre[1] + dv)
            cv2.line(picture, start, end, colour, thick, cv2.LINE_AA, 4)
        x, y, z = found.position_m
        lines.append(
            f"quality {found.quality:.2f}  visible {found.visible_fraction:.0%}  "
            f"x {x:+.3f} y {y:+.3f} z {z:.3f} m"
        )
    elif sighting.miss is not None and sighting.miss.box is not None:
        u0, v0, width, height = sighting.miss.box
        cv2.rectangle(picture, (u0, v0), (u0 + width, v0 + height), _REFUSED, thick)
    if sighting.problem:
        lines.extend(textwrap.wrap(sighting.problem, 66))
    # White on a darkened band: readable before anything.
    band = picture[: round((8 + 20 * len(lines)) * scale)]
    band //= 4
    for row, line in enumerate(lines):
        at = (round(10 * scale), round((20 + 20 * row) * scale))
        cv2.putText(picture, line, at, _FONT, 0.5 * scale, _TEXT, thick, cv2.LINE_AA)
    return picture
