"""Detection from a colour and a depth image, with plausibility checks; no ROS, no clock."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass, replace

import cv2
import numpy as np

from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.detection import (
    BallColour,
    BallDetection,
    Cause,
    Miss,
    colour_mask,
    detect_ball,
    examine,
)
from fvs_detector_node.images import Rectifier, Region
from fvs_detector_node.sphere import ACCEPT
from fvs_detector_node.tag_pose import TagPose
from fvs_detector_node.tracking import Gate, WindowTracker
from fvs_ros.camera import CameraModel, Intrinsics


@dataclass(frozen=True)
class Sighting:
    """The result of one image, or pair of images."""

    found: BallDetection | TagPose | None  # accepted or not
    problem: str = ""  # why nothing is published; empty if it is
    box: Region | None = None  # what the problem is about, if nothing is seen


class BallDetector:
    """Looks for the ball at its predicted place, else everywhere; its ``gate`` refuses jumps."""

    needs_depth = True
    measured = ("quality", "visible_fraction", "residual_m", "radius_px")

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

    def rectified(self, rgb: np.ndarray, camera: CameraModel) -> np.ndarray:
        """The whole colour image that the detections' pixel coordinates refer to."""
        return self._rectifier_of(camera).colour(rgb, Region.whole(camera.intrinsics))

    def look(
        self, stamp_s: float, rgb: np.ndarray, depth_m: np.ndarray, camera: CameraModel
    ) -> Sighting:
        """Look for the ball in a colour image and the depth aligned to it, as :func:`detect_ball`.

        Each exposure is later than those before, unless after :meth:`reset`.
        """
        rectifier, view = self._rectifier_of(camera), camera.intrinsics
        radius_m, colour = self._config.ball_radius_m, self._config.colour
        whole = Region.whole(view)

        def cut(region: Region) -> tuple[np.ndarray, np.ndarray]:
            return rectifier.colour(rgb, region), rectifier.depth(depth_m, region)

        def detect(region: Region) -> BallDetection | None:
            return detect_ball(*cut(region), region.view(view), radius_m, colour)

        if self._tracker is None:
            self._tracker = WindowTracker(view, radius_m)
        ball = self._tracker.find(stamp_s, detect, lambda: whole)
        if ball is not None:
            problem = self._judge(stamp_s, ball)
            # A refused position must not move the window: the ball may still be where it was.
            self._tracker.update(stamp_s, None if problem else ball)
            return Sighting(ball, problem)
        self._tracker.update(stamp_s, None)
        # Limited in rate, because a diagnosis takes longer than a search.
        if self._miss is None or not 0.0 <= stamp_s - self._explained_s < 0.3:
            self._miss = diagnose(*cut(whole), view, radius_m, colour)
            self._explained_s = stamp_s
        return Sighting(None, self._miss.text, self._miss.box)

    def _rectifier_of(self, camera: CameraModel) -> Rectifier:
        if self._rectifier is None or self._rectifier.camera != camera:
            self._rectifier = Rectifier(camera)
            self._tracker = None
        return self._rectifier

    def _judge(self, stamp_s: float, ball: BallDetection) -> str:
        """Why a ball is not to be published; empty if it is."""
        least = self._config.min_quality
        if not ball.quality >= least:
            return (
                f"quality {ball.quality:.2f} of the ball, {ball.visible_fraction:.0%} of it "
                f"visible, is below min_quality {least:g}"
            )
        return self.gate.check(stamp_s, ball.position_m)


def diagnose(
    rgb: np.ndarray, depth_m: np.ndarray, camera: Intrinsics, radius_m: float, colour: BallColour
) -> Miss:
    """Find the most likely reason why no ball was found, in up to three times a search's time.

    Parameters are those of :func:`~fvs_detector_node.detection.detect_ball`.
    """
    _, others = examine(rgb, depth_m, camera, radius_m, colour)
    # A speck of noise is no explanation: there may be a whole ball in the dark.
    if all(one.pixels < 2 * ACCEPT.pixels for one in others):
        relaxed = replace(
            colour,
            # Below these limits the hue of a pixel is only noise.
            min_saturation=min(40, colour.min_saturation),
            min_value=min(12, colour.min_value),
        )
        ball, _ = examine(rgb, depth_m, camera, radius_m, relaxed)
        if ball is not None:
            return _off_colour(rgb, ball, camera, colour, relaxed)
    if not others:
        text = "nothing in view has the ball's colour: is it out of view, or hue wrong?"
        return Miss(Cause.OUT_OF_VIEW, text)
    return max(others, key=lambda one: (one.cause, one.pixels))


def _off_colour(
    rgb: np.ndarray,
    ball: BallDetection,
    camera: Intrinsics,
    colour: BallColour,
    relaxed: BallColour,
) -> Miss:
    """Suggest parameters for a ball that is found with wider limits of its colour."""
    u, v = camera.project(ball.position_m).astype(int).tolist()
    box = Region(u, v, 1, 1).grown(int(0.8 * ball.radius_px), camera)
    disc = np.ascontiguousarray(rgb[box.part])
    pixels = cv2.cvtColor(disc, cv2.COLOR_RGB2HSV)[colour_mask(disc, relaxed) > 0]
    # With room for the ball's shaded side.
    wanted = (0.7 * np.percentile(pixels, 5, axis=0)).astype(int)
    if np.median(pixels[:, 2]) < colour.min_value:
        text = f"the ball is too dark: lower min_value to {wanted[2]}, or give more light"
    else:
        text = f"the ball is too pale: lower min_saturation to {wanted[1]}, or shorten the exposure"
    return Miss(Cause.OFF_COLOUR, text, box)


def annotate(rgb: np.ndarray, sighting: Sighting, camera: Intrinsics) -> np.ndarray:
    """A copy of an image, without distortion, with what was found or why it is not seen."""
    picture = np.array(rgb)
    scale = max(picture.shape[1] / 640.0, 0.4)
    thick = max(1, round(1.5 * scale))
    lines = textwrap.wrap(sighting.problem, 66)
    found, box = sighting.found, sighting.box
    refused_rgb = (255, 170, 0)
    colour = refused_rgb if sighting.problem else (60, 230, 60)
    if found is not None:
        lines.insert(0, found.draw(picture, camera, colour, thick))
    elif box is not None:
        cv2.rectangle(picture, (box.u0, box.v0, box.width, box.height), refused_rgb, thick)
    # White on a darkened band: readable before anything.
    picture[: round((8 + 20 * len(lines)) * scale)] //= 4
    for row, line in enumerate(lines):
        at = (round(10 * scale), round((20 + 20 * row) * scale))
        font = cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(picture, line, at, font, 0.5 * scale, (255, 255, 255), thick, cv2.LINE_AA)
    return picture
