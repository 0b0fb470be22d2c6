"""The camera's image, small, with ball, target and trail drawn in."""

from __future__ import annotations

import cv2
import numpy as np

from fvs_ros.core.camera import Intrinsics

#: Fractional bits of OpenCV's coordinates.
_SHIFT = 4
#: Nearer to the camera's plane than this nothing is drawn, m.
_NEAREST_M = 0.05
BALL_RGB, TARGET_RGB, TRAIL_RGB = (255, 214, 0), (86, 180, 233), (255, 255, 255)
#: What they mean.
LEGEND = (
    ("○", BALL_RGB, "ball found"),
    ("+", TARGET_RGB, "target"),
    ("―", TRAIL_RGB, "its way"),
)
_CROSS_PX = 7
#: What is left of the light of a picture that is old.
_OLD_LIGHT = 0.35


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
    trail_m: np.ndarray,
    width: int = 320,
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
    trail_m : ndarray, shape (n, 3)
        Where the ball was, camera frame, m.
    width : int
        Of the result, pixels; a smaller image keeps its size.

    Returns
    -------
    ndarray, shape (height, width, 3)
        uint8.
    """
    width = min(width, image_rgb.shape[1])
    height = round(width * image_rgb.shape[0] / image_rgb.shape[1])
    small = cv2.resize(image_rgb, (width, height), interpolation=cv2.INTER_AREA)
    if intrinsics is None:
        return small
    small_camera = scaled(intrinsics, width)
    _trail(small, small_camera, trail_m)
    if target_m is not None and _visible(target_m):
        _cross(small, _fixed(small_camera.project(target_m)))
    if ball_m is not None and _visible(ball_m):
        radius = small_camera.fx * ball_radius_m / ball_m[2]
        centre = _fixed(small_camera.project(ball_m))
        cv2.circle(small, centre, _fixed(radius), BALL_RGB, 1, cv2.LINE_AA, _SHIFT)
    return small


def darkened(image_rgb: np.ndarray) -> np.ndarray:
    """A picture that is not of now; uint8, as it was."""
    return (_OLD_LIGHT * image_rgb).astype(np.uint8)


def with_age(image_rgb: np.ndarray, age_s: int) -> np.ndarray:
    """A picture with its age, s, in words; itself where that is 0; uint8."""
    if not age_s:
        return image_rgb
    words = f"{age_s} s old"
    font, scale, white = cv2.FONT_HERSHEY_SIMPLEX, image_rgb.shape[1] / 400.0, (255, 255, 255)
    (width, height), _ = cv2.getTextSize(words, font, scale, 1)
    at = ((image_rgb.shape[1] - width) // 2, (image_rgb.shape[0] + height) // 2)
    return cv2.putText(image_rgb.copy(), words, at, font, scale, white, 1, cv2.LINE_AA)


def _visible(point_m: np.ndarray) -> bool:
    return bool(point_m[2] > _NEAREST_M)


def _trail(image: np.ndarray, camera: Intrinsics, trail_m: np.ndarray) -> None:
    seen = trail_m[trail_m[:, 2] > _NEAREST_M]
    if len(seen) > 1:
        line = np.array([_fixed(pixel) for pixel in camera.project(seen)], dtype=np.int32)
        cv2.polylines(image, [line], False, TRAIL_RGB, 1, cv2.LINE_AA, _SHIFT)


def _cross(image: np.ndarray, centre: tuple[int, int]) -> None:
    reach = _fixed(float(_CROSS_PX))
    u, v = centre
    for start, end in (((u - reach, v), (u + reach, v)), ((u, v - reach), (u, v + reach))):
        cv2.line(image, start, end, TARGET_RGB, 1, cv2.LINE_AA, _SHIFT)


def _fixed(value):
    """Pixels as OpenCV's fixed-point numbers, within what it can draw."""
    limited = np.clip(np.round(np.asarray(value) * (1 << _SHIFT)), -(2**20), 2**20).astype(int)
    return int(limited) if limited.ndim == 0 else tuple(int(one) for one in limited)
