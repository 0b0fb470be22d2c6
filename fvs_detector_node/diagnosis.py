"""Why no ball is seen, in one sentence for the person beside the camera."""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace

import cv2
import numpy as np

from fvs_detector_node.detection import (
    MIN_PIXELS,
    MIN_VISIBLE_FRACTION,
    BallColour,
    Cause,
    Rejection,
    colour_mask,
    examine,
)
from fvs_ros.camera import Intrinsics

#: Below these the hue of a pixel is mere noise.
_LEAST_VALUE, _LEAST_SATURATION = 12, 40
#: A ball that reaches beyond its edge looks this much too large or too small, in radii.
_WRONG_SIZE = 0.15


class Why(enum.Enum):
    """Kinds of answers."""

    OUT_OF_VIEW = "out of view"
    TOO_DARK = "too dark"
    TOO_PALE = "too pale"
    NO_DEPTH = "no depth"
    NOT_REGISTERED = "not registered"
    WRONG_SIZE = "wrong size"
    NO_BALL = "not a ball"
    HIDDEN = "partly hidden"


@dataclass(frozen=True)
class Miss:
    """Why no ball is seen.

    Parameters
    ----------
    why : Why
        The kind of answer.
    text : str
        One sentence.
    box : tuple of int or None
        What the sentence is about: first pixel (u0, v0), width and height, pixels.
    """

    why: Why
    text: str
    box: tuple[int, int, int, int] | None = None


def diagnose(
    rgb: np.ndarray,
    depth_m: np.ndarray,
    intrinsics: Intrinsics,
    radius_m: float,
    colour: BallColour,
) -> Miss:
    """Tell why no ball is seen in an image in which none was found.

    Takes several times as long as the detection itself.

    Parameters
    ----------
    rgb : ndarray of uint8, shape (H, W, 3)
        Colour image, red first.
    depth_m : ndarray of float, shape (H, W)
        Depth, m; 0 where there is none.
    intrinsics : Intrinsics
        Of both.
    radius_m : float
        Radius of the ball that is looked for, m.
    colour : BallColour
        Colour that is looked for.

    Returns
    -------
    Miss
        The most likely reason.
    """
    _, rejections = examine(rgb, depth_m, intrinsics, radius_m, colour)
    # A speck of noise is no answer while a whole ball may be standing in the dark.
    if all(rejection.pixels < 2 * MIN_PIXELS for rejection in rejections):
        miss = _other_light(rgb, depth_m, intrinsics, radius_m, colour)
        if miss is not None:
            return miss
    if not rejections:
        return Miss(
            Why.OUT_OF_VIEW,
            f"nothing in view has the ball's colour (hue {colour.hue} within {colour.hue_width}, "
            f"saturation from {colour.min_saturation}, brightness from {colour.min_value}): "
            "is the ball out of view or hidden?",
        )
    likeliest = max(rejections, key=lambda r: (r.cause, r.pixels))
    return _explain(likeliest, depth_m, radius_m)


# --------------------------------------------------------------------------------- colour
def _other_light(
    rgb: np.ndarray,
    depth_m: np.ndarray,
    intrinsics: Intrinsics,
    radius_m: float,
    colour: BallColour,
) -> Miss | None:
    """Whether something would have the ball's colour if it were brighter or less pale."""
    darker = replace(colour, min_value=min(_LEAST_VALUE, colour.min_value))
    paler = replace(colour, min_saturation=min(_LEAST_SATURATION, colour.min_saturation))
    channels = cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2HSV)
    candidates = []
    for why, relaxed, channel in ((Why.TOO_DARK, darker, 2), (Why.TOO_PALE, paler, 1)):
        mask = colour_mask(rgb, relaxed)
        box, pixels = _largest(mask)
        if pixels < MIN_PIXELS:
            continue
        ball, _ = examine(rgb, depth_m, intrinsics, radius_m, relaxed)
        if ball is not None:
            reach = 0.8 * ball.radius_px
            u, v = ball.pixel
            box = _clipped(u - reach, v - reach, 2 * reach, 2 * reach, intrinsics)
        u0, v0, width, height = box
        part = np.s_[v0 : v0 + height, u0 : u0 + width]
        chosen = channels[part][..., channel][mask[part] > 0]
        if len(chosen):
            candidates.append((ball is not None, pixels, why, box, chosen))
    if not candidates:
        return None
    is_ball, pixels, why, box, chosen = max(candidates, key=lambda c: c[:2])
    what = "a ball" if is_ball else f"something of {pixels} pixels"
    # With room for the ball's shaded side.
    median, wanted = int(np.median(chosen)), int(0.7 * np.percentile(chosen, 5))
    if why is Why.TOO_DARK:
        return Miss(
            why,
            f"too dark: {what} in view has the ball's hue, but a brightness of {median}, below "
            f"min_value {colour.min_value}: lower min_value to {wanted}, or give more light",
            box,
        )
    return Miss(
        why,
        f"too pale: {what} in view has the ball's hue, but a saturation of {median}, below "
        f"min_saturation {colour.min_saturation}: lower min_saturation to {wanted}, or shorten "
        "the exposure",
        box,
    )


