"""Accuracy of the ball detection over random poses.

Run ``python bench/bench_detection.py [poses]`` from the repository root.
"""

from __future__ import annotations

import sys
import time

import cv2
import numpy as np

from fvs_ros.core.detection import detect_ball
from fvs_sim_node.depth_noise import add_depth_noise
from fvs_sim_node.rendering import CAMERA_PRESETS, Renderer, camera_preset
from fvs_sim_node.simulation import SimConfig
from fvs_sim_node.world import World

CENTRE = np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0])
HALF_BOX = np.array([0.6, 0.5, 0.5, 0.5, 0.5, 0.5])
FULL_VIEW = 0.97


def measure(config: SimConfig, poses: int, noise: float, seed: int = 0) -> np.ndarray:
    """Rows of (visible fraction, error in mm, time in ms); all NaN where nothing was published."""
    rng = np.random.default_rng(seed)
    world = World(ball_radius_m=config.ball_radius_m, ball_offset_m=config.ball_offset_m)
    renderer = Renderer(world.client, config.intrinsics)
    pose = camera_preset(config.camera)
    rows = np.full((poses, 3), np.nan)
    for i in range(poses):
        world.reset(CENTRE + HALF_BOX * rng.uniform(-1.0, 1.0, 6))
        world.place_ball()
        rgb, depth = renderer.render(pose)
        depth = add_depth_noise(depth, config.intrinsics.fx, rng, noise)
        start = time.process_time()
        detection = detect_ball(rgb, depth, config.intrinsics, config.ball_radius_m)
        elapsed_ms = 1e3 * (time.process_time() - start)
        if detection is not None:
            error_m = detection.position_m - pose.to_camera(world.ball_position())
            rows[i] = detection.visible_fraction, 1e3 * np.linalg.norm(error_m), elapsed_ms
    world.close()
    return rows


def main() -> None:
    cv2.setNumThreads(1)
    poses = int(sys.argv[1]) if len(sys.argv) > 1 else 500
    print(f"{poses} poses in box M; error in mm, rms / median / largest; full frames, one thread")
    print(
        f"{'camera':<10}{'image':<9}{'noise':<7}{'published':<11}"
        f"{'full view':<32}{'partly hidden':<32}{'ms':<5}"
    )
    for camera in sorted(CAMERA_PRESETS, key=lambda name: name != "front"):
        for width, height in ((640, 480), (320, 240)):
            config = SimConfig(camera=camera, image_width=width, image_height=height)
            for noise in (0.0, 1.0):
                rows = measure(config, poses, noise)
                seen = rows[~np.isnan(rows[:, 0])]
                full = seen[:, 0] > FULL_VIEW
                cells = [_summary(seen[part, 1]) for part in (full, ~full)]
                print(
                    f"{camera:<10}{f'{width}x{height}':<9}{noise:<7.1f}"
                    f"{f'{len(seen) / poses:.1%}':<11}{cells[0]:<32}{cells[1]:<32}"
                    f"{np.median(seen[:, 2]):<5.2f}",
                    flush=True,
                )


def _summary(errors_mm: np.ndarray) -> str:
    if not len(errors_mm):
        return "none"
    rms = np.sqrt(np.mean(np.square(errors_mm)))
    return f"{rms:.2f} / {np.median(errors_mm):.2f} / {errors_mm.max():.2f} (n = {len(errors_mm)})"


if __name__ == "__main__":
    main()
