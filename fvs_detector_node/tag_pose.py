"""Pose of a tag, or of a body of them, from the corners in one image.

The covariance of the corners gives that of the pose; a pose that is not exact enough is refused.

A square seen almost squarely has two poses that fit, its plane tilted to one side or the other. One
is taken only if the other fits clearly worse, or if the last image says so.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.detector import Detector, Sighting
from fvs_detector_node.images import Region
from fvs_detector_node.tag_corners import Corners, TagReader
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
    #: Deviation of the first radial coefficient of a lens that nobody declared.
    radial: float = 0.6
    #: Chi-square by which such a coefficient must fit better to refuse a pose.
    radial_certain: float = 4.0
    #: Rotation of the pose by such a coefficient that refuses it, rad.
    radial_rotation_rad: float = 0.07
    #: Chi-square margin between the two solutions, five deviations.
    certain: float = 25.0
    #: Floor of the corners' deviation in that margin, px: with less, one of 700 rendered tags of
    #: 26 px was taken for its mirror image.
    certain_px: float = 0.1
    #: Largest age of a last image that decides, s: a tag may since have come to be like either.
    last_s: float = 0.2
    #: Fastest rotation since then, rad/s, that of a UR5's joints together. Only one solution must
    #: be in reach: if the nearer was taken, 58 of 2,131 poses were mirrored.
    rotation_rad_s: float = 2.0
    #: Solutions that differ by less, rad, are the same: else cubes are in doubt.
    same_rad: float = 0.02


ACCEPT = Acceptance()


@dataclass(frozen=True)
class TagPose:
    """Pose of a tag, or of a layout of them: its x axis to the right, y up, z out of the print."""

    position_m: np.ndarray  # of its middle, camera optical frame, (3,)
    rotation: np.ndarray  # from the tag's to the camera's frame, (3, 3)
    tag: Tag
    numbers: tuple[int, ...]  # of the tags that are seen
    residual_px: float  # of the corners, rms

    visible_fraction = 1.0  # a tag is read as a whole, or not

    def _outlines_px(self, camera: Intrinsics, numbers: tuple[int, ...]) -> np.ndarray:
        corners_m = np.array([self.tag.faces[number].corners_m for number in numbers])
        return camera.project(corners_m @ self.rotation.T + self.position_m)

    def box(self, camera: Intrinsics) -> Region:
        """The part of a camera's image with all tags, also with those that were not seen."""
        return Region.around(self._outlines_px(camera, tuple(self.tag.faces)).reshape(-1, 2))

    def draw(self, picture: np.ndarray, camera: Intrinsics, style: dict[str, Any]) -> str:
        """Draw the tags and the z axis; returns the pose's numbers in words."""
        outlines = np.round(16.0 * self._outlines_px(camera, self.numbers)).astype(int)
        cv2.polylines(picture, list(outlines), True, **style)
        tip_m = self.position_m + 0.05 * self.rotation[:, 2]
        ends_px = camera.project(np.array([self.position_m, tip_m]))
        start, end = np.round(16.0 * ends_px).astype(int).tolist()
        cv2.line(picture, start, end, **style)
        x, y, z = self.position_m
        return f"{self.residual_px:.2f} px  x {x:+.4f} y {y:+.4f} z {z:.4f} m"


@dataclass(frozen=True)
class _Fit:
    """A pose, and how well it fits."""

    pose: TagPose
    residuals: np.ndarray  # of the corners, in deviations, (N,)
    slopes: np.ndarray  # of these by rotation, rad, position, m, and radial coefficient, (N, 7)
    chi2: float  # squared residuals, in the variances that count where two poses fit


