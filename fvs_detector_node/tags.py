"""Pose of a square tag of known size, or of several on one body, in one colour image.

OpenCV finds the tags and reads their numbers. Their corners are then measured anew: each side is a
line through the steepest brightness across it, and a corner is where two sides meet. That is about
ten times as exact as a corner searched by itself, because a side has dozens of pixels.

A square seen almost squarely has two poses that fit, its plane tilted to one side or the other. One
is taken only if the other fits clearly worse, or if the last image says so, or the depths on the
print. Depth serves for nothing else: its errors are larger than those of the corners.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from scipy.special import gammaincinv

from fvs_ros.camera import Intrinsics
from fvs_ros.feature import rotation_angle_rad, rotation_matrix
from fvs_ros.params import Parameters, parameter

#: Dictionaries of OpenCV, without its prefix; of two spellings, H and h, the latter.
_NAMES = {number: name for name, number in sorted(vars(cv2.aruco).items()) if name[:5] == "DICT_"}
DICTIONARIES = tuple(sorted(name.removeprefix("DICT_") for name in _NAMES.values()))
#: Where the tags are on the flat print, to the right and up, in widths of a tag with its border.
#: The sides of a cube are then folded back.
LAYOUTS = {
    "single": ((0.0, 0.0),),
    "plate": ((-0.5, 0.5), (0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)),
    "cube": ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)),
}

#: Samples along a side begin and end at these parts of it: beyond, the next side blurs in.
_ALONG = 0.1, 0.9
#: Samples along and across a side that is looked for, and how far across, cells: OpenCV may have
#: found the paper's edge, a cell outside; from 2 cells inside on the cells look like a side. A cell
#: counts for at most this, px, or samples would be further apart than what is measured around them.
_ROUGH, _ROUGH_CELLS, _ROUGH_PX = (12, 21), (-1.5, 0.9), 30.0
#: Grey levels that are dark: below, ratios are those of noise.
_DARK = 10.0
#: Samples across a side that is measured reach this far, px, and over this share of a cell: beyond
#: is the next one.
_ACROSS_PX, _ACROSS_CELLS = 4.0, 0.45
#: A cell is at least as wide and high as this, px: smaller ones were not tried.
_LEAST_CELL_PX = 2.0
#: A side is clear if this share of its samples has this share of the usual contrast, and is this
#: near to the line, px: what hides an end of it would turn it. Paper is wavy: of a long side the
#: last share counts.
_CLEAR_SHARE, _CLEAR_CONTRAST, _CLEAR_PX, _WAVY = 0.85, 0.6, 0.4, 0.0075
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
#: Depths count inside of this share of the print, and if there are these. Depth cameras smooth over
#: about so many pixels; so many deviations apart, two planes are told apart.
_INSIDE, _LEAST_DEPTHS, _SMOOTHED_PX, _DEVIATIONS = 0.85, 50, 5.0, 6.0


@dataclass(frozen=True)
class Face:
    """One tag of a layout, in the frame of the whole."""

    middle_m: np.ndarray  # (3,)
    rotation: np.ndarray  # from the tag's frame to that of the whole, (3, 3)
    corners_m: np.ndarray  # of the black square, clockwise from the upper left, (4, 3)


@dataclass(frozen=True)
class Tag(Parameters):
    """The tag, or the tags of one body, that are looked for."""

    tag_dictionary: str = parameter(
        "APRILTAG_36h11", "family of the tag, as OpenCV names it", choices=DICTIONARIES
    )
    tag_id: int = parameter(0, "number of the tag; the others of a layout follow", 0, 2**16 - 1)
    tag_size_m: float = parameter(
        0.1, "side of the tag's black square; measure it: the distance scales with it", 0.005, 1.0
    )
    tag_layout: str = parameter(
        "single",
        "single, or several tags on one body, as fvs_tag prints them: plate (2 x 2) or cube (front "
        "and four sides)",
        choices=tuple(LAYOUTS),
    )

    @property
    def dictionary(self) -> cv2.aruco.Dictionary:
        """The family, as OpenCV has it."""
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{self.tag_dictionary}"))

    @property
    def cells(self) -> int:
        """Cells along a side of the black square."""
        return int(self.dictionary.markerSize) + 2

    @property
    def pitch_m(self) -> float:
        """Width of a tag with its white border of one cell, m."""
        return self.tag_size_m * (self.cells + 2) / self.cells

    @property
    def extent_m(self) -> np.ndarray:
        """Width, height and depth of the body, m, (3,); a plate is flat."""
        edges = {"single": (1.0, 1.0, 0.0), "plate": (2.0, 2.0, 0.0), "cube": (1.0, 1.0, 1.0)}
        return self.pitch_m * np.array(edges[self.tag_layout])

    @cached_property
    def faces(self) -> dict[int, Face]:
        """The tags by their numbers.

        The frame of the whole has its origin in the middle, x to the right of the first tag, y up
        and z out of its print.
        """
        half_m = 0.5 * self.tag_size_m
        square_m = half_m * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
        faces = {}
        for number, (x, y) in enumerate(LAYOUTS[self.tag_layout], self.tag_id):
            rotation, middle_m = np.eye(3), self.pitch_m * np.array([x, y, 0.0])
            if self.tag_layout == "cube":
                rotation = rotation_matrix(0.5 * np.pi * np.array([-y, x, 0.0]))
                middle_m = 0.5 * self.pitch_m * rotation[:, 2]
            faces[number] = Face(middle_m, rotation, middle_m + square_m @ rotation.T)
        return faces

    def facing(self, rotation: np.ndarray, position_m: np.ndarray) -> list[int]:
        """Numbers of the tags whose print looks at the camera, from a pose in its frame."""
        return [
            number
            for number, face in self.faces.items()
            if (rotation @ face.rotation[:, 2]) @ (position_m + rotation @ face.middle_m) < 0.0
        ]


@dataclass(frozen=True)
class TagPose:
    """Pose of a tag, or of a layout of them: its x axis to the right, y up, z out of the print."""

    position_m: np.ndarray  # of its middle, camera optical frame, (3,)
    rotation: np.ndarray  # from the tag's to the camera's frame, (3, 3)
    numbers: tuple[int, ...]  # of the tags that are seen
    corners_px: np.ndarray  # of these, clockwise from the upper left, (k, 4, 2)
    residual_px: float  # of the corners, rms


class TagReader:
    """Finds the tags of one body in grey images."""

    def __init__(self, tag: Tag) -> None:
        count, last = len(tag.dictionary.bytesList), max(tag.faces)
        if last >= count:
            raise ValueError(
                f"tag_id {last} is not in {tag.tag_dictionary}, which has {count} tags"
            )
        self.tag, self._cells = tag, tag.cells
        self._detector = cv2.aruco.ArucoDetector(tag.dictionary)

    def find(self, grey: np.ndarray) -> tuple[dict[int, np.ndarray], str]:
        """Corners of the tags, px, (4, 2), clockwise from the upper left; if none, why not.

        ``grey`` is of uint8, shape (H, W).
        """
        quads, numbers, others = self._detector.detectMarkers(grey)
        seen = [] if numbers is None else numbers.ravel().tolist()
        found, problem = {}, ""
        for quad, number in zip(quads, seen, strict=True):
            if number not in self.tag.faces:
                continue
            if seen.count(number) > 1:
                return {}, f"{seen.count(number)} tags have the number {number}: cover all but one"
            corners_px, why = self._measured(grey, quad.reshape(4, 2))
            if corners_px is None:
                problem = why
            else:
                found[number] = corners_px
        if found or problem:
            return found, problem if not found else ""
        first, last = min(self.tag.faces), max(self.tag.faces)
        wanted = f"tag {first}" if first == last else f"none of the tags {first} to {last}"
        wanted += f" of {self.tag.tag_dictionary} is {'not ' if first == last else ''}in view"
        if seen:
            return {}, f"{wanted}; seen are {sorted(set(seen))[:8]}: check tag_id"
        if others:
            return {}, f"{wanted}, nor another: is tag_dictionary right, the print not mirrored?"
        return {}, f"{wanted}: is it covered, too far, blurred, or without a white border?"

    def _measured(self, grey: np.ndarray, quad_px: np.ndarray) -> tuple[np.ndarray | None, str]:
        """A tag's corners from those that OpenCV found."""
        corners_px = refined(grey, quad_px, self._cells)
        if corners_px is None:
            return None, "a side of the tag is hidden or not clear"
        if across_px(corners_px) < _LEAST_CELL_PX * self._cells:
            return None, "the tag is too small in the image: bring it nearer or print it larger"
        return corners_px, ""


