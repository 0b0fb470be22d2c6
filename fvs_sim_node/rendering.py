"""The depth camera: PyBullet's software renderer, made to agree with the pinhole model.

A sub-image is drawn with an off-axis frustum and equals the crop of the full image, so that a
small window around the ball costs a small part of a full frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pybullet
from pybullet_utils.bullet_client import BulletClient
from scipy.spatial.transform import Rotation

from fvs_detector_node.detection import BallColour, colour_mask
from fvs_detector_node.region import Region
from fvs_ros.camera import Intrinsics, look_at

#: Depth range that is drawn, m. What lies beyond has no depth, as with a real camera.
NEAR_M, FAR_M = 0.25, 4.0

#: The renderer draws half a pixel to the right and up of the pinhole model; this takes it back.
_SHIFT_PX = (-0.5, 0.5)

#: A colour is looked for in an image this many times smaller, and given a margin.
_COARSE, _MARGIN_PX = 4, 16

# Depth buffer from which on nothing was drawn.
_NOTHING = 0.999999
_LIGHT = (-0.6, -0.5, 1.0)
# OpenGL cameras look along -z with y up.
_OPTICAL_TO_GL = np.diag([1.0, -1.0, -1.0])
# About z, as `base` and `base_link` of a UR differ.
_HALF_TURN = np.diag([-1.0, -1.0, 1.0])
_WALL_TOP_RGB, _WALL_BOTTOM_RGB = (214, 224, 234), (244, 246, 247)


@dataclass(frozen=True)
class CameraPose:
    """Where the camera is: ``p_world = rotation @ p_camera + position_m``.

    Parameters
    ----------
    position_m : ndarray, shape (3,)
        Camera centre, world frame, m.
    rotation : ndarray, shape (3, 3)
        Axes of the optical frame (x right, y down, z forward) as columns, world frame.
    """

    position_m: np.ndarray
    rotation: np.ndarray

    def to_camera(self, point_world_m: np.ndarray) -> np.ndarray:
        """Points, shape (..., 3), m, from the world frame into the camera's."""
        return (np.asarray(point_world_m) - self.position_m) @ self.rotation

    def in_base_link(self) -> CameraPose:
        """The same seen from ROS's ``base_link``, which is the world turned by half a turn."""
        return CameraPose(_HALF_TURN @ self.position_m, _HALF_TURN @ self.rotation)

    @property
    def quaternion_xyzw(self) -> np.ndarray:
        """The rotation as a unit quaternion, shape (4,)."""
        return Rotation.from_matrix(self.rotation).as_quat(canonical=True)


def pose_from_look_at(
    eye_m: tuple[float, ...], target_m: tuple[float, ...], up: tuple[float, ...] = (0.0, 0.0, 1.0)
) -> CameraPose:
    """Put a camera at ``eye_m`` that looks at ``target_m``, with ``up`` upwards in the image."""
    return CameraPose(
        np.array(eye_m, dtype=float), look_at(np.array(eye_m), np.array(target_m), np.array(up))
    )


#: Named camera poses. ``front`` stands in front of the arm and to its side, from where the wrist
#: hardly ever hides the ball. ``overhead`` hangs above the arm and looks down, as in the paper; the
#: wrist hides the ball more often.
CAMERA_PRESETS = {
    "front": pose_from_look_at((-1.3, 1.0, 0.85), (-0.47, -0.1, 0.33)),
    "overhead": pose_from_look_at((-1.2, 0.4, 1.8), (-0.47, -0.1, 0.33)),
}


def camera_preset(name: str) -> CameraPose:
    """Look up a named camera pose.

    Raises
    ------
    ValueError
        If the name is unknown.
    """
    try:
        return CAMERA_PRESETS[name]
    except KeyError:
        raise ValueError(
            f"unknown camera {name!r}; known are {', '.join(sorted(CAMERA_PRESETS))}"
        ) from None


