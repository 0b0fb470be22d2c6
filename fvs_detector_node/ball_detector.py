"""Detection of a ball of known colour and radius in a colour image and its depth.

Every connected part of the image in the ball's colour is a candidate. :mod:`.sphere` fits a sphere
of the known radius to it, the direction by its outline and the distance by its depth or, without
depth images, by its size. A candidate must have the size, outline and bulge of the ball; the best
one wins. A rejected candidate is searched again in layers of depth, because it may merge the ball
with another object.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import cv2
import numpy as np

from fvs_detector_node.config import BallColour, DetectorConfig
from fvs_detector_node.detector import Detector, Sighting
from fvs_detector_node.images import Region
from fvs_detector_node.sphere import ACCEPT, Patch, SphereFit, fit_by_size, fit_sphere, unit
from fvs_ros.camera import Intrinsics

#: Below this saturation and value the hue of a pixel is only noise.
_LEAST = BallColour(min_saturation=40, min_value=12)


@dataclass(frozen=True)
class BallDetection:
    """A ball that was seen."""

    position_m: np.ndarray  # centre, camera optical frame, (3,)
    quality: float  # 0 to 1: visible fraction, times how well outline and surface fit a sphere
    visible_fraction: float  # of the outline's area; what the image border cuts off is not visible
    residual_m: float  # systematic departure of the measured surface from the sphere, rms
    radius_px: float  # of a circle of the outline's area

    rotation: ClassVar[np.ndarray] = np.eye(3)  # a ball has none

    def box(self, camera: Intrinsics) -> Region:
        """The part of a camera's image that shows the ball."""
        centre_px = camera.project(self.position_m)
        return Region.around(np.array([centre_px - self.radius_px, centre_px + self.radius_px]))

    def draw(self, picture: np.ndarray, camera: Intrinsics, style: dict[str, Any]) -> str:
        """Draw the ball; returns its numbers in words."""
        # Subpixel coordinates (sixteenths): the drawing moves smoothly.
        centre = np.round(16.0 * camera.project(self.position_m)).astype(int).tolist()
        cv2.circle(picture, centre, round(16 * self.radius_px), **style)
        x, y, z = self.position_m
        fit = f"quality {self.quality:.2f}  visible {self.visible_fraction:.0%}"
        return f"{fit}  x {x:+.3f} y {y:+.3f} z {z:.3f} m"


class BallDetector(Detector):
    """Detects the ball."""

    measured = ("quality", "visible_fraction", "residual_m", "radius_px")

    def __init__(self, config: DetectorConfig) -> None:
        super().__init__(config)
        self.needs_depth = config.use_depth

    def detect_in(
        self, stamp_s: float, rgb: np.ndarray, depth_m: np.ndarray | None, camera: Intrinsics
    ) -> Sighting:
        """Detect the ball, or say which limits of its colour would show it."""
        colour = self._config.colour
        if depth_m is None or not self.needs_depth:
            depth_m = np.zeros(rgb.shape[:2], np.float32)  # unknown
        sighting = self._look(rgb, depth_m, camera, colour)
        if sighting.detection is not None:
            return sighting
        relaxed = replace(
            colour,
            min_saturation=min(_LEAST.min_saturation, colour.min_saturation),
            min_value=min(_LEAST.min_value, colour.min_value),
        )
        ball = self._look(rgb, depth_m, camera, relaxed).detection
        if ball is None:
            return sighting
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

    def _look(
        self, rgb: np.ndarray, depth_m: np.ndarray, camera: Intrinsics, colour: BallColour
    ) -> Sighting:
        """The ball, or else why the largest object of its colour is not it."""
        mask, radius_m = colour_mask(rgb, colour), self._config.ball_radius_m
        scene = _Scene(rgb, mask, depth_m, camera, radius_m, not self.needs_depth)
        balls: list[BallDetection] = []
        miss: Sighting | None = None
        for blob in blobs(scene.mask):
            result = _evaluate(blob, scene)
            if isinstance(result, Sighting):
                balls += _split_by_depth(blob, scene)
                miss = miss or result
            else:
                balls.append(result)
        if balls:  # without depth, specks may be far balls: the largest one counts
            best = balls[0] if scene.by_size else max(balls, key=lambda ball: ball.quality)
            return Sighting(best)
        text = "nothing in view has the ball's colour: is it out of view, or hue wrong?"
        return miss or Sighting(None, text)


