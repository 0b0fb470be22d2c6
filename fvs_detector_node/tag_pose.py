"""Pose of a tag, or of a body of them, from the corners in one image.

The covariance of the corners gives that of the pose; a pose that is not exact enough is refused.

A square seen almost squarely has two poses that fit, its plane tilted to one side or the other. One
is taken only if the other fits clearly worse, or if the last image says so, or the depths on the
print. Depth serves for nothing else: its errors are larger than those of the corners.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import cv2
import numpy as np

from fvs_detector_node.images import Region
from fvs_detector_node.tag_corners import Corners
from fvs_detector_node.tags import SQUARE, Tag
from fvs_ros.camera import Intrinsics
from fvs_ros.rotations import rotation_angle_rad


@dataclass(frozen=True)
class Acceptance:
    """Which poses are published."""

    #: Deviation of a corner's coordinate that its covariance does not show, px: of print and lens.
    floor_px: float = 0.03
    #: Largest deviation of a pose's angle, rad: five degrees are two of them.
    angle_rad: float = 0.045
    #: Largest residual, sides of the tag: curled paper had 0.007, and poses within 3 degrees.
    residual_sides: float = 0.01
    #: Deviation of the first radial coefficient of a lens that nobody declared. A pose is refused
    #: if the best coefficient turns it by this, rad, and fits better by this, chi-square.
    radial: float = 0.6
    radial_certain: float = 4.0
    radial_turn_rad: float = 0.07
    #: Chi-square margin between the two solutions, five deviations, with a floor of the corners'
    #: deviation, px: with less, one of 700 rendered tags of 26 px was taken for its mirror image.
    certain: float = 25.0
    certain_px: float = 0.1
    #: Otherwise the last image decides, if it is no older, s: a tag may since have come to be like
    #: either. Only one must be in reach of its pose at the fastest turn, rad/s, that of a UR5's
    #: joints together: if the nearer was taken, 58 of 2,131 poses of tags that turned through the
    #: square view were mirrored.
    last_s: float = 0.2
    turn_rad_s: float = 2.0
    #: Poses that differ by less, rad, are one, fitted from two sides: else cubes are in doubt.
    same_rad: float = 0.02
    #: Depths, those within the black square, are smoothed over about so many pixels.
    smoothed_px2: float = 25.0


ACCEPT = Acceptance()


#: Columns of ``cv2.projectPoints`` that are fitted: turn, position and first radial coefficient.
_UNKNOWN = [0, 1, 2, 3, 4, 5, 10]
#: Rounds of the fit, and the step, rad and m, that ends it.
_ROUNDS, _STILL = 10, 1e-5


@dataclass(frozen=True)
class TagPose:
    """Pose of a tag, or of a layout of them: its x axis to the right, y up, z out of the print."""

    position_m: np.ndarray  # of its middle, camera optical frame, (3,)
    rotation: np.ndarray  # from the tag's to the camera's frame, (3, 3)
    numbers: tuple[int, ...]  # of the tags that are seen
    corners_px: np.ndarray  # of these, clockwise from the upper left, (k, 4, 2)
    residual_px: float  # of the corners, rms

    visible_fraction: ClassVar[float] = 1.0  # a tag is read as a whole, or not

    def draw(
        self, picture: np.ndarray, camera: Intrinsics, colour: tuple[int, int, int], thick: int
    ) -> str:
        """Draw the tag and its z axis; returns its numbers in words."""
        corners = np.round(16.0 * self.corners_px).astype(int)
        cv2.polylines(picture, list(corners), True, colour, thick, cv2.LINE_AA, 4)
        tip_m = self.position_m + 0.05 * self.rotation[:, 2]
        ends_px = camera.project(np.array([self.position_m, tip_m]))
        start, end = np.round(16.0 * ends_px).astype(int).tolist()
        cv2.line(picture, start, end, colour, thick, cv2.LINE_AA, 4)
        x, y, z = self.position_m
        return f"{self.residual_px:.2f} px  x {x:+.4f} y {y:+.4f} z {z:.4f} m"


@dataclass(frozen=True)
class _Fit:
    """A pose, and how well it fits."""

    pose: TagPose
    off: np.ndarray  # residuals of the corners, in deviations, (N,)
    slopes: np.ndarray  # of these by turn, rad, position, m, and radial coefficient, (N, 7)
    chi2: float  # squared residuals, in the variances that count where two poses fit


class PoseFinder:
    """Finds the pose of a tag, or of a layout of them, from corners; remembers the last one."""

    def __init__(self, tag: Tag) -> None:
        self._tag, self._square_m = tag, tag.tag_size_m * SQUARE
        self._last: tuple[float, np.ndarray] | None = None

    def reset(self) -> None:
        """Forget the last pose."""
        self._last = None

    def find(
        self,
        stamp_s: float,
        seen: dict[int, Corners],
        camera: Intrinsics,
        depth_of: Callable[[Region], np.ndarray] | None = None,
    ) -> tuple[TagPose | None, str]:
        """The pose, or None and why there is none.

        Takes the exposure, s, and by the tags' numbers their corners; at least one. Depths are
        those of the whole image, (H, W), m, 0 where there is none.
        """
        matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
        covariances_px2 = np.array([one.covariance_px2 for one in seen.values()])
        # Multiplied by these, corners have a deviation of one.
        scales, cautious = (
            np.linalg.inv(np.linalg.cholesky(covariances_px2 + floor_px**2 * np.eye(8)))
            for floor_px in (ACCEPT.floor_px, ACCEPT.certain_px)
        )
        fits = [
            self._fitted(seen, scales, cautious, matrix, *one) for one in self._first(seen, matrix)
        ]
        # In front of the camera, and with the prints to it.
        fits = [
            one
            for one in fits
            if one.pose.position_m[2] > 0.0
            and seen.keys() <= set(self._tag.facing(one.pose.rotation, one.pose.position_m))
        ]
        fits.sort(key=lambda one: one.chi2)
        sides_px = [one.px - np.roll(one.px, 1, axis=0) for one in seen.values()]
        most_px = ACCEPT.residual_sides * np.sqrt(2.0 * np.square(sides_px).mean())
        if not fits or not fits[0].pose.residual_px <= most_px:
            return None, "the corners do not fit: is the tag bent or covered, is tag_layout right?"
        fit = self._choice(stamp_s, *fits[:2])
        if fit is None and depth_of is not None:
            fit = self._by_depth(fits[0], fits[1], camera, depth_of)
        if fit is None:
            return None, (
                "the tag is seen so squarely that two poses fit: tilt it, bring it nearer, or "
                "begin where it is seen at an angle"
            )
        problem = _inexact(fit)
        if problem:
            return None, problem
        self._last = (stamp_s, fit.pose.rotation)
        return fit.pose, ""

    def _first(
        self, seen: dict[int, Corners], matrix: np.ndarray
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """The two poses of the largest tag, as the whole's rotation and position, m."""
        number = max(seen, key=lambda one: cv2.contourArea(seen[one].px.astype(np.float32)))
        face = self._tag.faces[number]
        found = cv2.solvePnPGeneric(
            self._square_m, seen[number].px, matrix, None, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
        poses = []
        for turn, shift in zip(found[1], found[2], strict=True):
            rotation = cv2.Rodrigues(turn)[0] @ face.rotation.T
            poses.append((rotation, shift.ravel() - rotation @ face.middle_m))
        return poses

    def _fitted(
        self,
        seen: dict[int, Corners],
        scales: np.ndarray,
        cautious: np.ndarray,
        matrix: np.ndarray,
        rotation: np.ndarray,
        position_m: np.ndarray,
    ) -> _Fit:
        """The pose that fits all corners best, from one that is about right."""
        points_m = np.concatenate([self._tag.faces[number].corners_m for number in seen])
        corners_px = np.array([one.px for one in seen.values()])
        for _ in range(_ROUNDS):
            back_px, all_slopes = cv2.projectPoints(
                points_m @ rotation.T, np.zeros(3), position_m, matrix, np.zeros(4)
            )
            off_px = corners_px.reshape(-1, 8, 1) - back_px.reshape(-1, 8, 1)
            slopes_px = all_slopes[:, _UNKNOWN].reshape(-1, 8, 7)
            off = (scales @ off_px).ravel()
            slopes = (scales @ slopes_px).reshape(-1, 7)
            step = np.linalg.lstsq(slopes[:, :6], off, rcond=None)[0]
            if np.abs(step).max() < _STILL:
                break
            rotation = cv2.Rodrigues(step[:3])[0] @ rotation
            position_m = position_m + step[3:]
        residual_px = float(np.sqrt(np.square(off_px).mean()))
        pose = TagPose(position_m, rotation, tuple(seen), corners_px, residual_px)
        return _Fit(pose, off, slopes, float(np.square(cautious @ off_px).sum()))

    def _choice(self, stamp_s: float, first: _Fit, other: _Fit | None = None) -> _Fit | None:
        """The fit that is certain, of two; None if neither is."""
        if other is None or _apart_rad(first, other.pose.rotation) < ACCEPT.same_rad:
            return first
        certain = other.chi2 - first.chi2 > ACCEPT.certain
        if self._last is None or not 0.0 < stamp_s - self._last[0] <= ACCEPT.last_s:
            return first if certain else None
        reach_rad = 2.0 * ACCEPT.angle_rad + ACCEPT.turn_rad_s * (stamp_s - self._last[0])
        to_first, to_other = (_apart_rad(one, self._last[1]) for one in (first, other))
        if to_other <= reach_rad < to_first:
            # A corner that is off can make the wrong one certain.
            return None if certain else other
        return first if certain or to_first <= reach_rad < to_other else None

    def _by_depth(
        self,
        first: _Fit,
        other: _Fit,
        camera: Intrinsics,
        depth_of: Callable[[Region], np.ndarray],
    ) -> _Fit | None:
        """The pose whose largest print lies as the depths on it do; None if they do not tell."""
        sizes_px2 = [cv2.contourArea(one.astype(np.float32)) for one in first.pose.corners_px]
        largest = int(np.argmax(sizes_px2))
        corners_px, number = first.pose.corners_px[largest], first.pose.numbers[largest]
        region = Region.around(corners_px).grown(0, camera)
        depth_m, outline = depth_of(region), np.rint(corners_px).astype(np.int32)
        inside = np.zeros(depth_m.shape, np.uint8)
        cv2.fillConvexPoly(inside, outline - [region.u0, region.v0], 1)
        v, u = np.nonzero(inside * (depth_m > 0.0))
        rays = camera.rays(u + region.u0, v + region.v0)
        normal = self._tag.faces[number].rotation[:, 2]
        # On the right plane these are alike, whatever the scale of the depths.
        scales = [depth_m[v, u] * (rays @ (one.pose.rotation @ normal)) for one in (first, other)]
        spreads = [one.std() / abs(one.mean()) for one in scales] if u.size else [1.0, 1.0]
        chi2 = (
            (np.square(max(spreads) / max(min(spreads), 1e-9)) - 1.0) * u.size / ACCEPT.smoothed_px2
        )
        if chi2 < ACCEPT.certain:
            return None
        return first if spreads[0] < spreads[1] else other


def _apart_rad(fit: _Fit, rotation: np.ndarray) -> float:
    return rotation_angle_rad(fit.pose.rotation.T @ rotation)


def _inexact(fit: _Fit) -> str:
    """Why a pose is not exact enough; empty if it is."""
    normal = fit.slopes.T @ fit.slopes
    angle_rad = np.sqrt(np.trace(np.linalg.inv(normal[:6, :6])[:3, :3]))
    if not angle_rad <= ACCEPT.angle_rad:
        return (
            f"the tag shows its pose only to {np.degrees(angle_rad):.1f} degrees: more light, "
            "focus, a shorter exposure, or bring it nearer"
        )
    normal[6, 6] += ACCEPT.radial**-2
    gained = fit.off @ fit.slopes
    change = np.linalg.solve(normal, gained)
    if (
        change @ gained > ACCEPT.radial_certain
        and np.linalg.norm(change[:3]) > ACCEPT.radial_turn_rad
    ):
        return (
            f"the corners fit a lens with k1 = {change[6]:+.2f} that camera_info does not declare: "
            "calibrate the camera, or flatten the tag"
        )
    return ""
