"""Models behind a camera that may have been moved since the training.

The model says where the ball is, ``p``, in the frame of the camera that it was trained with; the
image says where it is, ``x``. Until the camera moves, ``x = R p + t`` with one rotation R and one
translation t, and ``J = R J_model``. A fitted chain knows p. Networks know only its steps
``J_rbf dr``: there p is their sum, which drifts, so that old positions count for less.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np

from fvs_estimator_node.base import CHAIN, Estimator
from fvs_estimator_node.rbf import FrozenRbfEstimator, RbfModel
from fvs_ros.chain import SerialChain
from fvs_ros.vectors import length

_IDENTITY, _ORIGIN = np.eye(3), np.zeros(3)
_IDENTITY.flags.writeable = _ORIGIN.flags.writeable = False
#: Prior deviation of the rotation, rad, and positions after which an old one's weight has decayed
#: by 63 %: with the positions of a chain, and with those summed from networks.
_CHAIN, _NETWORKS = (0.01, 1000.0), (0.14, 30.0)
#: Standard deviation of the rotation after a bump, at most, rad.
_BUMPED_RAD = 0.7
#: A position is not believed if it is further off than this and six deviations of the noise, m;
#: two such in a row, as far from each other as predicted, are a bump.
_BUMP_M, _BUMP_DEVIATIONS = 0.01, 6.0
#: How far a bumped camera may have been turned over how far that moved the ball in its view.
_TURN_SHARE = 1.5
#: A bump within this many positions of the last one belongs to it.
_SOON = 30
#: Standard deviation of a coordinate of a position: first guess and bounds, m.
_NOISE_M, _LEAST_NOISE_M, _MOST_NOISE_M = 0.001, 0.0002, 0.01
#: Share of a new squared change of the innovation in the noise, and how many variances it counts
#: for at most; at first, all changes count alike.
_NOISE_SHARE, _NOISE_CLIP = 0.02, 9.0
#: A ball that has gone no further since the last position that was kept is at rest, m.
_STILL_M = 0.002
#: No depth camera sees further, m.
_FARTHEST_M = 20.0
#: This many bumps within this many images (10 s of them) are no accidents.
_MANY_BUMPS, _MANY_IMAGES = 8, 300


def nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """The rotation R of the largest ``tr(R' M)``, shape (3, 3)."""
    left, _, right = np.linalg.svd(matrix)
    rotation = left @ right
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    if a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) < 0.0:  # a reflection
        left[:, 2] *= -1.0
        rotation = left @ right
    return rotation


def rotation_angle_rad(rotation: np.ndarray) -> float:
    """Angle of a rotation matrix, rad."""
    return math.acos(min(1.0, max(-1.0, 0.5 * (float(np.trace(rotation)) - 1.0))))