def _largest(mask: np.ndarray) -> tuple[tuple[int, int, int, int], int]:
    """Bounding box and area of the largest piece of a mask, pixels."""
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return (0, 0, 0, 0), 0
    largest = max(contours, key=len)
    u, v, width, height = cv2.boundingRect(largest)
    return (u, v, width, height), int(cv2.contourArea(largest) + 0.5 * len(largest))


def _clipped(
    u0: float, v0: float, width: float, height: float, camera: Intrinsics
) -> tuple[int, int, int, int]:
    left, top = max(0, int(u0)), max(0, int(v0))
    right, bottom = min(camera.width, int(u0 + width)), min(camera.height, int(v0 + height))
    return left, top, max(1, right - left), max(1, bottom - top)


# ---------------------------------------------------------------------------- size, depth
def _explain(thing: Rejection, depth_m: np.ndarray, radius_m: float) -> Miss:
    """Put into words what speaks against a thing of the ball's colour."""
    where = f"{thing.distance_m:.2f} m away"
    if thing.cause is Cause.NO_DEPTH:
        return Miss(
            Why.NO_DEPTH,
            f"something of the ball's colour has no depth ({thing.depth_pixels} of {thing.pixels} "
            "pixels do): is it too near for the camera, too far, or reflective?",
            thing.box,
        )
    if thing.cause is Cause.TOO_NEAR:
        return Miss(
            Why.NO_DEPTH,
            f"something of the ball's colour is nearer than a ball of {1e3 * radius_m:.0f} mm "
            "radius can be: check ball_radius_m and depth_unit_m",
            thing.box,
        )
    if thing.cause is Cause.HIDDEN:
        return Miss(
            Why.HIDDEN,
            f"the ball is hidden but for {thing.value:.0%} of it, {where}; "
            f"{MIN_VISIBLE_FRACTION:.0%} is needed",
            thing.box,
        )
    unfit = _depth_does_not_fit(thing, depth_m, radius_m)
    if unfit:
        return Miss(
            Why.NOT_REGISTERED,
            f"something of the ball's colour, {where}, {unfit}: is the depth image aligned to "
            "the colour image (align_depth.enable:=true)?",
            thing.box,
        )
    looks_m = radius_m * float(np.sqrt(thing.area_ratio))
    if abs(looks_m / radius_m - 1.0) > _WRONG_SIZE:
        return Miss(
            Why.WRONG_SIZE,
            f"something of the ball's colour, {where}, is as large as a ball of "
            f"{1e3 * looks_m:.0f} mm radius; ball_radius_m says {1e3 * radius_m:.0f} mm: is it "
            "right, is a part of the ball hidden, or is it not the ball?",
            thing.box,
        )
    against = {
        Cause.OUTLINE: f"only {thing.value:.0%} of its outline is round",
        Cause.BULGE: f"it is {1e3 * thing.value:.0f} mm (rms) off the shape of a sphere",
    }.get(thing.cause, "its depth is not that of a sphere")
    return Miss(
        Why.NO_BALL,
        f"something of the ball's colour, {where}, has the size of the ball, but {against}: is "
        "it the ball, and is the depth aligned to the colour (align_depth.enable:=true)?",
        thing.box,
    )


def _depth_does_not_fit(thing: Rejection, depth_m: np.ndarray, radius_m: float) -> str:
    """How the depth contradicts the colours, in words; empty if it does not.

    Where the two images are shifted against each other, the ball's edge in depth runs through the
    middle of the coloured disc, or all of the disc has the depth of what is around it.
    """
    u0, v0, width, height = thing.box
    rows, columns = np.mgrid[-0.5 : 0.5 : height * 1j, -0.5 : 0.5 : width * 1j]
    middle = np.square(rows) + np.square(columns) < 0.4**2
    part = depth_m[v0 : v0 + height, u0 : u0 + width]
    inner = part[middle & (part > 0.0) & (part < np.inf)]
    if len(inner) < MIN_PIXELS // 2:
        return ""
    near, far = np.percentile(inner, (10, 90))
    if far - near > 4.0 * radius_m:
        return f"has depths from {near:.2f} to {far:.2f} m within"
    margin_u, margin_v = width // 2 + 3, height // 2 + 3
    top, left = max(0, v0 - margin_v), max(0, u0 - margin_u)
    around = depth_m[top : v0 + height + margin_v, left : u0 + width + margin_u].copy()
    around[v0 - top : v0 - top + height, u0 - left : u0 - left + width] = 0.0
    outer = around[(around > 0.0) & (around < np.inf)]
    # Where little is seen around it, that may be what holds the ball.
    if 2 * len(outer) < around.size - width * height or far - near > 0.5 * radius_m:
        return ""
    if abs(np.median(outer) - np.median(inner)) < 0.5 * radius_m:
        return "is as far away as what is around it"
    return ""
