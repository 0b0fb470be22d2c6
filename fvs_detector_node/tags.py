"""Pose of a square tag of known size in one image, without depth.

OpenCV finds the tag and reads its number. Its corners are then measured anew: each side is a line
through the steepest brightness across it, and a corner is where two sides meet. That is about ten
times as exact as a corner searched by itself, because a side has dozens of pixels.

A square seen almost squarely has two poses that fit, its plane tilted to one side or the other. One
is taken only if the other fits clearly worse, or if the last image says so.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import log

import cv2
import numpy as np

from fvs_ros.camera import Intrinsics
from fvs_ros.feature import rotation_angle_rad
from fvs_ros.params import Parameters, parameter

#: Dictionaries of OpenCV, without its prefix; of two spellings, H and h, the latter.
_NAMES = {number: name for name, number in sorted(vars(cv2.aruco).items()) if name[:5] == "DICT_"}
DICTIONARIES = tuple(sorted(name.removeprefix("DICT_") for name in _NAMES.values()))

#: Samples along a side begin and end at these parts of it: beyond, the next side blurs in.
_ALONG = 0.1, 0.9
#: Samples across a side reach this far, px, and over this share of a cell, at first and then:
#: beyond is the next one.
_ACROSS_PX, _ACROSS_CELLS = 4.0, (0.9, 0.45)
#: A cell is at least as wide and high as this, px: of 2000 tags with smaller ones 13 became mirror
#: images.
_LEAST_CELL_PX = 3.0
#: A side is clear if this share of its samples has this share of the usual contrast, and is this
#: near to the line, px: what hides an end of it would turn it.
_CLEAR_SHARE, _CLEAR_CONTRAST, _CLEAR_PX = 0.85, 0.6, 0.4
#: Most samples along a side, and rounds of measuring around what the last round found.
_SAMPLES, _ROUNDS = 48, 3
#: Noise of a corner's coordinate, px: at least, as rendered images have it, and the first guess;
#: images that it is learned from, and how many of them the guess counts for.
_LEAST_PX, _GUESS_PX, _IMAGES, _GUESSES = 0.03, 0.15, 64, 8
#: A view is another one if a corner has moved by this, px.
_ANOTHER_PX = 1.0
#: A pose is certain if the squared residual of the other, in variances of the noise, is larger by
#: this: the noise would have to be off by five standard deviations. An error that stays from image
#: to image (lens, print, the paper's edge near a small tag) is no noise; it is taken for at least
#: this, px: with less, one of 700 rendered tags of 26 px was taken for its mirror image.
_CERTAIN, _SAME_PX = 25.0, 0.1
#: Otherwise the last image decides, if it is no older, s, and one pose is nearer to its pose than
#: this share of the other's distance.
_LAST_S, _NEARER = 0.2, 0.5
#: Poses that differ by less are as good as one, rad.
_SAME_RAD = 0.02


@dataclass(frozen=True)
class Tag(Parameters):
    """The tag that is looked for."""

    tag_dictionary: str = parameter(
        "APRILTAG_36h11", "family of the tag, as OpenCV names it", choices=DICTIONARIES
    )
    tag_id: int = parameter(0, "number of the tag", 0, 2**16 - 1)
    tag_size_m: float = parameter(
        0.1, "side of the tag's black square; measure it: the distance scales with it", 0.005, 1.0
    )


@dataclass(frozen=True)
class TagPose:
    """Pose of a tag: its x axis to the right, y up, z out of the print."""

    position_m: np.ndarray  # of its middle, camera optical frame, (3,)
    rotation: np.ndarray  # from the tag's to the camera's frame, (3, 3)
    corners_px: np.ndarray  # clockwise from the upper left, (4, 2)
    residual_px: float  # of the corners, rms


class TagReader:
    """Finds one tag in grey images."""

    def __init__(self, tag: Tag) -> None:
        number = getattr(cv2.aruco, f"DICT_{tag.tag_dictionary}")
        dictionary = cv2.aruco.getPredefinedDictionary(number)
        if tag.tag_id >= len(dictionary.bytesList):
            raise ValueError(
                f"tag_id {tag.tag_id} is not in {tag.tag_dictionary}, which has "
                f"{len(dictionary.bytesList)} tags"
            )
        self.tag, self.dictionary, self.cells = tag, dictionary, dictionary.markerSize + 2
        self._detector = cv2.aruco.ArucoDetector(dictionary)

    def find(self, grey: np.ndarray) -> tuple[np.ndarray | None, str]:
        """Corners of the tag, px, (4, 2), clockwise from its upper left; or None and why not.

        ``grey`` is of uint8, shape (H, W).
        """
        quads, numbers, others = self._detector.detectMarkers(grey)
        seen = [] if numbers is None else numbers.ravel().tolist()
        found = [
            quad for quad, number in zip(quads, seen, strict=True) if number == self.tag.tag_id
        ]
        if len(found) > 1:
            return None, f"{len(found)} tags have the number {self.tag.tag_id}: cover all but one"
        if found:
            return self._measured(grey, found[0].reshape(4, 2))
        wanted = f"tag {self.tag.tag_id} of {self.tag.tag_dictionary} is not in view"
        if seen:
            return None, f"{wanted}; seen are {sorted(set(seen))[:8]}: check tag_id"
        if others:
            return None, f"{wanted}, nor another: is tag_dictionary right, the print not mirrored?"
        return None, f"{wanted}: is it covered, too far, blurred, or without a white border?"

    def _measured(self, grey: np.ndarray, quad_px: np.ndarray) -> tuple[np.ndarray | None, str]:
        """The tag's corners from those that OpenCV found."""
        corners_px = refined(grey, quad_px, self.cells)
        if corners_px is None:
            return None, "a side of the tag is hidden or not clear"
        sides_px = np.linalg.norm(np.roll(corners_px, -1, axis=0) - corners_px, axis=1)
        across_px = cv2.contourArea(corners_px.astype(np.float32)) / sides_px.max()
        if across_px < _LEAST_CELL_PX * self.cells:
            return None, "the tag is too small in the image: bring it nearer or print it larger"
        return corners_px, ""


