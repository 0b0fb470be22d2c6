"""Detection of a tag's pose in colour images."""

from __future__ import annotations

import cv2
import numpy as np

from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.detector import Detector, Sighting
from fvs_detector_node.tag_corners import TagReader
from fvs_detector_node.tag_pose import PoseFinder
from fvs_ros.camera import Intrinsics


class TagDetector(Detector):
    """Detects the tag, or the body of tags."""

    measured = ("residual_px",)

    def __init__(self, config: DetectorConfig) -> None:
        self._reader, self._poses = TagReader(config.tag), PoseFinder(config.tag)
        super().__init__(config)

    def reset(self) -> None:
        """Forget the last pose."""
        super().reset()
        self._poses.reset()

    def detect_in(
        self, stamp_s: float, rgb: np.ndarray, depth_m: np.ndarray | None, camera: Intrinsics
    ) -> Sighting:
        """Detect the tag; ``depth_m`` does not matter."""
        corners, problem = self._reader.read(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY))
        if not corners:
            return Sighting(None, problem)
        return Sighting(*self._poses.find(stamp_s, corners, camera))
