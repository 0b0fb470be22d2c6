"""Detection of a tag's pose from images, with plausibility checks; no ROS, no clock."""

from __future__ import annotations

import cv2
import numpy as np

from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.detector import Sighting
from fvs_detector_node.images import Rectifier, Region
from fvs_detector_node.tag_corners import TagReader
from fvs_detector_node.tag_pose import PoseFinder
from fvs_detector_node.tracking import Gate
from fvs_ros.camera import CameraModel, Intrinsics

#: A tag that was seen within this time, s, is searched for where it was, and as far around as it is
#: large: at 1 m and 30 Hz it would have to move at 2 m/s to leave.
_NEAR_S = 0.1


class TagDetector:
    """Looks for the tag where it was, else everywhere; its ``gate`` refuses jumps."""

    def __init__(self, config: DetectorConfig) -> None:
        self._rectifier: Rectifier | None = None
        self._reader, self._poses = TagReader(config.tag), PoseFinder(config.tag)
        self._faces = config.tag.faces
        self.gate = Gate(config.max_ball_speed_m_s)
        self.reset()

    def configure(self, config: DetectorConfig) -> None:
        """Take changed parameters into use."""
        self.gate.max_speed_m_s = config.max_ball_speed_m_s

    def reset(self) -> None:
        """Forget where the tag was."""
        self.gate.reset()
        self._poses.reset()
        self._seen: tuple[float, Region] | None = None

    def rectified(self, rgb: np.ndarray, camera: CameraModel) -> np.ndarray:
        """The whole colour image that the detections' pixel coordinates refer to."""
        return self._rectifier_of(camera).colour(rgb, Region.whole(camera.intrinsics))

    def look(
        self, stamp_s: float, rgb: np.ndarray, depth_m: np.ndarray | None, camera: CameraModel
    ) -> Sighting:
        """Look for the tag in a colour image, red first; each exposure is later than the last.

        Depth aligned to it, if there is some, tells apart two poses that fit.
        """
        rectifier, view = self._rectifier_of(camera), camera.intrinsics
        corners_px: dict[int, np.ndarray] = {}
        problem = ""
        for region in self._regions(stamp_s, view):
            grey = cv2.cvtColor(rectifier.colour(rgb, region), cv2.COLOR_RGB2GRAY)
            corners_px, problem = self._reader.find(grey)
            if corners_px:
                corners_px = {
                    number: one + (region.u0, region.v0) for number, one in corners_px.items()
                }
                break
        self._seen = None
        if not corners_px:
            return Sighting(None, problem)
        if depth_m is not None:
            depth_m = rectifier.depth(depth_m, Region.whole(view))
        pose, problem = self._poses.find(stamp_s, corners_px, view, depth_m)
        if pose is None:
            return Sighting(None, problem, _bounds(np.concatenate(list(corners_px.values()))))
        # Also where tags of the body are that were not seen.
        corners_m = np.concatenate([one.corners_m for one in self._faces.values()])
        body_px = view.project(corners_m @ pose.rotation.T + pose.position_m)
        self._seen = (stamp_s, _bounds(body_px))
        return Sighting(pose, self.gate.check(stamp_s, pose.position_m))

    def _regions(self, stamp_s: float, view: Intrinsics) -> list[Region]:
        """The parts of the image to search, one after the other."""
        whole = Region.whole(view)
        if self._seen is None or not 0.0 <= stamp_s - self._seen[0] <= _NEAR_S:
            return [whole]
        box = self._seen[1]
        return [box.grown(max(box.width, box.height), view), whole]

    def _rectifier_of(self, camera: CameraModel) -> Rectifier:
        if self._rectifier is None or self._rectifier.camera != camera:
            self._rectifier = Rectifier(camera)
        return self._rectifier


def _bounds(corners_px: np.ndarray) -> Region:
    """The rectangle around corners."""
    (u0, v0), (u1, v1) = corners_px.min(axis=0).astype(int), corners_px.max(axis=0).astype(int)
    return Region(int(u0), int(v0), int(u1 - u0) + 1, int(v1 - v0) + 1)
