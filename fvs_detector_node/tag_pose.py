"""Pose of a tag, or of a body of them, from the corners in one image.

A square seen almost squarely has two poses that fit, its plane tilted to one side or the other. One
is taken only if the other fits clearly worse, or if the last image says so, or the depths on the
print. Depth serves for nothing else: its errors are larger than those of the corners.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.special import gammaincinv

from fvs_detector_node.tags import SQUARE, Tag
from fvs_ros.camera import Intrinsics
from fvs_ros.feature import rotation_angle_rad

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
class TagPose:
    """Pose of a tag, or of a layout of them: its x axis to the right, y up, z out of the print."""

    position_m: np.ndarray  # of its middle, camera optical frame, (3,)
    rotation: np.ndarray  # from the tag's to the camera's frame, (3, 3)
    numbers: tuple[int, ...]  # of the tags that are seen
    corners_px: np.ndarray  # of these, clockwise from the upper left, (k, 4, 2)
    residual_px: float  # of the corners, rms


class PoseFinder:
    """Finds the pose of a tag, or of a layout of them, from corners; remembers the last one."""

    def __init__(self, tag: Tag) -> None:
        self._tag, self._square_m = tag, tag.tag_size_m * SQUARE
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
        if not least_px2 <= unknown * _CERTAIN * self.noise_px**2:
            return None, "the corners do not fit: is the tag bent or covered, is tag_layout right?"
        # The same view again would tell the same error again, not the noise.
        if not self._same_view(seen):
            # The median of a chi squared of so many degrees is one variance.
            self._squares_px2.append(least_px2 / (2.0 * gammaincinv(0.5 * unknown, 0.5)))
            self._learned_at = seen
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
            self._square_m, seen[number], matrix, None, flags=cv2.SOLVEPNP_IPPE_SQUARE
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
