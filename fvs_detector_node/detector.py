"""From a colour and a depth image to a position that is believed: no ROS, no clock."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.detection import BallDetection, detect_ball
from fvs_detector_node.diagnosis import Miss, diagnose
from fvs_detector_node.gate import Gate
from fvs_detector_node.rectifier import Rectifier
from fvs_detector_node.region import Region
from fvs_detector_node.tracking import WindowTracker
from fvs_ros.camera import CameraModel

#: A lost ball is explained this often at most, s of image stamps; it takes as long as a search.
_EXPLAIN_PERIOD_S = 0.3


@dataclass(frozen=True)
class Sighting:
    """What one pair of images gave.

    Parameters
    ----------
    ball : BallDetection or None
        The ball, if one is seen, believed or not.
    problem : str
        Why nothing is to be published; empty if the ball is.
    miss : Miss or None
        Of the explanation, if no ball is seen.
    searched : bool
        Whether the whole image was searched.
    """

    ball: BallDetection | None
    problem: str = ""
    miss: Miss | None = None
    searched: bool = False


class Detector:
    """Looks for the ball where it will be, else everywhere; believes no jumps.

    Parameters
    ----------
    config : DetectorConfig
        Parameters of the node.

    Attributes
    ----------
    gate : Gate
        What judges positions.
    """

    def __init__(self, config: DetectorConfig) -> None:
        self._rectifier: Rectifier | None = None
        self._config = config
        self.gate = Gate(config.max_ball_speed_m_s)
        self._miss: Miss | None = None
        self.reset()

    def configure(self, config: DetectorConfig) -> None:
        """Take changed parameters into use."""
        self.gate.max_speed_m_s = config.max_ball_speed_m_s
        self._miss = None
        if config.ball_radius_m != self._config.ball_radius_m:
            self.reset()
        self._config = config

    def reset(self) -> None:
        """Forget where the ball was."""
        self.gate.reset()
        self._tracker: WindowTracker | None = None
        self._miss = None
        self._explained_s = -np.inf

    def rectified(self, rgb: np.ndarray, depth_m: np.ndarray, camera: CameraModel) -> np.ndarray:
        """Whole colour image in which the detections' pixels are meant."""
        whole = Region.whole(camera.intrinsics)
        return self._rectifier_of(camera).cut(rgb, depth_m, whole)[0]

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
        rectifier, view = self._rectifier_of(camera), camera.intrinsics
        radius_m, colour = self._config.ball_radius_m, self._config.colour
        whole = Region.whole(view)

        def detect(region: Region) -> BallDetection | None:
            images = rectifier.cut(rgb, depth_m, region)
            return detect_ball(*images, region.view(view), radius_m, colour)

        if self._tracker is None:
            self._tracker = WindowTracker(view, radius_m)
        ball, searched = self._tracker.find(stamp_s, detect, lambda: whole)
        if ball is not None:
            problem = self._judge(stamp_s, ball)
            # What is not believed is no place to look at next: the ball may still be where it was.
            self._tracker.update(stamp_s, None if problem else ball)
            return Sighting(ball, problem, None, searched)
        self._tracker.update(stamp_s, None)
        due = not 0.0 <= stamp_s - self._explained_s < _EXPLAIN_PERIOD_S
        if self._miss is None or due:
            self._miss = diagnose(*rectifier.cut(rgb, depth_m, whole), view, radius_m, colour)
            self._explained_s = stamp_s
        return Sighting(None, self._miss.text, self._miss, searched)

    def _rectifier_of(self, camera: CameraModel) -> Rectifier:
        if self._rectifier is None or self._rectifier.camera != camera:
            self._rectifier = Rectifier(camera)
            self._tracker = None
        return self._rectifier

    def _judge(self, stamp_s: float, ball: BallDetection) -> str:
        """Why a ball is not to be published; empty if it is."""
        least = self._config.min_quality
        if ball.quality < least:
            return (
                f"the ball is seen badly, {ball.visible_fraction:.0%} of it: quality "
                f"{ball.quality:.2f} is below min_quality {least:g}"
            )
        if not np.all(np.isfinite(ball.position_m)):
            return "the ball's position is not finite"
        return self.gate.check(stamp_s, ball.position_m)
