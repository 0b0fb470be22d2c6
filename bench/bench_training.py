"""Error of the trained Jacobian against data and method, and the time that training takes.

``python -m bench training``

The error is the relative Frobenius error against the analytic Jacobian on 2,000 joint vectors of
box M that were never trained on. Positions have 1 mm of noise in each coordinate.
"""

from __future__ import annotations

import time

import numpy as np
from ur5_dh import BOX_M_RAD, HOME_RAD, ball_and_jacobian, jacobian_error, uniform_in_box

from fvs_estimator_node.files import DataSet
from fvs_estimator_node.motion import MotionConfig, RandomMotion
from fvs_estimator_node.training import METHODS, TrainingOptions, train

CAMERA_HZ, NOISE_M = 30.0, 1e-3


def data_set(rng, joints, segment):
    """Noisy ball positions at joints, rad, (N, 6)."""
    ball = ball_and_jacobian(joints)[0]
    stamps_s = np.arange(len(joints)) / CAMERA_HZ
    return DataSet(stamps_s, joints, ball + NOISE_M * rng.standard_normal(ball.shape), segment)


def probes(rng, count=5000, size_rad=0.2):
    """Pairs of near poses all over the box."""
    middle = uniform_in_box(rng, count)
    half = 0.5 * rng.uniform(-size_rad, size_rad, middle.shape)
    joints = np.stack([middle - half, middle + half], axis=1).reshape(2 * count, -1)
    return data_set(rng, joints, np.repeat(np.arange(count), 2))


def motion(rng, duration_s=120.0):
    """What the collector records."""
    random_motion = RandomMotion(
        HOME_RAD, MotionConfig(duration_s=duration_s, joint_range_rad=tuple(BOX_M_RAD)), rng
    )
    joints = [HOME_RAD.copy()]
    for k in range(round(duration_s * CAMERA_HZ) - 1):
        joints.append(joints[-1] + random_motion.command(k / CAMERA_HZ, joints[-1]) / CAMERA_HZ)
    return data_set(rng, np.array(joints), np.zeros(len(joints), dtype=int))


def main():
    """Print a row for each data set and method."""
    print(f"{'data':24s} {'method':8s} {'Jacobian error':>14s} {'pair error':>12s} {'wall':>9s}")
    for name, make in {"5000 probes of 0.2 rad": probes, "motion of 120 s": motion}.items():
        data = make(np.random.default_rng(0))
        for method in reversed(METHODS):
            start_s = time.perf_counter()
            trained = train(data, TrainingOptions(method=method))
            wall_s = time.perf_counter() - start_s
            percent = 100.0 * jacobian_error(trained.model.jacobian)
            pair_mm = 1e3 * trained.errors.get("pair_error_m", np.nan)  # poe has none
            cells = f"{percent:12.2f} % {pair_mm:9.2f} mm {wall_s:7.1f} s"
            print(f"{name:24s} {method:8s} {cells}", flush=True)
