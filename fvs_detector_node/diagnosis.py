"""Why no ball is seen: one of five causes, with what to do about it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from fvs_detector_node.detection import (
    BallColour,
    BallDetection,
    Cause,
    Rejection,
    colour_mask,
    examine,
)
from fvs_detector_node.region import Region
from fvs_detector_node.sphere import MIN_PIXELS
from fvs_ros.camera import Intrinsics

#: Below these the hue of a pixel is mere noise.
_LEAST_SATURATION, _LEAST_VALUE = 40, 12

_THING = "something of the ball's colour"
_ALIGNED = "is depth aligned to colour (align_depth.enable:=true)?"


@dataclass(frozen=True)
class Miss:
    """Why no ball is seen.

    Parameters
    ----------
    cause : Cause
        The most likely cause.
    text : str
        One sentence.
    box : Region or None
        What it is about.
    """

    cause: Cause
    text: str
    box: Region | None = None


def diagnose(
    rgb: np.ndarray,
    depth_m: np.ndarray,
    camera: Intrinsics,
    radius_m: float,
    colour: BallColour,
) -> Miss:
    """Tell why no ball was found in an image; takes up to three times as long as finding one.

    Parameters are those of :func:`~fvs_detector_node.detection.detect_ball`.

    Returns
    -------
    Miss
        The most likely cause.
    """
    _, rejections = examine(rgb, depth_m, camera, radius_m, colour)
    # A speck of noise is no answer while a whole ball may be standing in the dark.
    if all(one.pixels < 2 * MIN_PIXELS for one in rejections):
        relaxed = replace(
            colour,
            min_saturation=min(_LEAST_SATURATION, colour.min_saturation),
            min_value=min(_LEAST_VALUE, colour.min_value),
        )
        ball, _ = examine(rgb, depth_m, camera, radius_m, relaxed)
        if ball is not None:
            return _off_colour(rgb, ball, camera, colour, relaxed)
    if not rejections:
        return Miss(
            Cause.OUT_OF_VIEW,
            "nothing in view has the ball's colour: is it out of view, or hue wrong?",
        )
    likeliest = max(rejections, key=lambda one: (one.cause, one.pixels))
    return Miss(likeliest.cause, _sentence(likeliest, radius_m), likeliest.box)


def _off_colour(
    rgb: np.ndarray,
    ball: BallDetection,
    camera: Intrinsics,
    colour: BallColour,
    relaxed: BallColour,
) -> Miss:
    """What to change for a ball that is found with wider limits of its colour."""
    u, v = camera.project(ball.position_m).astype(int).tolist()
    box = Region(u, v, 1, 1).grown(int(0.8 * ball.radius_px), camera)
    disc = np.ascontiguousarray(rgb[box.part])
    pixels = cv2.cvtColor(disc, cv2.COLOR_RGB2HSV)[colour_mask(disc, relaxed) > 0]
    # With room for the ball's shaded side.
    wanted = (0.7 * np.percentile(pixels, 5, axis=0)).astype(int)
    if np.median(pixels[:, 2]) < colour.min_value:
        text = f"the ball is too dark: lower min_value to {wanted[2]}, or give more light"
    else:
        text = f"the ball is too pale: lower min_saturation to {wanted[1]}, or shorten the exposure"
    return Miss(Cause.OFF_COLOUR, text, box)


def _sentence(thing: Rejection, radius_m: float) -> str:
    if thing.cause is Cause.NO_DEPTH:
        return f"{_THING} has no depth: is it too near, too far or reflective?"
    where = f"{_THING}, {thing.distance_m:.2f} m away,"
    if thing.cause is Cause.WRONG_SIZE:
        return (
            f"{where} looks like a ball of {1e3 * thing.looks_m:.0f} mm radius, not "
            f"{1e3 * radius_m:.0f} mm: check ball_radius_m, is it partly hidden, "
            f"or {_ALIGNED}"
        )
    return f"{where} is no sphere: is it the ball, or {_ALIGNED}"
