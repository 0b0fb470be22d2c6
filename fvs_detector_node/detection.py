"""Where a ball of known colour and radius is, from one colour image and its depth.

The steps, each a function below:

1. a red mask, and its contours: every blob is a candidate;
2. the outline gives the direction: seen from the camera, a sphere's outline lies on a cone about
   the direction of its centre, and the known radius fixes the cone's opening. The fit is robust,
   so that an arc of the outline suffices where the ball is partly hidden;
3. the depth gives the distance: with the direction known, each pixel's depth gives the distance
   of the centre along its own ray (surface is not centre, and the correction runs along the ray);
4. a candidate must have the size, outline and bulge of the ball; the best one wins. What speaks
   against each of the others is kept, for whoever has to tell a user why no ball is seen.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace

import cv2
import numpy as np

from fvs_ros.camera import Intrinsics

#: Nothing is reported where less of the ball is visible.
MIN_VISIBLE_FRACTION = 0.25

#: Fewer pixels of the ball's colour in one piece, or fewer of them with a depth, are no candidate.
MIN_PIXELS = 20
_MAX_BLOBS = 16
_MIN_ON_OUTLINE = 0.6
_MIN_ARC = 0.2
_MAX_RESIDUAL_RADII = 0.1


@dataclass(frozen=True)
class BallColour:
    """What counts as the ball's colour, in OpenCV's HSV units.

    Parameters
    ----------
    hue : int
        Middle of the hues, 0 to 179 (half degrees; red is 0).
    hue_width : int
        Largest distance from it, half degrees, around the colour circle.
    min_saturation, min_value : int
        Least saturation and brightness, 0 to 255; low enough for the shaded side.
    """

    hue: int = 0
    hue_width: int = 10
    min_saturation: int = 110
    min_value: int = 35

    def __post_init__(self) -> None:
        if not 0 <= self.hue < 180 or not 0 < self.hue_width < 90:
            raise ValueError(
                f"hue must be 0 to 179 and hue_width 1 to 89 half degrees, got {self.hue} "
                f"and {self.hue_width}"
            )
        if not 0 <= self.min_saturation <= 255 or not 0 <= self.min_value <= 255:
            raise ValueError("min_saturation and min_value must be 0 to 255")


@dataclass(frozen=True)
class BallDetection:
    """A ball that was seen.

    Parameters
    ----------
    position_m : ndarray, shape (3,)
        Centre, camera optical frame, m.
    quality : float
        0 to 1: visible fraction, times how well the outline and the surface fit a sphere.
    visible_fraction : float
        Visible part of the ball's outline area; what the image border cuts off is not visible.
    residual_m : float
        Systematic departure of the measured surface from the sphere, rms, m.
    pixel : tuple of float
        Where the centre projects to, (u, v), pixels.
    radius_px : float
        Radius of a circle of the outline's area, pixels.
    """

    position_m: np.ndarray
    quality: float
    visible_fraction: float
    residual_m: float
    pixel: tuple[float, float]
    radius_px: float


class Cause(enum.IntEnum):
    """Why a thing of the ball's colour is not taken for the ball; the later, the more like it."""

    NO_DEPTH = 1
    TOO_NEAR = 2
    SIZE = 3
    SURFACE = 4
    OUTLINE = 5
    BULGE = 6
    HIDDEN = 7


@dataclass(frozen=True)
class Rejection:
    """A thing of the ball's colour that is not taken for the ball.

    Parameters
    ----------
    cause : Cause
        What speaks against it.
    box : tuple of int
        Its bounding box: first pixel (u0, v0), width and height, pixels.
    pixels : int
        Its size, pixels.
    depth_pixels : int
        How many of them have a depth.
    distance_m : float
        Distance that its centre would have, m; NaN without depth.
    area_ratio : float
        Its area over that of a whole ball at this distance; NaN without depth.
    value : float
        The number that spoke against it: part of the outline that fits (``OUTLINE``), departure
        from the sphere, m (``BULGE``), share of the ball's area (``HIDDEN``).
    """

    cause: Cause
    box: tuple[int, int, int, int]
    pixels: int
    depth_pixels: int = 0
    distance_m: float = float("nan")
    area_ratio: float = float("nan")
    value: float = float("nan")


