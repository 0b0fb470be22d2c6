"""The pinhole camera: intrinsics, distortion, projection, and where a camera looks.

Pixel convention of OpenCV and of ``sensor_msgs/CameraInfo``: integer coordinates are pixel
centres, so a pixel (u, v) covers [u - 1/2, u + 1/2] x [v - 1/2, v + 1/2]. The camera frame is
optical: x right, y down, z forward.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np

from fvs_ros.params import Parameters, parameter

#: Frame of ball and target unless told otherwise: that of a RealSense's colour camera.
CAMERA_FRAME = "camera_color_optical_frame"


@dataclass(frozen=True)
class FeatureConfig(Parameters):
    """In which frame the feature is seen."""

    feature_frame: str = parameter(CAMERA_FRAME, "frame of ball, target and images")


@dataclass(frozen=True)
class CameraTopicsConfig(Parameters):
    """Where the images come from."""

    camera_topics: str = parameter(
        "", "prefix of the camera's topics, before /color/image_raw; empty: camera or camera/camera"
    )


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera without distortion: size, focal lengths and principal point, pixels."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @classmethod
    def of_pixels(cls, width: int, height: int) -> Intrinsics:
        """Of a camera of which nothing is known: its rays are the pixels themselves."""
        return cls(width, height, 1.0, 1.0, 0.0, 0.0)

    def coarser(self, step: float) -> Intrinsics:
        """Of the same image in pixels that are so many times as large."""
        size = ceil(self.width / step), ceil(self.height / step)
        cx, cy = (self.cx + 0.5) / step - 0.5, (self.cy + 0.5) / step - 0.5
        return Intrinsics(*size, self.fx / step, self.fy / step, cx, cy)

    @property
    def matrix(self) -> np.ndarray:
        """The camera matrix, (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, point_m: np.ndarray) -> np.ndarray:
        """Pixels (u, v), (..., 2), of points in the camera's frame, m, (..., 3), with z > 0."""
        point = np.asarray(point_m, dtype=float)
        return (self.fx, self.fy) * point[..., :2] / point[..., 2:] + (self.cx, self.cy)

    def contains(self, points_px: np.ndarray) -> bool:
        """Whether points, pixels, (..., 2), are all in the image."""
        size = self.width, self.height
        return bool(np.all((points_px >= 0.0) & (points_px < size)))

    def rays(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Rays (x/z, y/z, 1), (..., 3), through pixels u and v of one shape (...)."""
        x = (np.asarray(u, dtype=float) - self.cx) / self.fx
        y = (np.asarray(v, dtype=float) - self.cy) / self.fy
        return np.stack([x, y, np.ones_like(x)], axis=-1)


#: Distortion models of ``sensor_msgs``, and the numbers of coefficients that they may have: the
#: first two are one in OpenCV, and drivers name either.
DISTORTION_MODELS = {
    "plumb_bob": (0, 4, 5, 8, 12, 14),
    "rational_polynomial": (0, 4, 5, 8, 12, 14),
    "equidistant": (4,),
}
#: What drivers call them, too.
_ALSO = {"fisheye": "equidistant", "kannala_brandt": "equidistant"}
_MAX_COEFFICIENT = 1000.0


@dataclass(frozen=True)
class CameraModel:
    """A camera as it is: pinhole and distortion."""

    intrinsics: Intrinsics  #: of the image, and of the image without distortion as well
    model: str = "plumb_bob"  #: one of ``DISTORTION_MODELS``
    coefficients: tuple[float, ...] = ()  #: of the distortion, in the model's order

    def __post_init__(self) -> None:
        model, count = self.model, len(self.coefficients)
        if model not in DISTORTION_MODELS:
            known = ", ".join(DISTORTION_MODELS)
            raise ValueError(f"camera_info has distortion model {model[:40]!r}; known are {known}")
        if count not in DISTORTION_MODELS[model]:
            expected = " or ".join(map(str, DISTORTION_MODELS[model]))
            raise ValueError(
                f"camera_info has {count} coefficients for {model}, expected {expected}"
            )
        if not all(abs(value) <= _MAX_COEFFICIENT for value in self.coefficients):
            raise ValueError(
                f"camera_info has a distortion coefficient that is not finite, or above "
                f"{_MAX_COEFFICIENT:g}"
            )

    @property
    def distorts(self) -> bool:
        """Whether the image departs from a pinhole camera's."""
        # An equidistant lens is none, even with all coefficients zero.
        return self.model == "equidistant" or any(self.coefficients)


def camera_model(info: Any) -> CameraModel:
    """The camera of images by their calibration, any object with the fields of a ``CameraInfo``.

    A ``ValueError`` says why it cannot be used.
    """
    width, height, k = info.width, info.height, [float(number) for number in info.k]
    fx, skew, cx, zero, fy, cy, *last = k
    size = f"an image of {width}x{height}"
    if fx == 0.0:
        raise ValueError("camera_info has K[0] = 0: the camera is not calibrated")
    if [skew, zero, *last] != [0.0, 0.0, 0.0, 0.0, 1.0]:
        raise ValueError(f"camera_info has K = {k}, expected [fx 0 cx 0 fy cy 0 0 1]")
    if not 0.05 * width < fx < 100.0 * width or not 0.05 * height < fy < 100.0 * height:
        raise ValueError(
            f"camera_info has focal lengths {fx:g} and {fy:g} px, which do not fit {size}"
        )
    if not -width < cx < 2.0 * width or not -height < cy < 2.0 * height:
        raise ValueError(
            f"camera_info has its principal point at ({cx:g}, {cy:g}), far out of {size}"
        )
    if max(info.binning_x, info.binning_y) > 1:
        raise ValueError("camera_info has binning, which is not supported: switch it off")
    u0, v0 = info.roi.x_offset, info.roi.y_offset
    region = u0, v0, info.roi.width or width - u0, info.roi.height or height - v0
    if min(region[2:]) < 1 or u0 + region[2] > width or v0 + region[3] > height:
        raise ValueError(f"camera_info has a region {region} outside of {width}x{height}")
    intrinsics = Intrinsics(*region[2:], fx, fy, cx - u0, cy - v0)
    model, values = info.distortion_model, [float(value) for value in info.d]
    if model.lower() in ("", "none") and not any(values):
        return CameraModel(intrinsics)
    name = _ALSO.get(model, model)
    # More zeros than the model has are passed over.
    while values and values[-1] == 0.0 and len(values) not in DISTORTION_MODELS.get(name, ()):
        values.pop()
    return CameraModel(intrinsics, name, tuple(values))
