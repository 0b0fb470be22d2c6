"""Detection of a tag's pose from images, with plausibility checks; no ROS, no clock."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import cv2
import numpy as np

from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.detector import Sighting
from fvs_detector_node.images import Rectifier, Region, wide_views
from fvs_detector_node.tag_corners import Corners, TagReader
from fvs_detector_node.tag_pose import PoseFinder, TagPose
from fvs_detector_node.tags import Tag
from fvs_detector_node.tracking import Gate
from fvs_ros.camera import CameraModel

#: A tag that was seen within this time, s, is searched for where it was, and as far around as it is
#: large: at 1 m and 30 Hz it would have to move at 2 m/s to leave.
_NEAR_S = 0.1
#: What is beside the camera, or behind it, is drawn far out of its image: by this z of its ray.
_BESIDE = 0.05


class _View:
    """A pinhole view of the camera's image, and what was seen in it."""

    def __init__(self, rectifier: Rectifier, tag: Tag) -> None:
        self.rectifier, self.poses = rectifier, PoseFinder(tag)
        self.seen: tuple[float, Region] | None = None

    def forget(self) -> None:
        """Forget where the tag was."""
        self.poses.reset()
        self.seen = None

    def in_camera(self, pose: TagPose) -> TagPose:
        """A pose in the view's frame, as the camera's, and its corners, as along its axis."""
        view, turn = self.rectifier.camera.intrinsics, self.rectifier.turn
        rays = view.rays(*np.moveaxis(pose.corners_px, -1, 0)) @ turn
        rays[..., 2] = np.maximum(rays[..., 2], _BESIDE)
        return replace(
            pose,
            position_m=pose.position_m @ turn,
            rotation=turn.T @ pose.rotation,
            corners_px=view.project(rays),
        )


class TagDetector:
    """Looks for the tag where it was, else everywhere; its ``gate`` refuses jumps."""

    needs_depth = False  # it only helps
    measured = ("residual_px",)

    def __init__(self, config: DetectorConfig) -> None:
        self._reader, self._tag = TagReader(config.tag), config.tag
        self.gate = Gate(config.max_ball_speed_m_s)
        self._camera: CameraModel | None = None
        self._views: list[_View] = []
        self._last: _View | None = None

    def configure(self, config: DetectorConfig) -> None:
        """Take changed parameters into use."""
        self.gate.max_speed_m_s = config.max_ball_speed_m_s

    def reset(self) -> None:
        """Forget where the tag was."""
        self.gate.reset()
        for view in self._views:
            view.forget()

    def rectified(self, rgb: np.ndarray, camera: CameraModel) -> np.ndarray:
        """The whole colour image that the detections' pixel coordinates refer to."""
        return self._views_of(camera)[0].rectifier.colour(rgb, Region.whole(camera.intrinsics))

    def look(
        self, stamp_s: float, rgb: np.ndarray, depth_m: np.ndarray | None, camera: CameraModel
    ) -> Sighting:
        """Look for the tag in a colour image, red first; each exposure is later than the last.

        Depth aligned to it, if there is some, tells apart two poses that fit. Of a wide lens all
        views are searched, that in which the tag was last seen first.
        """
        misses = []
        for view in sorted(self._views_of(camera), key=lambda one: one is not self._last):
            ahead = view is self._views[0]
            sighting = self._look(view, stamp_s, rgb, depth_m if ahead else None)
            if sighting.found is not None:
                self._last = view
                return sighting
            # Nearer to a pose is a tag whose corners were found; only what is ahead is drawn.
            misses.append(
                (sighting.box is None, replace(sighting, box=sighting.box if ahead else None))
            )
        return min(misses, key=lambda one: one[0])[1]

    def _look(
        self, view: _View, stamp_s: float, rgb: np.ndarray, depth_m: np.ndarray | None
    ) -> Sighting:
        """Look for the tag in one view."""
        rectifier, intrinsics = view.rectifier, view.rectifier.camera.intrinsics
        corners: dict[int, Corners] = {}
        problem = ""
        for region in self._regions(stamp_s, view):
            grey = cv2.cvtColor(rectifier.colour(rgb, region), cv2.COLOR_RGB2GRAY)
            found, problem = self._reader.find(grey)
            corners = {number: one.moved(region.u0, region.v0) for number, one in found.items()}
            if corners:
                break
        view.seen = None
        if not corners:
            return Sighting(None, problem)
        depth_of = None if depth_m is None else partial(rectifier.depth, depth_m)
        pose, problem = view.poses.find(stamp_s, corners, intrinsics, depth_of)
        if pose is None:
            all_px = np.concatenate([one.px for one in corners.values()])
            return Sighting(None, problem, Region.around(all_px))
        # Also where tags of the body are that were not seen.
        corners_m = np.concatenate([one.corners_m for one in self._tag.faces.values()])
        body_px = intrinsics.project(corners_m @ pose.rotation.T + pose.position_m)
        view.seen = (stamp_s, Region.around(body_px))
        pose = view.in_camera(pose)
        return Sighting(pose, self.gate.check(stamp_s, pose.position_m))

    def _regions(self, stamp_s: float, view: _View) -> list[Region]:
        """The parts of the image to search, one after the other."""
        camera = view.rectifier.camera.intrinsics
        whole = Region.whole(camera)
        if view.seen is None or not 0.0 <= stamp_s - view.seen[0] <= _NEAR_S:
            return [whole]
        box = view.seen[1]
        return [box.grown(max(box.width, box.height), camera), whole]

    def _views_of(self, camera: CameraModel) -> list[_View]:
        if self._camera != camera:
            self._camera = camera
            self._views = [_View(one, self._tag) for one in wide_views(camera)]
        return self._views
