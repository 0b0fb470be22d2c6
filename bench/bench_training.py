"""Error of the trained Jacobian against data and method, and the time that training takes.

python -m bench training [--seeds N]

The error is the relative Frobenius error against the analytic Jacobian on 2,000 joint vectors of
box M that were never trained on. Positions have 1 mm of noise in each coordinate.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from ur5_dh import BOX_M_RAD, HOME_RAD, ball_and_jacobian, jacobian_error, uniform_in_box

from fvs_estimator_node.dataset import DataSet
from fvs_estimator_node.motion import MotionConfig, RandomMotion
from fvs_estimator_node.training import METHODS, TrainingOptions, train

CAMERA_HZ, NOISE_M = 30.0, 1e-3


def data_set(rng, joints, segment):
    """Noisy ball positions at joints, rad, (N, 6)."""
    ball = ball_and_jacobian(joints)[0]
    stamps_s = np.arange(len(joints)) / CAMERA_HZ
    return DataSet(stamps_s, joints, ball + NOISE_M * rng.standard_normal(ball.shape), segment)


def probes(seed, count, size_rad):
    """Pairs of near poses all over the box."""
    rng = np.random.default_rng(seed)
    middle = uniform_in_box(rng, count)
    half = 0.5 * rng.uniform(-size_rad, size_rad, middle.shape)
    joints = np.stack([middle - half, middle + half], axis=1).reshape(2 * count, -1)
    return data_set(rng, joints, np.repeat(np.arange(count), 2))


def motion(seed, duration_s):
    """What the collector records."""
    rng = np.random.default_rng(seed)
    random_motion = RandomMotion(HOME_RAD, MotionConfig(duration_s, tuple(BOX_M_RAD)), rng)
    joints = [HOME_RAD.copy()]
    for k in range(round(duration_s * CAMERA_HZ) - 1):
        joints.append(joints[-1] + random_motion.command(k / CAMERA_HZ, joints[-1]) / CAMERA_HZ)
    return data_set(rng, np.array(joints), np.zeros(len(joints), dtype=int))


DATA = {
    "5000 probes of 0.2 rad": lambda seed: probes(seed, 5000, 0.2),
    "1000 probes of 0.2 rad": lambda seed: probes(seed, 1000, 0.2),
    "motion of 120 s": lambda seed: motion(seed, 120.0),
    "motion of 400 s": lambda seed: motion(seed, 400.0),
}


def main():
    """Print a row for each data set and method: medians over the seeds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1)
    seeds = parser.parse_args().seeds
    print(f"{'data':24s} {'method':8s} {'Jacobian error':>14s} {'pair error':>12s} {'wall':>9s}")
    for name, make in DATA.items():
        for method in reversed(METHODS):
            rows = []
            for seed in range(seeds):
                data = make(seed)
                start_s = time.perf_counter()
                trained = train(data, TrainingOptions(method=method))
                wall_s = time.perf_counter() - start_s
                error = jacobian_error(trained.model.jacobian)
                rows.append((100.0 * error, 1e3 * trained.errors["pair_error_m"], wall_s))
            percent, pair_mm, wall_s = np.median(rows, axis=0)
            print(
                f"{name:24s} {method:8s} {percent:12.2f} % {pair_mm:9.2f} mm {wall_s:7.1f} s",
                flush=True,
            )
