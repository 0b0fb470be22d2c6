"""The demo again and again, in real time over DDS, each run with its own seed.

Run ``python -m bench demo`` from the repository root; FVS_BENCH_RUNS sets how many (5).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
RUNS = int(os.environ.get("FVS_BENCH_RUNS", "5"))


def run_demo(seed: int, folder: Path) -> list[dict]:
    """Scores of one run's targets."""
    subprocess.run(
        [
            *(sys.executable, "-m", "fvs_tools.launcher", "demo"),
            *("-p", f"seed:={seed}", "-p", f"output_dir:={folder}"),
        ],
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        check=False,
    )
    return json.loads((folder / "results.json").read_text(encoding="utf-8"))


def spread(values: list[float], unit: str) -> str:
    return f"{np.median(values):6.2f} {unit} median {max(values):8.2f} {unit} at most"


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        targets = [t for seed in range(1, RUNS + 1) for t in run_demo(seed, Path(name) / str(seed))]
    settled = [t for t in targets if t["settling_5mm_s"] is not None]
    fine = [t["settling_2mm_s"] for t in targets if t["settling_2mm_s"] is not None]
    print(f"{RUNS} runs, {len(targets)} targets, {len(settled)} settled")
    print(f"start distance     {spread([1e3 * t['start_distance_m'] for t in targets], 'mm')}")
    print(f"settling to 5 mm   {spread([t['settling_5mm_s'] for t in settled], 's')}")
    print(f"settling to 2 mm   {spread(fine, 's')}   ({len(fine)} of {len(targets)})")
    print(f"final true error   {spread([1e3 * t['final_rms_m'] for t in targets], 'mm')} (rms)")
    peak = [t["peak_joint_speed_rad_s"] for t in targets]
    print(f"peak joint speed   {spread(peak, 'rad/s')}")


if __name__ == "__main__":
    main()
