"""The pinhole camera: intrinsics, projection, and where a camera looks.

Pixel convention of OpenCV and of ``sensor_msgs/CameraInfo``: integer coordinates are pixel
centres, so a pixel (u, v) covers [u - 1/2, u + 1/2] x [v - 1/2, v + 1/2]. The camera frame is
optical: x right, y down, z forward.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

#: Frame of ball and target unless told otherwise: that of a RealSense's colour camera.
CAMERA_FRAME = "camera_color_optical_frame"


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera without distortion.

    Parameters
    ----------
    width, height : int
        Image size, pixels.
    fx, fy : float
        Focal lengths, pixels.
    cx, cy : float
        Principal point, pixels.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise ValueError(f"image size must be positive, got {self.width}x{self.height}")
        if not all(np.isfinite([self.fx, self.fy, self.cx, self.cy])):
            raise ValueError("intrinsics must be finite")
        if self.fx <= 0.0 or self.fy <= 0.0:
            raise ValueError(f"focal lengths must be positive, got fx={self.fx} fy={self.fy}")

    def project(self, point_m: np.ndarray) -> np.ndarray:
        """Pixel coordinates of points in the camera frame.

        Parameters
        ----------
        point_m : ndarray, shape (..., 3)
            Points in the optical frame, m, with z > 0.

        Returns
        -------
        ndarray, shape (..., 2)
            (u, v), pixels.
        """
        point = np.asarray(point_m, dtype=float)
        z = point[..., 2]
        return np.stack(
            [self.fx * point[..., 0] / z + self.cx, self.fy * point[..., 1] / z + self.cy],
            axis=-1,
        )

    def rays(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Viewing rays with z = 1 through pixels.

        Parameters
        ----------
        u, v : array_like
            Pixel coordinates of one shape (...).

        Returns
        -------
        ndarray, shape (..., 3)
            (x/z, y/z, 1); times a depth it is the point.
        """
        x = (np.asarray(u, dtype=float) - self.cx) / self.fx
        y = (np.asarray(v, dtype=float) - self.cy) / self.fy
        return np.stack([x, y, np.ones_like(x)], axis=-1)

    def window(self, u0: int, v0: int, width: int, height: int) -> Intrinsics:
        """Intrinsics of the sub-image whose first pixel is (u0, v0)."""
        return replace(self, width=width, height=height, cx=self.cx - u0, cy=self.cy - v0)


def look_at(eye_m: np.ndarray, target_m: np.ndarray, up: np.ndarray | None = None) -> np.ndarray:
    """Rotation of an optical frame at ``eye_m`` that looks at ``target_m``.

    Parameters
    ----------
    eye_m, target_m : array_like, shape (3,)
        Camera centre and a point on its optical axis, m, world frame.
    up : array_like, shape (3,), optional
        Direction that is up in the image, world frame; default +z.

    Returns
    -------
    ndarray, shape (3, 3)
        ``R`` with ``p_world = R @ p_camera + eye``.

    Raises
    ------
    ValueError
        If eye and target coincide, or the view is along ``up``.
    """
    forward = np.asarray(target_m, dtype=float) - np.asarray(eye_m, dtype=float)
    up_vector = np.array([0.0, 0.0, 1.0]) if up is None else np.asarray(up, dtype=float)
    right = np.cross(forward, up_vector)
    if np.linalg.norm(forward) < 1e-9 or np.linalg.norm(right) < 1e-9:
        raise ValueError(f"camera at {eye_m} cannot look at {target_m} with up {up_vector}")
    z_axis = forward / np.linalg.norm(forward)
    x_axis = right / np.linalg.norm(right)
    return np.stack([x_axis, np.cross(z_axis, x_axis), z_axis], axis=1)
