"""A bare node that passes messages on: the floor that the real loop is held against."""

from __future__ import annotations

import contextlib
import sys

import rclpy
from rclpy.executors import ExternalShutdownException
from std_msgs.msg import Float64MultiArray

from fvs_ros import ros


def main() -> None:
    rclpy.init()
    node = rclpy.create_node(f"relay_{sys.argv[1]}")
    publisher = node.create_publisher(Float64MultiArray, sys.argv[2], ros.QOS_RELIABLE)
    node.create_subscription(Float64MultiArray, sys.argv[1], publisher.publish, ros.QOS_NEWEST)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main()