class Renderer:
    """Draws one world as seen by one pinhole camera.

    Parameters
    ----------
    client : BulletClient
        PyBullet's functions for the world.
    intrinsics : Intrinsics
        The full image.
    """

    def __init__(self, client: BulletClient, intrinsics: Intrinsics) -> None:
        self._client = client
        self.intrinsics = intrinsics
        rows = np.linspace(0.0, 1.0, intrinsics.height)[:, None]
        colours = (1.0 - rows) * np.array(_WALL_TOP_RGB) + rows * np.array(_WALL_BOTTOM_RGB)
        opaque = np.insert(np.round(colours).astype(np.uint8), 3, 255, axis=1)
        self._wall = opaque.view(np.uint32)

    def render(
        self, pose: CameraPose, region: Region | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Draw the image, or a part of it.

        Parameters
        ----------
        pose : CameraPose
            Where the camera is.
        region : Region, optional
            The part to draw; default the whole image.

        Returns
        -------
        rgb : ndarray of uint8, shape (H, W, 3)
            Colours.
        depth_m : ndarray of float32, shape (H, W)
            Depth along the optical axis, m; 0 where there is none.
        """
        part = region or Region.whole(self.intrinsics)
        colours, raw = self._draw(pose, part.view(self.intrinsics))
        nothing = raw >= _NOTHING
        scale = np.float32(1.0 / NEAR_M - 1.0 / FAR_M)
        depth = np.float32(1.0) / (np.float32(1.0 / NEAR_M) - scale * raw)
        depth[nothing] = 0.0
        # Four bytes at once, a tenth of the time that it takes by colours.
        wall = self._wall[part.part[0]]
        np.copyto(colours.view(np.uint32)[..., 0], wall, where=nothing)
        return cv2.cvtColor(colours, cv2.COLOR_RGBA2RGB), depth

    def find_colour(self, pose: CameraPose, colour: BallColour) -> Region | None:
        """Part of the image that holds all of a colour, by a coarse drawing; None if none does."""
        full, n = self.intrinsics, _COARSE
        size = (-(-full.width // n), -(-full.height // n))
        lens = (full.fx / n, full.fy / n, full.cx / n, full.cy / n)
        rgb = self._draw(pose, Intrinsics(*size, *lens))[0][..., :3]
        u, v, width, height = cv2.boundingRect(colour_mask(rgb, colour))
        if width == 0:
            return None
        return Region(u * n, v * n, width * n, height * n).grown(_MARGIN_PX, full)

    def _draw(self, pose: CameraPose, camera: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
        """Colours (H, W, 4) and the depth buffer (H, W), 1 where nothing is."""
        _, _, rgba, buffer, _ = self._client.getCameraImage(
            camera.width,
            camera.height,
            viewMatrix=_view_matrix(pose),
            projectionMatrix=_projection_matrix(camera),
            lightDirection=_LIGHT,
            lightColor=(1.0, 1.0, 1.0),
            lightDistance=3.0,
            shadow=0,
            lightAmbientCoeff=0.62,
            lightDiffuseCoeff=0.42,
            lightSpecularCoeff=0.08,
            renderer=pybullet.ER_TINY_RENDERER,
            flags=pybullet.ER_NO_SEGMENTATION_MASK,
        )
        shape = (camera.height, camera.width)
        return (
            np.reshape(np.asarray(rgba, dtype=np.uint8), (*shape, 4)),
            np.reshape(np.asarray(buffer, dtype=np.float32), shape),
        )


def _view_matrix(pose: CameraPose) -> list[float]:
    rotation = _OPTICAL_TO_GL @ pose.rotation.T
    view = np.eye(4)
    view[:3, :3] = rotation
    view[:3, 3] = -rotation @ pose.position_m
    return view.T.ravel().tolist()


def _projection_matrix(camera: Intrinsics) -> list[float]:
    du, dv = _SHIFT_PX
    projection = np.zeros((4, 4))
    projection[0, 0] = 2.0 * camera.fx / camera.width
    projection[0, 2] = 1.0 - 2.0 * (camera.cx + 0.5 + du) / camera.width
    projection[1, 1] = 2.0 * camera.fy / camera.height
    projection[1, 2] = 2.0 * (camera.cy + 0.5 + dv) / camera.height - 1.0
    projection[2, 2] = -(FAR_M + NEAR_M) / (FAR_M - NEAR_M)
    projection[2, 3] = -2.0 * FAR_M * NEAR_M / (FAR_M - NEAR_M)
    projection[3, 2] = -1.0
    return projection.T.ravel().tolist()
