"""From a colour and a depth image to a position that is believed: no ROS, no clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fvs_detector_node.config import ball_colour
from fvs_detector_node.detection import BallDetection, detect_ball
from fvs_detector_node.diagnosis import Miss, diagnose
from fvs_detector_node.gate import Gate
from fvs_detector_node.rectifier import Rectifier
from fvs_detector_node.tracking import Region, WindowTracker
from fvs_ros.camera import CameraModel

#: A lost ball is explained this often at most, s of image stamps.
_EXPLAIN_PERIOD_S = 0.3


@dataclass(frozen=True)
class Sighting:
    """What one pair of images gave.

    Parameters
    ----------
    detection : BallDetection or None
        The ball, if one is seen, believed or not.
    problem : str
        Why nothing is to be published; empty if the detection is.
    miss : Miss or None
        Of the explanation, if no ball is seen.
    whole : bool
        Whether the whole image was searched.
    """

    detection: BallDetection | None
    problem: str = ""
    miss: Miss | None = None
    whole: bool = False


class Detector:
    """Looks for the ball where it will be, else everywhere; believes no jumps.

    Parameters
    ----------
    values : mapping
        Parameter values of the node.

    Attributes
    ----------
    gate : Gate
        What judges positions.
    """

    def __init__(self, values: Mapping[str, Any]) -> None:
        self._rectifier: Rectifier | None = None
        self._radius_m = 0.0
        self.gate = Gate(values["max_ball_speed_m_s"], values["gate_repeats"])
        self.configure(values)
        self.reset()

    def configure(self, values: Mapping[str, Any]) -> None:
        """Take parameter values into use; a ``ValueError`` says what is wrong with them."""
        self._colour = ball_colour(values)
        self._min_quality = values["min_quality"]
        self.gate.max_speed_m_s = values["max_ball_speed_m_s"]
        self.gate.repeats = values["gate_repeats"]
        if values["ball_radius_m"] != self._radius_m:
            self._radius_m = values["ball_radius_m"]
            self.reset()
        self._miss: Miss | None = None

    def reset(self) -> None:
        """Forget where the ball was."""
        self.gate.reset()
        self._tracker: WindowTracker | None = None
        self._miss = None
        self._explained_s = -np.inf

    def rectified(self, rgb: np.ndarray, depth_m: np.ndarray, camera: CameraModel) -> np.ndarray:
        """Whole colour image in which the detections' pixels are meant."""
        rectifier = self._rectifier_of(camera)
        return rectifier.cut(rgb, depth_m, _whole(camera))[0]

    def look(
        self, stamp_s: float, rgb: np.ndarray, depth_m: np.ndarray, camera: CameraModel
    ) -> Sighting:
        """Look for the ball.

        Parameters
        ----------
        stamp_s : float
            Exposure, s; later than those before, unless after :meth:`reset`.
        rgb : ndarray of uint8, shape (H, W, 3)
            Colour image, red first.
        depth_m : ndarray of float32, shape (H, W)
            Depth, aligned to it, m; 0 where there is none.
        camera : CameraModel
            Of both.

        Returns
        -------
        Sighting
            The ball, or why there is none.
        """
        rectifier = self._rectifier_of(camera)
        if self._tracker is None:
            self._tracker = WindowTracker(camera.intrinsics, self._radius_m)
        window = self._tracker.region(stamp_s)
        detection = None
        if window is not None:
            detection = self._search(rectifier, rgb, depth_m, window)
            if detection is not None and window.cuts_off(detection, camera.intrinsics):
                detection = None
        searched_whole = detection is None
        if searched_whole:
            detection = self._search(rectifier, rgb, depth_m, _whole(camera))
        if detection is None:
            self._tracker.update(stamp_s, None)
            miss = self._explain(stamp_s, rectifier, rgb, depth_m)
            return Sighting(None, miss.text, miss, searched_whole)
        problem = self._judge(stamp_s, detection)
        # What is not believed is no place to look at next: the ball may still be where it was.
        self._tracker.update(stamp_s, None if problem else detection)
        return Sighting(detection, problem, None, searched_whole)

    def _rectifier_of(self, camera: CameraModel) -> Rectifier:
        if self._rectifier is None or self._rectifier.camera != camera:
            self._rectifier = Rectifier(camera)
            self._tracker = None
        return self._rectifier

    def _search(
        self, rectifier: Rectifier, rgb: np.ndarray, depth_m: np.ndarray, region: Region
    ) -> BallDetection | None:
        view = rectifier.camera.intrinsics.window(region.u0, region.v0, region.width, region.height)
        images = rectifier.cut(rgb, depth_m, region)
        detection = detect_ball(*images, view, self._radius_m, self._colour)
        if detection is None:
            return None
        u, v = detection.pixel
        return replace(detection, pixel=(u + region.u0, v + region.v0))

    def _judge(self, stamp_s: float, detection: BallDetection) -> str:
        """Why a detection is not to be published; empty if it is."""
        if detection.quality < self._min_quality:
            return (
                f"the ball is seen too badly: quality {detection.quality:.2f} is below min_quality "
                f"{self._min_quality:g}; {detection.visible_fraction:.0%} of it is visible"
            )
        if not np.all(np.isfinite(detection.position_m)):
            return "the ball's position is not finite"
        return self.gate.check(stamp_s, detection.position_m)

    def _explain(
        self, stamp_s: float, rectifier: Rectifier, rgb: np.ndarray, depth_m: np.ndarray
    ) -> Miss:
        """Explain a miss; now and then only, as it takes longer than a search."""
        due = not 0.0 <= stamp_s - self._explained_s < _EXPLAIN_PERIOD_S
        if self._miss is None or due:
            view = rectifier.camera.intrinsics
            images = rectifier.cut(rgb, depth_m, _whole(rectifier.camera))
            self._miss = diagnose(*images, view, self._radius_m, self._colour)
            self._explained_s = stamp_s
        return self._miss


def _whole(camera: CameraModel) -> Region:
    return Region(0, 0, camera.intrinsics.width, camera.intrinsics.height)