def across_px(corners_px: np.ndarray) -> float:
    """Width across a tag at its thinnest, px; a tilted one is thinner than its sides are long."""
    sides_px = np.linalg.norm(np.roll(corners_px, -1, axis=0) - corners_px, axis=1)
    return float(cv2.contourArea(corners_px.astype(np.float32)) / sides_px.max())


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
    along = np.linspace(*_ALONG, _ROUGH[0])
    cell_px = min(across_px(corners) / cells, _ROUGH_PX)
    across = cell_px * np.linspace(*_ROUGH_CELLS, _ROUGH[1])
    # What light and shade do to the paper is a factor: ratios tell print from shadow.
    ratios = np.maximum(np.diff(np.log(_sampled(grey, corners, along, across) + _DARK)), 0.0)
    middles = 0.5 * (across[1:] + across[:-1])
    corners = _meeting(corners, middles[_steepest(along, ratios)])
    for _ in range(_ROUNDS):
        lengths = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
        along = np.linspace(*_ALONG, int(np.clip(lengths.mean(), 8, _SAMPLES)))
        reach = float(np.clip(_ACROSS_CELLS * across_px(corners) / cells, 1.5, _ACROSS_PX))
        across = np.linspace(-reach, reach, round(4 * reach) + 1)
        steps = np.maximum(np.diff(_sampled(grey, corners, along, across)), 0.0)
        contrast = steps.sum(axis=2)
        offsets = steps @ (0.5 * (across[1:] + across[:-1])) / np.maximum(contrast, 1e-9)
        lines, off = zip(
            *[_line(along, *one) for one in zip(offsets, contrast, strict=True)], strict=True
        )
        corners = _meeting(corners, lines)
    near = np.array(off) < np.maximum(_CLEAR_PX, _WAVY * lengths)[:, None]
    clear = near & (contrast > _CLEAR_CONTRAST * np.median(contrast))
    return corners if clear.mean(axis=1).min() > _CLEAR_SHARE else None


