"""Fit of a sphere of known radius to a part of an image: direction by outline, distance by depth.

Without depth, the outline's size tells the distance, too: a radius wrong by a share of itself, such
as a tenth of a pixel of twenty, makes the distance wrong by that share.

The outline of a sphere lies on a cone about the direction to its centre. The known radius and the
distance fix the cone's opening. In the plane at unit distance, normal to a first guess of that
direction, the outline is almost a circle of known radius. An arc suffices if the sphere is partly
hidden.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from fvs_ros.camera import Intrinsics


@dataclass(frozen=True)
class Acceptance:
    """Acceptance bounds for a candidate.

    Looser bounds find a few more balls, but 6 to 21 false ones in other red objects instead of one.
    """

    #: Least number of pixels, and of pixels with depth: fewer do not show a shape.
    pixels: int = 20
    #: Least quality, so also least part of the ball that is to be seen. A flat disc has none.
    quality: float = 0.3
    #: Bounds of the candidate's area over the ball's, before the distance is fitted. They allow for
    #: a first guess that is 25 % off.
    least_area: float = 0.7 * 0.3
    most_area: float = 1.6
    #: Nearest centre, radii: at one the camera touches the ball.
    nearest_radii: float = 1.5
    #: Least share of the candidate's outline that lies on the sphere's; others cut off the rest.
    on_outline: float = 0.6
    #: Tolerance of outline points on a circle, as a share of its radius; at least 1.2 pixels.
    circle: float = 0.05
    circle_px: float = 1.2
    #: Depths further off than this count of standard deviations are not the ball's.
    deviations: float = 3.0


ACCEPT = Acceptance()
#: Rounds of the fit of a circle: after 10, a half hidden ball was off by a pixel.
_ROUNDS = 30


@dataclass(frozen=True)
class Patch:
    """A part of the image with a candidate in it; its arrays have the shape (h, w)."""

    inside: np.ndarray  # bool: the pixels of the candidate
    coloured: np.ndarray  # bool: those of the ball's colour
    depth_m: np.ndarray  # 0 where unknown
    view: Intrinsics  # of this part

    @cached_property
    def rays(self) -> np.ndarray:
        """Unit rays through all pixels, shape (h, w, 3)."""
        v, u = np.mgrid[: self.view.height, : self.view.width]
        return unit(self.view.rays(u, v))


@dataclass(frozen=True)
class SphereFit:
    """A sphere fitted to a candidate."""

    direction: np.ndarray  # unit vector to the centre, (3,)
    distance_m: float  # of the centre
    on_outline: float  # share of the candidate's outline that lies on the sphere's
    residual_m: float  # systematic departure of the surface from the sphere, rms
    pixel_rad: float  # angle of a pixel there


def fit_sphere(patch: Patch, distance_m: float, radius_m: float) -> SphereFit | None:
    """Fit direction and distance of the centre alternately, from a first guess of the distance.

    None if too few depths lie on a sphere.
    """
    outline, outside_m = _outline(patch)
    inside = np.flatnonzero(patch.inside)
    own, depth_m = patch.rays.reshape(-1, 3)[inside], patch.depth_m.ravel()[inside]
    direction = unit(np.ones(len(own)) @ own)
    known = depth_m > 0.0
    own = own[known]
    range_m = depth_m[known] / own[:, 2]
    pixel_rad = float(direction[2] / np.sqrt(patch.view.fx * patch.view.fy))
    for iteration in range(3):
        before_m = distance_m
        # An edge against a nearer object is not the sphere's outline.
        free = outline[outside_m >= distance_m * direction[2] - 0.5 * radius_m]
        direction, on_outline = _fit_direction(free, direction, distance_m, radius_m, pixel_rad)
        surface = _distances(own, range_m, direction, radius_m)
        if surface is None:
            return None
        distances_m, shape = surface
        distance_m = float(distances_m.mean())
        if iteration > 0 and abs(distance_m - before_m) < 2e-4:
            break
    residual_m = _systematic(distances_m - distance_m, shape)
    return SphereFit(direction, distance_m, on_outline, residual_m, pixel_rad)


def fit_by_size(patch: Patch, rgb: np.ndarray, radius_m: float) -> SphereFit | None:
    """Fit direction and distance of the centre to the outline alone; None without an arc of it."""
    outline = _fine_outline(patch.inside, rgb, patch.view)
    if not len(outline):
        return None
    direction = unit(outline.sum(axis=0))
    pixel_rad = float(direction[2] / np.sqrt(patch.view.fx * patch.view.fy))
    for _ in range(3):
        points, axes = _across(outline, direction)
        # A fine outline: what hides a part of the ball stands out sooner.
        circle = fit_circle(points.T, 0.5 * ACCEPT.circle_px * pixel_rad)
        if circle is None:
            return None
        centre, radius, on_outline = circle
        direction = unit(direction + centre @ axes)
    return SphereFit(direction, radius_m * np.hypot(1.0, 1.0 / radius), on_outline, 0.0, pixel_rad)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors, shape (..., n), divided by their lengths."""
    return vectors / np.sqrt(np.sum(np.square(vectors), axis=-1, keepdims=True))


