"""The position of a ball, m, in the camera's optical frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fvs_ros.kinds.kind import Kind
from fvs_ros.topics import kind_topics


@dataclass(frozen=True)
class Ball(Kind):
    """z is the ball's centre, m, (3,)."""

    name = what = "ball"
    models = ("models/ur5_front.npz", "models/ur5_hand.npz")
    axes = ("x", "y", "z")
    topics = kind_topics(
        "geometry_msgs/msg/PointStamped",
        (
            "ball_position",
            "The ball's centre, m, in the camera's optical frame, stamped with the exposure; "
            "silent while the ball is not seen.",
        ),
        (
            "target_position",
            "The desired ball position, m, in the frame of `ball_position`, or from the object, "
            "along the camera's axes (`frame_id` `object`).",
        ),
        (
            "object_position",
            "The same of an object, which a camera on the arm servos; else optional, for targets "
            "relative to it.",
        ),
        "geometry_msgs/msg/Vector3Stamped",
    )

    def read(self, message: Any) -> np.ndarray:
        """Position of a ``PointStamped``, m, (3,)."""
        point = message.point
        return self.parse(np.array([point.x, point.y, point.z], dtype=float))

    def write(self, message: Any, z: np.ndarray) -> None:
        """Fill in a ``PointStamped``."""
        message.point.x, message.point.y, message.point.z = z.tolist()

    def read_sliding(self, message: Any) -> np.ndarray:
        """Sliding variable of a ``Vector3Stamped``, m, (3,)."""
        return np.array([message.vector.x, message.vector.y, message.vector.z])

    def write_sliding(self, message: Any, sliding_m: np.ndarray) -> None:
        """Fill in a ``Vector3Stamped``."""
        message.vector.x, message.vector.y, message.vector.z = sliding_m.tolist()
