"""The detectors by kind of feature. A new one is a file in this folder and a line here."""

from __future__ import annotations

from fvs_detector_node.ball_detector import BallDetector
from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.detector import Detector
from fvs_detector_node.tag_detector import TagDetector

DETECTORS: dict[str, type[Detector]] = {"ball": BallDetector, "pose": TagDetector}


def make_detector(config: DetectorConfig) -> Detector:
    """The detector of the configured kind of feature."""
    return DETECTORS[config.feature](config)