# ------------------------------------------------------------------------------- direction
def _outline(patch: Patch) -> tuple[np.ndarray, np.ndarray]:
    """Outline halfway between neighbouring pixels inside and outside; none at the border.

    Unit rays through it, (N, 3), and the nearest depth just outside, m, (N,), or infinite.
    """
    inside = patch.inside
    # Depth is often lost at an edge: take the nearest thing within two pixels.
    outside = np.where(inside | (patch.depth_m <= 0.0), np.inf, patch.depth_m).astype(np.float32)
    nearest = cv2.erode(outside, np.ones((5, 5), np.uint8))
    v_h, u_h = np.nonzero(inside[:, 1:] != inside[:, :-1])
    v_v, u_v = np.nonzero(inside[1:, :] != inside[:-1, :])
    across = np.where(inside[v_h, u_h], nearest[v_h, u_h + 1], nearest[v_h, u_h])
    along = np.where(inside[v_v, u_v], nearest[v_v + 1, u_v], nearest[v_v, u_v])
    outside_m = np.concatenate([across, along])
    u = np.concatenate([u_h + 0.5, u_v])
    v = np.concatenate([v_h, v_v + 0.5])
    return unit(patch.view.rays(u, v)), outside_m


def _fine_outline(inside: np.ndarray, rgb: np.ndarray, view: Intrinsics) -> np.ndarray:
    """Unit rays, (N, 3), through the outline, to parts of a pixel, by colours, (h, w, 3)."""
    pixels = []
    for axis in (0, 1):
        first, second = (np.swapaxes(inside, 0, axis)[part] for part in np.s_[:-1, 1:])
        at = np.argwhere(np.swapaxes(first != second, 0, axis))
        inward = np.where(inside[tuple(at.T)], -1, 1)
        outside = at[:, axis] + (inward < 0)
        # Two pixels beyond are of the background or the ball; four in between are of both.
        index: list[np.ndarray] = [at[:, [0]], at[:, [1]]]
        index[axis] = outside[:, None] + inward[:, None] * np.arange(-2, 4)
        index[axis] = np.clip(index[axis], 0, inside.shape[axis] - 1)
        across = rgb[tuple(index)].astype(float)
        across -= across[:, :1]
        # The ball's part of a pixel is linear in its colour, not in its saturation.
        ball = across[:, -1:]
        shares = np.sum(across * ball, axis=2) / np.maximum(np.sum(ball**2, axis=2), 1.0)
        shares = np.clip(shares[:, 1:-1], 0.0, 1.0)
        edge = at.astype(float)
        edge[:, axis] = outside + inward * (2.5 - shares.sum(axis=1))
        pixels.append(edge)
    v, u = np.concatenate(pixels).T
    return unit(view.rays(u, v))


def _fit_direction(
    rays: np.ndarray,
    direction: np.ndarray,
    distance_m: float,
    radius_m: float,
    pixel_rad: float,
) -> tuple[np.ndarray, float]:
    """Axis of the cone of known opening through an outline, and the outline's share on it."""
    if len(rays) < 6:
        return direction, 0.0
    points, axes = _across(rays, direction)
    radius = radius_m / np.sqrt(distance_m**2 - radius_m**2)
    tolerance = max(ACCEPT.circle_px * pixel_rad, ACCEPT.circle * radius)

    centre = np.zeros(2)
    # Of a ball that is partly hidden the first guess is off by up to half a radius.
    for cut in (radius, 0.3 * radius, 2.5 * tolerance):
        centre = _refine_circle(points, radius, centre, cut)
    errors = np.abs(np.hypot(*(points - centre[:, None])) - radius)
    return unit(direction + centre @ axes), float(np.mean(errors < tolerance))


