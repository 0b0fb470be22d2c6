"""Click and track: patches of an image that a user chose are followed from image to image.

Each patch is searched near where it should be by now, and then aligned with what it was in the
first image: by a shift, turn, scale and shear (ECC, Evangelidis and Psarakis 2008). So it does not
drift. Optical flow from image to image, which needs a forward-backward check, was off by 1.3 px
after 100 drawn images that turn, scale and blur; this, by 0.04 px, and it follows steps of 40 px.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.detector import Detector, Sighting
from fvs_detector_node.image_points import PointsDetection
from fvs_ros.camera import CameraModel


@dataclass(frozen=True)
class Tracking:
    """Limits of what counts as the same patch; measured on drawn images."""

    #: Half a patch: smaller ones are less exact, larger ones hold more of the background, px.
    half_px: int = 12
    #: Largest departure from uniform motion in an image, px.
    reach_px: int = 48
    #: Correlation that a place loses at that distance: of two that look alike, the nearer counts.
    distance: float = 0.2
    #: Least correlation with the first patch. Twice the size left 0.91, blur by 6 px 0.93;
    #: the worst of 20 that were covered little by little was off by 1.0 px before it was lost.
    correlation: float = 0.9
    #: Largest change of the shape since the last image: without, 35 of 1000 other images with
    #: details of half a patch were mistaken for it when it was suddenly covered; with it, 2.
    bent: float = 0.25
    #: Lack of correlation over that of the next best place, to be believed where it was not
    #: expected: of 1000 such images, 1 was mistaken for it once it was lost.
    unlike: float = 0.35
    #: Least slope of the brightness along any direction, grey levels per pixel; noise has 0.5.
    slope: float = 3.0


LIMITS = Tracking()
_SIZE = 2 * LIMITS.half_px + 1
_STEPS = np.arange(-LIMITS.reach_px, LIMITS.reach_px + 1)
_FARTHER = LIMITS.distance / LIMITS.reach_px * np.hypot(_STEPS[:, None], _STEPS).astype(np.float32)
#: All of the region in which a patch is searched.
_WHOLE = np.ones((len(_STEPS) + _SIZE - 1,) * 2, np.uint8)
_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-4)


def _cut(image: np.ndarray, middle_px: np.ndarray, half_px: int) -> np.ndarray:
    """The grey square about a point; beyond the image it continues the edge."""
    size, (u, v) = 2 * half_px + 1, middle_px
    square = cv2.getRectSubPix(image, (size, size), (float(u), float(v)))
    return cv2.cvtColor(square, cv2.COLOR_RGB2GRAY)


class Patch:
    """A patch about a point, px, (2,), of a first image."""

    def __init__(self, rgb: np.ndarray, px: np.ndarray) -> None:
        half = LIMITS.half_px
        # With its surroundings, which show where it shrinks.
        self._around = _cut(rgb, px, 3 * half)
        self._first = np.ascontiguousarray(self._around[2 * half : -2 * half, 2 * half : -2 * half])
        self._px, self._velocity_px = px, np.zeros(2)
        self._shape = np.eye(2)  # from offsets in the first image to those in the last
        self._lost = False
        smooth = cv2.GaussianBlur(self._first.astype(np.float32), (5, 5), 0.0)
        slopes = np.stack(np.gradient(smooth)).reshape(2, -1)
        least = np.linalg.eigvalsh(slopes @ slopes.T / slopes.shape[1])[0]
        #: Whether a shift along any direction shows.
        self.rough = bool(least > LIMITS.slope**2)

    def find(self, rgb: np.ndarray) -> np.ndarray | None:
        """Where it is in the next image, px, (2,); None if it is not certain."""
        half, reach = LIMITS.half_px, LIMITS.reach_px
        origin = self._px + self._velocity_px - (reach + half)
        region = _cut(rgb, origin + reach + half, reach + half)
        middle = np.full(2, half)
        turned = np.column_stack([self._shape, middle - self._shape @ (3 * middle)])
        expected = cv2.warpAffine(self._around, turned, (_SIZE, _SIZE))
        likeness = cv2.matchTemplate(region, expected, cv2.TM_CCOEFF_NORMED)
        u, v = cv2.minMaxLoc(likeness - _FARTHER)[3]
        start = middle + [u, v]
        guess = np.column_stack([self._shape, start - self._shape @ middle]).astype(np.float32)
        self._velocity_px = np.zeros(2)
        was_lost, self._lost = self._lost, True
        try:
            correlation, warp = cv2.findTransformECC(
                self._first, region, guess, cv2.MOTION_AFFINE, _CRITERIA, _WHOLE, 1
            )
        except cv2.error:  # it does not converge
            return None
        shape, shift = np.hsplit(warp.astype(float), [2])
        bent = np.abs(np.linalg.solve(self._shape, shape) - np.eye(2)).max()
        px = origin + shape @ middle + shift[:, 0]
        if not (
            correlation >= LIMITS.correlation
            and bent <= LIMITS.bent
            and np.all((px >= 0.0) & (px < rgb.shape[1::-1]))
        ):
            return None
        if was_lost or max(abs(u - reach), abs(v - reach)) > half:
            lack = 1.0 - likeness[v, u]
            likeness[max(v - half, 0) : v + half + 1, max(u - half, 0) : u + half + 1] = -1.0
            if lack > LIMITS.unlike * (1.0 - likeness.max()):
                return None
        if not was_lost:
            self._velocity_px = px - self._px
        self._lost, self._px, self._shape = False, px, shape
        return px


class PatchDetector(Detector):
    """Follows what is at ``track_px`` in its first image, in the images of any camera."""

    needs_calibration = False

    def __init__(self, config: DetectorConfig) -> None:
        super().__init__(config)
        self._start_px = np.reshape(config.track_px, (-1, 2))
        self._patches: list[Patch] | None = None

    def detect(
        self, stamp_s: float, rgb: np.ndarray, depth_m: np.ndarray | None, camera: CameraModel
    ) -> Sighting:
        """Find all patches; the first image shows what they are."""
        if not len(self._start_px):
            return Sighting(None, "nothing is tracked: click on the page, or set track_px")
        if self._patches is None:
            inside = np.all((self._start_px >= 0.0) & (self._start_px < rgb.shape[1::-1]), axis=1)
            if not inside.all():
                return _missing(inside, "is not in the image: set track_px again")
            self._patches = [Patch(rgb, px) for px in self._start_px]
        rough = np.array([patch.rough for patch in self._patches])
        if not rough.all():
            return _missing(rough, "has nothing to hold on to: set track_px to a corner or print")
        found = [patch.find(rgb) for patch in self._patches]
        missing = np.array([px is not None for px in found])
        if not missing.all():
            return _missing(missing, "is lost: uncover it, or set track_px again")
        return Sighting(PointsDetection(np.array(found), float(LIMITS.half_px)))


def _missing(good: np.ndarray, words: str) -> Sighting:
    return Sighting(None, f"point {np.argmin(good) + 1} of track_px {words}")