def detect_ball(
    rgb: np.ndarray,
    depth_m: np.ndarray,
    intrinsics: Intrinsics,
    radius_m: float,
    config: BallColour | None = None,
) -> BallDetection | None:
    """Find the ball.

    Parameters
    ----------
    rgb : ndarray of uint8, shape (H, W, 3)
        Colour image, red first.
    depth_m : ndarray of float, shape (H, W)
        Depth along the optical axis, aligned to the colour image, m; 0 or NaN where unknown.
    intrinsics : Intrinsics
        Of this image (of the sub-image, where only a part is given).
    radius_m : float
        Radius of the ball, m.
    config : BallColour, optional
        What counts as its colour; default red.

    Returns
    -------
    BallDetection or None
        None if no ball is seen, or less than a quarter of it.

    Raises
    ------
    ValueError
        If the sizes of images and intrinsics differ.
    """
    return examine(rgb, depth_m, intrinsics, radius_m, config)[0]


def examine(
    rgb: np.ndarray,
    depth_m: np.ndarray,
    intrinsics: Intrinsics,
    radius_m: float,
    config: BallColour | None = None,
) -> tuple[BallDetection | None, list[Rejection]]:
    """Find the ball as :func:`detect_ball` does, and tell what else has its colour.

    Returns
    -------
    detection : BallDetection or None
        The ball.
    rejections : list of Rejection
        What has the ball's colour and is not the ball, largest first.
    """
    size = (intrinsics.height, intrinsics.width)
    if rgb.shape != (*size, 3) or depth_m.shape != size:
        raise ValueError(
            f"intrinsics are for {size[1]}x{size[0]} pixels, but the colour image has shape "
            f"{rgb.shape} and the depth image {depth_m.shape}"
        )
    mask = colour_mask(rgb, config or BallColour())
    best: BallDetection | None = None
    rejections = []
    for blob in _blobs(mask):
        whole = _evaluate(blob, mask, depth_m, intrinsics, radius_m)
        if isinstance(whole, Rejection):
            found = _split_by_depth(blob, mask, depth_m, intrinsics, radius_m)
            if not found:
                rejections.append(whole)
        else:
            found = [whole]
        for detection in found:
            if best is None or detection.quality > best.quality:
                best = detection
    return best, rejections


def colour_mask(rgb: np.ndarray, colour: BallColour) -> np.ndarray:
    """Mask of the pixels with the ball's colour, uint8 0 or 255, shape (H, W)."""
    hsv = cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2HSV)
    least = (colour.min_saturation, colour.min_value)
    low, high = colour.hue - colour.hue_width, colour.hue + colour.hue_width
    mask = cv2.inRange(hsv, (max(low, 0), *least), (min(high, 179), 255, 255))
    if low < 0:
        mask = cv2.bitwise_or(mask, cv2.inRange(hsv, (180 + low, *least), (179, 255, 255)))
    if high > 179:
        mask = cv2.bitwise_or(mask, cv2.inRange(hsv, (0, *least), (high - 180, 255, 255)))
    return mask


