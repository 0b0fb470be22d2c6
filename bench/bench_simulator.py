"""How many times faster than real time the simulator runs on one core.

``taskset -c 0 python -m bench simulator``
"""

from __future__ import annotations

import time

import numpy as np

from fvs_ros.joints import TRAINING_BOX_RAD
from fvs_sim_node.simulation import SimConfig, Simulation


def measure(config, simulated_s=20.0, full_frames=False):
    """Speed, share of images with a ball, and error, over smooth motion inside box M."""
    with Simulation(config) as simulation:
        simulation.full_frames = full_frames
        # Sines of these amplitudes keep the joints inside the box.
        amplitude = np.array(TRAINING_BOX_RAD)
        rate = 2 * np.pi * np.array([0.11, 0.13, 0.17, 0.19, 0.23, 0.29])
        periods = round(simulated_s * config.joint_state_rate_hz)
        errors, images = [], 0
        wall, cpu = time.perf_counter(), time.process_time()
        for k in range(periods):
            angle = rate * k / config.joint_state_rate_hz
            simulation.command(amplitude * rate * np.cos(angle))
            for seen in simulation.advance().observations:
                images += 1
                if seen.detection is not None:
                    errors.append(np.linalg.norm(seen.detection.position_m - seen.true_position_m))
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    rms_mm = 1e3 * np.sqrt(np.mean(np.square(errors)))
    return (
        f"{simulated_s / wall:6.1f} x by wall clock, {simulated_s / cpu:6.1f} x by CPU time; "
        f"ball in {len(errors) / images:.0%} of {images} images, {rms_mm:.2f} mm rms"
    )


def main():
    cases = {
        "VGA, 30 Hz (default)": (SimConfig(), False),
        "VGA, 60 Hz": (SimConfig(image_rate_hz=60.0), False),
        "VGA, 30 Hz, overhead": (SimConfig(camera="overhead"), False),
        "320x240, 30 Hz": (SimConfig(image_width=320, image_height=240), False),
        "VGA, 30 Hz, whole frames": (SimConfig(), True),
        "320x240, 30 Hz, whole frames": (SimConfig(image_width=320, image_height=240), True),
    }
    print("physics at 500 Hz, joint states at 125 Hz, rendered and detected images")
    for name, (config, full_frames) in cases.items():
        print(f"{name:<30}{measure(config, full_frames=full_frames)}", flush=True)
