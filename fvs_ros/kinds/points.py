"""Image points of webcams, px: what a tracker finds, without depth and calibration.

z is u and v of one point after the other, camera by camera. Nothing is known of how they move under
a twist: their Jacobian is learned as it is, by networks, or by a chain before each webcam. A pixel
counts as the length ``pixel_m``: by default, a tracker's noise of 0.3 px as a ball's of 1.5 mm, so
that limits, gates and holds are as many deviations of the one as of the other.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from fvs_ros.kinds.kind import UNNAMED, Kind
from fvs_ros.params import ParameterError, parameter
from fvs_ros.topics import CALIBRATE, CONTROLLER, KindTopics, kind_topics, message_class, of_camera

_COUNT = 1
#: Most cameras, points of all of them, and what the cameras' names are made of: those of topics.
_MOST_CAMERAS, _MOST_POINTS, _NAME = 4, 100, re.compile("[A-Za-z][A-Za-z0-9_]*")


def _names(count: int, camera: str = "") -> tuple[str, ...]:
    prefix = f"{camera}_" if camera else ""
    return tuple(f"{prefix}{axis}{i + 1}" for i in range(count) for axis in "uv")


_TOPICS = kind_topics(
    "geometry_msgs/msg/PolygonStamped",
    (
        "image_points",
        "All points in a fixed order, x to the right and y down, px, stamped with the exposure; "
        "silent while one of them is not seen.",
    ),
    ("target_points", "Where the points are to be seen, as in `image_points`."),
    ("object_points", "The same of an object, for targets relative to it; optional."),
)
#: All but the calibration, which takes no pixels.
_NODES = tuple(node for node in _TOPICS.tool.subscribers if node != CALIBRATE)


@dataclass(frozen=True)
class Points(Kind):
    """Some image points, of one camera or of several."""

    name, what = "points", "pattern"
    columns = axes = _names(_COUNT)
    box_size, rigid = 0, False
    outliers = 0.03  # the middle of what is partly hidden
    models = ("models/ur5_webcams.npz", "")
    topics = _TOPICS._replace(
        tool=replace(_TOPICS.tool, subscribers=_NODES),
        object=replace(_TOPICS.object, publishers=(), subscribers=(CONTROLLER,)),
        object_truth=replace(_TOPICS.object_truth, publishers=(), subscribers=()),
    )

    point_count: int = parameter(_COUNT, "Count of the image points; for points.", 1, 64)
    pixel_m: float = parameter(
        0.005,
        "Length that a pixel counts as, m; for points. Limits and gains of lengths then hold for "
        "pixels.",
        1e-5,
        0.1,
    )
    cameras: tuple[str, ...] = parameter(
        (UNNAMED,),
        "Names of the cameras, such as left and right, whose image points are on left/image_points "
        "and right/image_points; for points. One without a name has no prefix.",
    )

    picture_px: tuple[int, ...] = parameter(
        (0, 0),
        "Width and height of the pictures, beyond which no target is taken; for points. 0: "
        "unknown.",
        0,
        20_000,
        size=2,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        cameras = self.cameras
        named = all(map(_NAME.fullmatch, cameras)) and len(set(cameras)) == len(cameras)
        if cameras != (UNNAMED,) and not (named and 1 <= len(cameras) <= _MOST_CAMERAS):
            raise ParameterError(
                f"cameras: expected up to {_MOST_CAMERAS} different names of letters, digits and "
                f"_, got {list(cameras)}"
            )
        if self.point_count * len(cameras) > _MOST_POINTS:
            raise ParameterError(
                f"point_count: expected at most {_MOST_POINTS} points of all cameras, or their "
                f"Jacobian is too large for a message, got {self.point_count * len(cameras)}"
            )
        names = [name for camera in cameras for name in _names(self.point_count, camera)]
        for attribute in ("columns", "axes"):
            object.__setattr__(self, attribute, tuple(names))
        if len(cameras) == 1 and self.any_frame:
            usual = type(self).topics
            mine = KindTopics(*(of_camera(each, cameras[0]) for each in usual))
            object.__setattr__(self, "topics", mine._replace(sliding=usual.sliding))

    @cached_property
    def parts(self) -> tuple[Points, ...]:
        """The points of each camera."""
        return tuple(replace(self, cameras=(camera,)) for camera in self.cameras)

    @classmethod
    def of_numbers(
        cls, count: int, camera_mount: str, cameras: tuple[str, ...] = (UNNAMED,)
    ) -> Points:
        """Half as many points as numbers of a camera."""
        points, rest = divmod(count, 2 * max(1, len(cameras)))
        if rest:
            raise ValueError(
                f"image points of {len(cameras)} cameras have an even count of numbers each, got "
                f"{count}"
            )
        return cls(points, cameras=cameras, camera_mount=camera_mount)

    @cached_property
    def unit(self) -> np.ndarray:
        """The length of a pixel, m, (d,)."""
        return np.full(2 * self.point_count * len(self.cameras), self.pixel_m)

    @property
    def freedom(self) -> int:
        """That of a rigid body, three at most of one point and five of two."""
        return min(self.size, {1: 3, 2: 5}.get(self.point_count, 6))

    def unseen(self, z: np.ndarray) -> str:
        """Why no camera can show z: it is not in the picture, where its size is known."""
        points, size = z.reshape(-1, 2), np.array(self.picture_px)
        if np.all((points >= 0.0) & (points <= size) | (size == 0)):
            return ""
        return f"{self.text(z)} is not in a picture of {size[0]} x {size[1]} px (picture_px)"

    def possible(self, jacobian: np.ndarray) -> np.ndarray:
        """The nearest Jacobian, (d, n), of no more motions than a rigid body's."""
        freedom = self.freedom
        if freedom >= min(jacobian.shape):
            return jacobian
        u, values, v = np.linalg.svd(jacobian, full_matrices=False)
        return np.asarray((u[:, :freedom] * values[:freedom]) @ v[:freedom])

    def along(self, chain: Any, joints_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The pixels, (m,), and their Jacobian, m/rad, (d, n), by a chain before a webcam."""
        z, by_joint = chain.position_and_jacobian(joints_rad)
        return z, self.possible(self.unit[:, None] * by_joint)

    def of_detection(self, detection: Any) -> np.ndarray:
        """Its points, px, (m,)."""
        return np.asarray(detection.px.ravel())

    def read(self, message: Any) -> np.ndarray:
        """Points of a ``PolygonStamped``, px, (m,)."""
        points = message.polygon.points
        if len(points) != self.point_count:
            raise ValueError(f"has {len(points)} points, expected {self.point_count}")
        return self.checked(np.array([(point.x, point.y) for point in points]).ravel())

    def write(self, message: Any, z: np.ndarray) -> None:
        """Fill in a ``PolygonStamped``."""
        point = message_class("geometry_msgs/msg/Point32")
        message.polygon.points = [point(x=u, y=v) for u, v in z.reshape(-1, 2).tolist()]

    def text(self, z: np.ndarray) -> str:
        """Points in words."""
        return ", ".join(f"({u:.1f}, {v:.1f})" for u, v in z.reshape(-1, 2)) + " px"

    def length_text(self, length_m: float, digits: int = 0) -> str:
        """A length in pixels."""
        return f"{length_m / self.pixel_m:.{max(digits, 1)}f} px"
