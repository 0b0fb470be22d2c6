"""How many times faster than real time the simulator runs on one core.

``taskset -c 0 python -m bench simulator``
"""

from __future__ import annotations

import time

import numpy as np

from fvs_sim_node.robot import TRAINING_BOX_RAD
from fvs_sim_node.simulation import Simulation

SIMULATED_S = 20.0


def main():
    """Print speed, share of images with a ball, and error, over smooth motion inside box M."""
    with Simulation() as simulation:
        # Sines of these amplitudes keep the joints inside the box.
        amplitude = np.array(TRAINING_BOX_RAD)
        rate = 2 * np.pi * np.linspace(0.11, 0.29, amplitude.size)
        rate_hz = simulation.config.joint_state_rate_hz
        errors, images = [], 0
        wall, cpu = time.perf_counter(), time.process_time()
        for k in range(round(SIMULATED_S * rate_hz)):
            simulation.command(amplitude * rate * np.cos(rate * k / rate_hz))
            for seen in simulation.advance().observations:
                images += 1
                if seen.z is not None:
                    errors.append(np.linalg.norm(seen.z - seen.true_position_m))
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    rms_mm = 1e3 * np.sqrt(np.mean(np.square(errors)))
    print("physics at 500 Hz, joint states at 125 Hz, VGA images rendered and detected at 30 Hz")
    print(
        f"{SIMULATED_S / wall:.1f} x by wall clock, {SIMULATED_S / cpu:.1f} x by CPU time; "
        f"ball in {len(errors) / images:.0%} of {images} images, {rms_mm:.2f} mm rms"
    )
