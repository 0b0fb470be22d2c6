"""What the arm carries, as the camera sees it. A new kind of feature adds a class and a line."""

from __future__ import annotations

import numpy as np

from fvs_detector_node.images import Region
from fvs_ros.camera import Intrinsics
from fvs_sim_node.camera import CameraPose
from fvs_sim_node.config import BALL_RGBA, SimConfig
from fvs_sim_node.shapes import BulletClient, box, sphere
from fvs_sim_node.tag import TagPicture


class Carried:
    """A body at the end of the arm; its pose is that of its frame in the camera's."""

    #: Depth behind its front by which it is further out on the arm, m.
    depth_m = 0.0
    #: Rotation vector from facing the camera at home, rad; None for a body that does not face it.
    tilt_rad: np.ndarray | None = None
    #: Distance of its rod behind it, m.
    rod_gap_m = 0.0

    def __init__(self, config: SimConfig) -> None:
        self._config = config

    def shape(self, client: BulletClient) -> int:
        """A visual shape of PyBullet."""
        raise NotImplementedError

    def part(self, pose: CameraPose, camera: Intrinsics) -> Region | None:
        """The part of the image that shows it; None if it is out of view."""
        raise NotImplementedError

    def paint(
        self,
        rgb: np.ndarray,
        depth_m: np.ndarray,
        view: Intrinsics,
        poses: list[CameraPose],
        rng: np.random.Generator,
    ) -> None:
        """Paint what the renderer cannot, blurred over the poses during an exposure."""


class CarriedBall(Carried):
    """The red ball."""

    def shape(self, client: BulletClient) -> int:
        """A sphere."""
        return sphere(client, self._config.ball_radius_m, BALL_RGBA)

    def part(self, pose: CameraPose, camera: Intrinsics) -> Region | None:
        """Around its outline."""
        radius_m, z = self._config.ball_radius_m, pose.position_m[2]
        if z < 2.0 * radius_m:
            return None
        middle_px, radius_px = camera.project(pose.position_m), camera.fx * radius_m / z
        return _in_view(np.array([middle_px - radius_px, middle_px + radius_px]), camera)


class CarriedTag(Carried):
    """The tags of a layout on white paper."""

    tilt_rad = np.array([0.4, 0.4, 0.0])  # seen squarely it tells its pose less well

    def __init__(self, config: SimConfig) -> None:
        super().__init__(config)
        self._tag, self._picture = config.tag, TagPicture(config.tag)
        self._flat = self._tag.extent_m[2] == 0.0
        self.depth_m = 0.5 * self._tag.extent_m.max()  # the flange hides none of it
        self.rod_gap_m = 0.03 if self._flat else 0.0

    def shape(self, client: BulletClient) -> int:
        """A box with its sides in the planes of the tags; a plate's front, if it is flat."""
        half_m = 0.5 * self._tag.extent_m
        behind_m = 0.001 if self._flat else 0.0  # half the thickness of a plate
        white = (1.0, 1.0, 1.0, 1.0)
        return box(client, half_m + [0.0, 0.0, behind_m], white, (0.0, 0.0, -behind_m))

    def part(self, pose: CameraPose, camera: Intrinsics) -> Region | None:
        """Around all tags, if one looks at the camera."""
        corners_m = self._picture.corners_m @ pose.rotation.T + pose.position_m
        if corners_m[:, 2].min() < 0.05 or not self._tag.facing(pose.rotation, pose.position_m):
            return None
        return _in_view(camera.project(corners_m), camera)

    def paint(
        self,
        rgb: np.ndarray,
        depth_m: np.ndarray,
        view: Intrinsics,
        poses: list[CameraPose],
        rng: np.random.Generator,
    ) -> None:
        """Paint the tags."""
        self._picture.paint(rgb, depth_m, view, poses, rng)


#: By the value of the parameter ``feature``.
CARRIED: dict[str, type[Carried]] = {"ball": CarriedBall, "pose": CarriedTag}


def _in_view(points_px: np.ndarray, camera: Intrinsics) -> Region | None:
    region = Region.around(points_px).grown(0, camera)
    return region if min(region.width, region.height) >= 8 else None