def _across(rays: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where rays cut the plane at unit distance, (2, N), and the axes of that plane, (2, 3)."""
    x, y, z = direction
    axes = np.array([[z, 0.0, -x], [-x * y, x * x + z * z, -y * z]])
    axes /= np.sqrt(x * x + z * z)
    along_axes = np.vstack([axes, direction]) @ rays.T
    return along_axes[:2] / along_axes[2], axes


def fit_circle(points: np.ndarray, near: float) -> tuple[np.ndarray, float, float] | None:
    """Centre and radius of the circle on which most points, (n, 2), lie, and their share on it.

    ``near`` is the distance from a circle that counts half. None if too few are on it.
    """
    if len(points) < 6:
        return None
    origin = points.mean(axis=0)
    around = points - origin
    columns = np.insert(around, 2, 1.0, axis=1)
    square, weights = np.sum(around**2, axis=1), np.ones(len(points))
    radius = 0.0
    for _ in range(_ROUNDS):
        before = radius
        solution = np.linalg.lstsq(columns * weights[:, None], square * weights, rcond=None)[0]
        middle = 0.5 * solution[:2]
        radius = float(np.sqrt(max(solution[2] + middle @ middle, 0.0)))
        off = np.linalg.norm(around - middle, axis=1) - radius
        weights = 1.0 / (1.0 + (off / near) ** 2)
        if abs(radius - before) < 1e-3 * near:
            break
    share = float(np.mean(np.abs(off) < max(near, ACCEPT.circle * radius)))
    return (origin + middle, radius, share) if share >= ACCEPT.on_outline else None


def _refine_circle(points: np.ndarray, radius: float, start: np.ndarray, cut: float) -> np.ndarray:
    """Centre of a circle of known radius through points, (2, N); those off by ``cut`` are out."""
    u, v = points
    x, y = start
    # Some damping: an arc hardly determines the centre along its own direction.
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


# -------------------------------------------------------------------------------- distance
def _distances(
    rays: np.ndarray, range_m: np.ndarray, direction: np.ndarray, radius_m: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """The centre's distance by each point of the surface, m, (N,), and where they are, (3, N).

    A pixel at range R along a ray at an angle b to the centre sees the sphere if the centre is at
    R cos b + sqrt(r^2 - R^2 sin^2 b). The median rejects pixels of other objects.
    """
    cos = rays @ direction
    sideways2 = np.square(range_m) * np.maximum(0.0, 1.0 - np.square(cos))
    central = np.flatnonzero(sideways2 < radius_m**2)
    if len(central) < ACCEPT.pixels:
        return None
    values = range_m[central] * cos[central] + np.sqrt(radius_m**2 - sideways2[central])
    errors = np.abs(values - np.median(values))
    # 1.4826 times the median is a normal deviation; depth comes in whole millimetres.
    near = errors < ACCEPT.deviations * max(1.4826 * np.median(errors), 0.001)
    central, values = central[near], values[near]
    if len(central) < ACCEPT.pixels:
        return None
    return values, np.vstack([rays[central, :2].T, sideways2[central]])


def _systematic(errors_m: np.ndarray, shape: np.ndarray) -> float:
    """Rms deviation explained by a tilt or a wrong bulge, minus the part due to noise, m."""
    count = len(errors_m)
    shape = shape - shape.mean(axis=1, keepdims=True)
    shape /= np.abs(shape).max(axis=1, keepdims=True) + 1e-12
    normal = shape @ shape.T + 1e-9 * count * np.eye(len(shape))
    model = np.linalg.solve(normal, shape @ errors_m) @ shape
    noise2 = float((errors_m - model) @ (errors_m - model)) / count
    # Neighbouring pixels share part of their noise, hence twice the parameters' share.
    systematic2 = float(model @ model) / count - 2.0 * len(shape) * noise2 / count
    return float(np.sqrt(max(0.0, systematic2)))
