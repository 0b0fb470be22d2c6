"""What the arm carries, and what stands in the room, as the camera sees them.

A new kind of feature adds a class and a line.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import cv2
import numpy as np

from fvs_detector_node.images import Region
from fvs_detector_node.tag_corners import TagReader
from fvs_detector_node.tags import SQUARE
from fvs_ros.camera import Intrinsics
from fvs_sim_node.camera import D435, RigidPose
from fvs_sim_node.config import BALL_RGBA, SimConfig
from fvs_sim_node.shapes import BulletClient, box, sphere


@dataclass(frozen=True)
class Print:
    """How a tag is drawn."""

    #: Pixels of a cell in the texture.
    cell_px: int = 16
    #: Samples on each side of an image's pixel, at most, and of a whole print, at least: with more
    #: the poses of near prints are no more exact.
    samples: int = 4
    print_samples: int = 800
    #: Deviation of the lens's blur, px.
    blur_px: float = 0.6
    #: Brightness of the ink and of the paper, grey levels.
    ink: float = 20.0
    paper: float = 235.0
    #: Deviation of a pixel's noise, grey levels.
    noise: float = 2.0
    #: A print is in view where the depth is within this of its plane's, m.
    near_m: float = 0.006
    #: It is read from 2 pixels a cell on, and to 75 degrees from squarely.
    least_px: float = 2.0
    least_cosine: float = 0.26


PRINT = Print()
#: Colours, (H, W, 3), depths, m, (H, W), and the camera of an image or a part of one.
Image = tuple[np.ndarray, np.ndarray, Intrinsics]


class Carried:
    """A body on the arm or in the room; its pose is that of its frame in the camera's."""

    #: Depth behind its front by which it is further out on the arm, m.
    depth_m = 0.0
    #: Rotation vector from facing the camera at home, rad; None for a body that does not face it.
    tilt_rad: np.ndarray | None = None
    #: Distance of its rod behind it, m.
    rod_gap_m = 0.0
    #: Its image points, in its frame, (K, 3).
    points_m = np.zeros((1, 3))
    #: Most pixels that the renderer draws across its part of the image; the largest image has less.
    drawn_px = 2000

    def __init__(self, config: SimConfig) -> None:
        self._config = config

    def shape(self, client: BulletClient) -> int:
        """A visual shape of PyBullet."""
        raise NotImplementedError

    def part(self, pose: RigidPose, camera: Intrinsics) -> Region | None:
        """The part of the image that shows it; None if it is out of view."""
        raise NotImplementedError

    def legible(self, pose: RigidPose, camera: Intrinsics) -> bool:
        """Whether it can be measured from so near and at such an angle."""
        raise NotImplementedError

    def paint(self, image: Image, poses: list[RigidPose], rng: np.random.Generator) -> None:
        """Paint what the renderer cannot into an image, where its depth is the body's.

        Blurred over ``poses``, those in the camera's frame during the exposure.
        """


class CarriedBall(Carried):
    """The red ball."""

    def shape(self, client: BulletClient) -> int:
        """A sphere."""
        return sphere(client, self._config.ball_radius_m, BALL_RGBA)

    def part(self, pose: RigidPose, camera: Intrinsics) -> Region | None:
        """Around its outline."""
        radius_m, z = self._config.ball_radius_m, pose.position_m[2]
        if z < 2.0 * radius_m:
            return None
        middle_px, radius_px = camera.project(pose.position_m), camera.fx * radius_m / z
        return _in_view(np.array([middle_px - radius_px, middle_px + radius_px]), camera)

    def legible(self, pose: RigidPose, camera: Intrinsics) -> bool:
        """Its middle is in the image, and its front where there are depths."""
        near = pose.position_m[2] - self._config.ball_radius_m < D435.least_m
        return not near and camera.contains(camera.project(pose.position_m))


