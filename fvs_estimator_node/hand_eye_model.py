"""What a camera sees of a ball or tag that an arm moves, by the arm's URDF: see ``hand_eye``."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fvs_estimator_node.chain_chart import Chart
from fvs_estimator_node.chain_fit import ChainFit
from fvs_estimator_node.chain_start import Path
from fvs_estimator_node.files import DataSet
from fvs_ros.chain import SerialChain
from fvs_ros.feature import PoseFeature, rotation_matrix
from fvs_ros.urdf import Kinematics

#: Sine of the angle below which two axes are parallel.
_PARALLEL = 0.05
#: Step of the slopes, m and rad.
_STEP = 1e-6


class Unknowns(NamedTuple):
    """Parts of the vector of unknowns."""

    turn: slice  # of the camera about the middle of what it saw, rad
    shift: slice  # of the camera, m
    carried: slice  # of ball or tag, m and rad
    zeros: slice  # of all joints but the first and the last, rad
    delay: int  # of the images, s
    scale: int  # logarithm of the camera's
    focal: int  # logarithm of its scale across the line of sight, over that along it
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
        self.arm, self.path, self._feature = arm, Path(data), data.servoed
        #: Where the images show the feature, m, (k, m), and the middle, (3,).
        self.seen = data.ball_m[self.path.indices]
        self.middle = self.seen[:, :3].mean(axis=0)
        n, of_task = len(arm.names), len(self._feature.task_scale)
        zeros = 6 + of_task + max(0, n - 2)
        links = slice(zeros + 3, zeros + 3 + 6 * (n - 1))
        self.at = Unknowns(
            slice(0, 3), slice(3, 6), slice(6, 6 + of_task), slice(6 + of_task, zeros), zeros,
            zeros + 1, zeros + 2, links, links.stop,
        )  # fmt: skip
        # The arm as it stands at the fit's reference joints, carrying nothing yet.
        self._reference = fit.chain.reference_rad
        self._points, self._axes = arm.at(self._reference)
        self._rotation, self._shift = self._registered(fit)
        carried = fit.chain.feature_m.reshape(-1, 3) @ self._rotation
        carried[0] -= self._shift @ self._rotation
        self._carried = carried.ravel()

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

    def features(self, values: np.ndarray, wider: np.ndarray | float = 1.0) -> np.ndarray:
        """The feature in all images, m, (k, m), had each joint moved so many times as far."""
        at = self.at
        joints = self.path.joints_and_velocities(float(values[at.delay]))[0]
        joints += (wider - 1.0) * (joints - joints.mean(axis=0))
        joints[:, 1:-1] += values[at.zeros]
        seen = self._chain(values).position(joints)
        seen[:, :3] *= np.exp(values[at.scale])
        seen[:, :2] *= np.exp(values[at.focal])
        return seen

    def slopes(self, values: np.ndarray, wider: np.ndarray | float = 1.0) -> np.ndarray:
        """Derivatives of the features, (k, m, unknowns)."""
        ends = (
            (self.features(values + one, wider), self.features(values - one, wider))
            for one in _STEP * np.eye(self.at.size)
        )
        return np.stack([(up - down) / (2.0 * _STEP) for up, down in ends], axis=-1)

    def camera(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Turn and shift, m, from the arm's to the camera's frame."""
        turn = rotation_matrix(values[self.at.turn])
        shift = turn @ (self._shift - self.middle) + self.middle + values[self.at.shift]
        return turn @ self._rotation, shift

    def on_tip(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Ball or tag in the tip's frame: place, m, and rotation of a tag."""
        turn, tip_m = self.arm.tip_at(self._reference)
        carried = self._feature_on_arm(values)
        place_m = turn @ (carried[:3] - tip_m)
        if not isinstance(self._feature, PoseFeature):
            return place_m, None
        return place_m, turn @ self._feature.rotation(carried)

    def _feature_on_arm(self, values: np.ndarray) -> np.ndarray:
        step = values[self.at.carried] * self._feature.task_scale
        return self._feature.displaced(self._carried, step)

    def _chain(self, values: np.ndarray) -> SerialChain:
        """The arm in the camera's frame."""
        axes, points = self._axes.copy(), self._points.copy()
        carried = self._feature_on_arm(values).reshape(-1, 3).copy()
        for i, twist in enumerate(values[self.at.links].reshape(-1, 6), 1):
            if twist.any():
                turn, pivot = rotation_matrix(twist[:3]), points[i].copy()
                shift = pivot - turn @ pivot + twist[3:]
                axes[i:] = axes[i:] @ turn.T
                points[i:] = points[i:] @ turn.T + shift
                carried = carried @ turn.T
                carried[0] += shift
        chain = SerialChain(axes, points, carried.ravel(), self._reference, self.arm.prismatic)
        return chain.moved(*self.camera(values))


def _across(axis: np.ndarray, way_m: np.ndarray) -> np.ndarray:
    """Direction of a way's part across an axis."""
    across = way_m - (way_m @ axis) * axis
    return np.asarray(across / max(np.linalg.norm(across), 1e-6))
