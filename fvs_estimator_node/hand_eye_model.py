"""What a camera sees of a ball or tag that an arm moves, by the arm's URDF: see ``hand_eye``.

Link i is displaced by a fixed twist before joint i. The camera reports a ball's point (x, y, z) as
``s (f (1 + k r^2) x, f (1 + k r^2) y, z)`` with ``r^2 = (x^2 + y^2) / z^2``: s, f and k are its
scale, the error of its focal length and its first coefficient of distortion. A tag's pose is found
from its corners, so that the same errors move and turn it.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fvs_estimator_node.chain_chart import Chart
from fvs_estimator_node.chain_fit import ChainFit
from fvs_estimator_node.chain_start import Path
from fvs_estimator_node.files import DataSet
from fvs_ros.chain import SerialChain, cross_matrix
from fvs_ros.rotations import nearest_rotation, rotation_from_vector
from fvs_ros.urdf import Kinematics

#: Sine of the angle below which two axes are parallel.
_PARALLEL = 0.05
#: Half a tag's edge, m. It tells how much of a lens error turns a tag that faces the camera.
_HALF_EDGE_M = 0.05


class Unknowns(NamedTuple):
    """Parts of the vector of unknowns."""

    turn: slice  # of the camera about the middle of what it saw, rad
    shift: slice  # of the camera, m
    carried: slice  # of ball or tag, m and rad
    delay: int  # of the images, s
    scale: int  # logarithm of the camera's
    focal: int  # logarithm of the focal length over the one that the camera counts with
    radial: int  # first coefficient of distortion that the camera does not know of
    zeros: slice  # of all joints but the first and the last, rad
    encoders: slice  # true motion of each joint over the reported one, less 1
    links: slice  # of the arm from each joint but the first on, rad and m, six each
    size: int


class HandEyeModel:
    """The images by the URDF, about the start that the registration gives.

    Parameters
    ----------
    data : DataSet
        With the joints of the arm, in its order.
    arm : Kinematics
        From the URDF.
    fit : ChainFit
        Of the data.
    """

    def __init__(self, data: DataSet, arm: Kinematics, fit: ChainFit) -> None:
        self.arm, self.path, self._kind = arm, Path(data), data.kind
        #: Where the images show the feature, weighted, m, (k, m), and the middle, (3,).
        self.seen = data.kind.weights * data.ball_m[self.path.indices]
        self.middle = self.seen[:, :3].mean(axis=0)
        n, delay = len(arm.names), 6 + self._kind.size
        zeros = slice(delay + 4, delay + 4 + max(0, n - 2))
        encoders = slice(zeros.stop, zeros.stop + n)
        links = slice(encoders.stop, encoders.stop + 6 * (n - 1))
        self.at = Unknowns(
            slice(0, 3), slice(3, 6), slice(6, delay), delay, delay + 1, delay + 2, delay + 3,
            zeros, encoders, links, links.stop,
        )  # fmt: skip
        # The arm as it stands at the fit's reference joints, carrying nothing yet.
        self._reference = fit.chain.reference_rad
        self._points, self._axes = arm.at(self._reference)
        self._rotation, self._shift = self._registered(fit)
        weighted = fit.weights * fit.chain.feature_m
        carried = weighted.reshape(-1, 3) @ self._rotation
        carried[0] -= self._shift @ self._rotation
        self._carried = carried.ravel()
        self._is_tag = not self._kind.flat
        self._of_lens = tag_by_lens(self.seen) if self._is_tag else None

    def _registered(self, fit: ChainFit) -> tuple[np.ndarray, np.ndarray]:
        """Turn and shift, m, that take the URDF's axes to those that the camera saw."""
        seen, chart = fit.chain, Chart(fit.chain)
        variance = np.diag(fit.covariance)
        turn, place = (
            1.0 / np.maximum(variance[part].reshape(-1, 2).sum(axis=1), 1e-8)
            for part in (chart.turns, chart.shifts)
        )
        # Parallel axes tell no turn about themselves, but the ways from one to the next do.
        turning = np.flatnonzero(self.arm.prismatic == 0.0)
        pairs = [
            (i, j)
            for i, j in pairwise(turning)
            if np.linalg.norm(np.cross(self._axes[i], self._axes[j])) < _PARALLEL
        ]
        ways = [
            np.array([_across(axes[i], points[j] - points[i]) for i, j in pairs]).reshape(-1, 3)
            for axes, points in ((seen.axes, seen.points_m), (self._axes, self._points))
        ]
        weights = np.append(turn, [min(turn[i], turn[j]) for i, j in pairs])
        rotation = Rotation.align_vectors(
            np.concatenate([seen.axes, ways[0]]), np.concatenate([self._axes, ways[1]]), weights
        )[0].as_matrix()
        across = np.eye(3) - seen.axes[:, :, None] * seen.axes[:, None, :]
        across *= np.sqrt(place)[:, None, None]
        across[self.arm.prismatic > 0.0] = 0.0  # only the direction of a prismatic joint counts
        off = np.einsum("ijk,ik->ij", across, seen.points_m - self._points @ rotation.T)
        shift, *_ = np.linalg.lstsq(across.reshape(-1, 3), off.ravel(), rcond=None)
        return rotation, shift

    def seen_and_slopes(
        self, values: np.ndarray, wider: np.ndarray | float = 1.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """The feature in all images, m, (k, m), and its derivatives, (k, m, unknowns).

        Had each joint moved so many times as far.
        """
        at = self.at
        reported, velocity = (
            one + (wider - 1.0) * (one - one.mean(axis=0))
            for one in self.path.joints_and_velocities(float(values[at.delay]))
        )
        true = 1.0 + values[at.encoders]
        joints = true * reported
        joints[:, 1:-1] += values[at.zeros]
        chain, twists = self._chain(values)
        parts = chain.slopes(joints, twists)
        slopes = np.zeros((*self.seen.shape, at.size))
        slopes[..., : at.delay] = parts.by_twist[..., : at.delay]
        slopes[..., at.delay] = -np.einsum("kmi,ki->km", parts.by_joint, true * velocity)
        slopes[..., at.zeros] = parts.by_joint[..., 1:-1]
        slopes[..., at.encoders] = parts.by_joint * reported[:, None]
        slopes[..., at.links] = parts.by_twist[..., at.delay :]
        seen = parts.feature_m
        (self._see_ball if self._of_lens is None else self._see_tag)(values, seen, slopes)
        scale = np.exp(values[at.scale])
        seen[:, :3] *= scale
        slopes[:, :3] *= scale
        slopes[:, :3, at.scale] = seen[:, :3]
        return seen, slopes

    def _see_ball(self, values: np.ndarray, seen: np.ndarray, slopes: np.ndarray) -> None:
        """Apply errors of the lens to points and their derivatives."""
        at, focal, radial = self.at, np.exp(values[self.at.focal]), values[self.at.radial]
        tangent = seen[:, :2] / seen[:, 2:]
        square = np.sum(tangent**2, axis=1)[:, None]
        # d(r^2) = 2 t . (dx, dy) / z - 2 r^2 dz / z
        by_point = np.concatenate([tangent, -square], axis=1) * (2.0 / seen[:, 2:])
        change = np.einsum("ki,kip->kp", by_point, slopes[:, :3])
        across, factor = seen[:, :2].copy(), focal * (1.0 + radial * square)
        slopes[:, :2] *= factor[..., None]
        slopes[:, :2] += focal * radial * across[..., None] * change[:, None]
        seen[:, :2] *= factor
        slopes[:, :2, at.focal] = seen[:, :2]
        slopes[:, :2, at.radial] = focal * square * across

    def _see_tag(self, values: np.ndarray, seen: np.ndarray, slopes: np.ndarray) -> None:
        """The same of poses, as far as it is linear."""
        assert self._of_lens is not None
        at = self.at
        for which in (at.focal, at.radial):
            step = self._of_lens[:, which - at.focal]
            slopes[:, :3, which] = step[:, :3]
            turned = cross_matrix(step[:, None, 3:]) @ seen[:, 3:].reshape(-1, 3, 3, 1)
            slopes[:, 3:, which] = turned.reshape(-1, 9)
        lens = values[[at.focal, at.radial]]
        turns = np.eye(3) + cross_matrix(np.einsum("i,kij->kj", lens, self._of_lens[..., 3:]))
        seen += slopes[..., [at.focal, at.radial]] @ lens
        motions = [one for one in range(at.size) if one not in (at.focal, at.radial)]
        directions = slopes[:, 3:, motions].reshape(len(seen), 3, 3, -1)
        slopes[:, 3:, motions] = (turns[:, None] @ directions).reshape(len(seen), 9, -1)

    def camera(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Turn and shift, m, from the arm's to the camera's frame."""
        turn = rotation_from_vector(values[self.at.turn])
        shift = turn @ (self._shift - self.middle) + self.middle + values[self.at.shift]
        return turn @ self._rotation, shift

    def on_tip(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Ball or tag in the tip's frame: place, m, and rotation of a tag."""
        turn, tip_m = self.arm.tip_at(self._reference)
        carried = self._feature_on_arm(values)
        place_m = turn @ (carried[:3] - tip_m)
        if not self._is_tag:
            return place_m, None
        axes = carried[3:].reshape(3, 3)
        return place_m, turn @ nearest_rotation(axes.T)

    def _feature_on_arm(self, values: np.ndarray) -> np.ndarray:
        weights, step_m = self._kind.weights, values[self.at.carried] * self._kind.unit
        return weights * self._kind.retract(self._carried / weights, step_m)

    def _chain(self, values: np.ndarray) -> tuple[SerialChain, np.ndarray]:
        """The arm in the camera's frame, and the twists by camera, carried and links."""
        at, joints = self.at, len(self._axes)
        twists = np.zeros((joints + 1, 6, at.delay + 6 * (joints - 1)))
        twists[0, :, :6] = _twists(values[at.turn], self.middle + values[at.shift])
        frames = [self.camera(values)]  # of what is behind each joint
        for i, twist in enumerate(values[at.links].reshape(-1, 6), 1):
            rotation, shift = frames[-1]
            turn, pivot = rotation_from_vector(twist[:3]), self._points[i]
            column = at.delay + 6 * (i - 1)
            local = _twists(twist[:3], pivot + twist[3:])
            twists[i, :, column : column + 6] = _adjoint(rotation, shift) @ local
            frames.append((rotation @ turn, shift + rotation @ (pivot - turn @ pivot + twist[3:])))
        axes, points = (
            np.array([frame[0] @ one for frame, one in zip(frames, some, strict=True)])
            for some in (self._axes, self._points)
        )
        points += [shift for _, shift in frames]
        carried, (rotation, shift) = self._feature_on_arm(values), frames[-1]
        turn = values[at.carried][3:] if self._is_tag else np.zeros(3)
        local = _adjoint(rotation, shift) @ _twists(turn, carried[:3])
        twists[-1, :, at.carried] = np.roll(local, 3, axis=1)[:, : at.delay - 6]  # shifts first
        carried = carried.reshape(-1, 3) @ rotation.T
        carried[0] += shift
        chain = SerialChain(axes, points, carried.ravel(), self._reference, self.arm.prismatic)
        return chain, twists


def _twists(turn_rad: np.ndarray, pivot_m: np.ndarray) -> np.ndarray:
    """Twists, (6, 6), by each change of a turn about a pivot, and by shifts."""
    angle_rad, k = float(np.linalg.norm(turn_rad)), cross_matrix(turn_rad)
    # The change of a rotation by that of its vector: 1/2 and 1/6 are the limits.
    a, b = (0.5, 1.0 / 6.0) if angle_rad < 1e-4 else (
        (1.0 - np.cos(angle_rad)) / angle_rad**2, (angle_rad - np.sin(angle_rad)) / angle_rad**3
    )  # fmt: skip
    twists = np.eye(6)
    twists[:3, :3] += a * k + b * (k @ k)
    twists[3:, :3] = cross_matrix(pivot_m) @ twists[:3, :3]
    return twists


def _adjoint(rotation: np.ndarray, shift_m: np.ndarray) -> np.ndarray:
    """Matrix that takes twists, (6,), to a frame that is turned and shifted."""
    adjoint = np.kron(np.eye(2), rotation)
    adjoint[3:, :3] = cross_matrix(shift_m) @ rotation
    return adjoint


def tag_by_lens(seen: np.ndarray) -> np.ndarray:
    """How tags, (k, 12), are shifted, m, and turned, rad, by focal length and distortion.

    Shape (k, 2, 6): by the logarithm of the focal length, and by the first coefficient of
    distortion. The pose is the least-squares one of the shifted corners.
    """
    axes = seen[:, 3:9].reshape(-1, 2, 3)
    axes = axes / np.linalg.norm(axes, axis=2, keepdims=True)
    edges = _HALF_EDGE_M * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) @ axes  # (k, 4, 3)
    corners = seen[:, None, :3] + edges
    image, depth = corners[..., :2] / corners[..., 2:], corners[..., 2:, None]
    projection = np.zeros((*image.shape, 3))
    projection[..., :2], projection[..., 2] = np.eye(2), -image
    projection /= depth
    slopes = np.concatenate([projection, -projection @ cross_matrix(edges)], axis=-1)
    shifts = np.stack([image, image * np.sum(image**2, axis=-1, keepdims=True)], axis=-1)
    slopes, shifts = (one.reshape(len(seen), 8, -1) for one in (slopes, shifts))
    back = np.swapaxes(slopes, 1, 2)
    return np.swapaxes(np.linalg.solve(back @ slopes, back @ shifts), 1, 2)


def _across(axis: np.ndarray, way_m: np.ndarray) -> np.ndarray:
    """Direction of a way's part across an axis."""
    across = way_m - (way_m @ axis) * axis
    return np.asarray(across / max(np.linalg.norm(across), 1e-6))
