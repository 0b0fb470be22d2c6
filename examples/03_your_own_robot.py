"""How do I servo a robot of my own, without ROS?

In each period: read the joints, `observe`, send `command`. It is limited already: speed,
acceleration, ends of joints. When joints or images stop coming, the command ramps to zero, and
`status` says why. Whatever ends the program, stop the arm.
"""

import numpy as np

from fvs_ros import Servo, SimConfig, Simulation


class MyRobot:
    """Stands in for your driver and your detector."""

    def __init__(self):
        self.simulation = Simulation(SimConfig(rendered=False, position_noise_m=0.001))

    def read(self):
        """Time, s, joints, rad, and what the camera has found since: exposures, s, and z, m."""
        arm = self.simulation.advance()
        return arm.time_s, arm.joints_rad, [(each.stamp_s, each.z) for each in arm.observations]

    def send(self, velocity_rad_s):
        """Command the joints until the next command."""
        self.simulation.command(velocity_rad_s)


def servo_to(robot, servo, wanted_m, most_s):
    """Move the ball by so much as the camera sees it; returns why it ended."""
    end_s = np.inf
    try:
        while True:
            now_s, joints_rad, images = robot.read()
            for exposed_s, ball_m in images:
                servo.see(exposed_s, ball_m)
            servo.observe(now_s, joints_rad)
            robot.send(servo.command())
            if np.isinf(end_s) and servo.feature is not None:
                servo.set_target(servo.feature + wanted_m)
                end_s = now_s + most_s
            if servo.settled or now_s > end_s:
                return servo.status.text
    finally:
        robot.send(np.zeros(6))


servo = Servo.load(
    "models/ur5_front.npz",  # yours: fvs_train DATA -o MODEL --method poe
    urdf="robots/ur5.urdf",  # the joints' limits
    max_joint_velocity_rad_s=0.5,
)
robot = MyRobot()
print(servo_to(robot, servo, [0.0, 0.1, 0.1], most_s=5.0))
print("Jacobian, m/rad, at zero:", np.round(servo.jacobian(np.zeros(6))[0], 2), "...")

robot.simulation.configure(SimConfig(rendered=False, camera_covered=True))
print(servo_to(robot, servo, [0.0, -0.1, 0.0], most_s=0.5))
robot.simulation.close()
