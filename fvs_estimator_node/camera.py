"""Models with a camera that may have been moved since the training.

The model predicts the ball, ``p``, in the camera frame of the training; the image measures it,
``x``, in the present one. Between camera moves ``x = R p + t`` with constant rotation R and
translation t, and ``J = R J_model``. A fitted chain gives p. Networks give only its steps
``J_rbf dr``; their sum drifts, so older positions have less weight.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from fvs_estimator_node.base import CHAIN, NETWORKS, Estimator
from fvs_estimator_node.rbf import FrozenRbfEstimator, RbfModel
from fvs_ros.chain import SerialChain
from fvs_ros.filter import OUTLIER, Image
from fvs_ros.kinds import Kind
from fvs_ros.rotations import nearest_rotation, rotation_angle_rad
from fvs_ros.vectors import largest, length

#: Prior deviation of the rotation, rad, and memory (positions until a weight has decayed by 63 %),
#: for the positions of a chain and for those summed from networks.
_CHAIN, _NETWORKS = (0.01, 1000.0), (0.14, 30.0)
#: What is off by more than this, m, beyond the noise, shows a bump.
_BUMP_M = 0.01
#: Largest prior deviation of the rotation after a bump, rad. It applies to a bump that follows
#: another within this number of positions: the first one did not show all of the rotation. (After
#: a rotation about the ball, 0.7 degrees remain after 40 positions, and 4.7 without this rule.)
_BUMPED_RAD, _REPEATED_WITHIN = 0.7, 20
#: No longer step, rad, is one Jacobian in its middle good for: at twice that it may miss 10 mm.
_LONGEST_RAD = 0.2
#: A ball within this distance of the last stored position is at rest, m.
_STILL_M = 0.002


_NO_DIRECTIONS = np.zeros((0, 3))


def shows_bump(off_m: float, deviation_m: float) -> bool:
    """Whether what was seen is off, m, by more than its standard deviation, m, explains."""
    return off_m > _BUMP_M + OUTLIER * deviation_m


def camera_values(rotation: np.ndarray, bumps: int) -> dict[str, float]:
    """How far a camera has been turned, and how often it was bumped, for a status."""
    turned_deg = math.degrees(rotation_angle_rad(rotation))
    return {"camera_turned_deg": turned_deg, "camera_bumps": float(bumps)}


class CameraPose:
    """Rotation R and translation t of ``x = R p + t``, position by position.

    The best rotation has a closed form (Kabsch), for any angle. The prior is a matrix Fisher
    distribution about the present rotation. A bump shows as a position beyond the noise; all pairs
    of the old pose are then dropped.

    ``deviation_rad`` is how far the camera may have been turned unnoticed, rad (standard
    deviation), ``memory`` the count of positions, some way apart, after which an old one's weight
    has decayed by 63 %. R and t, ``rotation`` and ``translation_m``, are not changed in place.
    """

    def __init__(self, deviation_rad: float = _CHAIN[0], memory: float = _CHAIN[1]) -> None:
        self._deviation_rad, self._memory = deviation_rad, memory
        self._keep = math.exp(-1.0 / memory)
        self.reset()

    def reset(self) -> None:
        """Assume the camera pose of the training."""
        self.translation_m = np.zeros(3)
        self.bumps = 0  #: how often the camera was found to have been moved
        self._begin(np.eye(3), self._deviation_rad)

    def _begin(self, rotation: np.ndarray, deviation_rad: float) -> None:
        """Forget all pairs; start from a rotation with this standard deviation."""
        self.rotation = rotation
        self._precision = 0.5 / deviation_rad**2
        #: Prior, in variances of a position; scatter of the pairs about their means, m^2, and their
        #: faded count.
        self._prior = self._precision * rotation
        self._scatter, self._weight = np.zeros((3, 3)), 0.0
        self._mean_p, self._mean_x, self._kept_at = np.zeros((3, 3))

    def add(
        self,
        model_m: np.ndarray,
        image_m: np.ndarray,
        noise_m: float,
        directions: np.ndarray = _NO_DIRECTIONS,
        image_directions: np.ndarray = _NO_DIRECTIONS,
    ) -> None:
        """Take a position by the model and by the image, m, (3,), and directions, m, (k, 3)."""
        residual_m = length(image_m - (self.rotation @ model_m + self.translation_m))
        direction_m = image_directions - directions @ self.rotation.T
        residual_m = math.hypot(residual_m, length(direction_m.ravel()))
        deviation_rad = self._rotation_deviation_rad(noise_m)
        reach_m = length(model_m - self._mean_p) if self._weight else 0.0
        if shows_bump(residual_m, math.hypot(noise_m, deviation_rad * reach_m)):
            self.bumps += 1
            # A rotation moves the ball by angle times distance, but not if it is about the ball.
            rotation_rad = residual_m / max(length(image_m), 1e-3)
            prior_rad = math.hypot(deviation_rad, rotation_rad, self._deviation_rad)
            repeated = 0.0 < self._weight < _REPEATED_WITHIN
            self._begin(self.rotation, _BUMPED_RAD if repeated else min(prior_rad, _BUMPED_RAD))
        # At rest no weight decays, because no new information arrives.
        shift_m = model_m - self._kept_at
        keep = 1.0
        if length(shift_m) > _STILL_M:
            keep, self._kept_at = self._keep, model_m
        weight = min(keep * self._weight, self._memory)
        self._weight = total = weight + 1.0
        from_p, from_x = model_m - self._mean_p, image_m - self._mean_x
        # The present rotation replaces the weight that decays: long motion along one line must not
        # erase the rotation about that line.
        self._prior = keep * self._prior + (1.0 - keep) * self._precision * self.rotation
        self._scatter = keep * self._scatter + (weight / total) * from_x[:, None] * from_p
        self._scatter += image_directions.T @ directions
        self._mean_p, self._mean_x = self._mean_p + from_p / total, self._mean_x + from_x / total
        self.rotation = nearest_rotation(self._scatter + noise_m**2 * self._prior)
        self.translation_m = self._mean_x - self.rotation @ self._mean_p

    def _rotation_deviation_rad(self, noise_m: float) -> float:
        """Standard deviation of the rotation, by the prior and the pairs since the last bump."""
        learned_m2 = max(float(np.vdot(self.rotation, self._scatter)), 0.0)
        return noise_m / math.sqrt(2.0 * self._precision * noise_m**2 + learned_m2 + 1e-12)


class _BehindCamera(Estimator):
    """A model whose Jacobian is turned by the camera's rotation."""

    def __init__(self, kind: Kind | None, deviation_rad: float, memory: float) -> None:
        super().__init__(kind)
        if not self.kind.rigid:
            raise ValueError(f"a {self.kind.what} does not turn with the camera: use rbf or frozen")
        if self.kind.on_arm:
            raise ValueError("a camera on the arm turns with it: use another method than rbf_left")
        self.camera = CameraPose(deviation_rad, memory)

    def reset(self) -> None:
        """Take the camera to stand where it stood at the training."""
        super().reset()
        self.camera.reset()

    def _rotated(self, motions: np.ndarray) -> np.ndarray:
        """Motions of points and directions, (3 k, n), as the camera sees them now."""
        rotated = self.camera.rotation @ motions.reshape(-1, 3, motions.shape[1])
        return np.asarray(rotated.reshape(motions.shape))

    def status_values(self) -> dict[str, float]:
        """Counts, how far the camera has been turned, and how often it was bumped."""
        camera = self.camera
        return {**super().status_values(), **camera_values(camera.rotation, camera.bumps)}


