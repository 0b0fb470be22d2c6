"""The detectors by kind of feature. A new one is a file in this folder and a line here."""

from __future__ import annotations

from dataclasses import replace

from fvs_detector_node.ball_detector import BallDetector
from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.detector import Detector
from fvs_detector_node.image_points import CentreDetector, CornerDetector
from fvs_detector_node.patches import PatchDetector
from fvs_detector_node.tag_pose import TagDetector

DETECTORS: dict[str, type[Detector]] = {"ball": BallDetector, "pose": TagDetector}
#: Those of image points, by what carries them.
POINT_DETECTORS: dict[str, type[Detector]] = {
    "ball": CentreDetector,
    "pose": CornerDetector,
    "": PatchDetector,
}


def make_detector(config: DetectorConfig) -> Detector:
    """The detector of the configured kind of feature."""
    if config.kind.rigid:
        return DETECTORS[config.feature](config)
    return PatchDetector(config) if config.track_px else POINT_DETECTORS[config.carries](config)


def make_object_detector(config: DetectorConfig) -> Detector | None:
    """The detector of the object, if there is one; a ``ValueError`` if its tags are the tool's."""
    tag = config.object_tag
    if tag is None:
        return None
    if not config.kind.rigid:
        raise ValueError("object_tag_id: image points are not seen from an object")
    if DETECTORS[config.feature] is TagDetector and (
        shared := tag.faces.keys() & config.tag.faces.keys()
    ):
        raise ValueError(f"object_tag_id: tag {min(shared)} is on the tool; print other numbers")
    return TagDetector(replace(config, tag=tag))
