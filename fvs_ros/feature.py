"""What is servoed: a ball's position or a tag's pose, as a vector of lengths.

A *feature* is a vector x of m numbers, m. A ball's is its position, ``m = 3``. A pose is the
position of its origin and its three axes, each ``L / sqrt(2)`` long, ``m = 12``: points of a rigid
body, which a camera that is moved sees turned and shifted, and which joints move by ``dx = J dr``.
With the lever arm L two poses are ``(|dp|^2 + (2 L sin(angle / 2))^2)^0.5`` apart: turning by an
angle counts like moving along its arc at L.

Of the 12 numbers six are free. The laws act on the *task* error: the way from the target, m, and,
for a pose, the rotation vector from the target times L. At x the motions of feature and task are
``dx = B t`` and ``t = B' dx``, with orthonormal columns B.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees, pi
from typing import NamedTuple

import numpy as np

from fvs_ros import topics
from fvs_ros.camera import FeatureConfig
from fvs_ros.chain import cross_matrix
from fvs_ros.params import parameter
from fvs_ros.rotations import (
    nearest_rotation,
    quaternion_from_rotation,
    rotation_from_vector,
    vector_from_rotation_rad,
)
from fvs_ros.vectors import length

_UNIT = np.eye(3)
#: From here on noise may change which way round is the shorter one, rad.
_HALF_TURN_RAD = 0.9 * pi
#: A vector that is further from any pose is none, as a share of the lever arm.
_NO_POSE = 0.01


class Feature:
    """A vector whose every component is servoed, such as the position of a ball.

    Parameters
    ----------
    size : int
        Number of its components, m.

    Attributes
    ----------
    seen, target, sliding, truth : Topic
        Where it is published, its target, the law's sliding variable, and a simulator's truth.
    what : str
        What the camera looks for, in a word.
    axes : tuple of str
        Names of the d components of the task.
    scale, task_scale : ndarray, shapes (m,) and (d,)
        Lengths, m, of what a message gives as 1: in metres, or of an axis, or in radians.
    """

    seen, target = topics.BALL_POSITION, topics.TARGET_POSITION
    sliding, truth = topics.SLIDING_VARIABLE, topics.TRUE_BALL_POSITION
    what = "ball"
    #: Whether the motion of the task depends on x.
    curved = False

    def __init__(self, size: int = 3) -> None:
        self.size = size
        self.axes = tuple("xyz") if size == 3 else tuple(str(one + 1) for one in range(size))
        self.scale = self.task_scale = np.ones(size)

    def error(
        self, feature_m: np.ndarray, target_m: np.ndarray, last_m: np.ndarray | None = None
    ) -> np.ndarray:
        """The task error of a feature from its target, m, (m,) each: m, (d,).

        Of two ways round, equal but for noise, that of the last error, if given, is kept.
        """
        return feature_m - target_m

    def to_task(self, feature_m: np.ndarray, motion: np.ndarray) -> np.ndarray:
        """Motion of the task, (d, ...), of a motion of the feature, (m, ...), at x, (m,)."""
        return motion

    def from_task(self, feature_m: np.ndarray, motion: np.ndarray) -> np.ndarray:
        """Motion of the feature, (m, ...), of a motion of the task, (d, ...), at x, (m,)."""
        return motion

    def displaced(self, feature_m: np.ndarray, step_m: np.ndarray) -> np.ndarray:
        """The feature, (m,), whose task error from ``feature_m`` is a step, m, (d,)."""
        return feature_m + step_m

    def nearest(self, vector_m: np.ndarray) -> np.ndarray:
        """The feature nearest to any vector, m, (m,): of a mean of features, say."""
        return vector_m

    def is_one(self, vector_m: np.ndarray) -> bool:
        """Whether a finite vector, m, (m,), is a feature."""
        return True

    def place(self, feature_m: np.ndarray) -> str:
        """A feature, m, (m,), in words."""
        return f"({', '.join(f'{one:.3f}' for one in feature_m)}) m"

    def distance(self, error_m: np.ndarray) -> str:
        """A task error, m, (d,), in words."""
        return f"{1e3 * length(error_m):.1f} mm"

    def parts(self, error_m: np.ndarray | None) -> dict[str, float]:
        """Lengths of a task error, m and rad, by name; NaN without one."""
        return {"error_m": float("nan") if error_m is None else length(error_m)}


class PoseFeature(Feature):
    """A pose, such as that of a tag.

    Parameters
    ----------
    lever_arm_m : float
        L, m.
    """

    seen, target = topics.TOOL_POSE, topics.TARGET_POSE
    sliding, truth = topics.SLIDING_VECTOR, topics.TRUE_TOOL_POSE
    what, curved = "tag", True

    def __init__(self, lever_arm_m: float) -> None:
        super().__init__(12)
        self.axes = ("x", "y", "z", "rx", "ry", "rz")
        self.lever_arm_m, self._axis_m = lever_arm_m, lever_arm_m / 2.0**0.5
        self.scale = np.repeat([1.0, self._axis_m], [3, 9])
        self.task_scale = np.repeat([1.0, lever_arm_m], 3)

    def of(self, position_m: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """The feature, (12,), of a position, m, (3,), and a rotation matrix, (3, 3)."""
        return np.concatenate([position_m, self._axis_m * rotation.T.ravel()])

    def rotation(self, feature_m: np.ndarray) -> np.ndarray:
        """The rotation matrix of a feature, shape (3, 3)."""
        return feature_m[3:].reshape(3, 3).T / self._axis_m

    def error(
        self, feature_m: np.ndarray, target_m: np.ndarray, last_m: np.ndarray | None = None
    ) -> np.ndarray:
        """The way, m, and the rotation vector times L, m, from the target: (6,)."""
        turn = vector_from_rotation_rad(self.rotation(feature_m) @ self.rotation(target_m).T)
        angle_rad = length(turn)
        if last_m is not None and angle_rad > _HALF_TURN_RAD and turn.dot(last_m[3:]) < 0.0:
            turn = turn * (1.0 - 2.0 * pi / angle_rad)
        return np.append(feature_m[:3] - target_m[:3], self.lever_arm_m * turn)

    def _basis(self, feature_m: np.ndarray) -> np.ndarray:
        """B', shape (6, 12)."""
        basis = np.zeros((6, 12))
        basis[:3, :3] = _UNIT
        turns = cross_matrix(feature_m[3:].reshape(3, 3)) / self.lever_arm_m
        basis[3:, 3:] = np.swapaxes(turns, 0, 1).reshape(3, 9)
        return basis

    def to_task(self, feature_m: np.ndarray, motion: np.ndarray) -> np.ndarray:
        """Motion of the task, (6, ...), of a motion of the feature, (12, ...), at x, (12,)."""
        return self._basis(feature_m) @ motion

    def from_task(self, feature_m: np.ndarray, motion: np.ndarray) -> np.ndarray:
        """Motion of the feature, (12, ...), of a motion of the task, (6, ...), at x, (12,)."""
        return self._basis(feature_m).T @ motion

    def displaced(self, feature_m: np.ndarray, step_m: np.ndarray) -> np.ndarray:
        """The pose, (12,), that is moved and turned by a task step, m, (6,)."""
        turn = rotation_from_vector(step_m[3:] / self.lever_arm_m)
        axes = feature_m[3:].reshape(3, 3) @ turn.T
        return np.concatenate([feature_m[:3] + step_m[:3], axes.ravel()])

    def nearest(self, vector_m: np.ndarray) -> np.ndarray:
        """The pose with the same origin and the rotation nearest to the axes, (12,)."""
        return self.of(vector_m[:3], nearest_rotation(self.rotation(vector_m)))

    def is_one(self, vector_m: np.ndarray) -> bool:
        """Whether a finite vector, m, (12,), is a pose."""
        return length(vector_m - self.nearest(vector_m)) < _NO_POSE * self.lever_arm_m

    def place(self, feature_m: np.ndarray) -> str:
        """A pose, (12,), in words."""
        turn = quaternion_from_rotation(self.rotation(feature_m))
        words = ", ".join(f"{one:.3f}" for one in turn)
        return f"{super().place(feature_m[:3])}, quaternion ({words})"

    def distance(self, error_m: np.ndarray) -> str:
        """A task error, m, (6,), in words."""
        parts = self.parts(error_m)
        return f"{1e3 * parts['way_m']:.1f} mm and {degrees(parts['angle_rad']):.2f} degrees"

    def parts(self, error_m: np.ndarray | None) -> dict[str, float]:
        """Lengths of a task error, m and rad, by name; NaN without one."""
        nan = float("nan")
        way, turn = (None, None) if error_m is None else (error_m[:3], error_m[3:])
        return {
            **super().parts(error_m),
            "way_m": nan if way is None else length(way),
            "angle_rad": nan if turn is None else length(turn) / self.lever_arm_m,
        }


class Distance(NamedTuple):
    """A task error, m, (d,), that becomes words only when it is read."""

    feature: Feature
    error_m: np.ndarray

    def __str__(self) -> str:
        return self.feature.distance(self.error_m)


@dataclass(frozen=True)
class ServoedConfig(FeatureConfig):
    """What is servoed."""

    feature: str = parameter(
        topics.BALL, "what is servoed: a ball, or the pose of a tag", choices=topics.FEATURES
    )
    lever_arm_m: float = parameter(
        0.3,
        "what a turn counts for: as much as a motion along its arc at this radius, m; for pose. "
        "Every limit and gain of a length holds for the arc, too.",
        0.1,
        1.0,
    )

    @property
    def servoed(self) -> Feature:
        """The feature."""
        return PoseFeature(self.lever_arm_m) if self.feature == topics.POSE else Feature()
