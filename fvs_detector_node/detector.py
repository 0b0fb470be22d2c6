"""The one way into detection: images in, what is seen in them out; no ROS, no clock."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.images import Rectifier, Region
from fvs_ros.camera import CameraModel, Intrinsics


class Detection(Protocol):
    """What is seen in an image: what its kind's ``of_detection`` takes, too."""

    @property
    def visible_fraction(self) -> float:
        """Of its area in the image."""

    def box(self, camera: Intrinsics) -> Region:
        """The part of a camera's image that shows it; it may go beyond."""

    def draw(self, picture: np.ndarray, camera: Intrinsics, style: dict[str, Any]) -> str:
        """Draw it with OpenCV's keywords, in sixteenths of pixels; returns its numbers in words."""


@dataclass(frozen=True)
class Sighting:
    """The result of one image, or pair of images: a detection, or why there is none."""

    detection: Detection | None
    problem: str = ""  # one sentence with what to do about it; empty with a detection
    box: Region | None = None  # what the problem is about


class Detector:
    """Looks for a body where the last image showed it, else everywhere.

    A kind of body overrides :meth:`detect_in`.
    """

    #: Whether it takes depth images, and a calibrated camera.
    needs_depth, needs_calibration = False, True
    measured: tuple[str, ...] = ()  #: attributes of its detections for the status

    def __init__(self, config: DetectorConfig) -> None:
        # One small image at a time: threads wait for each other by spinning.
        cv2.setNumThreads(1)
        threadpool_limits(1, user_api="blas")
        self._config = config
        self._rectifier: Rectifier | None = None
        self.reset()

    def configure(self, config: DetectorConfig) -> None:
        """Take changed live parameters into use."""
        self._config = config

    def reset(self) -> None:
        """Forget where the body was."""
        self._last: Detection | None = None

    def detect_in(
        self, stamp_s: float, rgb: np.ndarray, depth_m: np.ndarray | None, camera: Intrinsics
    ) -> Sighting:
        """Detect the body in an image without distortion, or in a part with its intrinsics."""
        raise NotImplementedError

    def rectified(self, rgb: np.ndarray, camera: CameraModel) -> np.ndarray:
        """The whole colour image without distortion."""
        return self._rectifier_of(camera).part(rgb, Region.whole(camera.intrinsics))

    def detect(
        self, stamp_s: float, rgb: np.ndarray, depth_m: np.ndarray | None, camera: CameraModel
    ) -> Sighting:
        """Detect the body in a colour image, red first, and the depth aligned to it, m."""
        rectifier, view = self._rectifier_of(camera), camera.intrinsics
        regions = [Region.whole(view)]
        if self._last is not None:
            box = self._last.box(view)
            # Half its width in an image: at 1 m and 30 Hz, 80 mm move by 1.2 m/s.
            near = box.grown(max(box.width, box.height) // 2, view)
            if near.width and near.height and near != regions[0]:
                regions.insert(0, near)
        for region in regions:
            depth = None if depth_m is None else rectifier.part(depth_m, region)
            part_of_view = region.view(view)
            sighting = self.detect_in(stamp_s, rectifier.part(rgb, region), depth, part_of_view)
            body = sighting.detection
            if body is not None and region.contains(body.box(view).grown(0, view)):
                break
        self._last = sighting.detection
        return sighting

    def _rectifier_of(self, camera: CameraModel) -> Rectifier:
        if self._rectifier is None or self._rectifier.camera != camera:
            self._rectifier = Rectifier(camera)
        return self._rectifier


def annotate(rgb: np.ndarray, sightings: list[Sighting], camera: Intrinsics) -> np.ndarray:
    """A copy of an image, without distortion, with tool and object, or why they are not seen."""
    picture = np.array(rgb)
    scale = max(picture.shape[1] / 640.0, 0.4)
    thick = max(1, round(1.5 * scale))
    style = {"color": (60, 230, 60), "thickness": thick, "lineType": cv2.LINE_AA, "shift": 4}
    lines = list[str]()
    for what, sighting in zip(("", "object: "), sightings, strict=False):
        words, body, box = sighting.problem, sighting.detection, sighting.box
        if body is not None:
            words = body.draw(picture, camera, style)
        elif box is not None:
            corner_and_size = (box.u0, box.v0, box.width, box.height)
            cv2.rectangle(picture, corner_and_size, (255, 170, 0), thick)
        lines += textwrap.wrap(what + words, 66)
    # White on a darkened band: readable before anything.
    picture[: round((8 + 20 * len(lines)) * scale)] //= 4
    for row, line in enumerate(lines):
        at = (round(10 * scale), round((20 + 20 * row) * scale))
        font = cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(picture, line, at, font, 0.5 * scale, (255, 255, 255), thick, cv2.LINE_AA)
    return picture
