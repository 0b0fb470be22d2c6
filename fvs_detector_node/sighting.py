"""What is seen in an image, and a picture of it."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np

from fvs_detector_node.images import Region
from fvs_ros.camera import Intrinsics


class Detection(Protocol):
    """A body that is seen in an image."""

    @property
    def position_m(self) -> np.ndarray:
        """Its middle, camera optical frame, (3,)."""

    @property
    def rotation(self) -> np.ndarray:
        """From the body's to the camera's frame, (3, 3)."""

    @property
    def visible_fraction(self) -> float:
        """Of its area in the image."""

    def box(self, camera: Intrinsics) -> Region:
        """The part of a camera's image that shows it; it may go beyond."""

    def draw(self, picture: np.ndarray, camera: Intrinsics, style: dict[str, Any]) -> str:
        """Draw it with OpenCV's keywords, in sixteenths of pixels; returns its numbers in words."""


@dataclass(frozen=True)
class Sighting:
    """The result of one image, or pair of images."""

    detection: Detection | None  # accepted or not
    problem: str = ""  # why nothing is published; empty if it is
    box: Region | None = None  # what the problem is about, if there is no detection

    @property
    def accepted(self) -> Detection | None:
        """The detection, unless there is a problem."""
        return None if self.problem else self.detection


def annotate(rgb: np.ndarray, sighting: Sighting, camera: Intrinsics) -> np.ndarray:
    """A copy of an image, without distortion, with what is seen, or why nothing is."""
    picture = np.array(rgb)
    scale = max(picture.shape[1] / 640.0, 0.4)
    thick = max(1, round(1.5 * scale))
    lines, box = textwrap.wrap(sighting.problem, 66), sighting.box
    colour = (255, 170, 0) if sighting.problem else (60, 230, 60)
    if sighting.detection is not None:
        style = {"color": colour, "thickness": thick, "lineType": cv2.LINE_AA, "shift": 4}
        lines.insert(0, sighting.detection.draw(picture, camera, style))
    elif box is not None:
        cv2.rectangle(picture, (box.u0, box.v0, box.width, box.height), colour, thick)
    # White on a darkened band: readable before anything.
    picture[: round((8 + 20 * len(lines)) * scale)] //= 4
    for row, line in enumerate(lines):
        at = (round(10 * scale), round((20 + 20 * row) * scale))
        font = cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(picture, line, at, font, 0.5 * scale, (255, 255, 255), thick, cv2.LINE_AA)
    return picture