class CarriedTag(Carried):
    """The tags of a layout on white paper: textures, by homographies, where it is in view."""

    tilt_rad = np.array([0.4, 0.4, 0.0])  # seen squarely it tells its pose less well
    drawn_px = 200  # only what hides a print: that itself is painted pixel by pixel

    def __init__(self, config: SimConfig) -> None:
        super().__init__(config)
        self._tag = tag = config.tag
        TagReader(tag)  # checks the numbers
        self._flat = tag.extent_m[2] == 0.0
        self.depth_m = 0.5 * tag.extent_m.max()  # the flange hides none of it
        self.rod_gap_m = 0.03 if self._flat else 0.0
        self._textures = {
            number: np.pad(
                cv2.aruco.generateImageMarker(tag.dictionary, number, tag.cells * PRINT.cell_px),
                PRINT.cell_px,
                constant_values=255,
            )
            for number in tag.faces
        }
        m_px = tag.pitch_m / ((tag.cells + 2) * PRINT.cell_px)
        first_m = 0.5 * (tag.pitch_m - m_px)  # from the middle to the first pixel's
        self._to_tag = np.array([[m_px, 0, -first_m], [0, -m_px, first_m], [0, 0, 1]])
        self._square_m = tag.pitch_m * SQUARE
        self.points_m = np.concatenate([face.corners_m for face in tag.faces.values()])
        #: Corners of all prints with their borders, in the body's frame, (4 k, 3).
        self._corners_m = np.concatenate(
            [face.middle_m + self._square_m @ face.rotation.T for face in tag.faces.values()]
        )

    def shape(self, client: BulletClient) -> int:
        """A box with its sides in the planes of the tags; a plate's front, if it is flat."""
        half_m = 0.5 * self._tag.extent_m
        behind_m = 0.001 if self._flat else 0.0  # half the thickness of a plate
        white = (1.0, 1.0, 1.0, 1.0)
        return box(client, half_m + [0.0, 0.0, behind_m], white, (0.0, 0.0, -behind_m))

    def part(self, pose: RigidPose, camera: Intrinsics) -> Region | None:
        """Around all tags, if one looks at the camera."""
        corners_m = self._corners_m @ pose.rotation.T + pose.position_m
        if corners_m[:, 2].min() < 0.05 or not self._tag.facing(pose.rotation, pose.position_m):
            return None
        return _in_view(camera.project(corners_m), camera)

    def legible(self, pose: RigidPose, camera: Intrinsics) -> bool:
        """The whole of one of its tags is in the image, large and square enough."""
        tag = self._tag
        for face in (tag.faces[number] for number in tag.facing(pose.rotation, pose.position_m)):
            corners_m = face.corners_m @ pose.rotation.T + pose.position_m
            middle_m, normal = corners_m.mean(axis=0), (pose.rotation @ face.rotation)[:, 2]
            if corners_m[:, 2].min() < D435.near_m or -normal @ middle_m < (
                PRINT.least_cosine * np.linalg.norm(middle_m)
            ):
                continue
            corners_px = camera.project(corners_m)
            area_px = cv2.contourArea(corners_px.astype(np.float32))
            if camera.contains(corners_px) and area_px > (PRINT.least_px * tag.cells) ** 2:
                return True
        return False

    def paint(self, image: Image, poses: list[RigidPose], rng: np.random.Generator) -> None:
        """Paint the tags."""
        (rgb, depth_m, view), middle = image, poses[len(poses) // 2]
        for number in self._tag.facing(middle.rotation, middle.position_m):
            face = self._tag.faces[number]
            own = RigidPose(face.middle_m, face.rotation)
            prints = [pose.pose_from_own(own) for pose in poses]
            print_ = prints[len(prints) // 2]
            corners_m = self._square_m @ print_.rotation.T + print_.position_m
            if corners_m[:, 2].min() <= 0.0:
                continue
            region = Region.around(view.project(corners_m)).grown(0, view)
            if not (region.width and region.height):
                continue
            part_view = region.view(view)
            grey = self._drawn(self._textures[number], part_view, prints)
            part = rgb[region.part]
            shown = self._shown(depth_m[region.part], part_view, print_)
            shade = part[shown] / 255.0
            shade *= (PRINT.ink + (PRINT.paper - PRINT.ink) / 255.0 * grey[shown])[:, None]
            shade += rng.normal(0.0, PRINT.noise, len(shade))[:, None]
            part[shown] = np.clip(np.rint(shade), 0, 255).astype(np.uint8)

    def _drawn(self, texture: np.ndarray, view: Intrinsics, prints: list[RigidPose]) -> np.ndarray:
        """A tag's brightness, 0 to 255, (H, W)."""
        fine = min(PRINT.samples, ceil(PRINT.print_samples / view.width))
        shift = 0.5 * (fine - 1)
        to_fine = np.array([[fine, 0.0, shift], [0.0, fine, shift], [0.0, 0.0, 1.0]])
        total = np.zeros((view.height, view.width))
        for pose in prints:
            picture = cv2.warpPerspective(
                texture,
                to_fine @ _px_from_plane(pose, view) @ self._to_tag,
                (fine * view.width, fine * view.height),
                borderMode=cv2.BORDER_CONSTANT,
                borderValue=255,
            )
            total += cv2.resize(picture, (view.width, view.height), interpolation=cv2.INTER_AREA)
        return cv2.GaussianBlur(total / len(prints), (0, 0), PRINT.blur_px)

    def _shown(self, depth_m: np.ndarray, view: Intrinsics, print_: RigidPose) -> np.ndarray:
        """Where the print is the nearest thing, bool (H, W): in its square, in its plane."""
        u, v = np.arange(view.width), np.arange(view.height)[:, None]
        plane_from_px = np.linalg.inv(_px_from_plane(print_, view))
        # Right, up, and 1, each over the depth of the plane.
        x, y, inverse_1_m = (a * u + b * v + c for a, b, c in plane_from_px)
        inside = np.maximum(np.abs(x), np.abs(y)) <= 0.5 * self._tag.pitch_m * inverse_1_m
        return np.asarray(
            inside & (np.abs(depth_m * inverse_1_m - 1.0) < PRINT.near_m * inverse_1_m)
        )


#: By the value of the parameter ``feature``.
CARRIED: dict[str, type[Carried]] = {"ball": CarriedBall, "pose": CarriedTag}


def _px_from_plane(pose: RigidPose, view: Intrinsics) -> np.ndarray:
    """From a print's plane, (right, up, 1), m, to the depth times (u, v, 1), (3, 3)."""
    return view.matrix @ np.column_stack([pose.rotation[:, :2], pose.position_m])


def _in_view(points_px: np.ndarray, camera: Intrinsics) -> Region | None:
    region = Region.around(points_px).grown(0, camera)
    return region if min(region.width, region.height) >= 8 else None


def exposed(
    pose: RigidPose, linear_m_s: np.ndarray, angular_rad_s: np.ndarray, exposure_s: float
) -> list[RigidPose]:
    """Poses during an exposure about its middle, of a body that moves at these speeds, (3,)."""
    if not (linear_m_s.any() or angular_rad_s.any()):
        return [pose]
    return [
        RigidPose(
            pose.position_m + after_s * linear_m_s,
            cv2.Rodrigues(np.asarray(after_s * angular_rad_s))[0] @ pose.rotation,
        )
        for after_s in exposure_s * np.linspace(-0.5, 0.5, 5)
    ]
