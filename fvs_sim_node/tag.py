"""Printed tags in rendered images: textures, by homographies, where their paper is in view."""

from __future__ import annotations

import cv2
import numpy as np

from fvs_detector_node.images import Region
from fvs_detector_node.tag_corners import TagReader
from fvs_detector_node.tags import SQUARE, Face, Tag
from fvs_ros.camera import Intrinsics
from fvs_sim_node.camera import CameraPose

#: Pixels of a cell in the texture, samples of a pixel on each side, and deviation of the lens'
#: blur, px.
_CELL_PX, _SAMPLES, _BLUR_PX = 16, 4, 0.6
#: Grey levels of print and paper, and the noise of a pixel.
_INK, _PAPER, _NOISE = 20.0, 235.0, 2.0
#: A print is seen where the depth is within this of its plane's, m.
_NEAR_M = 0.006
#: Kinds of features that are measured of a tag.
TAGGED = ("pose",)
#: Poses that an exposure is the mean of.
_BLURRED = 5


class TagPicture:
    """Paints the tags of a layout, with their borders, on the body that carries them."""

    def __init__(self, tag: Tag) -> None:
        self.tag = tag
        TagReader(tag)  # checks the numbers
        self._textures = {
            number: np.pad(
                cv2.aruco.generateImageMarker(tag.dictionary, number, tag.cells * _CELL_PX),
                _CELL_PX,
                constant_values=255,
            )
            for number in tag.faces
        }
        m_px = tag.pitch_m / ((tag.cells + 2) * _CELL_PX)
        first_m = 0.5 * (tag.pitch_m - m_px)  # from the middle to the first pixel's
        self._to_tag = np.array([[m_px, 0, -first_m], [0, -m_px, first_m], [0, 0, 1]])
        self._corners_m = tag.pitch_m * SQUARE

    def region(self, seen: CameraPose, camera: Intrinsics) -> Region | None:
        """Part of the image with the body at a pose in the camera's frame; None if it is none."""
        return self._region([_of(seen, face) for face in self.tag.faces.values()], camera)

    def _region(self, faces: list[CameraPose], camera: Intrinsics) -> Region | None:
        corners_m = np.concatenate(
            [self._corners_m @ one.rotation.T + one.position_m for one in faces]
        )
        if corners_m[:, 2].min() < 0.05:
            return None
        corners = camera.project(corners_m)
        low, high = np.floor(corners.min(axis=0)), np.ceil(corners.max(axis=0))
        last = np.array([camera.width, camera.height]) - 1
        (u0, v0), (u1, v1) = np.maximum(low, 0).astype(int), np.minimum(high, last).astype(int)
        if u1 - u0 < 8 or v1 - v0 < 8:
            return None
        return Region(int(u0), int(v0), int(u1 - u0) + 1, int(v1 - v0) + 1)

    def paint(
        self,
        rgb: np.ndarray,
        depth_m: np.ndarray,
        camera: Intrinsics,
        poses: list[CameraPose],
        rng: np.random.Generator,
    ) -> None:
        """Paint the tags into an image, (H, W, 3), of a camera, where its depth is the print's.

        ``poses`` are those of the body in the camera's frame during the exposure.
        """
        middle = poses[len(poses) // 2]
        for number in self.tag.facing(middle.rotation, middle.position_m):
            face = self.tag.faces[number]
            seen = _of(middle, face)
            region = self._region([seen], camera)
            if region is None:
                continue
            view = region.view(camera)
            grey = self._drawn(self._textures[number], view, [_of(one, face) for one in poses])
            part = rgb[region.part]
            print_ = self._print(depth_m[region.part], view, seen)
            shade = part[print_].astype(float) / 255.0
            shade *= (_INK + (_PAPER - _INK) / 255.0 * grey[print_])[:, None]
            shade += rng.normal(0.0, _NOISE, len(shade))[:, None]
            part[print_] = np.clip(np.rint(shade), 0, 255).astype(np.uint8)

    def _drawn(self, texture: np.ndarray, view: Intrinsics, poses: list[CameraPose]) -> np.ndarray:
        """A tag's brightness, 0 to 255, (H, W)."""
        several = _SAMPLES
        size = several * view.width, several * view.height
        pinhole = np.array([[view.fx, 0, view.cx], [0, view.fy, view.cy], [0, 0, 1]])
        finer = np.array(
            [[several, 0, (several - 1) / 2], [0, several, (several - 1) / 2], [0, 0, 1]]
        )
        total = np.zeros((view.height, view.width))
        for pose in poses:
            columns = np.column_stack([pose.rotation[:, :2], pose.position_m])
            fine = cv2.warpPerspective(
                texture,
                finer @ pinhole @ columns @ self._to_tag,
                size,
                borderMode=cv2.BORDER_CONSTANT,
                borderValue=255,
            )
            total += cv2.resize(fine, (view.width, view.height), interpolation=cv2.INTER_AREA)
        return cv2.GaussianBlur(total / len(poses), (0, 0), _BLUR_PX)

    def _print(self, depth_m: np.ndarray, view: Intrinsics, seen: CameraPose) -> np.ndarray:
        """Where the print is the nearest thing, bool (H, W): in its square, in its plane."""
        v, u = np.mgrid[: view.height, : view.width]
        rays, normal = view.rays(u, v), seen.rotation[:, 2]
        with np.errstate(divide="ignore"):
            plane_m = (normal @ seen.position_m) / (rays @ normal)
        beside_m = (plane_m[..., None] * rays - seen.position_m) @ seen.rotation[:, :2]
        inside = np.abs(beside_m).max(axis=-1) <= 0.5 * self.tag.pitch_m
        return np.asarray(inside & (np.abs(depth_m - plane_m) < _NEAR_M))


def _of(body: CameraPose, face: Face) -> CameraPose:
    """Pose of one tag of a body, in the camera's frame."""
    position_m = body.position_m + body.rotation @ face.middle_m
    return CameraPose(position_m, body.rotation @ face.rotation)


def exposed(
    pose: CameraPose, linear_m_s: np.ndarray, turning_rad_s: np.ndarray, exposure_s: float
) -> list[CameraPose]:
    """Poses during an exposure about its middle, of a tag that moves at these speeds, (3,)."""
    if exposure_s <= 0.0:
        return [pose]
    poses = []
    for after_s in exposure_s * np.linspace(-0.5, 0.5, _BLURRED):
        turn = cv2.Rodrigues(np.asarray(after_s * turning_rad_s))[0]
        poses.append(CameraPose(pose.position_m + after_s * linear_m_s, turn @ pose.rotation))
    return poses