# ------------------------------------------------------------------------------- candidates
@dataclass(frozen=True)
class _Blob:
    """A connected part of the mask: bounding box (first pixel, size), filled mask, pixels."""

    u0: int
    v0: int
    filled: np.ndarray
    pixels: int

    def depths(self, depth_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Depth within the bounding box, m, and where the blob has one; both of its shape."""
        height, width = self.filled.shape
        depth = depth_m[self.v0 : self.v0 + height, self.u0 : self.u0 + width]
        return depth, (self.filled > 0) & (depth > 0.0) & (depth < np.inf)


def _blobs(mask: np.ndarray, u0: int = 0, v0: int = 0) -> list[_Blob]:
    """Find the connected parts of a mask from (u0, v0) on, largest first, holes filled."""
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    blobs = []
    for contour in contours:
        # The area within the pixel centres of the border; half the border is missing.
        if cv2.contourArea(contour) + 0.5 * len(contour) < MIN_PIXELS:
            continue
        u, v, width, height = cv2.boundingRect(contour)
        filled = np.zeros((height, width), np.uint8)
        cv2.drawContours(filled, [contour], 0, 255, cv2.FILLED, offset=(-u, -v))
        blobs.append(_Blob(u0 + u, v0 + v, filled, cv2.countNonZero(filled)))
    blobs.sort(key=lambda blob: -blob.pixels)
    return blobs[:_MAX_BLOBS]


def _split_by_depth(
    blob: _Blob, mask: np.ndarray, depth_m: np.ndarray, camera: Intrinsics, radius_m: float
) -> list[BallDetection]:
    """Look for the ball within a blob that merges it with other things of its colour."""
    height, width = blob.filled.shape
    depth, left = blob.depths(depth_m)
    found: list[BallDetection] = []
    # Depth is often lost at an edge: close what that breaks out of the outline.
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    for _ in range(4):
        values = np.sort(depth[left])
        if len(values) < MIN_PIXELS:
            break
        ends = np.searchsorted(values, values + 1.5 * radius_m, side="right")
        start = int(np.argmax(ends - np.arange(len(values))))
        near = values[start] - 0.25 * radius_m
        layer = left & (depth >= near) & (depth <= near + 1.75 * radius_m)
        left &= ~layer
        if np.count_nonzero(layer) > 0.98 * blob.pixels:
            break
        closed = cv2.morphologyEx(
            np.where(layer, np.uint8(255), np.uint8(0)), cv2.MORPH_CLOSE, kernel
        )
        layer_mask = np.zeros_like(mask)
        layer_mask[blob.v0 : blob.v0 + height, blob.u0 : blob.u0 + width] = closed
        for part in _blobs(closed, blob.u0, blob.v0):
            detection = _evaluate(part, layer_mask, depth_m, camera, radius_m)
            if isinstance(detection, BallDetection):
                found.append(detection)
    return found


# --------------------------------------------------------------------------------- one ball
@dataclass(frozen=True)
class _Patch:
    """The part of the image around a blob that holds the whole ball, as far as the image does.

    Parameters
    ----------
    inside, coloured : ndarray of bool, shape (h, w)
        Pixels of the blob, and of the blob or the ball's colour.
    depth : ndarray, shape (h, w)
        Depth, m; 0 where unknown.
    rays : ndarray, shape (h, w, 3)
        Unit rays through the pixels.
    view : Intrinsics
        Of this part.
    distance_m : float
        First guess of the distance of the ball's centre, m.
    blame : Rejection
        What is known of it, should something speak against it.
    """

    inside: np.ndarray
    coloured: np.ndarray
    depth: np.ndarray
    rays: np.ndarray
    view: Intrinsics
    distance_m: float
    blame: Rejection


@dataclass(frozen=True)
class _Outline:
    """Outline of a blob: unit rays through it, and the nearest depth just outside, m or inf."""

    rays: np.ndarray
    outside_m: np.ndarray


@dataclass(frozen=True)
class _Fit:
    """A sphere fitted to a blob.

    Parameters
    ----------
    direction : ndarray, shape (3,)
        Unit vector to the centre.
    distance_m : float
        Distance of the centre, m.
    on_outline : float
        Part of the outline that lies on the sphere's.
    arc : float
        Part of the sphere's outline that is seen.
    residual_m : float
        Systematic departure of the surface from the sphere, rms, m.
    pixel_rad : float
        Angle of a pixel there, rad.
    """

    direction: np.ndarray
    distance_m: float
    on_outline: float
    arc: float
    residual_m: float
    pixel_rad: float


def _evaluate(
    blob: _Blob, mask: np.ndarray, depth_m: np.ndarray, camera: Intrinsics, radius_m: float
) -> BallDetection | Rejection:
    """Fit the ball to a blob, or tell what speaks against it."""
    patch = _cut_out(blob, mask, depth_m, camera, radius_m)
    if isinstance(patch, Rejection):
        return patch
    fit = _fit_sphere(patch, radius_m)
    if fit is None:
        return replace(patch.blame, cause=Cause.SURFACE)
    if fit.on_outline < _MIN_ON_OUTLINE or fit.arc < _MIN_ARC:
        return replace(patch.blame, cause=Cause.OUTLINE, value=fit.on_outline)
    if fit.residual_m > _MAX_RESIDUAL_RADII * radius_m:
        return replace(patch.blame, cause=Cause.BULGE, value=fit.residual_m)
    return _judge(patch, fit, camera, radius_m)


def _cut_out(
    blob: _Blob, mask: np.ndarray, depth_m: np.ndarray, camera: Intrinsics, radius_m: float
) -> _Patch | Rejection:
    """Surroundings of a blob, unless it cannot be the ball by its size at its depth."""
    height, width = blob.filled.shape
    box_depth, known = blob.depths(depth_m)
    own_depth = box_depth[known]
    blame = Rejection(
        Cause.NO_DEPTH, (blob.u0, blob.v0, width, height), blob.pixels, len(own_depth)
    )
    if len(own_depth) < MIN_PIXELS:
        return blame
    # First guess of the distance: half of a disc lies within 0.7 r of its middle.
    middle = _unit(camera.rays(blob.u0 + 0.5 * (width - 1), blob.v0 + 0.5 * (height - 1)))
    distance = _median(own_depth) / middle[2] + 0.7 * radius_m
    if distance < 1.5 * radius_m:
        return replace(blame, cause=Cause.TOO_NEAR, distance_m=float(distance))
    expected_px = _outline_area_px(middle, distance, radius_m, camera)
    area_ratio = blob.pixels / expected_px
    blame = replace(
        blame, cause=Cause.SIZE, distance_m=float(distance), area_ratio=float(area_ratio)
    )
    if not 0.7 * MIN_VISIBLE_FRACTION < area_ratio < 1.6:
        return blame

    pad = 3 + max(0, int(2.4 * np.sqrt(expected_px / np.pi)) - min(width, height))
    u0, v0 = max(0, blob.u0 - pad), max(0, blob.v0 - pad)
    u1 = min(camera.width, blob.u0 + width + pad)
    v1 = min(camera.height, blob.v0 + height + pad)
    inside = np.zeros((v1 - v0, u1 - u0), bool)
    inside[blob.v0 - v0 :, blob.u0 - u0 :][:height, :width] = blob.filled > 0
    view = camera.window(u0, v0, u1 - u0, v1 - v0)
    depth = np.asarray(depth_m[v0:v1, u0:u1], dtype=float)
    return _Patch(
        inside=inside,
        coloured=inside | (mask[v0:v1, u0:u1] > 0),
        depth=np.where((depth > 0.0) & (depth < np.inf), depth, 0.0),
        rays=_unit_rays(view),
        view=view,
        distance_m=distance,
        blame=blame,
    )


def _fit_sphere(patch: _Patch, radius_m: float) -> _Fit | None:
    """Direction and distance of the centre, in turns; None if too little is to be seen."""
    outline = _outline(patch)
    inside = np.flatnonzero(patch.inside)
    rays, depth = patch.rays.reshape(-1, 3)[inside], patch.depth.ravel()[inside]
    direction = _unit(np.ones(len(rays)) @ rays)
    rays = rays[depth > 0.0]
    range_m = depth[depth > 0.0] / rays[:, 2]
    distance = patch.distance_m
    pixel_rad = float(direction[2] / np.sqrt(patch.view.fx * patch.view.fy))
    residual = np.nan
    for turn in range(3):
        before = distance
        direction, on_outline, arc = _fit_direction(
            outline, direction, distance, radius_m, pixel_rad=pixel_rad, search=turn == 0
        )
        surface = _central_surface(rays, range_m, direction, radius_m)
        if surface is None:
            return None
        distance = surface.distance_m
        if turn == 2 or (turn > 0 and abs(distance - before) < 2e-4):
            residual = surface.residual_m()
            break
    return _Fit(direction, distance, on_outline, arc, residual, pixel_rad)


def _judge(
    patch: _Patch, fit: _Fit, camera: Intrinsics, radius_m: float
) -> BallDetection | Rejection:
    """Compare the whole picture with the fitted sphere's."""
    expected_px = _outline_area_px(fit.direction, fit.distance_m, radius_m, camera)
    # Angles from the axis are compared by their cosines: d cos = -sin d angle.
    cone_cos = np.sqrt(1.0 - (radius_m / fit.distance_m) ** 2)
    pixel_cos = fit.pixel_rad * radius_m / fit.distance_m
    cos = patch.rays @ fit.direction
    middle_z = fit.distance_m * fit.direction[2]
    behind = patch.depth > middle_z + 2.0 * radius_m
    before = (patch.depth > 0.0) & (patch.depth < middle_z - 2.0 * radius_m)
    visible = patch.coloured & (cos >= cone_cos - 0.5 * pixel_cos) & ~before & ~behind
    fraction = min(1.0, float(np.count_nonzero(visible) / expected_px))
    if fraction < MIN_VISIBLE_FRACTION:
        return replace(patch.blame, cause=Cause.HIDDEN, value=fraction)
    quality = fraction * fit.on_outline
    quality *= float(np.exp(-np.square(fit.residual_m / (0.08 * radius_m))))
    position = fit.distance_m * fit.direction
    pixel = camera.project(position)
    return BallDetection(
        position_m=position,
        quality=float(quality),
        visible_fraction=fraction,
        residual_m=fit.residual_m,
        pixel=(float(pixel[0]), float(pixel[1])),
        radius_px=float(np.sqrt(expected_px / np.pi)),
    )


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.sqrt(np.sum(np.square(vectors), axis=-1, keepdims=True))


def _unit_rays(view: Intrinsics) -> np.ndarray:
    """Unit rays through all pixels, shape (h, w, 3); seven times as fast as by ``rays``."""
    x = (np.arange(view.width) - view.cx) / view.fx
    y = (np.arange(view.height)[:, None] - view.cy) / view.fy
    rays = np.empty((view.height, view.width, 3))
    z = 1.0 / np.sqrt(x * x + y * y + 1.0)
    rays[..., 0], rays[..., 1], rays[..., 2] = x * z, y * z, z
    return rays


def _median(values: np.ndarray) -> float:
    """Median of finite numbers; the checks of ``np.median`` take longer than the median."""
    half = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, half)[half])
    parted = np.partition(values, (half - 1, half))
    return 0.5 * (float(parted[half - 1]) + float(parted[half]))


