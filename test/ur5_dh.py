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


def axes_origins_ball(joints_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Axes (..., 6, 3), points on them, m, (..., 6, 3), and ball, m, (..., 3), in the base."""
    q = np.asarray(joints_rad, dtype=float)
    shape = q.shape[:-1]
    rotation = np.broadcast_to(np.eye(3), (*shape, 3, 3))
    origin = np.zeros((*shape, 3))
    axes, origins = [], []
    for i in range(6):
        axes.append(rotation[..., :, 2])
        origins.append(origin)
        c, s = np.cos(q[..., i]), np.sin(q[..., i])
        ca, sa = np.cos(DH_ALPHA[i]), np.sin(DH_ALPHA[i])
        zero = np.zeros_like(c)
        step = np.stack(
            [
                np.stack([c, -s * ca, s * sa], axis=-1),
                np.stack([s, c * ca, -c * sa], axis=-1),
                np.stack([zero, zero + sa, zero + ca], axis=-1),
            ],
            axis=-2,
        )
        offset = np.stack([DH_A[i] * c, DH_A[i] * s, zero + DH_D[i]], axis=-1)
        origin = origin + np.einsum("...ij,...j->...i", rotation, offset)
        rotation = rotation @ step
    ball = origin + BALL_BEYOND_FLANGE_M * rotation[..., :, 2]
    return np.stack(axes, axis=-2), np.stack(origins, axis=-2), ball


def flange_pose(joints_rad: np.ndarray) -> np.ndarray:
    """Pose of the flange in the base, lengths in m, shape (4, 4)."""
    pose = np.eye(4)
    for q, d, a, alpha in zip(joints_rad, DH_D, DH_A, DH_ALPHA, strict=True):
        turn, twist = np.eye(4), np.eye(4)
        turn[:2, :2] = [[np.cos(q), -np.sin(q)], [np.sin(q), np.cos(q)]]
        twist[1:3, 1:3] = [[np.cos(alpha), -np.sin(alpha)], [np.sin(alpha), np.cos(alpha)]]
        turn[2, 3], twist[0, 3] = d, a
        pose = pose @ turn @ twist
    return pose


def ball_and_jacobian(
    joints_rad: np.ndarray,
    camera_from_base: np.ndarray = CAMERA_FROM_BASE,
    camera_origin_m: np.ndarray = CAMERA_ORIGIN_M,
) -> tuple[np.ndarray, np.ndarray]:
    """Ball in the camera frame, m, (..., 3), and its Jacobian, m/rad, (..., 3, 6)."""
    axes, origins, ball = axes_origins_ball(joints_rad)
    jacobian = np.swapaxes(np.cross(axes, ball[..., None, :] - origins), -1, -2)
    return (
        np.einsum("ij,...j->...i", camera_from_base, ball - camera_origin_m),
        np.einsum("ij,...jk->...ik", camera_from_base, jacobian),
    )


def uniform_in_box(
    rng: np.random.Generator, count: int, half_widths_rad: np.ndarray = BOX_M_RAD
) -> np.ndarray:
    """Joints evenly in a box about the home pose, rad, (count, 6)."""
    return HOME_RAD + rng.uniform(-1.0, 1.0, (count, 6)) * half_widths_rad


def jacobian_error(jacobian_of, seed: int = 12345, count: int = 2000) -> float:
    """Relative Frobenius error of a Jacobian function on joints of box M never trained on."""
    joints = uniform_in_box(np.random.default_rng(seed), count)
    true = ball_and_jacobian(joints)[1]
    return float(np.linalg.norm(jacobian_of(joints) - true) / np.linalg.norm(true))
