"""A fitted chain with the camera on the arm: any object in the room, and a bumped bracket.

The chain gives the motion G(r) of the room as the camera of the training sees it. An object that is
z0 at the reference joints is measured as

    z = D G(r) z0,

where D is how the camera's bracket has been moved since. What an image is off may have two causes:
the bracket was moved, or the object moves by itself. Each is fitted by least squares to the last
images, and the one that explains them better counts. The Jacobian is that of the object where the
newest image shows it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from fvs_estimator_node.base import CHAIN, Estimator
from fvs_ros.chain import SerialChain, cross_matrix
from fvs_ros.filter import OUTLIER
from fvs_ros.kinds import Kind
from fvs_ros.rotations import rotation_angle_rad, rotation_from_vector
from fvs_ros.vectors import largest, length

#: Images that are kept, and the least motion between two of them, m and rad.
_WINDOW, _STILL_M, _STILL_RAD = 60, 0.004, 0.01
#: Prior deviation of the bracket's rotation, rad, as of a training, and after a bump; and of the
#: object's velocity, rad/s. Those of shifts are the same at an arm's length of this, m.
_DEVIATION_RAD, _BUMPED_RAD, _MOVING_RAD_S, _ARM_M = 0.005, 0.3, 1.0, 0.3
#: An image off by more than this, m, beyond the noise, shows a bump, or a moved object.
_BUMP_M = 0.01
#: Of D, of z0, and of the velocity of z0, among the unknowns.
_BRACKET, _OBJECT, _VELOCITY = slice(6), slice(6, 12), slice(12, 18)


class _Seen(NamedTuple):
    """One image: its time, s, what was seen, (m,), the motion of the room, (4, 4), of rows.

    Or k of them, with one more dimension each.
    """

    stamp_s: np.ndarray
    joints_rad: np.ndarray
    z: np.ndarray
    motion: np.ndarray


class _Cause:
    """D, z0 and its velocity by the images, one of D and the velocity being known.

    Parameters
    ----------
    weights : ndarray, shape (m,)
        Lengths of the numbers of z.
    bracket : ndarray, shape (4, 4)
        D to begin with, for rows.
    deviation : ndarray, shape (18,)
        Prior deviations; 0 where nothing changes.
    """

    def __init__(self, weights: np.ndarray, bracket: np.ndarray, deviation: np.ndarray) -> None:
        self._weights = weights.reshape(-1, 3)[..., None]
        #: Which rows of z are points, and not directions.
        self._is_point = (np.arange(len(self._weights)) == 0).astype(float)
        self._free, self._deviation = np.flatnonzero(deviation), np.maximum(deviation, 1e-12)
        #: Unknowns that are likely to be small: all but those of z0.
        self._has_prior = (deviation > 0.0) & np.repeat([True, False, True], 6)
        self._known = np.zeros(18)  # the unknowns, summed up
        self.bracket, self.covariance, self.cost = bracket, np.zeros((18, 18)), 0.0
        self.object: np.ndarray | None = None  # z0 at the newest image, in rows
        self._newest_s = 0.0

    def residuals(self, images: _Seen) -> tuple[np.ndarray, np.ndarray]:
        """What k images miss, m, (k m,), and its slopes by the unknowns, (k m, 18)."""
        assert self.object is not None
        motions = images.motion @ self.bracket
        since_s = images.stamp_s[:, None, None] - self._newest_s
        there = self.object + since_s * self._moved(self.object, self._known[_VELOCITY])
        seen = (there @ motions)[..., :3]
        points = self._is_point[:, None, None] * np.eye(3)
        by_bracket = np.concatenate(
            [-cross_matrix(seen), np.broadcast_to(points, (*seen.shape, 3))], axis=-1
        )
        by_object = np.concatenate([-cross_matrix(self.object[:, :3]), points], axis=-1)
        turned = np.swapaxes(motions[:, None, :3, :3], -1, -2) @ by_object
        slopes = np.concatenate([by_bracket, turned, since_s[..., None] * turned], axis=-1)
        residual = self._weights[..., 0] * (images.z.reshape(seen.shape) - seen)
        return residual.ravel(), (self._weights * slopes).reshape(-1, 18)

    def learn(self, images: _Seen, noise_m: float) -> None:
        """One step of least squares over the images, the newest last."""
        newest_s = float(images.stamp_s[-1])
        if self.object is None:
            rows = np.insert(images.z[-1].reshape(-1, 3), 3, self._is_point, axis=1)
            self.object = np.linalg.solve((images.motion[-1] @ self.bracket).T, rows.T).T
            self._newest_s = newest_s
            return
        passed_s, self._newest_s = newest_s - self._newest_s, newest_s
        self.object = self.object + passed_s * self._moved(self.object, self._known[_VELOCITY])
        free, before = self._free, (self.bracket, self.object, self._known)
        residual, slopes = self.residuals(images)
        cost, slopes = self._cost(residual, noise_m), slopes[:, free] / noise_m
        covariance = np.linalg.inv(slopes.T @ slopes + np.diag(self._deviation[free] ** -2))
        step = np.zeros(18)
        prior = np.where(self._has_prior, self._known / self._deviation**2, 0.0)
        step[free] = covariance @ (slopes.T @ residual / noise_m - prior[free])
        self._known = self._known + step
        self.bracket = self.bracket @ _motion(step[_BRACKET])
        self.object = self.object @ _motion(step[_OBJECT])
        self.covariance[np.ix_(free, free)] = covariance
        self.cost = self._cost(self.residuals(images)[0], noise_m)
        if not self.cost <= cost:  # the wrong cause may lead anywhere
            self.cost, (self.bracket, self.object, self._known) = cost, before

    def _cost(self, residual_m: np.ndarray, noise_m: float) -> float:
        changed = (self._known / self._deviation)[self._has_prior]
        return float(residual_m.dot(residual_m)) / noise_m**2 + float(changed.dot(changed))

    def _moved(self, rows: np.ndarray, twist: np.ndarray) -> np.ndarray:
        """Motions of rows by a twist w, v."""
        moved = np.zeros_like(rows)
        moved[:, :3] = np.cross(twist[:3], rows[:, :3]) + self._is_point[:, None] * twist[3:]
        return moved


class OnArmPoeEstimator(Estimator):
    """A fitted chain (a product of exponentials) that ends in the camera."""

    made_from = CHAIN

    def __init__(self, chain: SerialChain, _config: Any = None, kind: Kind | None = None) -> None:
        super().__init__(kind)
        self._fitted = chain
        self.reset()

    def reset(self) -> None:
        """Take the bracket to be as it was at the training."""
        super().reset()
        self.bumps = 0
        self._moved = self._chain = self._fitted
        self._begin(np.eye(4), _DEVIATION_RAD)

    def _begin(self, bracket: np.ndarray, deviation_rad: float) -> None:
        """Forget the images; the bracket may be off by so much."""
        self._images: deque[_Seen] = deque(maxlen=_WINDOW)
        unit = np.repeat([1.0, _ARM_M], 3)
        free = unit if self.kind.numbers > 3 else np.repeat([0.0, _ARM_M], 3)  # no point turns
        by_bracket = np.concatenate([deviation_rad * unit, 10.0 * free, 0.0 * unit])
        by_object = np.concatenate([0.0 * unit, 10.0 * free, _MOVING_RAD_S * free])
        self._causes = [
            _Cause(self.kind.weights, bracket, deviation) for deviation in (by_bracket, by_object)
        ]
        self._cause = self._causes[0]

    @property
    def chain(self) -> SerialChain:
        """The arm as the camera sees it now, with the object that it saw last."""
        return self._chain

    def jacobian(self, joints_rad: np.ndarray, z: np.ndarray | None = None) -> np.ndarray:
        """Estimate at joints, rad, (n,), and the feature there, (m,): m/rad, shape (d, n)."""
        there, angular, linear_m = self._chain.motion(joints_rad)
        return self.kind.moved_by(there if z is None else z, angular, linear_m)

    def observe(
        self, joints_rad: np.ndarray, z: np.ndarray, noise_m: float, stamp_s: float = 0.0
    ) -> None:
        """Learn the bracket's pose, and where the object is."""
        image = _Seen(np.array(stamp_s), joints_rad, z, self._fitted.transform(joints_rad))
        if self._images:
            residual, slopes = self._cause.residuals(_stacked([image]))
            unsure_m2 = float(np.vdot(slopes @ self._cause.covariance, slopes))
            off_m = length(residual)
            if off_m > _BUMP_M + OUTLIER * math.sqrt(unsure_m2 + len(residual) * noise_m**2):
                self.bumps += 1
                self._begin(self._cause.bracket, _BUMPED_RAD)
        if not self._images or self._says_more(image):
            self._images.append(image)
            images = _stacked(self._images)
            for cause in self._causes:
                cause.learn(images, noise_m)
            self._cause = min(self._causes, key=attrgetter("cost"))
            bracket = self._cause.bracket
            self._moved = self._fitted.moved(bracket[:3, :3].T, bracket[3, :3])
        self._chain = self._moved.anchored(joints_rad, z)
        self.updates += 1

    def _says_more(self, image: _Seen) -> bool:
        """Whether an image differs from the newest that was kept."""
        last = self._images[-1]
        way_m = length((image.z - last.z) * self.kind.weights)
        return way_m > _STILL_M or largest(image.joints_rad - last.joints_rad) > _STILL_RAD

    def status_values(self) -> dict[str, float]:
        """Counts, how far the bracket has been turned, and how often something was moved."""
        turned_deg = math.degrees(rotation_angle_rad(self._cause.bracket[:3, :3]))
        camera = {"camera_turned_deg": turned_deg, "camera_bumps": float(self.bumps)}
        return {**super().status_values(), **camera}


def _stacked(images: Iterable[_Seen]) -> _Seen:
    return _Seen(*map(np.stack, zip(*images, strict=True)))


def _motion(twist: np.ndarray) -> np.ndarray:
    """The motion by a small twist w, v, (6,), for rows, (4, 4)."""
    motion = np.eye(4)
    motion[:3, :3], motion[3, :3] = rotation_from_vector(twist[:3]).T, twist[3:]
    return motion