def _lengths(points: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Distances of plane points, shape (2, ...), from one or as many others."""
    return np.sqrt(np.square(points[0] - origin[0]) + np.square(points[1] - origin[1]))


def _outline_area_px(
    direction: np.ndarray, distance_m: float, radius_m: float, camera: Intrinsics
) -> float:
    """Area of the image of a whole sphere, pixels: an ellipse, the cut of a cone by a plane."""
    sin2 = min((radius_m / distance_m) ** 2, 0.9)
    cos2_axis = max(direction[2] ** 2, sin2 + 0.05)
    ellipse = np.pi * sin2 * np.sqrt(1.0 - sin2) / (cos2_axis - sin2) ** 1.5
    return float(camera.fx * camera.fy * ellipse)


def _outline(patch: _Patch) -> _Outline:
    """Outline halfway between neighbouring pixels within and without; none at the border."""
    inside, depth = patch.inside, patch.depth
    # Depth is often lost at an edge: take the nearest thing within two pixels.
    others = np.where(inside | (depth <= 0.0), np.inf, depth).astype(np.float32)
    nearest = cv2.erode(others, np.ones((5, 5), np.uint8))
    v_h, u_h = np.nonzero(inside[:, 1:] != inside[:, :-1])
    v_v, u_v = np.nonzero(inside[1:, :] != inside[:-1, :])
    outside = np.concatenate(
        [
            np.where(inside[v_h, u_h], nearest[v_h, u_h + 1], nearest[v_h, u_h]),
            np.where(inside[v_v, u_v], nearest[v_v + 1, u_v], nearest[v_v, u_v]),
        ]
    )
    u = np.concatenate([u_h + 0.5, u_v])
    v = np.concatenate([v_h, v_v + 0.5])
    return _Outline(_unit(patch.view.rays(u, v)), outside)


def _fit_direction(
    outline: _Outline,
    direction: np.ndarray,
    distance_m: float,
    radius_m: float,
    *,
    pixel_rad: float,
    search: bool,
) -> tuple[np.ndarray, float, float]:
    """Axis of the cone of known opening through the outline.

    Returns
    -------
    direction : ndarray, shape (3,)
        Unit vector towards the centre.
    on_outline : float
        Part of the outline that lies on the cone, without what a nearer thing cuts off.
    arc : float
        Part of the cone that has outline on it.
    """
    nearer_m = distance_m * direction[2] - 0.5 * radius_m
    rays = outline.rays[outline.outside_m >= nearer_m]
    if len(rays) < 6:
        return direction, 0.0, 0.0
    # In the plane at unit distance across `direction` the outline is a circle, all but exactly.
    x, y, z = direction
    axes = np.array([[z, 0.0, -x], [-x * y, x * x + z * z, -y * z]])
    axes /= np.sqrt(x * x + z * z)
    seen = np.vstack([axes, direction]) @ rays.T
    points = seen[:2] / seen[2]
    radius = radius_m / np.sqrt(distance_m**2 - radius_m**2)
    tolerance = max(1.2 * pixel_rad, 0.05 * radius)

    centre = _refine_circle(points, radius, np.zeros(2), 2.5 * tolerance)
    off = np.abs(_lengths(points, centre) - radius)
    if search and np.count_nonzero(off < tolerance) < 0.85 * len(off):
        start = _search_circle(points, radius, tolerance)
        if start is not None:
            centre = _refine_circle(points, radius, start, 1.5 * tolerance)
            off = np.abs(_lengths(points, centre) - radius)
    on = int(np.count_nonzero(off < tolerance))
    # A circle of radius n pixels crosses from pixel to pixel 8 n times.
    return _unit(direction + centre @ axes), on / len(off), on * pixel_rad / (8.0 * radius)


def _refine_circle(points: np.ndarray, radius: float, start: np.ndarray, cut: float) -> np.ndarray:
    """Centre of a circle of known radius through points, (2, N); those off by ``cut`` are out."""
    u, v = points
    x, y = start
    # A little damping: an arc alone says little along its own direction.
    damping = 1e-3 * len(u)
    for _ in range(8):
        du, dv = u - x, v - y
        length = np.maximum(np.sqrt(du * du + dv * dv), 1e-12)
        error = length - radius
        weight = np.square(np.maximum(0.0, 1.0 - np.square(error / cut)))
        du, dv = du / length, dv / length
        weighted_u, weighted_v = weight * du, weight * dv
        # The normal equations of two unknowns: np.linalg.solve takes as long as all the rest.
        uu, vv, uv = weighted_u @ du + damping, weighted_v @ dv + damping, weighted_u @ dv
        right_u, right_v = weighted_u @ error, weighted_v @ error
        determinant = uu * vv - uv * uv
        step_x = (vv * right_u - uv * right_v) / determinant
        step_y = (uu * right_v - uv * right_u) / determinant
        x, y = x + step_x, y + step_y
        if max(abs(step_x), abs(step_y)) < 5e-3 * cut:
            break
    return np.array([x, y])


def _search_circle(points: np.ndarray, radius: float, tolerance: float) -> np.ndarray | None:
    """Centre with the most points on the circle and few outside, over pairs of points."""
    count = points.shape[1]
    chosen = points[:, np.linspace(0, count - 1, min(count, 32)).astype(int)]
    first, second = np.triu_indices(chosen.shape[1], 1)
    half = 0.5 * _lengths(chosen[:, second], chosen[:, first])
    usable = (half > 0.25 * radius) & (half < radius)
    if not usable.any():
        return None
    one, other, half = chosen[:, first[usable]], chosen[:, second[usable]], half[usable]
    chord, middle = other - one, 0.5 * (one + other)
    height = np.sqrt(radius**2 - half**2)
    across = np.stack([-chord[1], chord[0]]) * (height / (2.0 * half))
    centres = np.concatenate([middle + across, middle - across], axis=1)
    off = _lengths(points[:, None], centres[..., None]) - radius
    score = np.sum(np.abs(off) < tolerance, axis=1) - 2.0 * np.sum(off > 2.0 * tolerance, axis=1)
    return centres[:, int(np.argmax(score))]


@dataclass(frozen=True)
class _Surface:
    """Points on the ball's surface.

    Parameters
    ----------
    across : ndarray, shape (N, 2)
        x and y of the unit rays.
    sideways2_m2 : ndarray, shape (N,)
        Squared distance from the axis, m^2.
    values_m : ndarray, shape (N,)
        The centre's distance by each point, m.
    distance_m : float
        Their mean.
    """

    across: np.ndarray
    sideways2_m2: np.ndarray
    values_m: np.ndarray
    distance_m: float

    def residual_m(self) -> float:
        """Rms of what a tilt or a wrong bulge explains, less what noise alone would, m."""
        count = len(self.values_m)
        shape = np.vstack([self.across.T, self.sideways2_m2])
        shape -= shape.mean(axis=1, keepdims=True)
        shape /= np.abs(shape).max(axis=1, keepdims=True) + 1e-12
        off = self.values_m - self.distance_m
        normal = shape @ shape.T + 1e-9 * count * np.eye(3)
        model = np.linalg.solve(normal, shape @ off) @ shape
        noise2 = float((off - model) @ (off - model)) / count
        # Neighbouring pixels share part of their noise, hence twice the three parameters' share.
        systematic2 = float(model @ model) / count - 6.0 * noise2 / count
        return float(np.sqrt(max(0.0, systematic2)))


def _central_surface(
    rays: np.ndarray, range_m: np.ndarray, direction: np.ndarray, radius_m: float
) -> _Surface | None:
    """Take the ball's surface, and the distance of its centre from it.

    A pixel at range R along a ray at an angle b to the centre sees the sphere if the centre is at
    R cos b + sqrt(r^2 - R^2 sin^2 b). The median throws out what is not the ball.
    """
    cos = rays @ direction
    sideways2 = np.square(range_m) * np.maximum(0.0, 1.0 - np.square(cos))
    central = np.flatnonzero(sideways2 < radius_m**2)
    if len(central) < MIN_PIXELS:
        return None
    values = range_m[central] * cos[central] + np.sqrt(radius_m**2 - sideways2[central])
    off = np.abs(values - _median(values))
    near = off < 3.0 * max(1.4826 * _median(off), 0.001)
    central, values = central[near], values[near]
    if len(central) < MIN_PIXELS:
        return None
    return _Surface(rays[central, :2], sideways2[central], values, float(values.mean()))
