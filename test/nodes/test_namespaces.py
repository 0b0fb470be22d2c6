"""Two robots side by side on one host, of different schemes: nothing crosses over."""

import math

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from std_msgs.msg import Float64MultiArray

from fvs_ros import ros, topics
from fvs_ros.camera import CAMERA_FRAME

#: What no robot has for itself: /diagnostics is absolute by custom, the others are ROS's own.
SHARED = {"/diagnostics", "/rosout", "/parameter_events"}
#: Start and target of each robot, and its scheme: any estimator with any law.
ROBOTS = {
    "left": ("[0.2, -1.4, 1.6, -1.75, -1.57, 0.0]", (-0.15, 0.09, 1.58), ("--scheme", "extended")),
    "right": (
        "[-0.1, -1.3, 1.5, -1.7, -1.5, 0.1]",
        (0.16, 0.20, 1.67),
        ("--scheme", "ukf+mpc", "-p", "method:=lkf"),
    ),
}
#: Slower joint states and images, so that two robots fit on two cores.
SLOW = ("joint_state_rate_hz:=50", "image_rate_hz:=15.0")


class Robot:
    """One of the two, as the test hears it."""

    def __init__(self, harness, name):
        start, self.goal, scheme = ROBOTS[name]
        given = [f"initial_joints_rad:={start}", *SLOW]
        arguments = [*scheme, *(word for one in given for word in ("-p", one))]
        self.process = harness.start("fvs_tools.launcher", "servo", "--namespace", name, *arguments)
        self.commands = harness.collect(Float64MultiArray, f"{name}/{topics.COMMANDS.name}")
        self.balls = harness.collect(PointStamped, f"{name}/{topics.BALL_POSITION.name}")
        self.statuses = harness.collect(DiagnosticStatus, f"{name}/fvs_controller_node/status")
        self._target = harness.node.create_publisher(
            PointStamped, f"{name}/{topics.TARGET_POSITION.name}", ros.QOS_LATCHED
        )

    def waits_for_a_target(self):
        return bool(self.statuses) and (
            ros.from_status(self.statuses[-1])["reason"] == "NO_TARGET" and len(self.balls) > 5
        )

    def aim(self):
        self._target.publish(ros.to_point(1.0, CAMERA_FRAME, np.array(self.goal)))

    def there(self):
        last = [m.point for m in self.balls[-8:]]
        return all(math.dist((p.x, p.y, p.z), self.goal) < 0.005 for p in last)


def ends(node, name):
    """Nodes that publish or hear a topic: (namespace, name)."""
    found = node.get_publishers_info_by_topic(name) + node.get_subscriptions_info_by_topic(name)
    return {(end.node_namespace, end.node_name) for end in found}


def test_two_robots_side_by_side_each_reach_their_own_target(ros_test):
    left, right = robots = [Robot(ros_test, name) for name in ROBOTS]
    for robot in robots:
        ros_test.spin_until(robot.waits_for_a_target, 40.0, "all inputs")
    left.aim()
    ros_test.spin_until(left.there, 30.0, "the left ball at its target")
    assert not any(np.any(m.data) for m in right.commands)
    assert right.waits_for_a_target()
    right.aim()
    ros_test.spin_until(right.there, 30.0, "the right ball at its target")
    assert left.there()
    node = ros_test.node
    names = {name for name, _ in node.get_topic_names_and_types()}
    for name in names - SHARED:
        side = name.split("/")[1]
        assert side in ROBOTS, name
        others = ends(node, name) - {("/", node.get_name())}
        assert {namespace for namespace, _ in others} <= {f"/{side}"}, name
    for robot in robots:
        assert ros_test.stop(robot.process) == 0
