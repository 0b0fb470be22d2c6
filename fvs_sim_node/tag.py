"""Printed tags in rendered images: textures, by homographies, where their paper is in view."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from fvs_detector_node.images import Region
from fvs_detector_node.tag_corners import TagReader
from fvs_detector_node.tags import SQUARE, Tag
from fvs_ros.camera import Intrinsics
from fvs_sim_node.camera import CameraPose


@dataclass(frozen=True)
class Print:
    """How a tag is drawn."""

    #: Pixels of a cell in the texture.
    cell_px: int = 16
    #: Samples of an image's pixel on each side.
    samples: int = 4
    #: Deviation of the lens's blur, px.
    blur_px: float = 0.6
    #: Brightness of the ink and of the paper, grey levels.
    ink: float = 20.0
    paper: float = 235.0
    #: Deviation of a pixel's noise, grey levels.
    noise: float = 2.0
    #: A print is in view where the depth is within this of its plane's, m.
    near_m: float = 0.006


PRINT = Print()


class TagPicture:
    """Paints the tags of a layout, with their borders, on the body that carries them.

    ``corners_m``, (4 k, 3), are those of all prints with their borders, in the body's frame.
    """

    def __init__(self, tag: Tag) -> None:
        self._tag = tag
        TagReader(tag)  # checks the numbers
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
        self.corners_m = np.concatenate(
            [face.middle_m + self._square_m @ face.rotation.T for face in tag.faces.values()]
        )

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
        for number in self._tag.facing(middle.rotation, middle.position_m):
            face = self._tag.faces[number]
            prints = [
                CameraPose(
                    pose.position_m + pose.rotation @ face.middle_m, pose.rotation @ face.rotation
                )
                for pose in poses
            ]
            print_ = prints[len(prints) // 2]
            corners_m = self._square_m @ print_.rotation.T + print_.position_m
            if corners_m[:, 2].min() <= 0.0:
                continue
            region = Region.around(camera.project(corners_m)).grown(0, camera)
            if not (region.width and region.height):
                continue
            view = region.view(camera)
            grey = self._drawn(self._textures[number], view, prints)
            part = rgb[region.part]
            shown = self._shown(depth_m[region.part], view, print_)
            shade = part[shown].astype(float) / 255.0
            shade *= (PRINT.ink + (PRINT.paper - PRINT.ink) / 255.0 * grey[shown])[:, None]
            shade += rng.normal(0.0, PRINT.noise, len(shade))[:, None]
            part[shown] = np.clip(np.rint(shade), 0, 255).astype(np.uint8)

    def _drawn(self, texture: np.ndarray, view: Intrinsics, prints: list[CameraPose]) -> np.ndarray:
        """A tag's brightness, 0 to 255, (H, W)."""
        fine, shift = PRINT.samples, 0.5 * (PRINT.samples - 1)
        to_fine = np.array([[fine, 0.0, shift], [0.0, fine, shift], [0.0, 0.0, 1.0]])
        total = np.zeros((view.height, view.width))
        for pose in prints:
            columns = np.column_stack([pose.rotation[:, :2], pose.position_m])
            picture = cv2.warpPerspective(
                texture,
                to_fine @ view.matrix @ columns @ self._to_tag,
                (fine * view.width, fine * view.height),
                borderMode=cv2.BORDER_CONSTANT,
                borderValue=255,
            )
            total += cv2.resize(picture, (view.width, view.height), interpolation=cv2.INTER_AREA)
        return cv2.GaussianBlur(total / len(prints), (0, 0), PRINT.blur_px)

    def _shown(self, depth_m: np.ndarray, view: Intrinsics, print_: CameraPose) -> np.ndarray:
        """Where the print is the nearest thing, bool (H, W): in its square, in its plane."""
        v, u = np.mgrid[: view.height, : view.width]
        rays, normal = view.rays(u, v), print_.rotation[:, 2]
        with np.errstate(divide="ignore"):
            plane_m = (normal @ print_.position_m) / (rays @ normal)
        beside_m = (plane_m[..., None] * rays - print_.position_m) @ print_.rotation[:, :2]
        inside = np.abs(beside_m).max(axis=-1) <= 0.5 * self._tag.pitch_m
        return np.asarray(inside & (np.abs(depth_m - plane_m) < PRINT.near_m))


def exposed(
    pose: CameraPose, linear_m_s: np.ndarray, angular_rad_s: np.ndarray, exposure_s: float
) -> list[CameraPose]:
    """Poses during an exposure about its middle, of a body that moves at these speeds, (3,)."""
    return [
        CameraPose(
            pose.position_m + after_s * linear_m_s,
            cv2.Rodrigues(np.asarray(after_s * angular_rad_s))[0] @ pose.rotation,
        )
        for after_s in exposure_s * np.linspace(-0.5, 0.5, 5)
    ]
