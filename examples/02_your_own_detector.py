"""How do I use my own detector?

Give `see` what the detector found and when its image was exposed, on the joints' clock. The images
may be late: the servo pairs them with the joints at their exposure and predicts to now. A constant
bias, such as the depth of a ball's front instead of its middle, does not matter.
"""

import numpy as np

from fvs_ros import Servo, SimConfig, Simulation


def find_ball(frame, lens):
    """Middle of the red pixels, camera frame, m; None if too few are red."""
    colours, depths_m = frame
    red, green, blue = np.moveaxis(colours.astype(int), -1, 0)
    v, u = np.nonzero((red > 80) & (red > 3 * np.maximum(green, blue)) & (depths_m > 0.0))
    if len(u) < 50:
        return None
    ahead_m = np.median(depths_m[v, u])
    return ahead_m * np.array([(u.mean() - lens.cx) / lens.fx, (v.mean() - lens.cy) / lens.fy, 1.0])


simulation = Simulation(SimConfig(image_width=320, image_height=240, rendered=False))
simulation.full_frames = True  # stands in for a camera: colours and depths, 40 ms late
servo = Servo.load("models/ur5_front.npz", "best", urdf="robots/ur5.urdf")


def run(seconds):
    """Let the simulated arm and camera run for some time."""
    for _ in range(round(125 * seconds)):
        arm = simulation.advance()
        for image in arm.observations:
            servo.see(image.stamp_s, find_ball(image.frame, simulation.views[0].lens))
        servo.observe(arm.time_s, arm.joints_rad)
        simulation.command(servo.command())


run(0.4)
before_m, wanted_m = simulation.true_feature(), np.array([0.1, 0.1, 0.0])
servo.set_target(servo.feature + wanted_m)
run(1.6)
moved_m = simulation.true_feature() - before_m
print(servo.status.text)
print(f"the ball moved by {np.round(1e3 * moved_m, 1)} mm, wanted {1e3 * wanted_m} mm")
simulation.close()
