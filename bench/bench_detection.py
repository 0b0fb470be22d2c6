"""Accuracy of the ball detection over random poses, and what the detector takes of a core.

``python -m bench detection``; FVS_BENCH_POSES sets how many poses (500).
"""

from __future__ import annotations

import os
from itertools import count

import cv2
import numpy as np

from bench.timing import cpu_s, spread
from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.detection import detect_ball
from fvs_detector_node.detector import Detector
from fvs_ros.camera import CameraModel
from fvs_ros.joints import HOME_JOINTS_RAD, TRAINING_BOX_RAD
from fvs_ros.ros import to_image
from fvs_ros.ros.images import from_color, from_depth
from fvs_sim_node.camera import CAMERAS, add_depth_noise
from fvs_sim_node.config import SimConfig
from fvs_sim_node.world import Renderer, World


def measure(config, poses, noise, seed=0):
    """Rows of (visible fraction, error in mm, time in ms); all NaN where nothing was published."""
    rng = np.random.default_rng(seed)
    world = World(config)
    renderer = Renderer(world.client, config.intrinsics)
    pose = CAMERAS[config.camera]
    rows = np.full((poses, 3), np.nan)
    for i in range(poses):
        world.reset(
            np.add(HOME_JOINTS_RAD, TRAINING_BOX_RAD * rng.uniform(-1.0, 1.0, len(HOME_JOINTS_RAD)))
        )
        world.place_ball()
        rgb, depth = renderer.render(pose)
        depth = add_depth_noise(depth, config.intrinsics.fx, rng, noise)
        images = rgb, depth, config.intrinsics, config.ball_radius_m
        detection = detect_ball(*images)
        elapsed_ms = 1e3 * cpu_s(lambda images=images: detect_ball(*images))[0]
        if detection is not None:
            error_m = detection.position_m - pose.to_camera(world.ball_position())
            rows[i] = detection.visible_fraction, 1e3 * np.linalg.norm(error_m), elapsed_ms
    world.close()
    return rows


def one_image(repeats):
    """Print what a VGA image of the simulator costs: decode colours and depth, track the ball."""
    config = SimConfig()
    world = World(config)
    world.reset(HOME_JOINTS_RAD)
    world.place_ball()
    rgb, depth_m = Renderer(world.client, config.intrinsics).render(CAMERAS[config.camera])
    world.close()
    depth_m = add_depth_noise(depth_m, config.intrinsics.fx, np.random.default_rng(0))
    color = to_image(0.0, "", rgb, "rgb8")
    depth = to_image(0.0, "", np.round(1e3 * depth_m).astype(np.uint16), "16UC1")
    detector, frame, camera = Detector(DetectorConfig()), count(), CameraModel(config.intrinsics)
    spent_s = cpu_s(
        lambda: detector.look(next(frame) / 30, from_color(color), from_depth(depth), camera),
        repeats,
    )
    print(
        f"decode and track, VGA, one thread: {spread(1e3 * np.array(spent_s), 'ms of CPU', 90.0)}"
    )


def main():
    cv2.setNumThreads(1)
    one_image(200)
    poses = int(os.environ.get("FVS_BENCH_POSES", "500"))
    print(f"{poses} poses in box M; error in mm, rms / median / largest; full frames, one thread")
    print(
        f"{'camera':<10}{'image':<9}{'noise':<7}{'published':<11}"
        f"{'full view':<32}{'partly hidden':<32}{'ms':<5}"
    )
    for camera in sorted(CAMERAS, key=lambda name: name != "front"):
        for width, height in ((640, 480), (320, 240)):
            config = SimConfig(camera=camera, image_width=width, image_height=height)
            for noise in (0.0, 1.0):
                rows = measure(config, poses, noise)
                seen = rows[~np.isnan(rows[:, 0])]
                full = seen[:, 0] > 0.97
                cells = [_summary(seen[part, 1]) for part in (full, ~full)]
                print(
                    f"{camera:<10}{f'{width}x{height}':<9}{noise:<7.1f}"
                    f"{f'{len(seen) / poses:.1%}':<11}{cells[0]:<32}{cells[1]:<32}"
                    f"{np.median(seen[:, 2]):<5.2f}",
                    flush=True,
                )


def _summary(errors_mm):
    if not len(errors_mm):
        return "none"
    rms = np.sqrt(np.mean(np.square(errors_mm)))
    return f"{rms:.2f} / {np.median(errors_mm):.2f} / {errors_mm.max():.2f} (n = {len(errors_mm)})"
