"""The stranger of ``stranger.py`` behind the topics that a real robot and a detector have.

Plain rclpy, nothing of the package: what it publishes is what a driver and a camera would, in the
driver's (alphabetical) order, with a gripper's joint among the six. Without commands it stands;
the last one holds for ever.

usage: stranger_node.py SEED JOINT_RATE_HZ
"""

import contextlib
import sys
import time

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from stranger import Stranger, StrangerConfig

NAMES = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
FRAME = "camera_color_optical_frame"


def stamp(seconds: float) -> Time:
    nanoseconds = round(seconds * 1e9)
    return Time(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)


def point(seconds: float, position: np.ndarray) -> PointStamped:
    message = PointStamped()
    message.header.stamp = stamp(seconds)
    message.header.frame_id = FRAME
    message.point.x, message.point.y, message.point.z = (float(value) for value in position)
    return message


def main() -> None:
    stranger = Stranger(
        StrangerConfig(seed=int(sys.argv[1]), joint_state_rate_hz=float(sys.argv[2]))
    )
    rclpy.init()
    node = rclpy.create_node("ur_robot_driver")
    joint_states = node.create_publisher(JointState, "joint_states", 10)
    ball = node.create_publisher(PointStamped, "ball_position", 10)
    truth = node.create_publisher(PointStamped, "true_ball", 10)
    node.create_subscription(
        Float64MultiArray,
        "forward_velocity_controller/commands",
        lambda message: stranger.command(np.array(message.data)),
        10,
    )
    started_s, epoch_s = time.monotonic(), time.time()
    names = sorted([*NAMES, "gripper_joint"])

    def step() -> None:
        while stranger.time_s + stranger.period_s <= time.monotonic() - started_s:
            for seen in stranger.advance().observations:
                ball.publish(point(epoch_s + seen.stamp_s, seen.detection.position_m))
            positions = dict(zip(NAMES, stranger.joints_rad, strict=True), gripper_joint=0.3)
            message = JointState()
            message.header.stamp = stamp(epoch_s + stranger.time_s)
            message.name = names
            message.position = [float(positions[name]) for name in names]
            joint_states.publish(message)
            truth.publish(point(epoch_s + stranger.time_s, stranger.ball_m))

    node.create_timer(stranger.period_s, step)
    with contextlib.suppress(KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main()
