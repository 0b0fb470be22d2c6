"""Corners of tags in a grey image.

OpenCV finds the tags and reads their numbers. Their corners are then measured anew: each side is a
line through the steepest brightness across it, and a corner is where two sides meet. That is about
ten times as exact as a corner searched by itself, because a side has dozens of pixels.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from fvs_detector_node.tags import Tag

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
#: A cell is at least as wide and high as this, px: with 2 px corners are off by up to 0.8 px.
_LEAST_CELL_PX = 2.5
#: A side is clear if this share of its samples has this share of the usual contrast, and is this
#: near to the line, px: what hides an end of it would turn it. Paper is wavy: of a long side the
#: last share counts.
_CLEAR_SHARE, _CLEAR_CONTRAST, _CLEAR_PX, _WAVY = 0.85, 0.6, 0.4, 0.0075
#: Deviation of a side's brightness steps over the reach of the samples: at this one, blur moves
#: corners by 0.3 px; of 2000 blurred tags all that became mirror images were above.
_BLURRED = 0.5
#: Most samples along a side, and rounds of measuring around what the last round found.
_SAMPLES, _ROUNDS = 48, 3


class TagReader:
    """Finds the tags of one body in grey images."""

    def __init__(self, tag: Tag) -> None:
        count, last = len(tag.dictionary.bytesList), max(tag.faces)
        if last >= count:
            raise ValueError(
                f"tag_id {last} is not in {tag.tag_dictionary}, which has {count} tags"
            )
        self.tag, self._cells = tag, tag.cells
        options = cv2.aruco.DetectorParameters()
        # A view full of squares that are too small takes seconds; by the larger side, of 640 px.
        options.minMarkerPerimeterRate = 0.6 * 4.0 * _LEAST_CELL_PX * self._cells / 640.0
        self._detector = cv2.aruco.ArucoDetector(tag.dictionary, options)

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
        if found:
            return dict(sorted(found.items())), ""
        if problem:
            return {}, problem
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
        corners_px, problem = refined(grey, quad_px, self._cells)
        if corners_px is None:
            return None, problem
        if across_px(corners_px) < _LEAST_CELL_PX * self._cells:
            return None, "the tag is too small in the image: bring it nearer or print it larger"
        return corners_px, ""


def across_px(corners_px: np.ndarray) -> float:
    """Width across a tag at its thinnest, px; a tilted one is thinner than its sides are long."""
    sides_px = np.linalg.norm(np.roll(corners_px, -1, axis=0) - corners_px, axis=1)
    return float(cv2.contourArea(corners_px.astype(np.float32)) / sides_px.max())


def refined(grey: np.ndarray, corners_px: np.ndarray, cells: int) -> tuple[np.ndarray | None, str]:
    """Corners where the measured sides meet, px, (4, 2); None and why if a side is not clear.

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
        middles, whole = 0.5 * (across[1:] + across[:-1]), np.maximum(contrast, 1e-9)
        offsets = steps @ middles / whole
        width = np.sqrt(np.maximum(steps @ middles**2 / whole - offsets**2, 0.0))
        lines, off = zip(
            *[_line(along, *one) for one in zip(offsets, contrast, strict=True)], strict=True
        )
        corners = _meeting(corners, lines)
    near = np.array(off) < np.maximum(_CLEAR_PX, _WAVY * lengths)[:, None]
    clear = near & (contrast > _CLEAR_CONTRAST * np.median(contrast))
    if clear.mean(axis=1).min() <= _CLEAR_SHARE:
        return None, "a side of the tag is hidden or not clear"
    if np.median(width, axis=1).max() > _BLURRED * reach:
        return None, "the tag is blurred: focus, expose shorter, or bring it nearer"
    return corners, ""


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
