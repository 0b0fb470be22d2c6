"""A UR5 with a ball on its end, in numpy, for tests: written without a look at the simulator."""

import numpy as np

DH_D = np.array([0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823])
DH_A = np.array([0.0, -0.425, -0.39225, 0.0, 0.0, 0.0])
DH_ALPHA = np.array([np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0])
BALL_BEYOND_FLANGE_M = 0.09

#: Pose about which box M lies, and its half widths, rad.
HOME_RAD = np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0])
BOX_M_RAD = np.array([0.6, 0.5, 0.5, 0.5, 0.5, 0.5])

# A camera above the table that looks down and a little forward (optical axes, rows in the base).
_TILT = 0.3
CAMERA_FROM_BASE = np.array(
    [
        [0.0, -1.0, 0.0],
        [-np.cos(_TILT), 0.0, np.sin(_TILT)],
        [-np.sin(_TILT), 0.0, -np.cos(_TILT)],
    ]
)
CAMERA_ORIGIN_M = np.array([0.6, 0.0, 1.6])


def frames(joints_rad: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """The base and each joint's frame in it: rotations (..., 3, 3) and origins, m, (..., 3)."""
    q = np.asarray(joints_rad, dtype=float)
    zero = np.zeros(q.shape[:-1])
    rotation, origin = np.broadcast_to(np.eye(3), (*zero.shape, 3, 3)), np.zeros((*zero.shape, 3))
    poses = [(rotation, origin)]
    for i in range(6):
        c, s = np.cos(q[..., i]), np.sin(q[..., i])
        ca, sa = np.cos(DH_ALPHA[i]), np.sin(DH_ALPHA[i])
        rows = [[c, -s * ca, s * sa], [s, c * ca, -c * sa], [zero, zero + sa, zero + ca]]
        step = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
        offset = np.stack([DH_A[i] * c, DH_A[i] * s, zero + DH_D[i]], axis=-1)
        origin = origin + np.einsum("...ij,...j->...i", rotation, offset)
        rotation = rotation @ step
        poses.append((rotation, origin))
    return poses


def axes_origins_ball(joints_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Axes (..., 6, 3), points on them, m, (..., 6, 3), and ball, m, (..., 3), in the base."""
    *joints, (rotation, origin) = frames(joints_rad)
    axes = np.stack([rotation[..., :, 2] for rotation, _ in joints], axis=-2)
    ball = origin + BALL_BEYOND_FLANGE_M * rotation[..., :, 2]
    return axes, np.stack([point for _, point in joints], axis=-2), ball
