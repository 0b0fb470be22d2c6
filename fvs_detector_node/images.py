"""Parts of an image, and images without the lens's distortion."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from fvs_ros.camera import CameraModel, Intrinsics


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
        (u0, v0), (u1, v1) = np.floor(points_px.min(axis=0)), np.ceil(points_px.max(axis=0))
        return cls(int(u0), int(v0), int(u1 - u0) + 1, int(v1 - v0) + 1)

    @property
    def part(self) -> tuple[slice, slice]:
        """Rows and columns of the image."""
        return np.s_[self.v0 : self.v0 + self.height, self.u0 : self.u0 + self.width]

    def view(self, camera: Intrinsics) -> Intrinsics:
        """Intrinsics of this part of a camera's image."""
        cx, cy = camera.cx - self.u0, camera.cy - self.v0
        return Intrinsics(self.width, self.height, camera.fx, camera.fy, cx, cy)

    def grown(self, margin: int, camera: Intrinsics) -> Region:
        """The part with a margin, pixels, as far as a camera's image goes; may be empty."""
        u0, v0 = max(0, self.u0 - margin), max(0, self.v0 - margin)
        u1 = min(camera.width, self.u0 + self.width + margin)
        v1 = min(camera.height, self.v0 + self.height + margin)
        return Region(u0, v0, max(0, u1 - u0), max(0, v1 - v0))

    def contains(self, other: Region) -> bool:
        """Whether another part lies inside."""
        return (
            self.u0 <= other.u0
            and self.v0 <= other.v0
            and other.u0 + other.width <= self.u0 + self.width
            and other.v0 + other.height <= self.v0 + self.height
        )


class Rectifier:
    """Removes the distortion from a camera's images or parts of them, with the same intrinsics."""

    def __init__(self, camera: CameraModel) -> None:
        self.camera = camera
        self._maps: tuple[np.ndarray, np.ndarray] | None = None
        if camera.distorts:
            make = (
                cv2.fisheye.initUndistortRectifyMap
                if camera.model == "equidistant"
                else cv2.initUndistortRectifyMap
            )
            view, coefficients = camera.intrinsics, np.array(camera.coefficients)
            size = view.width, view.height
            self._maps = make(view.matrix, coefficients, np.eye(3), view.matrix, size, cv2.CV_32FC1)

    def part(self, image: np.ndarray, region: Region) -> np.ndarray:
        """A part of a whole image without distortion; 0 outside of the camera's view.

        Depth, (H, W), is that of the nearest pixel: a mean of two surfaces lies on neither.
        """
        if self._maps is None:
            return image[region.part]
        u, v = (each[region.part] for each in self._maps)
        return cv2.remap(image, u, v, cv2.INTER_LINEAR if image.ndim == 3 else cv2.INTER_NEAREST)
