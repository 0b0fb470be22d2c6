"""A fitted chain with the camera on the arm: any object in the room, and a bumped bracket.

The chain gives the motion G(r) of the room as the camera of the training sees it. An object that is
z0 at the reference joints is measured as

    z = D G(r) z0,

where D is how the camera's bracket has been moved since. An image that is off shows that the object
was put elsewhere, that it moves by itself, that the bracket was bumped, or both. Each cause is
fitted by least squares to the images since; that of the largest evidence counts. The Jacobian is
that of the object where the newest image shows it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from fvs_estimator_node.base import CHAIN, Estimator
from fvs_estimator_node.camera import camera_values, shows_bump
from fvs_ros.chain import SerialChain, cross_matrix
from fvs_ros.filter import Image
from fvs_ros.kinds import Kind
from fvs_ros.timeline import MAX_GAP_S
from fvs_ros.vectors import largest, length

#: Images that are kept, and the least motion between two of them, m and rad.
_WINDOW, _STILL_M, _STILL_RAD = 60, 0.004, 0.01
#: Prior deviation of the bracket's rotation, rad, as of a training; of that of what has been moved,
#: bracket or object, and of the object's velocity, rad/s. Those of shifts are the same at an arm's
#: length of this, m.
_DEVIATION_RAD, _ELSEWHERE_RAD, _MOVING_RAD_S, _ARM_M = 0.005, 0.3, 1.0, 0.3


class _Seen(NamedTuple):
    """One image: its time, s, what was seen, (m,), the motion of the room, (4, 4), of rows.

    Or k of them, with one more dimension each.
    """

    stamp_s: np.ndarray
    z: np.ndarray
    motion: np.ndarray


class _State(NamedTuple):
    """D, (4, 4), and z0, (m / 3, 4), of rows, at a time, s, with its velocity, (6,)."""

    bracket: np.ndarray
    carried: np.ndarray
    velocity: np.ndarray
    time_s: float


class _Cause:
    """D, z0 and its velocity by the images, where some of them may have changed.

    ``weights``, (m,), are lengths of the numbers of z, ``state`` is what was known before.
    ``deviation``, (18,), are prior deviations of the twists by which D and z0 have changed, and of
    the velocity's change; 0 where nothing changes.
    """

    def __init__(self, weights: np.ndarray, state: _State, deviation: np.ndarray) -> None:
        self._weights, self.state = weights.reshape(-1, 3)[..., None], state
        self._free = np.flatnonzero(deviation)
        self._deviation, self._change = deviation[self._free], np.zeros(len(self._free))
        self.covariance, self.cost = np.diag(deviation**2), 0.0
        self.bumped = bool(deviation[0] > _DEVIATION_RAD)

    def residuals(self, images: _Seen) -> tuple[np.ndarray, np.ndarray]:
        """What k images miss, m, (k m,), and its slopes by the unknowns, (k m, 18)."""
        bracket, carried, velocity, time_s = self.state
        motions = images.motion @ bracket
        since_s = images.stamp_s - time_s
        seen = (carried @ _motions(velocity, since_s) @ motions)[..., :3]
        points = carried[:, 3, None, None] * np.eye(3)  # directions are not shifted
        by_bracket = np.concatenate(
            [-cross_matrix(seen), np.broadcast_to(points, (*seen.shape, 3))], axis=-1
        )
        by_object = np.concatenate([-cross_matrix(carried[:, :3]), points], axis=-1)
        turned = np.swapaxes(motions[:, None, :3, :3], -1, -2) @ by_object
        by_velocity = since_s[:, None, None, None] * turned
        slopes = np.concatenate([by_bracket, turned, by_velocity], axis=-1)
        residual = self._weights[..., 0] * (images.z.reshape(seen.shape) - seen)
        return residual.ravel(), (self._weights * slopes).reshape(-1, 18)

    def learn(self, images: _Seen, noise_m: float) -> None:
        """One step of least squares over the images, the newest last."""
        bracket, carried, velocity, time_s = self.state
        newest_s, free, deviation = float(images.stamp_s[-1]), self._free, self._deviation
        carried = carried @ _motions(velocity, newest_s - time_s)
        self.state = before = _State(bracket, carried, velocity, newest_s)
        residual, slopes = self.residuals(images)
        cost, slopes = self._cost(residual, noise_m), slopes[:, free] / noise_m
        precision = slopes.T @ slopes + np.diag(deviation**-2)
        covariance, step, change = np.linalg.inv(precision), np.zeros(18), self._change
        step[free] = covariance @ (slopes.T @ residual / noise_m - change / deviation**2)
        of_bracket, of_object, of_velocity = np.split(step, 3)
        bracket, carried = bracket @ _motions(of_bracket), carried @ _motions(of_object)
        self.state = _State(bracket, carried, velocity + of_velocity, newest_s)
        self._change, self.covariance[np.ix_(free, free)] = change + step[free], covariance
        after = self._cost(self.residuals(images)[0], noise_m)
        if not after <= cost:  # the wrong cause may lead anywhere
            after, self.state, self._change = cost, before, change
        # Twice the negative logarithm of the evidence.
        self.cost = after + float(np.linalg.slogdet(precision * np.outer(deviation, deviation))[1])

    def _cost(self, residual_m: np.ndarray, noise_m: float) -> float:
        changed = self._change / self._deviation
        return float(residual_m.dot(residual_m)) / noise_m**2 + float(changed.dot(changed))


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
        self.bumps = self._bumps_before = 0
        self._moved = self._chain = self._fitted
        self._bracket = np.eye(4)
        self._images: deque[_Seen] = deque(maxlen=_WINDOW)
        self._cause: _Cause | None = None
        self._seen_s = math.nan

    @property
    def chain(self) -> SerialChain:
        """The arm as the camera sees it now, with the object that it saw last."""
        return self._chain

    def jacobian(self, joints_rad: np.ndarray, z: np.ndarray | None = None) -> np.ndarray:
        """Estimate at joints, rad, (n,), and the feature there, (m,): m/rad, shape (d, n)."""
        there, angular, linear_m = self._chain.motion(joints_rad)
        return self.kind.moved_by(there if z is None else z, angular, linear_m)

    def observe(self, image: Image, noise_m: float) -> None:
        """Learn the bracket's pose, and where the object is."""
        joints_rad, z = image.joints_rad, image.z
        seen = _Seen(np.array(image.stamp_s), z, self._fitted.transform(joints_rad))
        cause, last_s, self._seen_s = self._cause, self._seen_s, image.stamp_s
        paused = not 0.0 < image.stamp_s - last_s <= MAX_GAP_S  # or another clock's
        if cause is not None and paused:
            cause.state = cause.state._replace(velocity=np.zeros(6), time_s=image.stamp_s)
        if cause is None or self._is_off(cause, seen, noise_m):
            self._begin(seen, cause)
        elif paused:
            self._begin(seen)
        if not self._images or self._says_more(image):
            self._last = image
            self._images.append(seen)
            images = _stacked(self._images)
            for cause in self._causes:
                cause.learn(images, noise_m)
            self._cause = min(self._causes, key=attrgetter("cost"))
            self.bumps = self._bumps_before + self._cause.bumped
            self._bracket = bracket = self._cause.state.bracket
            self._moved = self._fitted.moved(bracket[:3, :3].T, bracket[3, :3])
        self._chain = self._moved.anchored(joints_rad, z)
        self.updates += 1

    def _is_off(self, cause: _Cause, seen: _Seen, noise_m: float) -> bool:
        """Whether what was seen is further off than the noise."""
        residual, slopes = cause.residuals(_stacked([seen]))
        unsure_m2 = max(float(np.vdot(slopes @ cause.covariance, slopes)), 0.0)
        return shows_bump(length(residual), math.sqrt(unsure_m2 + len(residual) * noise_m**2))

    def _begin(self, seen: _Seen, before: _Cause | None = None) -> None:
        """Forget the images, and look for causes of what is seen now."""
        self._images.clear()
        self._bumps_before = self.bumps
        unit = np.repeat([1.0, _ARM_M], 3)
        free = np.repeat([float(self.kind.numbers > 3), _ARM_M], 3)  # no point turns
        velocity, known = np.zeros(6), np.zeros((3, 6))
        if before is not None:
            velocity = before.state.velocity
            known = np.sqrt(np.diag(before.covariance).clip(0.0)).reshape(3, 6)
        rows = np.insert(seen.z.reshape(-1, 3), 3, 0.0, axis=1)
        rows[0, 3] = 1.0
        carried = np.linalg.solve((seen.motion @ self._bracket).T, rows.T).T
        state = _State(self._bracket, carried, velocity, float(seen.stamp_s))
        elsewhere, bumped = _ELSEWHERE_RAD * free, _ELSEWHERE_RAD * unit
        causes = [
            (state, _DEVIATION_RAD * unit, elsewhere, known[2]),
            (state, 0.0 * unit, elsewhere, _MOVING_RAD_S * free),
        ]
        if before is not None:
            causes.append((before.state, bumped, known[1], known[2]))
            causes.append((state, bumped, elsewhere, known[2]))
        self._causes = [
            _Cause(self.kind.weights, start, np.concatenate(deviations))
            for start, *deviations in causes
        ]

    def _says_more(self, image: Image) -> bool:
        """Whether an image differs from the newest that was kept."""
        way_m = length((image.z - self._last.z) * self.kind.weights)
        return way_m > _STILL_M or largest(image.joints_rad - self._last.joints_rad) > _STILL_RAD

    def status_values(self) -> dict[str, float]:
        """Counts, how far the bracket has been turned, and how often it was bumped."""
        return {**super().status_values(), **camera_values(self._bracket[:3, :3], self.bumps)}


def _stacked(images: Iterable[_Seen]) -> _Seen:
    return _Seen(*map(np.stack, zip(*images, strict=True)))


def _motions(twist: np.ndarray, times_s: np.ndarray | float = 1.0) -> np.ndarray:
    """The motions by a twist w, v, (6,), for times, s, (...), for rows, (..., 4, 4)."""
    times_s = np.asarray(times_s)[..., None, None]
    rate = length(twist[:3])
    k = cross_matrix(-twist[:3] / max(rate, 1e-12))
    motions = np.zeros((*times_s.shape[:-2], 4, 4))
    motions[..., :3, :3] = np.sin(rate * times_s) * k + (1.0 - np.cos(rate * times_s)) * (k @ k)
    motions[..., 3:, :3] = times_s * twist[3:]
    return motions + np.eye(4)
