"""A fitted chain with the camera on the arm: any object in the room, and a bumped bracket.

The chain gives the motion G(r) of the room as the camera of the training sees it. An object, z0 at
the reference joints, is measured as

    z = D G(r) z0,

where D is how the camera's bracket has been moved since. Both D and z0 are found by least squares
over the last images; z0 is then taken from the newest one, so that the Jacobian is that of what is
seen now.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any, NamedTuple

import numpy as np

from fvs_estimator_node.base import CHAIN, Estimator
from fvs_ros.chain import SerialChain, cross_matrix
from fvs_ros.filter import OUTLIER
from fvs_ros.kinds import Kind
from fvs_ros.rotations import rotation_angle_rad, rotation_from_vector
from fvs_ros.vectors import length

#: Images that are kept, and the least way between two of them, m.
_WINDOW, _STILL_M = 60, 0.004
#: Prior deviation of the bracket's rotation, rad, as of a training; and after a bump. Shifts are
#: those at an arm's length of this, m.
_DEVIATION_RAD, _BUMPED_RAD, _ARM_M = 0.005, 0.3, 0.3
#: An image off by more than this, m, beyond the noise, shows a bump, or a moved object.
_BUMP_M = 0.01


class _Seen(NamedTuple):
    """One image: what was seen, (m,), and the motion of the room, (4, 4), that rows are put by."""

    z: np.ndarray
    motion: np.ndarray


class OnArmPoeEstimator(Estimator):
    """A fitted chain (a product of exponentials) that ends in the camera."""

    made_from = CHAIN

    def __init__(self, chain: SerialChain, _config: Any = None, kind: Kind | None = None) -> None:
        super().__init__(kind)
        self._fitted = chain
        self._weights = self.kind.weights
        #: Which rows of z are points, not directions, (m / 3,).
        self._is_point = (np.arange(self.kind.numbers // 3) == 0).astype(float)
        self.reset()

    def reset(self) -> None:
        """Take the bracket to be as it was at the training."""
        super().reset()
        self.bumps = 0
        self._bracket = np.eye(4)  # D, for rows
        self._moved = self._chain = self._fitted
        self._begin(_DEVIATION_RAD)

    def _begin(self, deviation_rad: float) -> None:
        """Forget the images; the bracket may be off by so much."""
        self._images: deque[_Seen] = deque(maxlen=_WINDOW)
        self._object = np.zeros((len(self._is_point), 4))  # z0, in rows
        self._change = np.zeros(6)  # of the bracket since then
        deviation = deviation_rad * np.repeat([1.0, _ARM_M], 3)
        self._prior = np.append(deviation**-2, np.full(6, 1e-2))
        self._covariance = np.zeros((12, 12))

    @property
    def chain(self) -> SerialChain:
        """The arm as the camera sees it now, with the object that it saw last."""
        return self._chain

    def jacobian(self, joints_rad: np.ndarray, z: np.ndarray | None = None) -> np.ndarray:
        """Estimate at joints, rad, (n,), and the feature there, (m,): m/rad, shape (d, n)."""
        there, angular, linear_m = self._chain.motion(joints_rad)
        return self.kind.moved_by(there if z is None else z, angular, linear_m)

    def observe(self, joints_rad: np.ndarray, z: np.ndarray, noise_m: float) -> None:
        """Learn the bracket's pose, and where the object is."""
        image = _Seen(z, self._fitted.transform(joints_rad))
        if self._images:
            residual, slopes = self._residuals([image])
            unsure_m2 = float(np.vdot(slopes @ self._covariance, slopes))
            off_m = length(residual)
            if off_m > _BUMP_M + OUTLIER * math.sqrt(unsure_m2 + len(residual) * noise_m**2):
                self.bumps += 1
                self._begin(_BUMPED_RAD)
        if not self._images:
            rows = np.insert(z.reshape(-1, 3), 3, self._is_point, axis=1)
            self._object = np.linalg.solve((image.motion @ self._bracket).T, rows.T).T
            self._images.append(image)
        elif length((self._images[-1].z - z) * self._weights) > _STILL_M:
            self._images.append(image)
            self._learn(noise_m)
        self._chain = self._moved.anchored(joints_rad, z)
        self.updates += 1

    def _residuals(self, images: list[_Seen]) -> tuple[np.ndarray, np.ndarray]:
        """What k images miss, m, (k m,), and its slopes by motions of D and z0, (k m, 12)."""
        motions = np.stack([image.motion for image in images]) @ self._bracket
        seen = (self._object @ motions)[..., :3]
        points = self._is_point[:, None, None] * np.eye(3)
        by_bracket = np.concatenate(
            [-cross_matrix(seen), np.broadcast_to(points, (*seen.shape, 3))], axis=-1
        )
        by_object = np.concatenate([-cross_matrix(self._object[:, :3]), points], axis=-1)
        turned = np.swapaxes(motions[:, None, :3, :3], -1, -2) @ by_object
        weights = self._weights.reshape(-1, 3)[..., None]
        slopes = weights * np.concatenate([by_bracket, turned], axis=-1)
        z = np.stack([image.z for image in images])
        residual = self._weights * (z - seen.reshape(len(images), -1))
        return residual.ravel(), slopes.reshape(-1, 12)

    def _learn(self, noise_m: float) -> None:
        """One step of least squares, about what is known of the bracket."""
        residual, slopes = self._residuals(list(self._images))
        known = slopes.T @ slopes / noise_m**2 + np.diag(self._prior)
        wanted = slopes.T @ residual / noise_m**2
        wanted[:6] -= self._prior[:6] * self._change
        self._covariance = np.linalg.inv(known)
        step = self._covariance @ wanted
        self._change = self._change + step[:6]
        self._bracket = self._bracket @ _moved(step[:6])
        self._object = self._object @ _moved(step[6:])
        rotation, shift_m = self._bracket[:3, :3].T, self._bracket[3, :3]
        self._moved = self._fitted.moved(rotation, shift_m)

    def status_values(self) -> dict[str, float]:
        """Counts, how far the bracket has been turned, and how often something was moved."""
        turned_deg = math.degrees(rotation_angle_rad(self._bracket[:3, :3]))
        camera = {"camera_turned_deg": turned_deg, "camera_bumps": float(self.bumps)}
        return {**super().status_values(), **camera}


def _moved(twist: np.ndarray) -> np.ndarray:
    """The motion by a small twist w, v, (6,), for rows, (4, 4)."""
    motion = np.eye(4)
    motion[:3, :3], motion[3, :3] = rotation_from_vector(twist[:3]).T, twist[3:]
    return motion
