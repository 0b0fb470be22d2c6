"""An arm that moves as told: a light publisher of joint states, ball positions and targets.

``python -m bench.arm_node RATE_HZ SECONDS NAMESPACE`` gives targets until the arm moves, and goes
on for so many seconds. It prints when they begin, and at the end the times to the commands, ms, as
JSON: after joint states, and after those with an image.
"""

from __future__ import annotations

import json
import sys
import time

import numpy as np
import rclpy
from geometry_msgs.msg import PointStamped
from rclpy.experimental import EventsExecutor
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fvs_ros import ros, topics
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_ros.kinds.ball import Ball
from fvs_sim_node.camera import CAMERAS
from fvs_sim_node.robot import HOME_JOINTS_RAD
from fvs_sim_node.world import World

IMAGE_PERIOD_S, TARGET_PERIOD_S, OFFSET_M = 1.0 / 30.0, 0.8, np.array([0.1, 0.0, 0.05])
CAMERA, CHAIN = CAMERAS["front"], World().chain
#: The longest start, and the motion before it counts, s.
START_S, WARM_UP_S = 30.0, 2.0


class Arm:
    """The arm, its ball and its camera."""

    def __init__(self, node, namespace):
        def publisher(kind, topic, qos):
            return node.create_publisher(kind, f"{namespace}/{topic.name}", qos)

        self._clock = node.get_clock()
        self._joints = publisher(JointState, topics.JOINT_STATES, ros.QOS_NEWEST)
        self._balls = publisher(PointStamped, Ball.topics.tool, ros.QOS_NEWEST)
        self._targets = publisher(PointStamped, Ball.topics.target, ros.QOS_LATCHED)
        name = f"{namespace}/{topics.COMMANDS.name}"
        node.create_subscription(
            Float64MultiArray, name, self._on_command, ros.QOS_RELIABLE, raw=True
        )
        self._joints_rad, self._velocity_rad_s = np.array(HOME_JOINTS_RAD), np.zeros(6)
        self._home_m, self._side = self._ball_m(), 1.0
        self._image_s = self._target_s = 0.0
        self._sent = -1.0, False  # when the last joint state went, s, and whether with an image
        #: Times to the first command after each joint state, ms, and whether with an image.
        self.answers = []

    def _ball_m(self):
        return CAMERA.to_own(CHAIN.position(self._joints_rad))

    @property
    def moves(self):
        return bool(self._velocity_rad_s.any())

    def _on_command(self, data):
        sent_s, with_image = self._sent
        if sent_s > 0.0:
            self.answers.append((1e3 * (time.monotonic() - sent_s), with_image))
            self._sent = -1.0, False
        self._velocity_rad_s = np.frombuffer(data[-48:])

    def step(self, now_s, dt_s):
        """Move on and send."""
        stamp_s = self._clock.now().nanoseconds * 1e-9
        self._joints_rad = self._joints_rad + dt_s * self._velocity_rad_s
        if now_s - self._target_s > TARGET_PERIOD_S:
            self._target_s, self._side = now_s, -self._side
            target_m = self._home_m + self._side * OFFSET_M
            self._targets.publish(ros.to_feature(stamp_s, CAMERA_FRAME, Ball(), target_m))
        with_image = now_s - self._image_s > IMAGE_PERIOD_S
        self._sent = now_s, with_image
        if with_image:
            self._image_s = now_s
            self._balls.publish(ros.to_feature(stamp_s, CAMERA_FRAME, Ball(), self._ball_m()))
        message = ros.to_joint_state(
            stamp_s, UR_JOINT_NAMES, self._joints_rad, self._velocity_rad_s
        )
        self._joints.publish(message)


def play(executor, arm, period_s, seconds, until=lambda: False):
    """Let the arm send and hear for so many seconds, or until a condition holds."""
    next_s = time.monotonic()
    end_s = next_s + seconds
    while next_s < end_s and not until():
        next_s = max(next_s + period_s, time.monotonic())
        while (left_s := next_s - time.monotonic()) > 0.0:
            executor.spin_once(timeout_sec=left_s)
        arm.step(time.monotonic(), period_s)


def main(rate_hz, seconds, namespace):
    rclpy.init()
    node = rclpy.create_node("arm", start_parameter_services=False)
    arm = Arm(node, namespace)
    executor = EventsExecutor()
    executor.add_node(node)
    play(executor, arm, 1.0 / rate_hz, START_S, lambda: arm.moves)
    play(executor, arm, 1.0 / rate_hz, WARM_UP_S)
    print("begin", flush=True)
    arm.answers.clear()
    play(executor, arm, 1.0 / rate_hz, seconds)
    images = [answer_ms for answer_ms, with_image in arm.answers if with_image]
    print(json.dumps([[answer_ms for answer_ms, _ in arm.answers], images]), flush=True)
    return 0 if arm.moves else 1


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1]), float(sys.argv[2]), sys.argv[3]))
