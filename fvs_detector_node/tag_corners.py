"""Corners of tags in a grey image, and how exact they are.

OpenCV finds the tags and reads their numbers. Then the whole pattern, which is known, is laid over
the image: perspective, brightness and blur are fitted at once, with weights that leave out what
hides a part. What the fit leaves unexplained gives the covariance of the corners: noise, contrast,
blur and covers count for what they do.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import erfc

import cv2
import numpy as np

from fvs_detector_node.tags import Tag


@dataclass(frozen=True)
class Fitting:
    """How a pattern is fitted, and what it must be like."""

    #: Least width across a tag, px a cell; OpenCV does not look for smaller squares, since a view
    #: full of them takes seconds.
    cell_px: float = 2.5
    #: Least share of the brightness' variance that the pattern explains: 0.2 to 0.4 where OpenCV
    #: read a number in noise, 0.9 at a contrast of 12 grey levels.
    explained: float = 0.8
    #: Samples lie on both sides of the lines between cells, so many steps away. A step is as long
    #: as the blur's deviation, but at least so many px, and at most this share of a cell.
    steps: tuple[float, ...] = (-1.5, -0.5, 0.5, 1.5)
    step_px: float = 1.5
    step_cells: float = 0.25
    #: First guess of the blur's deviation, cells: with sharper ones a corner that OpenCV has off by
    #: half a cell is lost.
    blur_cells: float = 0.35
    #: A residual of so many deviations has a quarter of the weight; what is hidden has none.
    outlier: float = 6.0
    #: Rounds at most, and the step of a corner, px, that ends them.
    rounds: int = 12
    still_px: float = 0.03


FIT = Fitting()

#: Least deviations: of a brightness, which is rounded, grey levels, and of the blur, px, since a
#: pixel averages over its width.
_UNIFORM = 12.0**-0.5
#: The normal distribution, tabulated: SciPy's takes a quarter of a second to import.
_DEVIATIONS = np.linspace(-6.0, 6.0, 2401)
_NORMAL = np.array([0.5 * erfc(-x / 2.0**0.5) for x in _DEVIATIONS])
#: The tag's corners in the frame of the fit, homogeneous, (4, 3).
_SQUARE = np.array([[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]])
#: Small homographies are 1 plus these times the eight unknowns, (8, 3, 3).
_SMALL = np.zeros((8, 3, 3))
_SMALL[range(6), [0, 0, 0, 1, 1, 1], [2, 0, 1, 2, 0, 1]] = 1.0
_SMALL[[6, 7], 2, [0, 1]] = -1.0


@dataclass(frozen=True)
class Corners:
    """Corners of a tag, clockwise from the upper left."""

    px: np.ndarray  # (4, 2)
    covariance_px2: np.ndarray  # of u and v of the first, of the second, ...: (8, 8)


class TagReader:
    """Reads the tags of one body in grey images."""

    def __init__(self, tag: Tag) -> None:
        count, last = len(tag.dictionary.bytesList), max(tag.faces)
        if last >= count:
            first = f"tag_id can be 0 to {count - len(tag.faces)}"
            raise ValueError(f"tag {last} is not in {tag.tag_dictionary}: {first}")
        self.tag = tag
        self._patterns = {number: _Pattern(tag, number) for number in tag.faces}
        self._options = cv2.aruco.DetectorParameters()
        self._detector = cv2.aruco.ArucoDetector(tag.dictionary, self._options)

    def read(self, grey: np.ndarray) -> tuple[dict[int, Corners], str]:
        """The corners of the tags by their numbers; if none, why not.

        ``grey`` is of uint8, shape (H, W), without distortion.
        """
        # OpenCV wants it as a share of the larger side; OpenCV's outlines are a little too small.
        perimeter_px = 0.6 * 4.0 * FIT.cell_px * self.tag.cells
        self._options.minMarkerPerimeterRate = min(perimeter_px / max(grey.shape), 4.0)
        self._detector.setDetectorParameters(self._options)
        quads, ids, rejected = self._detector.detectMarkers(grey)
        numbers = [] if ids is None else ids.ravel().tolist()
        tags, problem = {}, ""
        for quad, number in zip(quads, numbers, strict=True):
            if number not in self.tag.faces:
                continue
            if (count := numbers.count(number)) > 1:
                return {}, f"{count} tags have the number {number}: cover all but one"
            corners = self._patterns[number].fit(grey, quad.reshape(4, 2))
            if corners is None:
                problem = "the tag's pattern is not clear: is it covered, or the light too poor?"
            elif across_px(corners.px) < FIT.cell_px * self.tag.cells:
                problem = "the tag is too small in the image: bring it nearer or print it larger"
            else:
                tags[number] = corners
        if tags:
            return dict(sorted(tags.items())), ""
        if problem:
            return {}, problem
        first, last = min(self.tag.faces), max(self.tag.faces)
        missing = f"tag {first}" if first == last else f"none of the tags {first} to {last}"
        missing += f" of {self.tag.tag_dictionary} is {'not ' if first == last else ''}in view"
        if numbers:
            return {}, f"{missing}; seen are {sorted(set(numbers))[:8]}: is the number right?"
        if rejected:
            return {}, f"{missing}, nor another: is tag_dictionary right, the print not mirrored?"
        return {}, f"{missing}: is it covered, too far, blurred, or without a white border?"


def across_px(corners_px: np.ndarray) -> float:
    """Width across a tag at its thinnest, px; a tilted one is thinner than its sides are long."""
    sides_px = np.linalg.norm(np.roll(corners_px, -1, axis=0) - corners_px, axis=1)
    return float(cv2.contourArea(corners_px.astype(np.float32)) / sides_px.max())


class _Pattern:
    """A tag's pattern with its white border, which is fitted to images.

    The fit has 16 unknowns: 8 of the perspective, the blur along both axes and oblique to them, how
    far ink spreads, the contrast, and the brightness of the ink, a plane.
    """

    def __init__(self, tag: Tag, number: int) -> None:
        print_ = cv2.aruco.generateImageMarker(tag.dictionary, number, tag.cells) / 255.0
        self._cells = np.pad(print_, 1, constant_values=1.0)
        self._lines = np.linspace(-1.0, 1.0, tag.cells + 1)
        self._pitch = 2.0 / tag.cells

    def fit(self, grey: np.ndarray, corners_px: np.ndarray) -> Corners | None:
        """Corners from those that are about right, px, (4, 2); None if the pattern is not there."""
        corners_px = corners_px.astype(np.float32)
        matrix = cv2.getPerspectiveTransform(_SQUARE[:, :2].astype(np.float32), corners_px)
        sides_px = np.linalg.norm(np.roll(corners_px, -1, axis=0) - corners_px, axis=1)
        px = 4.0 / (sides_px[:2] + sides_px[2:])  # in the frame of the fit
        blur, light = np.full(2, FIT.blur_cells * self._pitch), np.zeros(6)
        weights = np.ones((self._lines.size * len(FIT.steps)) ** 2)
        for iteration in range(FIT.rounds):
            step = np.minimum(np.maximum(FIT.step_px * px, blur), FIT.step_cells * self._pitch)
            x, y = (self._lines[:, None] + (step[:, None] * FIT.steps)[:, None]).reshape(2, -1)
            samples = matrix @ [np.tile(x, y.size), np.repeat(y, x.size), np.ones(weights.size)]
            u, v = (samples[:2] / samples[2]).astype(np.float32).reshape(2, y.size, x.size)
            values = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            values = values.ravel().astype(float)
            slopes = self._slopes(x, y, blur, light, values)
            residual = values - light @ slopes[10:]
            # Until the pattern is about in place, its blur is as guessed, and nothing is hidden.
            free = slice(16) if iteration else np.r_[:8, 12:16]
            if iteration:
                spread = 1.4826 * np.median(np.abs(residual)) + _UNIFORM
                weights = (1.0 + np.square(residual / (FIT.outlier * spread))) ** -2
            weighted = slopes[free] * weights
            normal = weighted @ slopes[free].T
            normal[np.diag_indices_from(normal)] += 1e-6 * normal.diagonal() + 1e-9
            step = np.zeros(16)
            step[free] = np.linalg.solve(normal, weighted @ residual)
            matrix = matrix @ np.linalg.inv(np.eye(3) + np.tensordot(step[:8], _SMALL, 1))
            if (_SQUARE @ matrix[2]).min() <= 0.0:  # The tag would go through the camera.
                return None
            sharpest = np.maximum(_UNIFORM * px, 0.5 * blur)
            blur = np.clip(blur + step[8:10], sharpest, np.maximum(sharpest, 2.0 * blur))
            light += step[10:]
            if iteration > 1 and (np.abs(step[:8]).max() < FIT.still_px * px).all():
                break
        variance = weights @ np.square(values - np.average(values, weights=weights))
        if not weights @ np.square(residual) < (1.0 - FIT.explained) * variance:
            return None
        # What is unexplained has the same cause around one crossing of lines. The sums over these
        # surroundings are independent, and their scatter gives the covariance.
        crossings = (self._lines.size, len(FIT.steps)) * 2
        sums = (weighted * residual).reshape(16, *crossings).sum(axis=(2, 4)).reshape(16, -1)
        scatter = np.linalg.solve(normal, sums)
        scatter *= (sums.shape[1] / (sums.shape[1] - 16)) ** 0.5
        # The black square is what has a size, with the ink's spread.
        corners, moves = _corners(matrix @ np.diag([1.0 + light[1], 1.0 + light[1], 1.0]))
        moved = moves.T @ scatter[:8] + np.outer(moves[1] + moves[5], scatter[11])
        return Corners(corners, moved @ moved.T)

    def _slopes(
        self, x: np.ndarray, y: np.ndarray, blur: np.ndarray, light: np.ndarray, values: np.ndarray
    ) -> np.ndarray:
        """Slopes of the brightness by the unknowns, (16, N); the last 6 times ``light`` are it.

        ``light``, (6,), is guessed from the values if it is not known.
        """
        (at_x, to_right, wider), (at_y, down, higher) = (
            _edges(along, self._lines, width) for along, width in zip((x, y), blur, strict=True)
        )
        row, column = x[None, :], y[:, None]
        slopes = np.empty((16, y.size, x.size))
        slopes[12], slopes[13] = 1.0, at_y @ self._cells @ at_x.T
        slopes[14], slopes[15] = row, column
        if not light.any():
            light[2:4] = np.linalg.lstsq(slopes[12:14].reshape(2, -1).T, values, rcond=None)[0]
        along = light[3] * (at_y @ self._cells @ to_right.T)
        across = light[3] * (down @ self._cells @ at_x.T)
        both = along * row + across * column
        slopes[:3] = along, along * row, along * column
        slopes[3:6] = across, across * row, across * column
        slopes[6:8] = both * row, both * column
        slopes[8] = light[3] * (at_y @ self._cells @ wider.T)
        slopes[9] = light[3] * (higher @ self._cells @ at_x.T)
        slopes[10] = light[3] * (down @ self._cells @ to_right.T)
        slopes[11] = -np.hypot(along, across)
        return slopes.reshape(16, -1)


def _edges(x: np.ndarray, lines: np.ndarray, blur: float) -> np.ndarray:
    """Shares of the cells between lines in the brightness at x, with a blur: (N, lines + 1).

    With their slopes by x and by the blur: (3, N, lines + 1).
    """
    distances = (x[:, None] - lines) / blur
    bell = np.exp(-0.5 * distances**2) / (np.sqrt(2.0 * np.pi) * blur)
    shares = np.zeros((3, x.size, lines.size + 1))
    shares[..., 1:] = np.interp(distances, _DEVIATIONS, _NORMAL), bell, -bell * distances
    shares[..., :-1] -= shares[..., 1:]
    shares[0, :, 0] += 1.0
    return shares


def _corners(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A tag's corners, px, (4, 2), and their slopes by the eight unknowns, (8, 8)."""
    corners = _SQUARE @ matrix.T
    corners_px = corners[:, :2] / corners[:, 2:]
    moves = np.einsum("ij,kjl,cl->kci", matrix, _SMALL, _SQUARE)
    moves = (moves[..., :2] - corners_px * moves[..., 2:]) / corners[:, 2:]
    return corners_px, moves.reshape(8, 8)
