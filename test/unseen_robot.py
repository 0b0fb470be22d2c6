"""A robot and a camera that the package has never seen: six random axes, a random view, in numpy.

Nothing here is shared with the simulator: another arm (random axes), another drive, another camera,
white noise on the ball positions. As a program it stands behind the topics that a
real driver and a detector have: joints in the driver's (alphabetical) order with a
gripper's among them, all but the elbow wrapped at pi, where the arm stands at first. Without
commands it stands; the last one holds for ever.

The arm has a seventh joint, and carries a tag whose pose a foreign tracker publishes.

usage: unseen_robot.py SEED JOINT_RATE_HZ
"""

import contextlib
import sys
import time
from collections import deque

import numpy as np

from fvs_ros.chain import SerialChain
from fvs_ros.joints import UR_JOINT_NAMES as NAMES
from fvs_ros.kinds import Kind, kind_of
from fvs_ros.rotations import rotation_from_vector

#: Half width of the joints' box, rad: how far a collection may go.
REACH_RAD = np.array([0.6, 0.5, 0.5, 0.5, 0.5, 0.5])
FRAME = "camera_color_optical_frame"
ARM_M = 0.3  # of a pose
IMAGE_RATE_HZ, NOISE_M, LATENCY_S, LAG_S = 30.0, 0.001, 0.03, 0.02


def draw_arm(rng: np.random.Generator) -> SerialChain:
    """Six revolute axes with a ball on the last link, before a camera.

    Around its reference joints the ball can be moved in every direction, and stays in view.
    """
    while True:
        # As on most arms: a turning base, two parallel axes, then a wrist; all of it tilted.
        axes = np.array([[0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]], float)
        axes += 0.3 * rng.standard_normal((6, 3))
        lengths = rng.uniform([0.1, 0.05, 0.3, 0.2, 0.08, 0.05], [0.3, 0.2, 0.5, 0.45, 0.2, 0.15])
        ways = np.array([[0, 0, 1], [0, 1, 0], [0.3, 0, 1], [1, 0, 0.2], [1, 0, 0], [1, 0, 0]])
        points = np.cumsum(lengths[:, None] * (ways + 0.2 * rng.standard_normal((6, 3))), axis=0)
        ball = points[-1] + [0.12, 0.0, 0.0] + 0.06 * rng.standard_normal(3)
        # A camera about a metre and a half away, turned and rolled as it likes.
        forward, across = rng.standard_normal((2, 3))
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, across)
        right /= np.linalg.norm(right)
        camera = np.stack([right, np.cross(forward, right), forward])
        eye = ball - rng.uniform(1.2, 1.8) * forward
        home = rng.uniform(-1.0, 1.0, 6)
        arm = SerialChain(axes @ camera.T, (points - eye) @ camera.T, camera @ (ball - eye), home)
        box = home + REACH_RAD * rng.uniform(-1.0, 1.0, (40, 6))
        least = np.linalg.svd(arm.jacobian(box), compute_uv=False)[:, -1]
        if least.min() > 0.12 and arm.position(box)[:, 2].min() > 0.5:
            return arm


def with_tag(arm: SerialChain, kind: Kind, rng: np.random.Generator) -> SerialChain:
    """The arm with one more axis near the ball, and a tag in its place that can be turned."""
    while True:
        axis, aside, turn = rng.standard_normal((3, 3))
        found = SerialChain(
            np.vstack([arm.axes, axis]),
            np.vstack([arm.points_m, arm.feature_m + 0.1 * aside]),
            kind.of_body(arm.feature_m, rotation_from_vector(turn)),
            np.append(arm.reference_rad, 0.2),
        )
        box = found.reference_rad + 0.5 * rng.uniform(-1.0, 1.0, (40, 7))
        jacobians = kind.moved_by(*found.motion(box))
        if np.linalg.svd(jacobians, compute_uv=False)[:, -1].min() > 0.1:
            return found