class TagDetector(Detector):
    """Detects the tag, or the body of tags; remembers the last rotation, and when it was."""

    measured: tuple[str, ...] = ("residual_px",)

    def __init__(self, config: DetectorConfig) -> None:
        self._tag, self._reader = config.tag, TagReader(config.tag)
        super().__init__(config)

    def reset(self) -> None:
        """Forget the last pose."""
        super().reset()
        self._certain: tuple[float, np.ndarray] | None = None

    def detect_in(
        self, stamp_s: float, rgb: np.ndarray, depth_m: np.ndarray | None, camera: Intrinsics
    ) -> Sighting:
        """Detect the tag; ``depth_m`` does not matter."""
        corners, problem = self._reader.read(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY))
        return self.find(stamp_s, corners, camera) if corners else Sighting(None, problem)

    def find(self, stamp_s: float, corners: dict[int, Corners], camera: Intrinsics) -> Sighting:
        """The pose at an exposure, s, from corners by the tags' numbers, at least one."""
        covariances_px2 = np.array([tag.covariance_px2 for tag in corners.values()])
        # Multiplied by these, corners have a deviation of one.
        scales, cautious = (
            np.linalg.inv(np.linalg.cholesky(covariances_px2 + floor_px**2 * np.eye(8)))
            for floor_px in (ACCEPT.floor_px, ACCEPT.certain_px)
        )
        fits = [
            self._fit(corners, scales, cautious, camera.matrix, *start)
            for start in self._starts(corners, camera.matrix)
        ]
        # In front of the camera, and with the prints to it.
        fits = [
            fit
            for fit in fits
            if fit.pose.position_m[2] > 0.0
            and corners.keys() <= set(self._tag.facing(fit.pose.rotation, fit.pose.position_m))
        ]
        fits.sort(key=lambda fit: fit.chi2)
        sides_px = [tag.px - np.roll(tag.px, 1, axis=0) for tag in corners.values()]
        most_px = ACCEPT.residual_sides * np.sqrt(2.0 * np.square(sides_px).mean())
        if not fits or not fits[0].pose.residual_px <= most_px:
            text = "the corners do not fit: is the tag bent or covered, is tag_layout right?"
            return Sighting(None, text)
        fit = self._choice(stamp_s, *fits)
        if fit is None:
            return Sighting(
                None,
                "the tag is seen so squarely that two poses fit: tilt it, bring it nearer, or "
                "begin where it is seen at an angle",
            )
        problem = _inexact(fit)
        if problem:
            return Sighting(None, problem)
        self._certain = (stamp_s, fit.pose.rotation)
        return Sighting(fit.pose)

    def _starts(
        self, corners: dict[int, Corners], matrix: np.ndarray
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """The two poses of the largest tag, as the whole's rotation and position, m."""
        number = max(corners, key=lambda tag: cv2.contourArea(corners[tag].px.astype(np.float32)))
        face = self._tag.faces[number]
        _, vectors, shifts, _ = cv2.solvePnPGeneric(
            self._tag.tag_size_m * SQUARE,
            corners[number].px,
            matrix,
            None,
            flags=cv2.SOLVEPNP_IPPE_SQUARE,
        )
        rotations = [cv2.Rodrigues(vector)[0] @ face.rotation.T for vector in vectors]
        return [
            (rotation, shift.ravel() - rotation @ face.middle_m)
            for rotation, shift in zip(rotations, shifts, strict=True)
        ]

    def _fit(
        self,
        corners: dict[int, Corners],
        scales: np.ndarray,
        cautious: np.ndarray,
        matrix: np.ndarray,
        rotation: np.ndarray,
        position_m: np.ndarray,
    ) -> _Fit:
        """The pose that fits all corners best, from one that is about right."""
        points_m = np.concatenate([self._tag.faces[number].corners_m for number in corners])
        corners_px = np.array([tag.px for tag in corners.values()]).reshape(-1, 8, 1)
        for _ in range(10):
            back_px, all_slopes = cv2.projectPoints(
                points_m @ rotation.T, np.zeros(3), position_m, matrix, np.zeros(4)
            )
            error_px = corners_px - back_px.reshape(-1, 8, 1)
            # By rotation, position and first radial coefficient.
            slopes_px = all_slopes[:, [*range(6), 10]].reshape(-1, 8, 7)
            residuals = (scales @ error_px).ravel()
            slopes = (scales @ slopes_px).reshape(-1, 7)
            step = np.linalg.lstsq(slopes[:, :6], residuals, rcond=None)[0]
            if np.abs(step).max() < 1e-5:  # rad and m
                break
            rotation = cv2.Rodrigues(step[:3])[0] @ rotation
            position_m = position_m + step[3:]
        residual_px = float(np.sqrt(np.square(error_px).mean()))
        pose = TagPose(position_m, rotation, self._tag, tuple(corners), residual_px)
        return _Fit(pose, residuals, slopes, float(np.square(cautious @ error_px).sum()))

    def _choice(self, stamp_s: float, first: _Fit, second: _Fit | None = None) -> _Fit | None:
        """The fit that is certain, of two; None if neither is."""
        if second is None or _apart_rad(first, second.pose.rotation) < ACCEPT.same_rad:
            return first
        certain = second.chi2 - first.chi2 > ACCEPT.certain
        last = self._certain
        if last is None or not 0.0 < stamp_s - last[0] <= ACCEPT.last_s:
            return first if certain else None
        reach_rad = 2.0 * ACCEPT.angle_rad + ACCEPT.rotation_rad_s * (stamp_s - last[0])
        to_first, to_second = (_apart_rad(fit, last[1]) for fit in (first, second))
        if to_second <= reach_rad < to_first:
            # A corner that is off can make the wrong one certain.
            return None if certain else second
        return first if certain or to_first <= reach_rad < to_second else None


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
    gained = fit.residuals @ fit.slopes
    change = np.linalg.solve(normal, gained)
    if (
        change @ gained > ACCEPT.radial_certain
        and np.linalg.norm(change[:3]) > ACCEPT.radial_rotation_rad
    ):
        return (
            f"the corners fit a lens with k1 = {change[6]:+.2f} that camera_info does not declare: "
            "calibrate the camera, or flatten the tag"
        )
    return ""
