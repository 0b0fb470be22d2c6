"""Accuracy of the ball detection over random poses, and what each step of the detector takes.

``python -m bench detection``; FVS_BENCH_POSES sets how many poses (500).
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable

import cv2
import numpy as np
from sensor_msgs.msg import CompressedImage

from bench.timing import cpu_s
from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.detection import BallColour, detect_ball
from fvs_detector_node.detector import Detector, diagnose
from fvs_detector_node.images import Rectifier, Region
from fvs_detector_node.tracking import WindowTracker
from fvs_ros.camera import CameraModel
from fvs_ros.joints import HOME_JOINTS_RAD, TRAINING_BOX_RAD
from fvs_ros.ros import to_image
from fvs_ros.ros.images import from_color, from_depth
from fvs_sim_node.camera import CAMERAS, add_depth_noise
from fvs_sim_node.config import SimConfig
from fvs_sim_node.world import Renderer, World

FULL_VIEW = 0.97


def measure(config: SimConfig, poses: int, noise: float, seed: int = 0) -> np.ndarray:
    """Rows of (visible fraction, error in mm, time in ms); all NaN where nothing was published."""
    rng = np.random.default_rng(seed)
    world = World(config)
    renderer = Renderer(world.client, config.intrinsics)
    pose = CAMERAS[config.camera]
    rows = np.full((poses, 3), np.nan)
    for i in range(poses):
        world.reset(np.add(HOME_JOINTS_RAD, TRAINING_BOX_RAD * rng.uniform(-1.0, 1.0, 6)))
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


def steps(repeats: int) -> None:
    """Print what each step of ``fvs_detector_node`` takes on one VGA image of the simulator."""
    config = SimConfig()
    world = World(config)
    world.reset(HOME_JOINTS_RAD)
    world.place_ball()
    rgb, depth = Renderer(world.client, config.intrinsics).render(CAMERAS[config.camera])
    world.close()
    depth = add_depth_noise(depth, config.intrinsics.fx, np.random.default_rng(0))
    camera, radius_m = config.intrinsics, config.ball_radius_m
    found = detect_ball(rgb, depth, camera, radius_m)
    assert found is not None
    tracker = WindowTracker(camera, radius_m)
    tracker.update(0.0, found)
    window = tracker.region(0.0)
    assert window is not None
    part, view = window.part, window.view(camera)

    lens = (-0.055, 0.066, 0.0003, 0.0007, -0.021)  # of a RealSense D455's colour camera
    rectifier = Rectifier(CameraModel(camera, "plumb_bob", lens))
    whole = Region.whole(camera)
    millimetres = np.round(1e3 * depth).astype(np.uint16)
    raw_rgb, raw_bgr = (to_image(0.0, "", rgb, encoding) for encoding in ("rgb8", "bgr8"))
    raw_mm, raw_m = to_image(0.0, "", millimetres, "16UC1"), to_image(0.0, "", depth, "32FC1")
    jpeg = CompressedImage(format="jpeg", data=cv2.imencode(".jpg", rgb[..., ::-1])[1].tobytes())
    png = CompressedImage(format="16UC1; compressedDepth png")
    png.data = struct.pack("<iff", 0, 0.0, 0.0) + cv2.imencode(".png", millimetres)[1].tobytes()
    detector = Detector(DetectorConfig(max_ball_speed_m_s=100.0))
    clock_s = iter(range(10**9))

    def one_image() -> None:
        images = from_color(raw_rgb), from_depth(raw_mm)
        detector.look(next(clock_s) / 30, *images, CameraModel(camera))

    rows: dict[str, Callable[[], object]] = {
        "decode rgb8": lambda: from_color(raw_rgb),
        "decode bgr8": lambda: from_color(raw_bgr),
        "decode 16UC1": lambda: from_depth(raw_mm),
        "decode 32FC1": lambda: from_depth(raw_m),
        "decode jpeg": lambda: from_color(jpeg),
        "decode compressedDepth": lambda: from_depth(png),
        "rectify whole image": lambda: rectifier.cut(rgb, depth, whole),
        "rectify window": lambda: rectifier.cut(rgb, depth, window),
        "search whole image": lambda: detect_ball(rgb, depth, camera, radius_m),
        "search window": lambda: detect_ball(rgb[part], depth[part], view, radius_m),
        "explain a lost ball": lambda: diagnose(rgb, depth, camera, 0.07, BallColour()),
        "one image, raw, tracked": one_image,
    }
    print(f"one step on VGA, {repeats} times, one thread; ms of CPU, median / 90 %")
    for name, step in rows.items():
        median, most = np.percentile(1e3 * np.array(cpu_s(step, repeats)), (50, 90))
        print(f"{name:<26}{median:6.2f} / {most:.2f}", flush=True)


def main() -> None:
    cv2.setNumThreads(1)
    steps(200)
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
