"""The pose of a tag: position, m, and orientation, in the camera's optical frame.

z is the position of the origin and, one after the other, the three axes as unit vectors: 12
numbers of which six are free. A motion is that of the origin, m, and a rotation vector in the
camera's frame times the *lever arm* L: turning by an angle counts like moving along its arc at L.
In z, an axis weighs ``L / sqrt(2)``: then ``|dz|`` is the length of the motion, and tangent vectors
are coordinates in an orthonormal basis.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import atan2, degrees, pi
from typing import Any

import numpy as np

from fvs_ros.chain import cross_matrix
from fvs_ros.kinds.kind import Kind
from fvs_ros.params import parameter
from fvs_ros.rotations import (
    nearest_rotation,
    quaternion_from_rotation,
    rotation_from_quaternion,
    rotation_from_vector,
    vector_from_rotation_rad,
)
from fvs_ros.topics import kind_topics
from fvs_ros.vectors import length

#: From here on noise may change which direction of rotation is the shorter one, rad.
_HALF_TURN_RAD = 0.9 * pi
#: What of a pose is servoed: how many numbers, and the axis whose direction is, if only that is.
_TASKS: dict[str, tuple[int, int | None]] = {
    "all": (6, None),
    "position": (3, None),
    **{f"position_{axis}": (5, i) for i, axis in enumerate("xyz")},
}
#: Half a tag's edge, m. It tells how much of a lens error turns a tag that faces the camera.
_HALF_EDGE_M = 0.05


@dataclass(frozen=True)
class Pose(Kind):
    """The pose of a tag; ``lever_arm_m`` is L."""

    name, what = "pose", "tag"
    models = ("models/ur5_front_pose.npz", "models/ur5_hand_pose.npz")
    columns = ("x", "y", "z", "qx", "qy", "qz", "qw")
    axes = ("x", "y", "z", "rx", "ry", "rz")
    outliers = 0.05  # its noise depends on the view
    topics = kind_topics(
        "geometry_msgs/msg/PoseStamped",
        (
            "tool_pose",
            "The tag's pose in the camera's optical frame, its x axis to the right, y up, z out of "
            "the print, stamped with the exposure; silent while it is not seen or not certain.",
        ),
        (
            "target_pose",
            "The desired pose of the tag, in the frame of `tool_pose`, or in that of the object "
            "(`frame_id` `object`).",
        ),
        (
            "object_pose",
            "The same of an object, which a camera on the arm servos; else optional, for targets "
            "relative to it.",
        ),
    )

    lever_arm_m: float = parameter(
        0.3,
        "Lever arm: converts rotation to length, m per rad; for pose. Limits and gains of lengths "
        "then hold for rotation, too.",
        0.1,
        1.0,
    )

    task_axes: str = parameter(
        "all",
        "What of a tag's pose is servoed: all; or, with five joints, position and the direction of "
        "the tag's x, y or z axis, about which it may turn; or position alone; for pose.",
        choices=tuple(_TASKS),
    )

    @property
    def freedom(self) -> int:
        """Count of the numbers that are servoed."""
        return _TASKS[self.task_axes][0]

    @property
    def least_joints(self) -> int:  # type: ignore[override]
        """A joint for each."""
        return self.freedom

    @cached_property
    def unit(self) -> np.ndarray:
        """A metre, and the length of a radian, m, (6,)."""
        return np.repeat([1.0, self.lever_arm_m], 3)

    @cached_property
    def weights(self) -> np.ndarray:
        """A metre, and the length of an axis, m, (12,)."""
        return np.repeat([1.0, self.lever_arm_m / 2.0**0.5], [3, 9])

    def read(self, message: Any) -> np.ndarray:
        """Pose of a ``PoseStamped``, (12,)."""
        p, q = message.pose.position, message.pose.orientation
        return self.parse(np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w]))

    def write(self, message: Any, z: np.ndarray) -> None:
        """Fill in a ``PoseStamped``."""
        p, q = message.pose.position, message.pose.orientation
        p.x, p.y, p.z, q.x, q.y, q.z, q.w = self.columns_of(z).tolist()

    def parse(self, numbers: np.ndarray) -> np.ndarray:
        """Pose of a position, m, and a quaternion or a rotation vector, degrees."""
        if len(numbers) == len(self.columns):
            return super().parse(numbers)
        if len(numbers) != 6:
            ways = "6 numbers, x y z and a rotation vector, degrees, or 7, x y z qx qy qz qw"
            raise ValueError(f"has {ways}, got {len(numbers)}")
        rotation = rotation_from_vector(np.radians(numbers[3:]))
        return self.checked(self.of_body(numbers[:3], rotation))

    def of_columns(self, numbers: np.ndarray) -> np.ndarray:
        """Pose of a position, m, and a quaternion x, y, z, w."""
        return self.of_body(numbers[:3], rotation_from_quaternion(numbers[3:]))

    def columns_of(self, z: np.ndarray) -> np.ndarray:
        """Position, m, and quaternion x, y, z, w of a pose, (7,)."""
        return np.append(z[:3], quaternion_from_rotation(self.rotation(z)))

    def minus(
        self, z: np.ndarray, origin: np.ndarray, before: np.ndarray | None = None
    ) -> np.ndarray:
        """Motion from a pose ``origin`` to z, m, (6,)."""
        rotation_rad = vector_from_rotation_rad(self.rotation(z) @ self.rotation(origin).T)
        return self._motion(z[:3] - origin[:3], rotation_rad, before)

    def _motion(
        self, way_m: np.ndarray, rotation_rad: np.ndarray, before: np.ndarray | None
    ) -> np.ndarray:
        angle_rad = length(rotation_rad)
        if before is not None and angle_rad > _HALF_TURN_RAD and rotation_rad.dot(before[3:]) < 0.0:
            rotation_rad = rotation_rad * (1.0 - 2.0 * pi / angle_rad)
        return np.append(way_m, self.lever_arm_m * rotation_rad)

    def error(
        self, z: np.ndarray, target: np.ndarray, before: np.ndarray | None = None
    ) -> np.ndarray:
        """Motion to z, m, (6,), from the nearest pose with the position and axis of a target."""
        count, axis = _TASKS[self.task_axes]
        if count == 6:
            return self.minus(z, target, before)
        way_m, rotation_rad = z[:3] - target[:3], np.zeros(3)
        if axis is not None:
            axes = z[3:].reshape(3, 3)
            wanted, shown = target[3:].reshape(3, 3)[axis], axes[axis]
            across = np.cross(wanted, shown)
            sine, angle_rad = length(across), atan2(length(across), float(wanted.dot(shown)))
            # Any direction across is as good where they are opposite.
            rotation_rad = angle_rad * (across / sine if sine > 1e-9 else axes[axis - 1])
        return self._motion(way_m, rotation_rad, before)

    def of_task(self, z: np.ndarray | None, motion_m: np.ndarray) -> np.ndarray:
        """Of motions, m, (6, ...), of z what changes its error: no rotation about the axis."""
        count, axis = _TASKS[self.task_axes]
        if count == 6 or z is None:
            return motion_m
        changes, rotation = np.zeros_like(motion_m), motion_m[3:]
        changes[:3] = motion_m[:3]
        if axis is not None:
            free = z[3:].reshape(3, 3)[axis]
            changes[3:] = rotation - np.multiply.outer(free, free.dot(rotation))
        return changes

    def retract(self, z: np.ndarray, motion_m: np.ndarray) -> np.ndarray:
        """The pose that a motion, m, (6,), leads to from z."""
        rotation = rotation_from_vector(motion_m[3:] / self.lever_arm_m)
        return np.append(z[:3] + motion_m[:3], z[3:].reshape(3, 3) @ rotation.T)

    def relative(self, z: np.ndarray, object_z: np.ndarray) -> np.ndarray:
        """The pose z in the frame of an object's pose, both (12,)."""
        camera_from_object = self.rotation(object_z)
        from_object_m = camera_from_object.T @ (z[:3] - object_z[:3])
        return self.of_body(from_object_m, camera_from_object.T @ self.rotation(z))

    def absolute(self, relative_z: np.ndarray, object_z: np.ndarray) -> np.ndarray:
        """The pose that is ``relative_z`` in the frame of an object's pose, all (12,)."""
        camera_from_object = self.rotation(object_z)
        position_m = object_z[:3] + camera_from_object @ relative_z[:3]
        return self.of_body(position_m, camera_from_object @ self.rotation(relative_z))

    def moved_by(self, z: np.ndarray, angular: np.ndarray, linear_m: np.ndarray) -> np.ndarray:
        """Motions, m, (..., 6, n), of z by n twists of space."""
        linear = super().moved_by(z, angular, linear_m)
        angular = self.lever_arm_m * np.swapaxes(angular, -1, -2)
        return np.concatenate([linear, angular], axis=-2)

    def through_lens(self, z: np.ndarray, focal: float, radial: float) -> np.ndarray:
        """Poses, (k, 12), that a wrong lens shows: the least-squares ones of shifted corners."""
        axes = z[:, 3:9].reshape(-1, 2, 3)
        edges = _HALF_EDGE_M * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) @ axes  # (k, 4, 3)
        corners = z[:, None, :3] + edges
        image = corners[..., :2] / corners[..., 2:]
        projection = np.zeros((*image.shape, 3))
        projection[..., :2], projection[..., 2] = np.eye(2), -image
        projection /= corners[..., 2:, None]
        slopes = np.concatenate([projection, -projection @ cross_matrix(edges)], axis=-1)
        error = (focal + radial * np.sum(image**2, axis=-1, keepdims=True)) * image
        slopes, error = slopes.reshape(-1, 8, 6), error.reshape(-1, 8, 1)
        back = np.swapaxes(slopes, 1, 2)
        motion = np.linalg.solve(back @ slopes, back @ error)[..., 0]
        axes = z[:, 3:].reshape(-1, 3, 3)
        axes = axes - axes @ cross_matrix(motion[:, 3:])
        return np.hstack([z[:, :3] + motion[:, :3], axes.reshape(-1, 9)])

    def without_lens(self, z: np.ndarray, focal: float, radial: float) -> np.ndarray:
        """Poses with the true lens, (k, 12): exact in the distance of a tag that faces it."""
        return self.through_lens(z, -focal, -radial)

    @property
    def flat(self) -> bool:
        """Never: a turn moves each axis in its own direction."""
        return False

    def _basis(self, z: np.ndarray | None) -> np.ndarray | None:
        """Orthonormal rows, (6, 12): the tangent vectors among those of the weighted numbers."""
        if self.on_arm:
            return super()._basis(z)
        assert z is not None
        basis = np.zeros((6, 12))
        basis[:3, :3] = np.eye(3)
        rotations = cross_matrix(z[3:].reshape(3, 3)) / 2.0**0.5
        basis[3:, 3:] = np.swapaxes(rotations, 0, 1).reshape(3, 9)
        return basis

    def nearest(self, numbers: np.ndarray) -> np.ndarray:
        """The pose with the same origin and the rotation nearest to the axes, (12,)."""
        return self.of_body(numbers[:3], nearest_rotation(self.rotation(numbers)))

    def of_body(self, position_m: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """The pose, (12,), of a position, m, (3,), and a rotation matrix, (3, 3)."""
        return np.append(position_m, rotation.T)

    def rotation(self, z: np.ndarray) -> np.ndarray:
        """The rotation matrix of a pose, (3, 3)."""
        return z[3:].reshape(3, 3).T

    def directions(self, z: np.ndarray) -> np.ndarray:
        """The axes, weighted, m, (3, 3): one a row."""
        return self.weights[-1] * z[3:].reshape(3, 3)

    def facing(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cosine, (1,), of the angle between the print's normal and the line to the camera."""
        distance_m, normal = length(z[:3]), z[9:]
        sight = z[:3] / distance_m
        cosine = -normal.dot(sight)
        linear, angular = (normal + cosine * sight) / -distance_m, np.cross(sight, normal)
        return np.array([cosine]), np.append(linear, angular / self.lever_arm_m)[None]

    def text(self, z: np.ndarray) -> str:
        """A pose in words."""
        turned_deg = np.degrees(vector_from_rotation_rad(self.rotation(z)))
        words = ", ".join(f"{number:.1f}" for number in turned_deg)
        return f"{super().text(z[:3])}, turned by ({words}) degrees"

    def error_text(self, error_m: np.ndarray) -> str:
        """An error, m, (6,), in words."""
        if self.freedom == 3:
            return super().error_text(error_m)
        angle_deg = degrees(length(error_m[3:]) / self.lever_arm_m)
        return f"{self.length_text(length(error_m[:3]), 1)} and {angle_deg:.2f} degrees"

    def parts_m(self, errors_m: np.ndarray) -> dict[str, np.ndarray]:
        """Lengths, m, (...), of the ways and of the arcs of errors, m, (..., 6)."""
        arc_m = np.linalg.norm(errors_m[..., 3:], axis=-1)
        return {**super().parts_m(errors_m[..., :3]), "arc_m": arc_m}

    def status_values(self, error_m: np.ndarray | None) -> dict[str, float]:
        """Lengths of an error, m and rad, by name; NaN without one."""
        parts = error_m if error_m is not None else np.full(6, np.nan)
        return {
            **super().status_values(error_m),
            "way_m": length(parts[:3]),
            "angle_rad": length(parts[3:]) / self.lever_arm_m,
        }
