"""What the residual of a fitted chain tells of a wrong prior, and what it does not.

python bench/bench_misfit.py [--seeds N] [--along M] [--across M]

Minutes of the collector's motion, noisier along the line of sight than across, are told with two
joints' names swapped, or with one that counts wrongly; the truth judges the chain.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from fvs_estimator_node.chain_fit import fit_chain  # noqa: E402
from fvs_estimator_node.dataset import DataSet  # noqa: E402
from fvs_ros.apps.experiments.beyond_minute import (  # noqa: E402
    MINUTE_S,
    Minute,
    draw_places,
    record,
    relative_errors,
)
from fvs_ros.apps.experiments.trials import Conditions, simulation_of  # noqa: E402
from fvs_ros.core.joints import N_JOINTS  # noqa: E402

_PLACES = 200


def _swapped(one: int, other: int) -> np.ndarray:
    """Joints as told over joints as they are, (6, 6): the names of two (from 1) swapped."""
    matrix = np.eye(N_JOINTS)
    matrix[[one - 1, other - 1]] = matrix[[other - 1, one - 1]]
    return matrix


def _scaled(joint: int, scale: float) -> np.ndarray:
    """Joints as told over joints as they are, (6, 6): one (from 1) counts wrongly."""
    matrix = np.eye(N_JOINTS)
    matrix[joint - 1, joint - 1] = scale
    return matrix


TOLD = {
    "as it is": np.eye(N_JOINTS),
    "joints 4 and 5 swapped": _swapped(4, 5),
    "joints 2 and 3 swapped": _swapped(2, 3),
    "joint 3 times 1.05": _scaled(3, 1.05),
    "joint 3 times 1.1": _scaled(3, 1.1),
    "joint 3 times 1.2": _scaled(3, 1.2),
    "joint 3 times 2": _scaled(3, 2.0),
}


def _noisy(data: DataSet, along_m: float, across_m: float, seed: int) -> DataSet:
    rays = data.ball_m / np.linalg.norm(data.ball_m, axis=1, keepdims=True)
    noise_m = across_m * np.random.default_rng(seed).standard_normal(data.ball_m.shape)
    depth_m = (noise_m * rays).sum(axis=1, keepdims=True)
    return replace(data, ball_m=data.ball_m + noise_m + (along_m / across_m - 1.0) * depth_m * rays)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--along", type=float, default=0.003, help="noise along the ray, m")
    parser.add_argument("--across", type=float, default=0.0007, help="and across it, m")
    arguments = parser.parse_args()
    silent = Conditions(rendered=False, position_noise_m=0.0)
    places = draw_places(0, _PLACES)
    simulation = simulation_of(silent)
    true = np.array([simulation.true_jacobian(one) for one in places.box_rad])
    minutes = [
        _noisy(
            record(Minute(seed, MINUTE_S, silent, places))[0],
            arguments.along,
            arguments.across,
            seed,
        )
        for seed in range(arguments.seeds)
    ]
    print(f"{'told':24s} {'misfit':>23s}  {'Jacobian off by, %':>23s}  noticed")
    for name, told in TOLD.items():
        fits = [fit_chain(replace(one, joints_rad=one.joints_rad @ told.T)) for one in minutes]
        wanted = true @ np.linalg.inv(told)
        found = [fit.chain.jacobian(places.box_rad @ told.T) for fit in fits]
        off = [100.0 * float(np.median(relative_errors(one, wanted))) for one in found]
        print(
            f"{name:24s} {' '.join(f'{fit.misfit:5.2f}' for fit in fits):>23s}  "
            f"{' '.join(f'{one:5.2f}' for one in off):>23s}  "
            f"{sum(not fit.is_chain for fit in fits)} of {len(fits)}",
            flush=True,
        )


if __name__ == "__main__":
    main()
