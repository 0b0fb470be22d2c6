"""Error of the trained Jacobian against data and method, and the time that training takes.

``python -m bench training``

The error is the relative Frobenius error against the analytic Jacobian on 2,000 joint vectors of
box M that were never trained on. Positions have 1 mm of noise in each coordinate.
"""

from __future__ import annotations

import time

import numpy as np
from recordings import Recording
from ur5_dh import BOX_M_RAD, HOME_RAD

from fvs_estimator_node.files import DataSet
from fvs_estimator_node.training import METHODS, TrainingOptions, train

RECORDING = Recording(seconds=120.0, outliers=0.0, late_s=0.0)


def probes(count=5000, size_rad=0.2):
    """Pairs of near poses all over the box."""
    rng = np.random.default_rng(0)
    middle = HOME_RAD + BOX_M_RAD * rng.uniform(-1.0, 1.0, (count, 6))
    half = 0.5 * rng.uniform(-size_rad, size_rad, middle.shape)
    joints = np.stack([middle - half, middle + half], axis=1).reshape(2 * count, -1)
    ball = RECORDING.chain().position(joints)
    ball += RECORDING.noise_m * rng.standard_normal(ball.shape)
    return DataSet(np.arange(2 * count) / 30.0, joints, ball, np.repeat(np.arange(count), 2))


def main():
    """Print a row for each data set and method."""
    joints = RECORDING.sampled_joints(2000)
    true = RECORDING.chain().jacobian(joints)
    print(f"{'data':24s} {'method':8s} {'Jacobian error':>14s} {'pair error':>12s} {'wall':>9s}")
    sets = {"5000 probes of 0.2 rad": probes(), "motion of 120 s": RECORDING.data()}
    for name, data in sets.items():
        for method in reversed(METHODS):
            if method == "poe" and data.segment.any():  # which needs continuous motion
                continue
            start_s = time.perf_counter()
            trained = train(data, TrainingOptions(method=method))
            wall_s = time.perf_counter() - start_s
            percent = 100.0 * np.linalg.norm(trained.model.jacobian(joints) - true)
            percent /= np.linalg.norm(true)
            pair_mm = 1e3 * trained.errors.get("pair_error_m", np.nan)  # poe has none
            cells = f"{percent:12.2f} % {pair_mm:9.2f} mm {wall_s:7.1f} s"
            print(f"{name:24s} {method:8s} {cells}", flush=True)
