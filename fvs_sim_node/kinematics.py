"""Forward kinematics of the UR5 and the exact Jacobian of the ball, in closed form.

Numpy only and independent of the physics engine: the truth that estimates are held against.
Frames follow the Denavit-Hartenberg convention of Universal Robots: the world frame here is the
robot's own ``base`` frame, which is ROS's ``base_link`` turned by half a turn about z. The arm at
zero angles points along -x.
"""

from __future__ import annotations

import numpy as np

from fvs_sim_node.ur5_urdf import DH_A_M, DH_ALPHA_RAD, DH_D_M

_COS_ALPHA = np.round(np.cos(DH_ALPHA_RAD), 15)
_SIN_ALPHA = np.round(np.sin(DH_ALPHA_RAD), 15)


def link_frames(joints_rad: np.ndarray) -> np.ndarray:
    """Poses of the base and of the link frames.

    Parameters
    ----------
    joints_rad : array_like, shape (..., n)
        Joint angles, rad, kinematic order.

    Returns
    -------
    ndarray, shape (..., n + 1, 4, 4)
        Homogeneous transforms to the world frame; the first is the identity, the last the flange.
    """
    joints = np.asarray(joints_rad, dtype=float)
    cos, sin = np.cos(joints), np.sin(joints)
    frames = np.zeros((*joints.shape[:-1], len(DH_A_M) + 1, 4, 4))
    frames[..., 0, :, :] = np.eye(4)
    step = np.zeros((*joints.shape[:-1], 4, 4))
    step[..., 3, 3] = 1.0
    for i in range(len(DH_A_M)):
        c, s = cos[..., i], sin[..., i]
        step[..., 0, 0] = c
        step[..., 0, 1] = -s * _COS_ALPHA[i]
        step[..., 0, 2] = s * _SIN_ALPHA[i]
        step[..., 0, 3] = DH_A_M[i] * c
        step[..., 1, 0] = s
        step[..., 1, 1] = c * _COS_ALPHA[i]
        step[..., 1, 2] = -c * _SIN_ALPHA[i]
        step[..., 1, 3] = DH_A_M[i] * s
        step[..., 2, 1] = _SIN_ALPHA[i]
        step[..., 2, 2] = _COS_ALPHA[i]
        step[..., 2, 3] = DH_D_M[i]
        frames[..., i + 1, :, :] = frames[..., i, :, :] @ step
    return frames


def flange_pose(joints_rad: np.ndarray) -> np.ndarray:
    """Pose of the flange (``tool0``), shape (..., 4, 4), world frame, lengths in m."""
    return link_frames(joints_rad)[..., -1, :, :]


def ball_position(joints_rad: np.ndarray, ball_offset_m: float = 0.09) -> np.ndarray:
    """Ball centre in the world frame.

    Parameters
    ----------
    joints_rad : array_like, shape (..., n)
        Joint angles, rad.
    ball_offset_m : float
        Distance of the ball's centre beyond the flange on the tool axis, m.

    Returns
    -------
    ndarray, shape (..., 3)
        Position, m.
    """
    pose = flange_pose(joints_rad)
    return pose[..., :3, 3] + ball_offset_m * pose[..., :3, 2]


def ball_jacobian(joints_rad: np.ndarray, ball_offset_m: float = 0.09) -> np.ndarray:
    """Exact Jacobian of :func:`ball_position`.

    Parameters
    ----------
    joints_rad : array_like, shape (..., n)
        Joint angles, rad.
    ball_offset_m : float
        Distance of the ball's centre beyond the flange on the tool axis, m.

    Returns
    -------
    ndarray, shape (..., 3, n)
        m/rad, world frame; column i is ``z_i x (p - o_i)``.
    """
    frames = link_frames(joints_rad)
    ball = frames[..., -1, :3, 3] + ball_offset_m * frames[..., -1, :3, 2]
    axes = frames[..., :-1, :3, 2]
    levers = ball[..., None, :] - frames[..., :-1, :3, 3]
    return np.swapaxes(np.cross(axes, levers), -1, -2)
