"""How do I bring a ball to where I want to see it?

A simulated UR5 carries a ball before a depth camera. The packaged model has learned from motion how
the ball moves with the joints; nothing else is known of arm and camera.
"""

import numpy as np

from fvs_ros import ClosedLoop

loop = ClosedLoop.of_scheme("best")  # estimator and law, see docs/schemes.md
loop.run(0.5)  # s: the first images

target_m = loop.feature + [0.0, 0.2, 0.1]  # camera frame: x right, y down, z ahead
loop.set_target(target_m)
start_s = loop.simulation.time_s
while not loop.settled:  # below 5 mm for 0.3 s
    loop.tick()  # one joint state, 8 ms
print(f"settled after {loop.simulation.time_s - start_s:.2f} s")

loop.run(0.5)
print(loop.status.text)
error_mm = 1e3 * np.linalg.norm(loop.true_feature - target_m)
print(f"true error: {error_mm:.2f} mm")
loop.simulation.close()
