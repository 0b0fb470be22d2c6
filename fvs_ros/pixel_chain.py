"""A serial chain before a webcam: the pixels of the points that it carries.

The chain carries K points of its last link, in the camera's frame and up to scale. With
(x, y) = (p_1, p_2) / p_3, a point p is seen at

    (u, v) = f (1 + k1 (x^2 + y^2)) (x, y) + c.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fvs_ros.chain import SerialChain

#: Least distance along the line of sight, in units of a chain whose points are about 1 away.
_CLOSEST = 1e-3


@dataclass(frozen=True)
class Webcam:
    """What a webcam makes of a point before it."""

    focal_px: float  #: focal length f, px, positive
    centre_px: tuple[float, float]  #: principal point c, px
    k1: float = 0.0  #: first radial distortion coefficient
    #: How late the images are stamped, s: one stamped t shows the joints at t - late_s.
    late_s: float = 0.0
    #: How much later each row is exposed than the one above it, s: a rolling shutter.
    line_s: float = 0.0

    def __post_init__(self) -> None:
        if not (all(map(math.isfinite, self.numbers)) and self.focal_px > 0.0):
            raise ValueError(f"a lens is of {self.numbers.tolist()}")

    @property
    def numbers(self) -> np.ndarray:
        """f, c, k1, late_s and line_s, (6,)."""
        return np.array([self.focal_px, *self.centre_px, self.k1, self.late_s, self.line_s])

    @classmethod
    def of_numbers(cls, numbers: np.ndarray) -> Webcam:
        """The inverse of ``numbers``."""
        focal_px, u_px, v_px, *others = numbers.tolist()
        return cls(focal_px, (u_px, v_px), *others)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixels, (..., 2), of points in the camera's frame, (..., 3), and their derivatives.

        The latter are by the point, (..., 2, 3), and by the logarithm of f, by c and by k1,
        (..., 2, 4). A point that is not before the camera is far out of the picture.
        """
        depth = np.maximum(points[..., 2:], _CLOSEST)
        ray = points[..., :2] / depth
        square = np.sum(ray**2, axis=-1, keepdims=True)
        factor = self.focal_px * (1.0 + self.k1 * square)
        bent = 2.0 * self.focal_px * self.k1 * ray[..., :, None] * ray[..., None, :]
        by_ray = factor[..., None] * np.eye(2) + bent
        by_point = np.concatenate([by_ray, -by_ray @ ray[..., None]], axis=-1) / depth[..., None]
        by_lens = np.empty((*ray.shape, 4))
        by_lens[..., 0], by_lens[..., 3] = factor * ray, self.focal_px * square * ray
        by_lens[..., 1:3] = np.eye(2)
        return factor * ray + self.centre_px, by_point, by_lens


class _Pixels:
    """What answers as a :class:`~fvs_ros.chain.SerialChain` whose feature are pixels, (m,)."""

    #: As of a serial chain: its camera is as good as declared.
    lens: ClassVar[np.ndarray] = np.zeros(2)

    def position_and_jacobian(self, joints_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The pixels, (..., m), and their Jacobian, px/rad, (..., m, n), at joints, (..., n)."""
        raise NotImplementedError

    def jacobian(self, joints_rad: np.ndarray) -> np.ndarray:
        """The Jacobian, px/rad, (..., m, n), at joints, rad, (..., n)."""
        return self.position_and_jacobian(joints_rad)[1]


@dataclass(frozen=True)
class PixelChain(_Pixels):
    """A chain that carries points, and the lens through which they are seen.

    The pixels are point by point, u then v.
    """

    #: In the camera's frame; it carries a point, and the ways from there to the others.
    chain: SerialChain
    webcam: Webcam

    @property
    def play_rad(self) -> np.ndarray:
        """Play of each joint, rad (m), (n,)."""
        return self.chain.play_rad

    @property
    def joints(self) -> int:
        """Count of joints, n."""
        return self.chain.joints

    @property
    def numbers(self) -> int:
        """Count of numbers of the feature, m."""
        return self.chain.numbers * 2 // 3

    def position(self, joints_rad: np.ndarray) -> np.ndarray:
        """The pixels, (..., m), at joints, rad, (..., n)."""
        pixels = self.webcam.project(points_of(self.chain.position(joints_rad)))[0]
        return pixels.reshape(*joints_rad.shape[:-1], -1)

    def position_and_jacobian(self, joints_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The pixels, (..., m), and their Jacobian, px/rad, (..., m, n), at joints, (..., n)."""
        carried, slopes = self.chain.position_and_jacobian(joints_rad)
        pixels, by_point, _ = self.webcam.project(points_of(carried))
        jacobian = by_point @ slopes_of_points(slopes)
        *outer, joints = joints_rad.shape
        return pixels.reshape(*outer, -1), jacobian.reshape(*outer, -1, joints)


@dataclass(frozen=True)
class PixelChains(_Pixels):
    """One arm before several webcams, a chain for each: their scales differ.

    The pixels are those of all, camera by camera.
    """

    each: tuple[PixelChain, ...]  #: of each camera
    blind: tuple[int, ...] = ()  #: cameras that do not count now: their pixels stay at 0

    @property
    def play_rad(self) -> np.ndarray:
        """Play of each joint, rad (m), (n,)."""
        return self.each[0].play_rad

    @property
    def joints(self) -> int:
        """Count of joints, n."""
        return self.each[0].joints

    @property
    def numbers(self) -> int:
        """Count of numbers of the feature, m."""
        return sum(chain.numbers for chain in self.each)

    def position(self, joints_rad: np.ndarray) -> np.ndarray:
        """The pixels, (..., m), at joints, rad, (..., n)."""
        return self._counted([chain.position(joints_rad) for chain in self.each], -1)

    def position_and_jacobian(self, joints_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The pixels, (..., m), and their Jacobian, px/rad, (..., m, n), at joints, (..., n)."""
        pixels, jacobians = zip(
            *(chain.position_and_jacobian(joints_rad) for chain in self.each), strict=True
        )
        return self._counted(pixels, -1), self._counted(jacobians, -2)

    def _counted(self, parts: Sequence[np.ndarray], axis: int) -> np.ndarray:
        counted = [np.zeros_like(part) if i in self.blind else part for i, part in enumerate(parts)]
        return np.concatenate(counted, axis=axis)


AnyChain = SerialChain | PixelChain | PixelChains


def points_of(carried: np.ndarray) -> np.ndarray:
    """Points, (..., K, 3), of what a chain carries, (..., 3 K)."""
    points = carried.reshape(*carried.shape[:-1], -1, 3).copy()
    points[..., 1:, :] += points[..., :1, :]
    return points


def slopes_of_points(slopes: np.ndarray) -> np.ndarray:
    """Derivatives of the points, (..., K, 3, p), of those of what is carried, (..., 3 K, p)."""
    return np.moveaxis(points_of(np.swapaxes(slopes, -1, -2)), -3, -1)