class PoeEstimator(_BehindCamera):
    """A fitted chain (a product of exponentials) behind a camera that may have been moved."""

    made_from = CHAIN

    def __init__(self, chain: SerialChain, _config: Any = None, kind: Kind | None = None) -> None:
        super().__init__(kind, *_CHAIN)
        self._fitted = self._moved = chain
        self._rotation: np.ndarray | None = None  # that has moved it; a new array at every image

    @property
    def chain(self) -> SerialChain:
        """The chain as the camera sees it now."""
        if self._rotation is not self.camera.rotation:
            self._rotation = self.camera.rotation
            self._moved = self._fitted.moved(self._rotation, self.camera.translation_m)
        return self._moved

    def jacobian(self, joints_rad: np.ndarray, z: np.ndarray | None = None) -> np.ndarray:
        """Estimate at joints, rad, (n,): m/rad, shape (d, n)."""
        return self._rotated(self.kind.along(self._fitted, joints_rad)[1])

    def observe(self, image: Image, noise_m: float) -> None:
        """Learn the camera's pose from where the feature is."""
        model = self._fitted.position(image.joints_rad)
        directions = self.kind.directions(model), self.kind.directions(image.z)
        self.camera.add(model[:3], image.z[:3], noise_m, *directions)
        self.updates += 1


class TurnedRbfEstimator(_BehindCamera):
    """The networks as they were trained, behind a camera that may have been turned."""

    made_from = NETWORKS

    def __init__(self, model: RbfModel, _config: Any = None, kind: Kind | None = None) -> None:
        super().__init__(kind, *_NETWORKS)
        self._model = FrozenRbfEstimator(model, None, kind)
        self._joints: np.ndarray | None = None
        self._sum_m = np.zeros(3)

    def reset(self) -> None:
        """Take the camera to stand where it stood at the training."""
        super().reset()
        self._joints = None

    def jacobian(self, joints_rad: np.ndarray, z: np.ndarray | None = None) -> np.ndarray:
        """Estimate at joints, rad, (n,), and the feature there, (m,): m/rad, shape (d, n)."""
        columns = self._rotated(self._model.jacobian(joints_rad))
        return columns if z is None else self.kind.to_tangent(z, columns)

    def observe(self, image: Image, noise_m: float) -> None:
        """Learn the camera's rotation from the motion of the position.

        Directions say nothing before the camera's rotation is known.
        """
        joints_rad, z = image.joints_rad, image.z
        if self._joints is None:
            self._sum_m = self.camera.rotation.T @ (z[:3] - self.camera.translation_m)
        else:
            # The way between two images does not matter: of a long one the straight line will do.
            step = joints_rad - self._joints
            parts = max(1, math.ceil(largest(step) / _LONGEST_RAD))
            for middle in (np.arange(parts) + 0.5) / parts:
                jacobian = self._model.jacobian(self._joints + middle * step)
                self._sum_m = self._sum_m + jacobian[:3] @ step / parts
        self._joints = joints_rad
        self.camera.add(self._sum_m, z[:3], noise_m)
        self.updates += 1
