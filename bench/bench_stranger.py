"""Robots and cameras never seen: what two minutes of motion teach, and how the ball then arrives.

python bench/bench_stranger.py [--seeds N] [--method varpro|ridge]

Each seed is another robot (six random axes) behind another camera: 1 mm of noise on every
coordinate, 30 ms of latency, 20 ms of joint lag, joint states at 125 or 250 Hz. The truth judges.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "test")]

from stranger import Stranger, StrangerConfig  # noqa: E402
from stranger_trial import collect, draw_targets, jacobian_error, servo  # noqa: E402

from fvs_estimator_node.training import METHODS, TrainingOptions, train  # noqa: E402


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--method", choices=METHODS, default=METHODS[0])
    arguments = parser.parse_args()
    print("seed  Hz   train  Jacobian  settled to 5 mm: median, most    rms: median, most  not")
    settled, rms, never = [], [], 0
    for seed in range(arguments.seeds):
        rate_hz = (125.0, 250.0)[seed % 2]
        stranger = Stranger(StrangerConfig(seed=seed, joint_state_rate_hz=rate_hz))
        data = collect(stranger, 120.0)
        start_s = time.monotonic()
        model = train(data, TrainingOptions(method=arguments.method)).trained.model
        train_s = time.monotonic() - start_s
        rng = np.random.default_rng(seed)
        error = jacobian_error(model, stranger, rng)
        arrivals = servo(stranger, model, draw_targets(stranger, rng))
        times = [a.settled_s for a in arrivals]
        finals = [1e3 * a.final_rms_m for a in arrivals]
        missed = int(np.isinf(times).sum())
        print(
            f"{seed:4d} {rate_hz:4.0f} {train_s:6.1f}s {100 * error:8.2f}% "
            f"{np.median(times):18.2f} s {max(times):6.2f} s "
            f"{np.median(finals):11.2f} mm {max(finals):5.2f} mm {missed:4d}",
            flush=True,
        )
        settled += times
        rms += finals
        never += missed
    print(
        f"all  {len(settled)} targets: {np.median(settled):.2f} s, {max(settled):.2f} s at most; "
        f"{np.median(rms):.2f} mm rms, {max(rms):.2f} mm at most; {never} not settled"
    )


if __name__ == "__main__":
    main()
