"""Accuracy of the ball detection over 500 random poses, and what the detector takes of a core."""

from __future__ import annotations

import time

import cv2
import numpy as np

from bench.timing import spread
from fvs_detector_node.ball_detector import BallDetector
from fvs_detector_node.config import DetectorConfig
from fvs_ros.camera import CameraModel
from fvs_ros.ros import to_image
from fvs_ros.ros.images import from_color, from_depth
from fvs_sim_node.camera import CAMERAS, add_depth_noise
from fvs_sim_node.config import SimConfig
from fvs_sim_node.robot import HOME_JOINTS_RAD, TRAINING_BOX_RAD
from fvs_sim_node.world import Renderer, World

CONFIG, POSES = SimConfig(), 500
POSE = CAMERAS[CONFIG.camera]


def images(poses):
    """Render noise-free VGA images of the ball at joints near home; its position, m, with each."""
    world = World(CONFIG)
    renderer = Renderer(world.client, CONFIG.lens())
    for offset_rad in poses:
        world.reset(np.add(HOME_JOINTS_RAD, offset_rad))
        world.place_bodies()
        yield *renderer.render(POSE), POSE.to_own(world.carried_position())
    world.close()


def accuracy(noise):
    """Errors, mm, where the ball is in full view, at a factor on the depth camera's noise."""
    rng = np.random.default_rng(0)
    offsets_rad = np.array(TRAINING_BOX_RAD) * rng.uniform(-1, 1, (POSES, len(TRAINING_BOX_RAD)))
    errors_mm, detector = [], BallDetector(DetectorConfig())
    for rgb, depth_m, ball_m in images(offsets_rad):
        measured_m = add_depth_noise(depth_m, CONFIG.lens().fx, rng, noise)
        ball = detector.detect_in(0.0, rgb, measured_m, CONFIG.lens()).detection
        if ball is not None and ball.visible_fraction > 0.97:
            errors_mm.append(1e3 * np.linalg.norm(ball.position_m - ball_m))
    return np.array(errors_mm)


def one_image(repeats):
    """CPU time, ms, of decoding a colour and a depth image and tracking the ball."""
    ((rgb, depth_m, _),) = images([0.0])
    depth_m = add_depth_noise(depth_m, CONFIG.lens().fx, np.random.default_rng(0))
    color = to_image(0.0, "", rgb, "rgb8")
    depth = to_image(0.0, "", np.round(1e3 * depth_m).astype(np.uint16), "16UC1")
    detector, camera = BallDetector(DetectorConfig()), CameraModel(CONFIG.lens())
    spent_ms = []
    for frame in range(repeats):
        begin_s = time.process_time()
        detector.detect(frame / 30, from_color(color), from_depth(depth), camera)
        spent_ms.append(1e3 * (time.process_time() - begin_s))
    return spent_ms


def main():
    cv2.setNumThreads(1)
    print(f"decode and track, VGA, one thread: {spread(one_image(200), 'ms of CPU', 90.0)}")
    for noise, name in ((0.0, "no noise"), (1.0, "a D435's noise")):
        errors_mm = accuracy(noise)
        rms_mm = np.sqrt(np.mean(errors_mm**2))
        print(
            f"error of {POSES} poses in box M, {name}: {rms_mm:.2f} mm rms, {errors_mm.max():.2f} "
            f"at most; in full view {len(errors_mm)}"
        )
