"""How do I servo a LeRobot arm, such as an SO-101?

`ServoedRobot` wraps any robot with LeRobot's `Robot` interface and has it itself. Its action is no
longer a goal of each joint, but where the camera shall see the ball; at each action it moves the
joints one limited step, which `sent` holds. A policy or a script then acts in the camera's frame.
Joints are `NAME.pos` in degrees (`use_degrees=True`).
"""

import time

import numpy as np

from fvs_ros import Servo, SimConfig, Simulation

TARGET = ("target.x", "target.y", "target.z")  # m, camera frame


class ServoedRobot:
    """A robot whose action is a target in the camera's frame."""

    name = "fvs_servoed"

    def __init__(self, robot, servo, detect, clock=time.monotonic):
        self.robot, self.servo, self.detect, self.clock = robot, servo, detect, clock
        self.keys, self.sent = [f"{name}.pos" for name in servo.joint_names], {}

    def __getattr__(self, name):  # connect, disconnect, calibrate, configure, is_connected, ...
        return getattr(self.robot, name)

    @property
    def observation_features(self):
        return {**self.robot.observation_features, **dict.fromkeys(TARGET, float)}

    @property
    def action_features(self):
        return dict.fromkeys(TARGET, float)

    def get_observation(self):
        """The robot's, and where the ball is now; NaN while it is not known."""
        observed = self.robot.get_observation()
        joints_rad = np.radians([observed[key] for key in self.keys])
        self.servo.observe(self.clock(), joints_rad, self.detect(observed))
        ball_m = self.servo.feature
        return {**observed, **dict(zip(TARGET, np.full(3, np.nan) if ball_m is None else ball_m))}

    def send_action(self, action):
        """Step towards the target, which is returned; nothing is sent while the arm is held."""
        self.servo.set_target([action[key] for key in TARGET])
        joints_rad = self.servo.command()
        if joints_rad is not None:
            goal = dict(zip(self.keys, np.degrees(joints_rad).tolist()))
            self.sent = self.robot.send_action(goal)
        return action


class FakeRobot:
    """Stands in for LeRobot's: a simulated arm that takes goal positions 30 times per second."""

    def __init__(self):
        self.simulation = Simulation(
            SimConfig(
                command_interface="position",
                joint_state_rate_hz=30.0,
                latency_s=0.0,
                rendered=False,
                position_noise_m=0.001,
            )
        )
        self.names, self.is_connected = self.simulation.world.joint_names, False
        self.action_features = {f"{name}.pos": float for name in self.names}
        self.observation_features = {**self.action_features, "front": (480, 640, 3)}

    def connect(self, calibrate=True):
        self.is_connected = True

    def disconnect(self):
        self.is_connected = False

    def calibrate(self):
        """Nothing to do, nor in the next."""

    def configure(self):
        """Set up motors."""

    def get_observation(self):
        arm = self.simulation.advance()
        self.image = arm.observations[-1] if arm.observations else None
        return {**dict(zip(self.action_features, np.degrees(arm.joints_rad))), "front": self.image}

    def send_action(self, action):
        self.simulation.command(np.radians(list(action.values())))
        return action


fake = FakeRobot()
servo = Servo.load(
    "models/ur5_front.npz",
    urdf="robots/ur5.urdf",
    command_interface="position",
    max_joint_velocity_rad_s=0.5,
)
robot = ServoedRobot(
    fake,
    servo,
    detect=lambda observed: observed["front"] and observed["front"].z,
    clock=lambda: fake.simulation.time_s,
)
robot.connect()
for _ in range(15):
    action = {key: observed for key, observed in robot.get_observation().items() if key in TARGET}
action["target.y"] += 0.1
while not servo.settled:
    robot.get_observation()
    robot.send_action(action)
print(servo.status.text)
print("last action sent:", {key: round(value, 1) for key, value in robot.sent.items()})
robot.disconnect()
