"""Parts of an image, and images without the lens's distortion."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan

import cv2
import numpy as np

from fvs_ros.camera import CameraModel, Intrinsics
from fvs_ros.rotations import rotation_from_vector

#: A lens that sees by less beyond a pinhole of its focal length needs no other views, rad.
_BEYOND_RAD = 0.1


@dataclass(frozen=True)
class Region:
    """A part of an image: first pixel (u0, v0) and size, pixels."""

    u0: int
    v0: int
    width: int
    height: int

    @classmethod
    def whole(cls, camera: Intrinsics) -> Region:
        """All of a camera's image."""
        return cls(0, 0, camera.width, camera.height)

    @classmethod
    def around(cls, points_px: np.ndarray) -> Region:
        """The smallest part with points, pixels, (n, 2)."""
        (u0, v0), (u1, v1) = points_px.min(axis=0).astype(int), points_px.max(axis=0).astype(int)
        return cls(int(u0), int(v0), int(u1 - u0) + 1, int(v1 - v0) + 1)

    @property
    def part(self) -> tuple[slice, slice]:
        """Rows and columns of the image."""
        return np.s_[self.v0 : self.v0 + self.height, self.u0 : self.u0 + self.width]

    def view(self, camera: Intrinsics) -> Intrinsics:
        """Intrinsics of this part of a camera's image."""
        return camera.window(self.u0, self.v0, self.width, self.height)

    def grown(self, margin: int, camera: Intrinsics) -> Region:
        """The part with a margin, pixels, as far as a camera's image goes."""
        u0, v0 = max(0, self.u0 - margin), max(0, self.v0 - margin)
        u1 = min(camera.width, self.u0 + self.width + margin)
        v1 = min(camera.height, self.v0 + self.height + margin)
        return Region(u0, v0, u1 - u0, v1 - v0)

    def overlap(self, other: Region) -> Region | None:
        """What this and another part have in common."""
        u0, v0 = max(self.u0, other.u0), max(self.v0, other.v0)
        u1 = min(self.u0 + self.width, other.u0 + other.width)
        v1 = min(self.v0 + self.height, other.v0 + other.height)
        return Region(u0, v0, u1 - u0, v1 - v0) if u1 > u0 and v1 > v0 else None

    def cuts_off(self, u: float, v: float, radius: float, camera: Intrinsics) -> bool:
        """Whether the part's border, but not the image's, cuts a circle off; all in pixels."""
        return bool(
            (u - radius < self.u0 and self.u0 > 0)
            or (v - radius < self.v0 and self.v0 > 0)
            or (u + radius > self.u0 + self.width < camera.width)
            or (v + radius > self.v0 + self.height < camera.height)
        )


class Rectifier:
    """Removes the distortion from a camera's images or parts of them, with the same intrinsics.

    ``turn``, (3, 3), takes the camera's frame to that of a pinhole camera which looks elsewhere.
    """

    def __init__(self, camera: CameraModel, turn: np.ndarray = np.eye(3)) -> None:  # noqa: B008
        self.camera, self.turn = camera, turn
        self._maps: tuple[tuple[np.ndarray, np.ndarray], np.ndarray] | None = None
        if not camera.distorts:
            return
        view = camera.intrinsics
        matrix = np.array([[view.fx, 0.0, view.cx], [0.0, view.fy, view.cy], [0.0, 0.0, 1.0]])
        coefficients = np.array(camera.coefficients)
        make = (
            cv2.fisheye.initUndistortRectifyMap
            if camera.model == "equidistant"
            else cv2.initUndistortRectifyMap
        )
        u, v = make(matrix, coefficients, turn, matrix, (view.width, view.height), cv2.CV_32FC1)
        # Nearest neighbours need maps of their own: the others' whole parts are rounded down.
        self._maps = (
            cv2.convertMaps(u, v, cv2.CV_16SC2),
            cv2.convertMaps(u, v, cv2.CV_16SC2, nninterpolation=True)[0],
        )

    def depth(self, depth_m: np.ndarray, region: Region) -> np.ndarray:
        """A part of the whole depth image, m (H, W), without distortion; 0 where there is none.

        It is that of the nearest pixel, because a mean of two surfaces lies on neither.
        """
        part = region.part
        if self._maps is None:
            return depth_m[part]
        return cv2.remap(depth_m, self._maps[1][part], np.empty(0), cv2.INTER_NEAREST)

    def colour(self, rgb: np.ndarray, region: Region) -> np.ndarray:
        """The same of the colours, uint8 (H, W, 3); black outside of the camera's view."""
        part = region.part
        if self._maps is None:
            return rgb[part]
        whole, fraction = self._maps[0]
        return cv2.remap(rgb, whole[part], fraction[part], cv2.INTER_LINEAR)


def wide_views(camera: CameraModel) -> list[Rectifier]:
    """The view along the optical axis; and, of a lens that sees more, one to each such side."""
    view = camera.intrinsics
    views = [Rectifier(camera)]
    if camera.model != "equidistant":
        return views
    edges = (
        (view.cx / view.fx, [0.0, 1.0, 0.0]),  # to the left
        ((view.width - view.cx) / view.fx, [0.0, -1.0, 0.0]),
        (view.cy / view.fy, [-1.0, 0.0, 0.0]),  # up
        ((view.height - view.cy) / view.fy, [1.0, 0.0, 0.0]),
    )
    for lens_rad, axis in edges:
        pinhole_rad = atan(lens_rad)
        if lens_rad - pinhole_rad > _BEYOND_RAD:
            # As far as the lens sees half of the view has something in it.
            tilt = np.array(axis) * (lens_rad - 0.5 * pinhole_rad)
            views.append(Rectifier(camera, rotation_from_vector(tilt)))
    return views
