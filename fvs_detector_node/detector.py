"""The one way into detection: images in, what is seen in them out; no ROS, no clock."""

from __future__ import annotations

import numpy as np

from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.images import Rectifier, Region
from fvs_detector_node.sighting import Detection, Sighting
from fvs_ros.camera import CameraModel, Intrinsics


class Detector:
    """Looks for a body where the last image showed it, else everywhere.

    A kind of body overrides :meth:`search`.

    Attributes
    ----------
    needs_depth : bool
        Whether it takes depth images.
    measured : tuple of str
        Attributes of its detections for the status.
    """

    needs_depth = False
    measured: tuple[str, ...] = ()

    def __init__(self, config: DetectorConfig) -> None:
        self._config = config
        self._rectifier: Rectifier | None = None
        self.reset()

    def configure(self, config: DetectorConfig) -> None:
        """Take changed live parameters into use."""
        self._config = config

    def reset(self) -> None:
        """Forget where the body was."""
        self._last: Detection | None = None

    def search(
        self, stamp_s: float, rgb: np.ndarray, depth_m: np.ndarray | None, camera: Intrinsics
    ) -> Sighting:
        """Look for the body in an image without distortion, or in a part with its intrinsics."""
        raise NotImplementedError

    def rectified(self, rgb: np.ndarray, camera: CameraModel) -> np.ndarray:
        """The whole colour image without distortion."""
        return self._rectifier_of(camera).colour(rgb, Region.whole(camera.intrinsics))

    def look(
        self, stamp_s: float, rgb: np.ndarray, depth_m: np.ndarray | None, camera: CameraModel
    ) -> Sighting:
        """Look for the body in a colour image, red first, and the depth aligned to it, m."""
        rectifier, view = self._rectifier_of(camera), camera.intrinsics
        regions = [Region.whole(view)]
        if self._last is not None:
            box = self._last.box(view)
            # Half its width in an image: at 1 m and 30 Hz, 80 mm move by 1.2 m/s.
            near = box.grown(max(box.width, box.height) // 2, view)
            if near.width and near.height and near != regions[0]:
                regions.insert(0, near)
        for region in regions:
            depth = None if depth_m is None else rectifier.depth(depth_m, region)
            part_of_view = region.view(view)
            sighting = self.search(stamp_s, rectifier.colour(rgb, region), depth, part_of_view)
            body = sighting.detection
            if body is not None and region.contains(body.box(view).grown(0, view)):
                break
        # A refused one must not move the window: the body may still be where it was.
        self._last = sighting.accepted
        return sighting

    def _rectifier_of(self, camera: CameraModel) -> Rectifier:
        if self._rectifier is None or self._rectifier.camera != camera:
            self._rectifier = Rectifier(camera)
        return self._rectifier