def refined(grey: np.ndarray, corners_px: np.ndarray, cells: int) -> np.ndarray | None:
    """Corners where the measured sides meet, px, (4, 2); None if a side is not clearly seen.

    Parameters
    ----------
    grey : ndarray of uint8, shape (H, W)
        Image, without distortion.
    corners_px : ndarray, shape (4, 2)
        About where they are, clockwise in the image.
    cells : int
        Number of the tag's cells along a side, with its border.
    """
    corners = np.asarray(corners_px, dtype=float)
    for round_ in range(_ROUNDS):
        sides = np.roll(corners, -1, axis=0) - corners
        lengths = np.linalg.norm(sides, axis=1)
        outward = np.column_stack([sides[:, 1], -sides[:, 0]]) / lengths[:, None]
        along = np.linspace(*_ALONG, int(np.clip(lengths.mean(), 8, _SAMPLES)))
        share = _ACROSS_CELLS[min(round_, 1)]
        reach = float(np.clip(share * lengths.min() / cells, 1.5, _ACROSS_PX))
        across = np.linspace(-reach, reach, round(4 * reach) + 1)
        starts = corners[:, None, None] + sides[:, None, None] * along[:, None, None]
        points = (starts + outward[:, None, None] * across[:, None]).reshape(4, -1, 2)
        u, v = np.moveaxis(points.astype(np.float32), -1, 0)
        values = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        values = values.reshape(4, along.size, across.size).astype(float)
        steps = np.maximum(np.diff(values), 0.0)  # outward it becomes brighter
        contrast = steps.sum(axis=2)
        if round_ == 0:  # the edge of the paper may be in sight: the steepest step counts
            steps = steps**3
        weights = steps.sum(axis=2)
        middles = 0.5 * (across[1:] + across[:-1])
        offsets = steps @ middles / np.maximum(weights, 1e-9)
        lines, off = [], np.empty_like(offsets)
        for side in range(4):
            line, off[side] = _line(along, offsets[side], contrast[side])
            ends = line[:, None] * outward[side]
            start, end = corners[side] + ends[0], corners[side] + sides[side] + ends[1]
            lines.append(np.cross(np.append(start, 1.0), np.append(end, 1.0)))
        meets = np.cross(np.roll(lines, 1, axis=0), lines)
        corners = meets[:, :2] / meets[:, 2:]
    clear = (contrast > _CLEAR_CONTRAST * np.median(contrast)) & (off < _CLEAR_PX)
    return corners if clear.mean(axis=1).min() > _CLEAR_SHARE else None