def colour_mask(rgb: np.ndarray, colour: BallColour) -> np.ndarray:
    """Mask of the pixels with the ball's colour, uint8 0 or 255, shape (H, W)."""
    hsv = cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2HSV)
    darkest = (colour.min_saturation, colour.min_value)
    mask = np.zeros(hsv.shape[:2], np.uint8)
    for wrap in (-180, 0, 180):  # hues are a circle
        low = max(colour.hue - colour.hue_width + wrap, 0)
        high = min(colour.hue + colour.hue_width + wrap, 179)
        if low <= high:
            mask |= cv2.inRange(hsv, (low, *darkest), (high, 255, 255))
    return mask


# ------------------------------------------------------------------------------- candidates
@dataclass(frozen=True)
class _Scene:
    """An image and what is looked for in it."""

    rgb: np.ndarray
    mask: np.ndarray  # of the ball's colour, 0 or 255, (H, W)
    depth_m: np.ndarray
    camera: Intrinsics
    radius_m: float
    by_size: bool  # whether a ball's size tells its distance


@dataclass(frozen=True)
class Blob:
    """A connected part of a mask: its bounding box, its mask in there, filled, and its size."""

    box: Region
    filled: np.ndarray
    pixels: int
    outline: np.ndarray  # its pixels at the border, (n, 2)

    def depths(self, depth_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Depth within the bounding box, m, and where the blob has one; both of its shape."""
        depth = depth_m[self.box.part]
        return depth, (self.filled > 0) & (depth > 0.0) & (depth < np.inf)


def blobs(mask: np.ndarray, u0: int = 0, v0: int = 0) -> list[Blob]:
    """Find the connected parts of a mask from (u0, v0) on, largest first, holes filled."""
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    found = []
    for contour in contours:
        # The area within the pixel centres of the border; half the border is missing.
        if cv2.contourArea(contour) + 0.5 * len(contour) < ACCEPT.pixels:
            continue
        u, v, width, height = cv2.boundingRect(contour)
        filled = np.zeros((height, width), np.uint8)
        cv2.drawContours(filled, [contour], 0, 255, cv2.FILLED, offset=(-u, -v))
        box = Region(u0 + u, v0 + v, width, height)
        found.append(Blob(box, filled, cv2.countNonZero(filled), contour[:, 0] + [u0, v0]))
    found.sort(key=lambda blob: -blob.pixels)
    return found[:16]  # bounds the time that a noisy image takes


def _split_by_depth(blob: Blob, scene: _Scene) -> list[BallDetection]:
    """Look for the ball in a blob that merges it with other objects of its colour.

    The first layer, as deep as a ball, is the one with most pixels. The next ones are searched in
    the remaining pixels.
    """
    depth, remaining = blob.depths(scene.depth_m)
    radius_m, balls = scene.radius_m, []
    for _ in range(4):  # layers; with only two, one ball in forty is missed
        values = np.sort(depth[remaining])
        if len(values) < ACCEPT.pixels:
            break
        ends = np.searchsorted(values, values + 1.5 * radius_m, side="right")
        start = int(np.argmax(ends - np.arange(len(values))))
        near = values[start] - 0.25 * radius_m
        layer = remaining & (depth >= near) & (depth <= near + 1.75 * radius_m)
        remaining &= ~layer
        if np.count_nonzero(layer) > 0.98 * blob.pixels:  # the whole blob was tried before
            break
        mask = np.zeros_like(scene.mask)
        part = mask[blob.box.part]
        part[:] = 255 * layer.astype(np.uint8)
        for piece in blobs(part, blob.box.u0, blob.box.v0):
            ball = _evaluate(piece, replace(scene, mask=mask))
            if isinstance(ball, BallDetection):
                balls.append(ball)
    return balls


def _evaluate(blob: Blob, scene: _Scene) -> BallDetection | Sighting:
    """Fit the ball to a blob, or say why it is none."""
    box, radius_m = blob.box, scene.radius_m
    if scene.by_size:
        miss = Sighting(None, "the ball's colour is there, but not round: uncover the ball", box)
        pad = 3 + abs(box.width - box.height)
        patch = _cut_out(blob, scene, pad)
        fit = fit_by_size(patch, scene.rgb[box.grown(pad, scene.camera).part], radius_m)
    else:
        guess = _guess(blob, scene)
        if isinstance(guess, Sighting):
            return guess
        distance_m, pad, miss = guess
        patch = _cut_out(blob, scene, pad)
        fit = fit_sphere(patch, distance_m, radius_m)
    if fit is None or fit.on_outline < ACCEPT.on_outline:
        return miss
    ball = _measured(patch, fit, radius_m)
    if ball.visible_fraction < ACCEPT.quality:
        return Sighting(None, f"only {ball.visible_fraction:.0%} of the ball is visible", box)
    return miss if ball.quality < ACCEPT.quality else ball


def _guess(blob: Blob, scene: _Scene) -> tuple[float, int, Sighting] | Sighting:
    """By depth, a ball's distance, m, the pixels about the blob, and what to say if it is none.

    Only the latter for a blob of the wrong size.
    """
    box_depth, known = blob.depths(scene.depth_m)
    box, camera, radius_m = blob.box, scene.camera, scene.radius_m
    if np.count_nonzero(known) < ACCEPT.pixels:
        text = "the ball's colour is there, but no depth: too near, too far or reflective?"
        return Sighting(None, text, box)
    # Half of a disc lies within 0.7 r of its middle.
    middle_px = np.array([box.u0 + 0.5 * (box.width - 1), box.v0 + 0.5 * (box.height - 1)])
    middle = unit(camera.rays(*middle_px))
    distance_m = float(np.median(box_depth[known]) / middle[2]) + 0.7 * radius_m
    expected_px = _outline_area_px(middle, distance_m, radius_m, camera)
    share = blob.pixels / expected_px
    miss = Sighting(
        None,
        f"an object of the ball's colour, {distance_m:.2f} m away, as large as a ball of "
        f"{1e3 * radius_m * np.sqrt(share):.0f} mm radius, has not the outline of one of "
        f"{1e3 * radius_m:.0f} mm: check ball_radius_m, uncover the ball, use larger images, align "
        "depth to colour (align_depth.enable:=true)",
        box,
    )
    nearest_m = ACCEPT.nearest_radii * radius_m
    if distance_m < nearest_m or not ACCEPT.least_area < share < ACCEPT.most_area:
        return miss
    pad = 3 + max(0, int(2.4 * np.sqrt(expected_px / np.pi)) - min(box.width, box.height))
    return distance_m, pad, miss


def _cut_out(blob: Blob, scene: _Scene, pad: int) -> Patch:
    """A blob with its surroundings."""
    box, around = blob.box, blob.box.grown(pad, scene.camera)
    inside = np.zeros((around.height, around.width), bool)
    within = Region(box.u0 - around.u0, box.v0 - around.v0, box.width, box.height)
    inside[within.part] = blob.filled > 0
    depth = np.asarray(scene.depth_m[around.part], dtype=float)
    known = np.where((depth > 0.0) & (depth < np.inf), depth, 0.0)
    coloured = inside | (scene.mask[around.part] > 0)
    return Patch(inside, coloured, known, around.view(scene.camera))


def _measured(patch: Patch, fit: SphereFit, radius_m: float) -> BallDetection:
    """The fitted ball, with its visible fraction."""
    expected_px = _outline_area_px(fit.direction, fit.distance_m, radius_m, patch.view)
    # Angles from the axis are compared by their cosines: d cos = -sin d angle.
    cone_cos = np.sqrt(1.0 - (radius_m / fit.distance_m) ** 2)
    pixel_cos = fit.pixel_rad * radius_m / fit.distance_m
    on_ball = patch.rays @ fit.direction >= cone_cos - 0.5 * pixel_cos
    # Pixels far in front of or behind it belong to another object.
    apart = np.abs(patch.depth_m - fit.distance_m * fit.direction[2]) > 2.0 * radius_m
    visible = patch.coloured & on_ball & ~(apart & (patch.depth_m > 0.0))
    fraction = min(1.0, float(np.count_nonzero(visible) / expected_px))
    roundness = float(np.exp(-np.square(fit.residual_m / (0.08 * radius_m))))
    return BallDetection(
        position_m=fit.distance_m * fit.direction,
        quality=fraction * fit.on_outline * roundness,
        visible_fraction=fraction,
        residual_m=fit.residual_m,
        radius_px=float(np.sqrt(expected_px / np.pi)),
    )


def _outline_area_px(
    direction: np.ndarray, distance_m: float, radius_m: float, camera: Intrinsics
) -> float:
    """Image area of a whole sphere, pixels: an ellipse, where the image plane cuts its cone."""
    sin2 = min((radius_m / distance_m) ** 2, 0.9)
    cos2_axis = max(direction[2] ** 2, sin2 + 0.05)
    ellipse = np.pi * sin2 * np.sqrt(1.0 - sin2) / (cos2_axis - sin2) ** 1.5
    return float(camera.fx * camera.fy * ellipse)
