"""The simulated depth camera: its poses and the noise of its depths."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, floor

import cv2
import numpy as np

from fvs_ros.camera import Intrinsics
from fvs_ros.pixel_chain import Webcam


@dataclass(frozen=True)
class RigidPose:
    """Where a camera or a body is: ``p_parent = rotation @ p_own + position_m``.

    A camera's own frame is the optical one: x right, y down, z forward.
    """

    position_m: np.ndarray  # of its origin, (3,)
    rotation: np.ndarray  # columns: its axes, (3, 3)

    @classmethod
    def looking(cls, eye_m: tuple[float, ...], target_m: tuple[float, ...]) -> RigidPose:
        """A camera at ``eye_m``, upright, ``target_m`` in mid-image; world frame, m."""
        eye, forward = np.array(eye_m), np.subtract(target_m, eye_m)
        right = np.cross(forward, (0.0, 0.0, 1.0))
        z_axis, x_axis = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
        return cls(eye, np.stack([x_axis, np.cross(z_axis, x_axis), z_axis], axis=1))

    def rotated(self, rotation_rad: np.ndarray) -> RigidPose:
        """The same rotated about its origin by a rotation vector of its frame, rad, shape (3,)."""
        rotation = cv2.Rodrigues(np.asarray(rotation_rad, dtype=float))[0]
        return RigidPose(self.position_m, self.rotation @ rotation)

    def moved(self, translation_m: np.ndarray) -> RigidPose:
        """The same moved by a vector of the parent frame, m, shape (3,)."""
        return RigidPose(self.position_m + translation_m, self.rotation)

    def pose_from_own(self, body: RigidPose) -> RigidPose:
        """A body's pose, from its own frame into the parent's."""
        position_m = self.rotation @ body.position_m + self.position_m
        return RigidPose(position_m, self.rotation @ body.rotation)

    def to_own(self, points_m: np.ndarray) -> np.ndarray:
        """Points, shape (..., 3), m, from the parent frame into its own."""
        return (np.asarray(points_m) - self.position_m) @ self.rotation

    def pose_to_own(self, body: RigidPose) -> RigidPose:
        """A body's pose, from the parent frame into its own."""
        return RigidPose(self.to_own(body.position_m), self.rotation.T @ body.rotation)


#: Named camera poses. ``front`` is in front of the arm and to its side, where the wrist rarely
#: hides the ball. ``overhead`` looks down from above the arm, as in the paper; there the wrist
#: hides the ball more often. ``side`` is on the other side: it sees the ball at 60 to 90 degrees
#: from ``front``.
CAMERAS = {
    "front": RigidPose.looking((1.3, -1.0, 0.85), (0.47, 0.1, 0.33)),
    "overhead": RigidPose.looking((1.2, -0.4, 1.8), (0.47, 0.1, 0.33)),
    "side": RigidPose.looking((1.65, 0.8, 0.95), (0.47, 0.1, 0.33)),
}
#: A camera on the arm, in the frame of its last link: beside the flange, where a RealSense fits, it
#: looks along the tool, whose axis is in mid-image a quarter of a metre away.
BRACKET = RigidPose(np.array([0.0, -0.07, 0.02]), np.eye(3)).rotated(np.radians([-15.0, 0.0, 0.0]))


@dataclass(frozen=True)
class Lens(Intrinsics):
    """A webcam whose lens distorts, with its first coefficient."""

    k1: float = 0.0

    @property
    def webcam(self) -> Webcam:
        """The same, as a chain is fitted before it."""
        return Webcam(self.fx, (self.cx, self.cy), self.k1)

    def project(self, point_m: np.ndarray) -> np.ndarray:
        """Pixels of points in the camera frame."""
        return self.webcam.project(np.asarray(point_m, dtype=float))[0]

    def pinhole(self) -> tuple[Intrinsics, np.ndarray, np.ndarray]:
        """A camera without distortion that sees as much; u and v there of each pixel, (H, W)."""
        v, u = np.mgrid[: self.height, : self.width].astype(float)
        x, y = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        seen = radius = np.hypot(x, y)
        for _ in range(20):  # Newton's steps
            slope = 1.0 + 3.0 * self.k1 * radius**2
            radius = radius - (radius + self.k1 * radius**3 - seen) / slope
        grows = radius / np.maximum(seen, 1e-9)
        u, v = self.fx * grows * x, self.fy * grows * y
        cx, cy = 2 - floor(u.min()), 2 - floor(v.min())
        size = ceil(u.max()) + cx + 3, ceil(v.max()) + cy + 3
        pinhole = Intrinsics(*size, self.fx, self.fy, cx, cy)
        return pinhole, (u + cx).astype(np.float32), (v + cy).astype(np.float32)


@dataclass(frozen=True)
class StereoNoise:
    """Noise of a stereo depth camera, by default an Intel RealSense D435.

    The spread follows Intel's tuning guide for the D400 family: disparity * z^2 / (f * baseline).
    """

    #: Standard deviation of the disparity, pixels.
    disparity_px: float = 0.08
    #: Distance between the two imagers, m.
    baseline_m: float = 0.05
    #: Probability that a pixel has no depth.
    dropout: float = 0.01
    #: The same beside an edge.
    edge_dropout: float = 0.5
    #: Least range of the depths in 3 x 3 pixels at an edge, m.
    edge_m: float = 0.05
    #: Least depths at which its colours are sharp, and that it measures, m.
    near_m: float = 0.1
    least_m: float = 0.17


D435 = StereoNoise()


def add_depth_noise(
    depth_m: np.ndarray, fx: float, rng: np.random.Generator, scale: float = 1.0
) -> np.ndarray:
    """Add a real camera's noise to a depth image along z, m; 0 where there is none.

    ``fx`` is the focal length, pixels; ``scale`` is a factor on the spread and on the
    probabilities of loss, 0 gives a plain copy.
    """
    depth = np.array(depth_m, dtype=np.float32)
    if scale <= 0.0:
        return depth
    lost = depth <= 0.0
    kernel = np.ones((3, 3), np.uint8)
    edge = cv2.dilate(depth, kernel) - cv2.erode(depth, kernel) > D435.edge_m

    noise = rng.standard_normal(depth.shape, dtype=np.float32)
    # Neighbouring pixels share a quarter of the variance. The mean of 3 x 3 unit normals has a
    # standard deviation of 1/3.
    noise *= np.float32(np.sqrt(0.75))
    shared = cv2.blur(rng.standard_normal(depth.shape, dtype=np.float32), (3, 3))
    shared *= np.float32(1.5)
    noise += shared
    noise *= np.float32(D435.disparity_px / (fx * D435.baseline_m)) * np.square(depth)
    noise *= np.float32(scale)
    depth += noise
    depth *= np.float32(1e3)  # it comes in whole millimetres
    np.rint(depth, out=depth)
    depth *= np.float32(1e-3)

    chance = rng.random(depth.shape, dtype=np.float32)
    lost |= chance < np.float32(scale * D435.dropout)
    lost |= edge & (chance < np.float32(scale * D435.edge_dropout))
    lost |= depth < D435.least_m
    depth[lost] = 0.0
    return depth
