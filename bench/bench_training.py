"""Error of the trained Jacobian against data, method and seconds; and microseconds online.

python bench/bench_training.py [--seeds N] [--quick]

The error is the relative Frobenius error against the analytic Jacobian on 2,000 joint vectors of
box M that were never trained on. Positions have 1 mm of noise in each coordinate.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "test")]

from ur5_dh import (  # noqa: E402
    BOX_M_RAD,
    HOME_RAD,
    ball_and_jacobian,
    jacobian_error,
    uniform_in_box,
)

from fvs_estimator_node.base import MotionStep  # noqa: E402
from fvs_estimator_node.dataset import DataSet  # noqa: E402
from fvs_estimator_node.motion import MotionConfig, RandomMotion  # noqa: E402
from fvs_estimator_node.rbf import FrozenRbfEstimator, RbfEstimator, RbfModel  # noqa: E402
from fvs_estimator_node.training import METHODS, TrainingOptions, train  # noqa: E402

CAMERA_HZ, NOISE_M = 30.0, 1e-3


def data_set(rng: np.random.Generator, joints: np.ndarray, segment: np.ndarray) -> DataSet:
    ball = ball_and_jacobian(joints)[0] + NOISE_M * rng.standard_normal((len(joints), 3))
    return DataSet(np.arange(len(joints)) / CAMERA_HZ, joints, ball, segment)


def probes(seed: int, count: int, size_rad: float) -> DataSet:
    rng = np.random.default_rng(seed)
    middle = uniform_in_box(rng, count)
    half = 0.5 * rng.uniform(-size_rad, size_rad, (count, 6))
    joints = np.stack([middle - half, middle + half], axis=1).reshape(-1, 6)
    return data_set(rng, joints, np.repeat(np.arange(count), 2))


def collected(seed: int, duration_s: float) -> DataSet:
    rng = np.random.default_rng(seed)
    motion = RandomMotion(HOME_RAD, MotionConfig(duration_s, tuple(BOX_M_RAD)), rng)
    joints, now = [], HOME_RAD.copy()
    for k in range(round(duration_s * CAMERA_HZ)):
        joints.append(now)
        now = now + motion.command(k / CAMERA_HZ, now) / CAMERA_HZ
    return data_set(rng, np.array(joints), np.zeros(len(joints), dtype=int))


DATA: dict[str, Callable[[int], DataSet]] = {
    "5000 probes of 0.1 rad": lambda seed: probes(seed, 5000, 0.1),
    "5000 probes of 0.2 rad": lambda seed: probes(seed, 5000, 0.2),
    "1000 probes of 0.2 rad": lambda seed: probes(seed, 1000, 0.2),
    "motion of 60 s": lambda seed: collected(seed, 60.0),
    "motion of 120 s": lambda seed: collected(seed, 120.0),
    "motion of 200 s": lambda seed: collected(seed, 200.0),
    "motion of 400 s": lambda seed: collected(seed, 400.0),
}


def table(names: list[str], seeds: int) -> None:
    print(f"{'data':24s} {'method':8s} {'Jacobian error':>14s} {'of seeds':>15s} "
          f"{'pair error':>11s} {'wall':>7s} {'CPU':>7s}")  # fmt: skip
    for name in names:
        for method in reversed(METHODS):
            errors, pair_mm, wall, cpu = [], [], [], []
            for seed in range(seeds):
                data = DATA[name](seed)
                start_wall, start_cpu = time.perf_counter(), time.process_time()
                result = train(data, TrainingOptions(method=method))
                wall.append(time.perf_counter() - start_wall)
                cpu.append(time.process_time() - start_cpu)
                errors.append(100.0 * jacobian_error(result.trained.model.jacobian))
                pair_mm.append(1e3 * result.pair_error_m)
            print(f"{name:24s} {method:8s} {np.median(errors):12.2f} % "
                  f"{min(errors):5.2f} .. {max(errors):5.2f} {np.median(pair_mm):8.2f} mm "
                  f"{np.median(wall):5.1f} s {np.median(cpu):5.1f} s", flush=True)  # fmt: skip


def microseconds(call: Callable[[], object], times: int = 2000) -> float:
    spent = []
    for _ in range(times):
        begin = time.perf_counter()
        call()
        spent.append(time.perf_counter() - begin)
    return 1e6 * float(np.median(spent))


def online(neurons: int = 50) -> None:
    rng = np.random.default_rng(0)
    model = RbfModel(
        uniform_in_box(rng, 6 * neurons).reshape(6, neurons, 6),
        np.full((6, neurons), 2.07),
        rng.normal(size=(6, 3, neurons)),
    )
    joints = HOME_RAD + 0.1
    step = MotionStep(1.0, 0.04, joints, np.full(6, 0.01), np.full(3, 0.003))
    learning, frozen = RbfEstimator(model), FrozenRbfEstimator(model)
    print(f"\n{neurons} neurons: jacobian {microseconds(lambda: frozen.jacobian(joints)):.1f} us, "
          f"update {microseconds(lambda: learning.update(step)):.1f} us (median)")  # fmt: skip


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="two data sets only")
    options = parser.parse_args([] if arguments is None else arguments)
    names = ["5000 probes of 0.2 rad", "motion of 120 s"] if options.quick else list(DATA)
    table(names, options.seeds)
    online()


if __name__ == "__main__":
    main(sys.argv[1:])
