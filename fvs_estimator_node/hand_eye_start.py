"""Where the URDF's arm is in still poses, which are too few to fit a chain of their own to."""

from __future__ import annotations

import numpy as np

from fvs_estimator_node.calibration import CalibrationError
from fvs_estimator_node.chain_chart import Chart
from fvs_estimator_node.chain_fit import ChainFit, noise_by_direction
from fvs_estimator_node.files import DataSet
from fvs_ros.chain import SerialChain
from fvs_ros.rotations import nearest_rotation
from fvs_ros.urdf import Kinematics


def still_fit(data: DataSet, arm: Kinematics) -> ChainFit:
    """The arm as it is in the URDF, where it is nearest to still poses.

    Raises a ``CalibrationError`` if there are too few of them.
    """
    size = data.ball_m.shape[1]
    least = 2 * (12 + size) // size  # twice as many equations as unknowns
    if len(data) < least:
        raise CalibrationError(
            f"there are {len(data)} still poses, expected at least {least}; or move the arm for a "
            "minute"
        )
    chain = registered(data, arm)
    weights = data.kind.weights
    off_m = weights * (chain.position(data.joints_rad) - data.ball_m)
    residual_m = float(np.median(np.linalg.norm(off_m[:, :3], axis=1)))
    ray_noise_m, lateral_noise_m = noise_by_direction(off_m[:, :3], data.ball_m)
    coordinates = Chart(chain).size
    return ChainFit(
        chain=chain,
        weights=weights,
        time_offset_s=0.0,
        time_offset_deviation_s=np.inf,
        residual_m=residual_m,
        noise_m=residual_m,
        ray_noise_m=ray_noise_m,
        lateral_noise_m=lateral_noise_m,
        outliers=0,
        samples=len(data),
        covariance=np.eye(coordinates),
        unfitted=np.zeros((coordinates, coordinates)),
    )


def registered(data: DataSet, arm: Kinematics) -> SerialChain:
    """The arm in the camera's frame with what it carries, by linear least squares.

    In the root's frame and with vectors as rows, what is seen at x and carried at c of the tip is
    at ``x R + s = f + c T``, linear in R, s and c; the nearest rotation of R fixes the others.
    """
    turns, places_m = arm.tip_at(data.joints_rad)  # T and f
    seen = data.ball_m.reshape(len(data), -1, 3)  # a point, and directions, without s and f
    slopes = np.zeros((*seen.shape, 12 + seen[0].size))
    slopes[..., :9] = np.einsum("kjm,de->kjdme", seen, np.eye(3)).reshape(*seen.shape, 9)
    slopes[:, 0, :, 9:12] = np.eye(3)
    for j, one in enumerate(range(12, slopes.shape[-1], 3)):
        slopes[:, j, :, one : one + 3] = -np.swapaxes(turns, 1, 2)
    rows, wanted = slopes.reshape(seen.size, -1), np.zeros(seen.shape)
    wanted[:, 0] = places_m
    flat = wanted.ravel()
    rotation = nearest_rotation(np.linalg.lstsq(rows, flat, rcond=None)[0][:9].reshape(3, 3))
    rest = np.linalg.lstsq(rows[:, 9:], flat - rows[:, :9] @ rotation.ravel(), rcond=None)[0]
    carried = rest[3:].reshape(-1, 3) @ arm.tip_rotation.T
    carried[0] += arm.tip_m
    return arm.chain(carried.ravel()).moved(rotation, -rotation @ rest[:3])