class UnseenRobot:
    """Robot and camera in steps of a millisecond: velocities in, joints and noisy balls out."""

    STEP_S = 0.001

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng([seed, 77])
        self.kind, self.names = kind_of("pose", ARM_M), [*NAMES, "wrist_4_joint"]
        self.arm = with_tag(draw_arm(self._rng), self.kind, self._rng)
        self.joints_rad = self.arm.reference_rad.copy()
        self.command_rad_s = np.zeros(self.joints_rad.size)
        self._velocity = self.command_rad_s
        self._steps = self._images = 0
        self._pending: deque[tuple[float, np.ndarray]] = deque()

    @property
    def time_s(self) -> float:
        """Time since the start, s."""
        return self._steps * self.STEP_S

    @property
    def ball_m(self) -> np.ndarray:
        """Where ball or tag truly is, camera frame, m, shape (m,)."""
        return self.arm.position(self.joints_rad)

    def advance(self, duration_s: float) -> list[tuple[float, np.ndarray]]:
        """Let time pass; returns exposures, s, and noisy ball positions, m, seen meanwhile."""
        blend = 1.0 - np.exp(-self.STEP_S / LAG_S)
        for _ in range(round(duration_s / self.STEP_S)):
            self._velocity = self._velocity + blend * (self.command_rad_s - self._velocity)
            self.joints_rad = self.joints_rad + self.STEP_S * self._velocity
            self._steps += 1
            if self.time_s * IMAGE_RATE_HZ >= self._images:
                self._images += 1
                noise = NOISE_M * self._rng.standard_normal(self.kind.size)
                self._pending.append((self.time_s, self.kind.retract(self.ball_m, noise)))
        seen = []
        while self._pending and self._pending[0][0] + LATENCY_S <= self.time_s:
            seen.append(self._pending.popleft())
        return seen

    def draw_targets(self, rng: np.random.Generator, count: int) -> list[np.ndarray]:
        """Targets that the ball can be at, each within 0.3 m of the one before, m."""
        targets = [self.ball_m]
        while len(targets) <= count:
            way_rad = 0.45 * rng.uniform(-1.0, 1.0, self.joints_rad.size)
            target = self.arm.position(self.arm.reference_rad + way_rad)
            if 0.05 < np.linalg.norm(self.kind.minus(target, targets[-1])) < 0.3:
                targets.append(target)
        return targets[1:]


def main() -> None:
    """Stand behind the topics, in real time."""
    import rclpy
    from geometry_msgs.msg import PoseStamped
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    from fvs_ros import ros

    robot, period_s = UnseenRobot(int(sys.argv[1])), 1.0 / float(sys.argv[2])
    rclpy.init()
    node = rclpy.create_node("ur_robot_driver")
    joint_states = node.create_publisher(JointState, "joint_states", 10)
    seen = node.create_publisher(PoseStamped, robot.kind.topics.tool.name, 10)
    truth = node.create_publisher(PoseStamped, "truth", 10)
    started_s, epoch_s = time.monotonic(), time.time()
    names = sorted([*robot.names, "gripper_joint"])
    home = np.pi * (np.arange(len(robot.names)) != 2)  # where the driver says that it stands

    def obey(message: Float64MultiArray) -> None:
        assert len(message.data) == len(robot.names), "a real controller would be deactivated"
        robot.command_rad_s = np.array(message.data)

    node.create_subscription(Float64MultiArray, "forward_velocity_controller/commands", obey, 10)

    def step() -> None:
        while robot.time_s + period_s <= time.monotonic() - started_s:
            for stamp_s, found_m in robot.advance(period_s):
                seen.publish(ros.to_feature(epoch_s + stamp_s, FRAME, robot.kind, found_m))
            now_s = epoch_s + robot.time_s
            turned = robot.joints_rad - robot.arm.reference_rad + home
            wrapped = np.arctan2(np.sin(turned), np.cos(turned))
            joints = dict(zip(robot.names, wrapped.tolist(), strict=True), gripper_joint=0.3)
            positions = np.array([joints[name] for name in names])
            joint_states.publish(ros.to_joint_state(now_s, names, positions, np.zeros(0)))
            truth.publish(ros.to_feature(now_s, FRAME, robot.kind, robot.ball_m))

    node.create_timer(period_s, step)
    with contextlib.suppress(KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main()
