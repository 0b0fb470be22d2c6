"""The camera's image, small, with ball, target and words drawn in."""

from __future__ import annotations

import textwrap

import cv2
import numpy as np

from fvs_ros.camera import Intrinsics

#: Fractional bits of OpenCV's coordinates.
_SHIFT = 4
#: Nearer to the camera's plane than this nothing is drawn, m.
_NEAREST_M = 0.05
BALL_RGB, TARGET_RGB = (255, 214, 0), (86, 180, 233)
_CROSS_PX = 7
_WIDTH_PX = 320
#: What is left of the light of a picture that words stand on.
_OLD_LIGHT = 0.35
_LETTERS, _LINE_PX = 36, 22  # a line of words
BLANK = np.full((240, _WIDTH_PX, 3), 90, np.uint8)


def scaled(intrinsics: Intrinsics, width: int) -> Intrinsics:
    """Intrinsics of the same image at another width."""
    scale = width / intrinsics.width
    return Intrinsics(
        width,
        round(scale * intrinsics.height),
        scale * intrinsics.fx,
        scale * intrinsics.fy,
        # integer coordinates are pixel centres
        scale * (intrinsics.cx + 0.5) - 0.5,
        scale * (intrinsics.cy + 0.5) - 0.5,
    )


def draw(
    image_rgb: np.ndarray,
    intrinsics: Intrinsics | None,
    ball_m: np.ndarray | None,
    ball_radius_m: float,
    target_m: np.ndarray | None,
) -> np.ndarray:
    """Scale an image down and draw what was found in it.

    Parameters
    ----------
    image_rgb : ndarray, shape (height, width, 3)
        The camera's image, uint8; not changed.
    intrinsics : Intrinsics or None
        Of that image; without, nothing is drawn.
    ball_m, target_m : ndarray, shape (3,), or None
        Camera frame, m.
    ball_radius_m : float
        m.

    Returns
    -------
    ndarray, shape (height, width, 3)
        uint8.
    """
    width = min(_WIDTH_PX, image_rgb.shape[1])
    height = round(width * image_rgb.shape[0] / image_rgb.shape[1])
    small = cv2.resize(image_rgb, (width, height), interpolation=cv2.INTER_AREA)
    if intrinsics is None:
        return small
    camera = scaled(intrinsics, width)
    if target_m is not None and target_m[2] > _NEAREST_M:
        u, v = _fixed(camera.project(target_m))
        reach = _CROSS_PX << _SHIFT
        for start, end in (((u - reach, v), (u + reach, v)), ((u, v - reach), (u, v + reach))):
            cv2.line(small, start, end, TARGET_RGB, 1, cv2.LINE_AA, _SHIFT)
    if ball_m is not None and ball_m[2] > _NEAREST_M:
        radius, _ = _fixed(np.array([camera.fx * ball_radius_m / ball_m[2], 0.0]))
        centre = _fixed(camera.project(ball_m))
        cv2.circle(small, centre, radius, BALL_RGB, 1, cv2.LINE_AA, _SHIFT)
    return small


def with_words(image_rgb: np.ndarray, words: str) -> np.ndarray:
    """A darkened copy of a picture with words in its middle, uint8."""
    dark = (_OLD_LIGHT * image_rgb).astype(np.uint8)
    scale = image_rgb.shape[1] / _WIDTH_PX
    font, white = cv2.FONT_HERSHEY_SIMPLEX, (255, 255, 255)
    lines = textwrap.wrap(words, _LETTERS)
    row = 0.5 * image_rgb.shape[0] - 0.5 * scale * _LINE_PX * (len(lines) - 1)
    for line in lines:
        (width, height), _ = cv2.getTextSize(line, font, 0.45 * scale, 1)
        at = ((image_rgb.shape[1] - width) // 2, round(row + 0.5 * height))
        cv2.putText(dark, line, at, font, 0.45 * scale, white, 1, cv2.LINE_AA)
        row += scale * _LINE_PX
    return dark


def _fixed(pixels: np.ndarray) -> tuple[int, int]:
    """Pixels as OpenCV's fixed-point numbers, within what it can draw."""
    u, v = np.clip(np.round(pixels * (1 << _SHIFT)), -(2**20), 2**20).astype(int).tolist()
    return u, v