def _line(
    along: np.ndarray, offsets: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Offsets at 0 and 1 of a line, fitted twice, then without outliers; what is off it."""
    terms = np.column_stack([1.0 - along, along])
    for _ in range(2):
        fit = np.linalg.lstsq(terms * weights[:, None], offsets * weights, rcond=None)[0]
        off = np.abs(offsets - terms @ fit)
        weights = weights * (off <= 3.0 * np.median(off) + 1e-3)
    return fit, np.abs(offsets - terms @ fit)


class PoseFinder:
    """Finds the pose of a square from its corners; remembers the last one."""

    def __init__(self, size_m: float) -> None:
        half = 0.5 * size_m
        self._square = half * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]], float)
        self._last: tuple[float, np.ndarray] | None = None
        self._squares_px2 = deque([2.0 * log(2.0) * _GUESS_PX**2] * _GUESSES, maxlen=_IMAGES)
        self._learned_at_px = np.full((4, 2), np.inf)

    def reset(self) -> None:
        """Forget the last pose."""
        self._last = None

    @property
    def noise_px(self) -> float:
        """Noise of a corner's coordinate, px: eight of them less six unknowns leave two to know.

        By the median, 2 ln 2 variances, which views with a hidden corner hardly change.
        """
        return max(_LEAST_PX, float(np.median(self._squares_px2) / (2.0 * log(2.0))) ** 0.5)

    def find(
        self, stamp_s: float, corners_px: np.ndarray, camera: Intrinsics
    ) -> tuple[TagPose | None, str]:
        """The pose, or None and why there is none; exposure, s, and corners, px, (4, 2)."""
        matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
        found = cv2.solvePnPGeneric(
            self._square, corners_px, matrix, None, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
        poses = [
            self._refined(corners_px, matrix, *one) for one in zip(found[1], found[2], strict=True)
        ]
        # In front of the camera, and with the print to it.
        poses = [
            one for one in poses if one.rotation[:, 2] @ one.position_m < 0.0 < one.position_m[2]
        ]
        poses.sort(key=lambda one: one.residual_px)
        least_px2 = 8.0 * poses[0].residual_px ** 2 if poses else np.inf
        # The same view again would tell the same error again, not the noise.
        if np.abs(corners_px - self._learned_at_px).max() > _ANOTHER_PX:
            self._squares_px2.append(least_px2)
            self._learned_at_px = corners_px
        if least_px2 > 2.0 * _CERTAIN * self.noise_px**2:
            return None, "the corners of the tag are those of no square: is it bent, or covered?"
        pose = self._choice(stamp_s, *poses[:2])
        if pose is None:
            return None, (
                "the tag is seen so squarely that two poses fit: tilt it, bring it nearer, or "
                "begin where it is seen at an angle"
            )
        self._last = (stamp_s, pose.rotation)
        return pose, ""

    def _refined(
        self, corners_px: np.ndarray, matrix: np.ndarray, turn: np.ndarray, shift: np.ndarray
    ) -> TagPose:
        turn, shift = cv2.solvePnPRefineLM(self._square, corners_px, matrix, None, turn, shift)
        seen_px = cv2.projectPoints(self._square, turn, shift, matrix, None)[0].reshape(4, 2)
        residual_px = float(np.sqrt(np.square(seen_px - corners_px).mean()))
        return TagPose(shift.ravel(), cv2.Rodrigues(turn)[0], corners_px, residual_px)

    def _choice(
        self, stamp_s: float, first: TagPose, other: TagPose | None = None
    ) -> TagPose | None:
        """The pose that is certain, of two; None if neither is."""
        if other is None or rotation_angle_rad(first.rotation.T @ other.rotation) < _SAME_RAD:
            return first
        worse_px2 = 8.0 * (other.residual_px**2 - first.residual_px**2)
        certain = worse_px2 > _CERTAIN * max(self.noise_px, _SAME_PX) ** 2
        if self._last is None or not 0.0 < stamp_s - self._last[0] <= _LAST_S:
            return first if certain else None
        to_first, to_other = (
            rotation_angle_rad(one.rotation.T @ self._last[1]) for one in (first, other)
        )
        if to_other < _NEARER * to_first:  # a corner that is off can make the wrong one certain
            return None if certain else other
        return first if certain or to_first < _NEARER * to_other else None
