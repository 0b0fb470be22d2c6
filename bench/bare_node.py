"""A bare node that answers every message with a command: what rclpy itself costs.

``python -m bench.bare_node HEARD ANSWERED [events]``: on wait sets, or on the events executor.
"""

from __future__ import annotations

import contextlib
import sys

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fvs_ros import ros, topics


def main(heard, answered, executor=""):
    rclpy.init()
    node = rclpy.create_node("bare")
    publisher = node.create_publisher(Float64MultiArray, answered, ros.QOS_RELIABLE)
    command = Float64MultiArray(data=[1e-3] * 6)
    kind = JointState if heard.endswith(topics.JOINT_STATES.name) else Float64MultiArray
    node.create_subscription(kind, heard, lambda _: publisher.publish(command), ros.QOS_NEWEST)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        if executor:
            events = EventsExecutor()
            events.add_node(node)
            while True:
                events.spin_once(timeout_sec=0.05)
        rclpy.spin(node)


if __name__ == "__main__":
    main(*sys.argv[1:])