def _outward(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sides, px, and their unit normals out of the tag, each (4, 2)."""
    sides = np.roll(corners, -1, axis=0) - corners
    normals = np.column_stack([sides[:, 1], -sides[:, 0]])
    return sides, normals / np.linalg.norm(sides, axis=1)[:, None]


def _sampled(
    grey: np.ndarray, corners: np.ndarray, along: np.ndarray, across: np.ndarray
) -> np.ndarray:
    """Brightness along the sides, as shares of them, and across, outward, px: (4, A, B)."""
    sides, outward = _outward(corners)
    starts = corners[:, None, None] + sides[:, None, None] * along[:, None, None]
    points = (starts + outward[:, None, None] * across[:, None]).reshape(4, -1, 2)
    u, v = np.moveaxis(points.astype(np.float32), -1, 0)
    values = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return values.reshape(4, along.size, across.size).astype(float)


def _steepest(along: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Columns at 0 and 1 of the lines across which steps, (4, A, B), are the steepest: (4, 2).

    OpenCV may take a corner of the paper for that of the tag: most of the steps that are in sight
    are then not those of the side.
    """
    count = steps.shape[2]
    start, end = np.mgrid[:count, :count].reshape(2, -1, 1)
    columns = np.rint(start + (end - start) * along).astype(int)
    heights = steps[:, np.arange(along.size), columns].sum(axis=-1)
    return np.stack(np.divmod(heights.argmax(axis=-1), count), axis=-1)


def _meeting(corners: np.ndarray, ends: Sequence[np.ndarray]) -> np.ndarray:
    """Where lines meet that begin and end so far outward of the sides, px: (4, 2)."""
    _, outward = _outward(corners)
    lines = []
    for side, (start, end) in enumerate(ends):
        first = corners[side] + start * outward[side]
        last = corners[(side + 1) % 4] + end * outward[side]
        lines.append(np.cross(np.append(first, 1.0), np.append(last, 1.0)))
    meets = np.cross(np.roll(lines, 1, axis=0), lines)
    return np.asarray(meets[:, :2] / meets[:, 2:])


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
    """Finds the pose of a tag, or of a layout of them, from corners; remembers the last one."""

    def __init__(self, tag: Tag) -> None:
        half = 0.5 * tag.tag_size_m
        self._tag = tag
        self._square = half * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]], float)
        self._last: tuple[float, np.ndarray] | None = None
        self._squares_px2 = deque([_GUESS_PX**2] * _GUESSES, maxlen=_IMAGES)
        self._learned_at: dict[int, np.ndarray] = {}

    def reset(self) -> None:
        """Forget the last pose."""
        self._last = None

    @property
    def noise_px(self) -> float:
        """Noise of a corner's coordinate, px, by the median, which a hidden corner hardly moves."""
        return max(_LEAST_PX, float(np.median(self._squares_px2)) ** 0.5)

    def find(
        self,
        stamp_s: float,
        seen: dict[int, np.ndarray],
        camera: Intrinsics,
        depth_m: np.ndarray | None = None,
    ) -> tuple[TagPose | None, str]:
        """The pose, or None and why there is none.

        Takes the exposure, s, and by the tags' numbers their corners, px, (4, 2); at least one.
        Depths are those of the whole image, (H, W), m, 0 where there is none.
        """
        matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
        poses = [self._refined(seen, matrix, *one) for one in self._first(seen, matrix)]
        # In front of the camera, and with the prints to it.
        poses = [
            one
            for one in poses
            if one.position_m[2] > 0.0
            and seen.keys() <= set(self._tag.facing(one.rotation, one.position_m))
        ]
        poses.sort(key=lambda one: one.residual_px)
        coordinates = 8 * len(seen)
        unknown = coordinates - 6
        least_px2 = coordinates * poses[0].residual_px ** 2 if poses else np.inf
        # The same view again would tell the same error again, not the noise.
        if not self._same_view(seen):
            # The median of a chi squared of so many degrees is one variance.
            self._squares_px2.append(least_px2 / (2.0 * gammaincinv(0.5 * unknown, 0.5)))
            self._learned_at = seen
        if least_px2 > unknown * _CERTAIN * self.noise_px**2:
            return None, "the corners of the tag are those of no square: is it bent, or covered?"
        pose = self._choice(stamp_s, *poses[:2])
        if pose is None and depth_m is not None:
            pose = self._by_depth(poses[0], poses[1], camera, depth_m)
        if pose is None:
            return None, (
                "the tag is seen so squarely that two poses fit: tilt it, bring it nearer, or "
                "begin where it is seen at an angle"
            )
        self._last = (stamp_s, pose.rotation)
        return pose, ""

    def _same_view(self, seen: dict[int, np.ndarray]) -> bool:
        last = self._learned_at
        return seen.keys() == last.keys() and all(
            np.abs(corners_px - last[number]).max() <= _ANOTHER_PX
            for number, corners_px in seen.items()
        )

    def _first(
        self, seen: dict[int, np.ndarray], matrix: np.ndarray
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """The two poses of the largest tag, as the whole's rotation vector and position, m."""
        number = max(seen, key=lambda one: cv2.contourArea(seen[one].astype(np.float32)))
        face = self._tag.faces[number]
        found = cv2.solvePnPGeneric(
            self._square, seen[number], matrix, None, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
        poses = []
        for turn, shift in zip(found[1], found[2], strict=True):
            rotation = cv2.Rodrigues(turn)[0] @ face.rotation.T
            poses.append((cv2.Rodrigues(rotation)[0], shift - rotation @ face.middle_m[:, None]))
        return poses

    def _refined(
        self, seen: dict[int, np.ndarray], matrix: np.ndarray, turn: np.ndarray, shift: np.ndarray
    ) -> TagPose:
        points_m = np.concatenate([self._tag.faces[number].corners_m for number in seen])
        corners_px = np.array(list(seen.values()))
        flat_px = corners_px.reshape(-1, 2)
        turn, shift = cv2.solvePnPRefineLM(points_m, flat_px, matrix, None, turn, shift)
        back_px = cv2.projectPoints(points_m, turn, shift, matrix, None)[0].reshape(-1, 2)
        residual_px = float(np.sqrt(np.square(back_px - flat_px).mean()))
        return TagPose(shift.ravel(), cv2.Rodrigues(turn)[0], tuple(seen), corners_px, residual_px)

    def _choice(
        self, stamp_s: float, first: TagPose, other: TagPose | None = None
    ) -> TagPose | None:
        """The pose that is certain, of two; None if neither is."""
        if other is None or rotation_angle_rad(first.rotation.T @ other.rotation) < _SAME_RAD:
            return first
        worse_px2 = first.corners_px.size * (other.residual_px**2 - first.residual_px**2)
        certain = worse_px2 > _CERTAIN * max(self.noise_px, _SAME_PX) ** 2
        if self._last is None or not 0.0 < stamp_s - self._last[0] <= _LAST_S:
            return first if certain else None
        to_first, to_other = (
            rotation_angle_rad(one.rotation.T @ self._last[1]) for one in (first, other)
        )
        if to_other < _NEARER * to_first:  # a corner that is off can make the wrong one certain
            return None if certain else other
        return first if certain or to_first < _NEARER * to_other else None

    def _by_depth(
        self, first: TagPose, other: TagPose, camera: Intrinsics, depth_m: np.ndarray
    ) -> TagPose | None:
        """The pose whose largest print lies as the depths on it do; None if they do not tell."""
        sizes_px2 = [cv2.contourArea(one.astype(np.float32)) for one in first.corners_px]
        largest = int(np.argmax(sizes_px2))
        corners_px = first.corners_px[largest]
        middle_px = corners_px.mean(axis=0)
        inside = np.zeros(depth_m.shape, np.uint8)
        quad_px = np.rint(middle_px + _INSIDE * (corners_px - middle_px)).astype(np.int32)
        v, u = np.nonzero(cv2.fillConvexPoly(inside, quad_px, 1) * (depth_m > 0.0))
        if u.size < _LEAST_DEPTHS:
            return None
        # On a plane 1 / depth is linear in the pixels, and its slopes are those of the normal.
        rays, nearness = camera.rays(u, v), 1.0 / depth_m[v, u]
        normal, *_ = np.linalg.lstsq(rays, nearness, rcond=None)
        noise = (nearness - rays @ normal).std() * _SMOOTHED_PX
        spread = noise * np.sqrt(np.trace(np.linalg.inv(rays.T @ rays)[:2, :2]))
        rotation = self._tag.faces[first.numbers[largest]].rotation
        seen, one, two = (
            row / np.linalg.norm(row)
            for row in (-normal, first.rotation @ rotation[:, 2], other.rotation @ rotation[:, 2])
        )
        if np.linalg.norm(one - two) < _DEVIATIONS * spread / np.linalg.norm(normal):
            return None
        to_first, to_other = np.linalg.norm(seen - one), np.linalg.norm(seen - two)
        if to_first < _NEARER * to_other:
            return first
        return other if to_other < _NEARER * to_first else None
