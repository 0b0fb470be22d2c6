"""The demo again and again, in real time over DDS, each run with its own seed.

``python -m bench demo``; FVS_BENCH_RUNS sets how many runs (5).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from bench import ROOT
from bench.timing import spread


def run_demo(seed, folder):
    """Scores of one run's targets."""
    parameters = ("-p", f"seed:={seed}", "-p", f"output_dir:={folder}")
    subprocess.run(
        (sys.executable, "-m", "fvs_tools.launcher", "demo", *parameters),
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        check=False,
    )
    return json.loads((folder / "results.json").read_text(encoding="utf-8"))


def main():
    runs = int(os.environ.get("FVS_BENCH_RUNS", "5"))
    with tempfile.TemporaryDirectory() as name:
        targets = [t for seed in range(1, runs + 1) for t in run_demo(seed, Path(name) / str(seed))]
    settled = sum(target["settling_5mm_s"] is not None for target in targets)
    print(f"{runs} runs, {len(targets)} targets, {settled} settled")
    for name, key, scale, unit in (
        ("start distance", "start_distance_m", 1e3, "mm"),
        ("settling to 5 mm", "settling_5mm_s", 1.0, "s"),
        ("settling to 2 mm", "settling_2mm_s", 1.0, "s"),
        ("final true error (rms)", "final_rms_m", 1e3, "mm"),
        ("peak joint speed", "peak_joint_speed_rad_s", 1.0, "rad/s"),
    ):
        values = [scale * target[key] for target in targets if target[key] is not None]
        print(f"{name:24}{spread(values, unit, 100.0)}")
