"""How the camera stands now against where it stood when a model was learned.

A model says where the ball should be, ``p``, in the frame of the camera that it was learned with;
the image says where it is, ``x``. As long as the camera does not move, ``x = R p + t`` with one
rotation R and one translation t. The rotation that fits best is known in closed form (Kabsch),
however far the camera has been turned; what is known before enters as a matrix Fisher
distribution about the rotation so far, so that a little motion turns it a little.

A camera that is bumped shows at once: positions that no noise explains, several in a row, as far
from each other as they should be. What was learned of the old pose is then dropped, and the new
one is learned from there. How far the ball jumped says how far the camera may have been turned; but
if it is soon off again, then the camera turns on (somebody carries it), or it was turned about the
ball, and the jump says nothing: the rotation from before all that is then doubted as much as ever.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from fvs_estimator_node.camera_doubts import CameraDoubts
from fvs_estimator_node.rotations import nearest_rotation, rotation_angle_rad
from fvs_ros.vectors import length

_IDENTITY, _NOWHERE = np.eye(3), np.zeros(3)
_IDENTITY.flags.writeable = _NOWHERE.flags.writeable = False
#: How far a bumped camera may have been turned over how far that moved the ball in its view.
_TURN_SHARE = 1.5
#: Standard deviation that the first guess of the noise is, m, and its bounds.
_NOISE_M, _LEAST_NOISE_M, _MOST_NOISE_M = 0.001, 0.0002, 0.01
#: A bump within so many positions of the last one belongs to it.
_SOON = 30
#: A ball that has gone no further since what was remembered last is at rest, m.
_STILL_M = 0.002
#: No depth camera sees further, m.
_FARTHEST_M = 20.0
#: Share of a new squared change of the innovation in the noise.
_NOISE_SHARE = 0.02


@dataclass(frozen=True)
class CameraMotionConfig:
    """Settings of the pose of a camera that may have moved.

    Parameters
    ----------
    rotation_deviation_rad : float
        How far it may have been turned without anybody noticing, a standard deviation, rad.
    bumped_deviation_rad : float
        The same at most once it was noticed, rad; less after a small bump that stays alone.
    memory : float
        Positions, some way apart, after which an old one's weight has decayed by 63 %.
    bump_m : float
        A position further than this, and than six standard deviations of the noise besides, from
        where it should be is not believed, m.
    bump_repeats : int
        So many of them in a row are a camera that was bumped.
    """

    rotation_deviation_rad: float = 0.01
    bumped_deviation_rad: float = 0.7
    memory: float = 1000.0
    bump_m: float = 0.01
    bump_repeats: int = 2

    def __post_init__(self) -> None:
        for name in ("rotation_deviation_rad", "bumped_deviation_rad", "bump_m"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} must be positive, got {value}")
        if not self.memory >= 1.0:
            raise ValueError(f"memory must be at least 1 step, got {self.memory}")
        if self.bump_repeats < 1:
            raise ValueError(f"bump_repeats must be at least 1, got {self.bump_repeats}")


@dataclass(frozen=True)
class _Pose:
    """A pose and what is known of it; never changed in place.

    Parameters
    ----------
    rotation, translation_m : ndarray, shapes (3, 3) and (3,)
        R and t, the latter in m.
    prior_m2 : float
        What the rotation before all pairs counts like, m^2.
    scatter : ndarray, shape (3, 3)
        Of the pairs about their means, the prior included, m^2.
    weight : float
        So many pairs, old ones faded.
    mean_p_m, mean_x_m : ndarray, shape (3,)
        Their means, m.
    """

    rotation: np.ndarray
    translation_m: np.ndarray
    prior_m2: float
    scatter: np.ndarray
    weight: float = 0.0
    mean_p_m: np.ndarray = field(default_factory=lambda: _NOWHERE)
    mean_x_m: np.ndarray = field(default_factory=lambda: _NOWHERE)

    def off_m(self, model_m: np.ndarray, seen_m: np.ndarray) -> np.ndarray:
        """From where the ball should be seen to where it is, m, shape (3,)."""
        return np.asarray(seen_m - (self.rotation @ model_m + self.translation_m))


class CameraMotion:
    """Rotation R and translation t of ``x = R p + t``, step by step.

    Parameters
    ----------
    config : CameraMotionConfig, optional
        Settings.
    """

    def __init__(self, config: CameraMotionConfig | None = None) -> None:
        self._config = config if config is not None else CameraMotionConfig()
        self._keep = math.exp(-1.0 / self._config.memory)
        self.reset()

    def reset(self) -> None:
        """Forget everything: the camera stands where it stood."""
        self._variance = _NOISE_M**2
        #: Positions since the last bump, and the rotation from before the first one of a series.
        self._since_bump, self._before_bump = _SOON, _IDENTITY
        self._doubts = CameraDoubts()
        self._pose = _Pose(_IDENTITY, _NOWHERE, 0.0, np.zeros((3, 3)))
        self._begin(_IDENTITY, self._config.rotation_deviation_rad)

    def _begin(self, rotation: np.ndarray, deviation_rad: float) -> None:
        """Forget all pairs; a rotation is known to a standard deviation."""
        prior_m2 = self._variance / (2.0 * deviation_rad**2)
        self._pose = _Pose(rotation, self._pose.translation_m, prior_m2, prior_m2 * rotation)
        self._faded_at = _NOWHERE
        self._strangers: list[tuple[np.ndarray, np.ndarray]] = []
        self._innovation: np.ndarray | None = None

    @property
    def rotation(self) -> np.ndarray:
        """R, shape (3, 3); not to be changed."""
        return self._pose.rotation

    @property
    def translation_m(self) -> np.ndarray:
        """t, m, shape (3,); not to be changed."""
        return self._pose.translation_m

    @property
    def angle_rad(self) -> float:
        """Angle of the rotation, rad."""
        return rotation_angle_rad(self._pose.rotation)

    @property
    def noise_m(self) -> float:
        """Standard deviation of one coordinate of a position, as far as seen, m."""
        return math.sqrt(self._variance)

    @property
    def doubts(self) -> CameraDoubts:
        """How often the camera was found to have been moved."""
        return self._doubts

    def add(self, model_m: np.ndarray, seen_m: np.ndarray) -> bool:
        """Tell one pair: where the model has the ball, and where the image has it, m, (3,) each.

        Nothing is learned from what is not finite, beyond all reason, or not believed yet.

        Returns
        -------
        bool
            Whether the pose is another one now.
        """
        if not (length(model_m) < _FARTHEST_M and length(seen_m) < _FARTHEST_M):
            return False
        self._doubts.image()
        innovation = self._pose.off_m(model_m, seen_m)
        distance_m = length(innovation)
        believed = distance_m <= self._disbelief_m()
        if believed:
            self._strangers.clear()
            if self._innovation is not None:
                self._hear_noise(innovation - self._innovation)
            self._innovation = innovation
            self._learn(model_m, seen_m)
        bumped = not believed and self._wonder(model_m, seen_m, distance_m)
        return believed or bumped

    def _hear_noise(self, change_m: np.ndarray) -> None:
        """Learn the noise from what changes between two positions: what stays is no noise."""
        share = max(_NOISE_SHARE, 1.0 / (self._pose.weight + 10.0))
        self._variance += share * (float(change_m.dot(change_m)) / 6.0 - self._variance)
        self._variance = min(max(self._variance, _LEAST_NOISE_M**2), _MOST_NOISE_M**2)

    def _disbelief_m(self) -> float:
        return self._config.bump_m + 6.0 * self.noise_m

    def _wonder(self, model_m: np.ndarray, seen_m: np.ndarray, distance_m: float) -> bool:
        """Keep a pair that does not fit; so many in a row that fit each other are a bump."""
        if self._strangers:
            before_p, before_x = self._strangers[-1]
            # However the camera was moved: in between the ball went as far as it was to go.
            off_m = abs(length(seen_m - before_x) - length(model_m - before_p))
            if off_m > self._disbelief_m():
                self._strangers.clear()
        self._strangers.append((model_m, seen_m))
        if len(self._strangers) < self._config.bump_repeats:
            return False
        least_rad, most_rad = self._config.rotation_deviation_rad, self._config.bumped_deviation_rad
        if self._since_bump < _SOON:
            # What was learned in between was learned of a pose that did not last.
            doubt_rad = most_rad
        else:
            self._before_bump = self._pose.rotation
            # A turn moves the ball by angle times distance, less where it is about the ball.
            turned_rad = _TURN_SHARE * distance_m / max(length(seen_m), 1e-3)
            doubt_rad = min(max(turned_rad, least_rad), most_rad)
        self._begin_anew(self._strangers, self._before_bump, doubt_rad)
        return True

    def _begin_anew(
        self,
        pairs: list[tuple[np.ndarray, np.ndarray]],
        rotation: np.ndarray,
        deviation_rad: float,
    ) -> None:
        """Count a bump, and know of the new pose what some pairs tell, and a rotation at most."""
        self._doubts.bump()
        self._since_bump = 0
        self._begin(rotation, deviation_rad)
        for pair in pairs:
            self._learn(*pair)

    def _learn(self, model_m: np.ndarray, seen_m: np.ndarray) -> None:
        self._since_bump += 1
        pose = self._pose
        # At rest there is nothing new to remember, and so nothing to forget.
        gone = model_m - self._faded_at
        keep = self._keep if float(gone.dot(gone)) > _STILL_M**2 else 1.0
        if keep < 1.0:
            self._faded_at = model_m
        weight = min(keep * pose.weight, self._config.memory)
        total = weight + 1.0
        from_p, from_x = model_m - pose.mean_p_m, seen_m - pose.mean_x_m
        # What fades is made up for by the rotation so far: a ball that has long been going along
        # one line does not make the camera forget how it is turned.
        scatter = keep * pose.scatter + (1.0 - keep) * pose.prior_m2 * pose.rotation
        # Where the ball hardly goes, noise and a camera that is being carried would turn it.
        if float(from_p.dot(from_p)) > _STILL_M**2:
            scatter += (weight / total) * from_x[:, None] * from_p
        mean_p_m, mean_x_m = pose.mean_p_m + from_p / total, pose.mean_x_m + from_x / total
        rotation = nearest_rotation(scatter)
        translation_m = mean_x_m - rotation @ mean_p_m
        self._pose = _Pose(
            rotation, translation_m, pose.prior_m2, scatter, total, mean_p_m, mean_x_m
        )
