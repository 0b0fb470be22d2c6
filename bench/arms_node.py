"""Arms that move as told, each in a namespace: light publishers that time every answer.

``python -m bench.arms_node RATE_HZ SECONDS NAMESPACE ...`` gives targets until every arm moves,
counts for so many seconds, and prints what it saw of each arm as JSON.
"""

from __future__ import annotations

import json
import sys
import threading
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
#: The longest start, and the wait for the last answers, s.
START_S, IN_FLIGHT_S = 30.0, 0.05


class Arm:
    """One arm, its ball and its camera."""

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
        self.sent_s, self.sent, self.answers_s, self._waits = 0.0, 0, [], False

    def _ball_m(self):
        return CAMERA.to_camera(CHAIN.position(self._joints_rad))

    @property
    def moves(self):
        return bool(self._velocity_rad_s.any())

    def _on_command(self, data):
        if self._waits:  # zeros come unasked, too, when joint states are missing
            self.answers_s.append(time.monotonic() - self.sent_s)
        self._waits = False
        self._velocity_rad_s = np.frombuffer(data[-48:])

    def step(self, now_s, dt_s):
        stamp_s = self._clock.now().nanoseconds * 1e-9
        self._joints_rad = self._joints_rad + dt_s * self._velocity_rad_s
        if now_s - self._target_s > TARGET_PERIOD_S:
            self._target_s, self._side = now_s, -self._side
            target_m = self._home_m + self._side * OFFSET_M
            self._targets.publish(ros.to_point(stamp_s, CAMERA_FRAME, target_m))
        if now_s - self._image_s > IMAGE_PERIOD_S:
            self._image_s = now_s
            self._balls.publish(ros.to_point(stamp_s, CAMERA_FRAME, self._ball_m()))
        message = ros.to_joint_state(
            stamp_s, UR_JOINT_NAMES, self._joints_rad, self._velocity_rad_s
        )
        self.sent += 1
        self.sent_s, self._waits = time.monotonic(), True
        self._joints.publish(message)


def play(arms, period_s, until):
    """Let the arms send, one after the other within a period, until a condition holds."""
    gap_s = period_s / len(arms)
    next_s = time.monotonic()
    while not until():
        for arm in arms:
            next_s = max(next_s + gap_s, time.monotonic())  # never two at once
            time.sleep(max(0.0, next_s - time.monotonic()))
            arm.step(time.monotonic(), period_s)


def main(rate_hz, seconds, namespaces):
    rclpy.init()
    node = rclpy.create_node("arms", start_parameter_services=False)
    arms = [Arm(node, namespace) for namespace in namespaces]
    executor = EventsExecutor()
    executor.add_node(node)
    running = True

    def receive():
        while running:
            executor.spin_once(timeout_sec=0.1)

    receiver = threading.Thread(target=receive)
    receiver.start()
    try:
        period_s, begin_s = 1.0 / rate_hz, time.monotonic()
        play(
            arms,
            period_s,
            lambda: all(arm.moves for arm in arms) or time.monotonic() > begin_s + START_S,
        )
        begin_s = time.monotonic()
        play(arms, period_s, lambda: time.monotonic() > begin_s + 2.0)
        time.sleep(IN_FLIGHT_S)
        for arm in arms:
            arm.sent, arm.answers_s = 0, []
        print("begin", flush=True)
        begin_s = time.monotonic()
        play(arms, period_s, lambda: time.monotonic() > begin_s + seconds)
        time.sleep(IN_FLIGHT_S)
        print(
            json.dumps(
                [
                    {"sent": arm.sent, "answers_s": list(arm.answers_s), "moves": arm.moves}
                    for arm in arms
                ]
            ),
            flush=True,
        )
    finally:
        running = False
        receiver.join()


if __name__ == "__main__":
    main(float(sys.argv[1]), float(sys.argv[2]), sys.argv[3:])