class CameraPose:
    """Rotation R and translation t of ``x = R p + t``, position by position.

    The best rotation is known in closed form (Kabsch), however far the camera was turned; what is
    known before enters as a matrix Fisher distribution about the rotation so far.

    A bump shows as positions that no noise explains. What was learned of the old pose is then
    dropped. How far the ball jumped says how far the camera may have been turned, unless it jumps
    again soon: then the camera is being carried, or was turned about the ball, and the rotation
    from before is doubted as much as ever.

    Parameters
    ----------
    deviation_rad : float
        How far the camera may have been turned unnoticed, standard deviation, rad.
    memory : float
        Positions, some way apart, after which an old one's weight has decayed by 63 %.

    Attributes
    ----------
    rotation, translation_m : ndarray, shapes (3, 3) and (3,)
        R and t, the latter in m; not to be changed in place.
    bumps : int
        How often the camera was found to have been moved.
    """

    def __init__(self, deviation_rad: float = _CHAIN[0], memory: float = _CHAIN[1]) -> None:
        self._deviation_rad, self._memory = deviation_rad, memory
        self._keep = math.exp(-1.0 / memory)
        self.reset()

    def reset(self) -> None:
        """Take the camera to stand where it stood."""
        self._variance = _NOISE_M**2
        self.translation_m = _ORIGIN
        self.bumps = self._images = 0
        self._bumped_at: deque[int] = deque(maxlen=_MANY_BUMPS)
        #: Positions since the last bump, and the rotation from before the first one of a series.
        self._since_bump, self._before_bump = _SOON, _IDENTITY
        self._begin(_IDENTITY, self._deviation_rad)

    def _begin(self, rotation: np.ndarray, deviation_rad: float) -> None:
        """Forget all pairs; a rotation is known to a standard deviation."""
        self.rotation = rotation
        self._precision = 0.5 / deviation_rad**2
        #: Prior, in variances of a position; scatter of the pairs about their means, m^2, and their
        #: faded count.
        self._prior = self._precision * rotation
        self._scatter, self._weight = np.zeros((3, 3)), 0.0
        self._mean_p, self._mean_x, self._kept_at = _ORIGIN, _ORIGIN, _ORIGIN
        self._outlier: tuple[np.ndarray, np.ndarray] | None = None
        self._innovation: np.ndarray | None = None

    @property
    def angle_rad(self) -> float:
        """Angle of the rotation, rad."""
        return rotation_angle_rad(self.rotation)

    @property
    def noise_m(self) -> float:
        """Standard deviation of one coordinate of a position, as far as seen, m."""
        return math.sqrt(self._variance)

    @property
    def remark(self) -> str:
        """That the camera seems to move again and again; empty if not."""
        at = self._bumped_at
        if len(at) < _MANY_BUMPS or self._images - at[0] >= _MANY_IMAGES:
            return ""
        return (
            f"the camera seems to have moved {_MANY_BUMPS} times in {_MANY_IMAGES} images; is it "
            "being carried? If not, check sign, zero, scale and name of each joint"
        )

    def add(self, model_m: np.ndarray, seen_m: np.ndarray) -> bool:
        """Take where the model has the ball and where the image has it, m, (3,) each.

        Returns
        -------
        bool
            Whether it was learned from: not what is not finite, too far, or not believed yet.
        """
        if not (math.isfinite(length(model_m)) and length(seen_m) < _FARTHEST_M):
            return False
        self._images += 1
        innovation = seen_m - (self.rotation @ model_m + self.translation_m)
        if self._innovation is not None:
            self._learn_noise(innovation - self._innovation)
        self._innovation = innovation
        if length(innovation) > self._disbelief_m():
            return self._disbelieve(model_m, seen_m, length(innovation))
        self._outlier = None
        self._learn(model_m, seen_m)
        return True

    def _disbelief_m(self) -> float:
        return _BUMP_M + _BUMP_DEVIATIONS * self.noise_m

    def _learn_noise(self, change_m: np.ndarray) -> None:
        """Learn the noise from what changes between two positions: what stays is no noise."""
        square, share = float(change_m.dot(change_m)) / 6.0, 1.0 / (self._images + 1.0)
        if share < _NOISE_SHARE:  # a blow is no noise
            square, share = min(square, _NOISE_CLIP * self._variance), _NOISE_SHARE
        self._variance += share * (square - self._variance)
        self._variance = min(max(self._variance, _LEAST_NOISE_M**2), _MOST_NOISE_M**2)

    def _disbelieve(self, model_m: np.ndarray, seen_m: np.ndarray, distance_m: float) -> bool:
        """Keep a pair that does not fit; with one before that fits it, it is a bump."""
        before, self._outlier = self._outlier, (model_m, seen_m)
        if before is None:
            return False
        # However the camera was moved: in between the ball went as far as predicted.
        off_m = abs(length(seen_m - before[1]) - length(model_m - before[0]))
        if off_m > self._disbelief_m():
            return False
        doubt_rad = _BUMPED_RAD
        if self._since_bump >= _SOON:
            self._before_bump = self.rotation
            # A turn moves the ball by angle times distance, less where it is about the ball.
            turned_rad = _TURN_SHARE * distance_m / max(length(seen_m), 1e-3)
            doubt_rad = min(max(turned_rad, self._deviation_rad), _BUMPED_RAD)
        self.bumps += 1
        self._bumped_at.append(self._images)
        self._since_bump = 0
        self._begin(self._before_bump, doubt_rad)
        self._learn(*before)
        self._learn(model_m, seen_m)
        return True

    def _learn(self, model_m: np.ndarray, seen_m: np.ndarray) -> None:
        self._since_bump += 1
        # At rest there is nothing new to remember, and so nothing to forget.
        gone = model_m - self._kept_at
        keep = 1.0
        if float(gone.dot(gone)) > _STILL_M**2:
            keep, self._kept_at = self._keep, model_m
        weight = min(keep * self._weight, self._memory)
        self._weight = total = weight + 1.0
        from_p, from_x = model_m - self._mean_p, seen_m - self._mean_x
        # What fades is made up for by the rotation so far: a ball that has long been going along
        # one line does not make the camera forget how it is turned.
        self._prior = keep * self._prior + (1.0 - keep) * self._precision * self.rotation
        self._scatter = keep * self._scatter + (weight / total) * from_x[:, None] * from_p
        self._mean_p, self._mean_x = self._mean_p + from_p / total, self._mean_x + from_x / total
        self.rotation = nearest_rotation(self._scatter + self._variance * self._prior)
        self.translation_m = self._mean_x - self.rotation @ self._mean_p

    def status_values(self) -> dict[str, float]:
        """How far the camera has been turned, how often it was bumped, and the noise."""
        return {
            "camera_turned_deg": math.degrees(self.angle_rad),
            "camera_bumps": float(self.bumps),
            "position_noise_m": self.noise_m,
        }


class _BehindCamera(Estimator):
    """A model whose Jacobian is turned by the camera's rotation."""

    learns = True

    def __init__(self, deviation_rad: float, memory: float) -> None:
        super().__init__()
        self.camera = CameraPose(deviation_rad, memory)

    @property
    def camera_rotation(self) -> np.ndarray:
        """How the camera has been turned since the training, (3, 3)."""
        return self.camera.rotation

    @property
    def remark(self) -> str:
        """What does not fit; empty if all is well."""
        return self.camera.remark

    def reset(self) -> None:
        """Take the camera to stand where it stood at the training."""
        super().reset()
        self.camera.reset()

    def _learn(self, model_m: np.ndarray, ball_m: np.ndarray) -> None:
        if self.camera.add(model_m, ball_m):
            self.updates += 1
        else:
            self.refused += 1

    def status_values(self) -> dict[str, float]:
        """Counts and what is known of the camera."""
        return {**super().status_values(), **self.camera.status_values()}


class PoeEstimator(_BehindCamera):
    """A fitted chain (a product of exponentials) behind a camera that may have been moved.

    Parameters
    ----------
    chain : SerialChain
        The fitted chain.
    config : optional
        Not used: it has no parameters.
    """

    def __init__(self, chain: SerialChain, config: Any = None) -> None:
        super().__init__(*_CHAIN)
        self._fitted = chain

    @classmethod
    def needs(cls, _config: Any) -> str:
        """The fitted chain."""
        return CHAIN

    @property
    def chain(self) -> SerialChain:
        """The chain as the camera sees it now."""
        return self._fitted.moved(self.camera.rotation, self.camera.translation_m)

    def jacobian(self, joints_rad: np.ndarray) -> np.ndarray:
        """Estimate at given joints, m/rad, shape (3, n)."""
        return self.camera.rotation @ self._fitted.jacobian(joints_rad)

    def observe(self, joints_rad: np.ndarray, ball_m: np.ndarray) -> None:
        """Learn the camera's pose from where the ball is."""
        if np.all(np.isfinite(joints_rad)):
            self._learn(self._fitted.position(joints_rad), ball_m)
        else:
            self.refused += 1


class TurnedRbfEstimator(_BehindCamera):
    """The networks as they were trained, behind a camera that may have been turned.

    Parameters
    ----------
    model : RbfModel
        The trained networks.
    config : optional
        Not used: it has no parameters.
    """

    def __init__(self, model: RbfModel, config: Any = None) -> None:
        super().__init__(*_NETWORKS)
        self._networks = FrozenRbfEstimator(model)
        self._joints: np.ndarray | None = None
        self._model_m = _ORIGIN

    needs = FrozenRbfEstimator.needs

    def reset(self) -> None:
        """Take the camera to stand where it stood at the training."""
        super().reset()
        self._joints = None

    def jacobian(self, joints_rad: np.ndarray) -> np.ndarray:
        """Estimate at given joints, m/rad, shape (3, n)."""
        return self.camera.rotation @ self._networks.jacobian(joints_rad)

    def observe(self, joints_rad: np.ndarray, ball_m: np.ndarray) -> None:
        """Learn the camera's pose from how the ball goes."""
        if not np.all(np.isfinite(joints_rad)):
            self.refused += 1
            return
        if self._joints is None:
            self._model_m = ball_m
        else:
            step = joints_rad - self._joints
            jacobian = self._networks.jacobian(self._joints + 0.5 * step)
            self._model_m = self._model_m + jacobian @ step
        self._joints = joints_rad
        self._learn(self._model_m, ball_m)
