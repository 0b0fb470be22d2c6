"""Two robots side by side on one host, and nodes under other names: nothing crosses over."""

import math
import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from fvs_ros import ros, topics
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.joints import JointMap

#: What no robot has for itself: /diagnostics is absolute by custom, the others are ROS's own.
SHARED = {"/diagnostics", "/rosout", "/parameter_events"}

#: Seed, start and target of each robot; slower joint states, so that two fit on two cores.
ROBOTS = {
    "left": (1, "[0.2, -1.4, 1.6, -1.75, -1.57, 0.0]", (-0.15, 0.09, 1.58)),
    "right": (2, "[-0.1, -1.3, 1.5, -1.7, -1.5, 0.1]", (0.16, 0.20, 1.67)),
}
SLOW = ["-p", "joint_state_rate_hz:=50", "-p", "tick_rate_hz:=50.0", "-p", "image_rate_hz:=15.0"]


class Robot:
    """One of the two, as the test hears it."""

    def __init__(self, harness, name):
        seed, start, self.goal = ROBOTS[name]
        self.harness = harness
        arguments = ["-p", f"fvs_sim_node:seed:={seed}", "-p", f"initial_joints_rad:={start}"]
        self.process = harness.start(
            "fvs_tools.launcher", "servo", "--namespace", name, *arguments, *SLOW
        )
        self.commands = harness.collect(Float64MultiArray, f"{name}/{topics.COMMANDS.name}")
        self.states = harness.collect(JointState, f"{name}/{topics.JOINT_STATES.name}")
        self.balls = harness.collect(PointStamped, f"{name}/{topics.BALL_POSITION.name}")
        self.statuses = harness.collect(DiagnosticStatus, f"{name}/fvs_controller_node/status")
        self.target = harness.node.create_publisher(
            PointStamped, f"{name}/{topics.TARGET_POSITION.name}", ros.QOS_LATCHED
        )

    def waits_for_a_target(self):
        return bool(self.statuses) and (
            ros.from_status(self.statuses[-1])["reason"] == "NO_TARGET" and len(self.balls) > 5
        )

    def joints(self):
        return JointMap().positions(self.states[-1].name, self.states[-1].position)

    def aim(self):
        self.target.publish(ros.to_point(time.time(), CAMERA_FRAME, np.array(self.goal)))

    def there(self):
        last = [m.point for m in self.balls[-8:]]
        return all(math.dist((p.x, p.y, p.z), self.goal) < 0.005 for p in last)


def test_two_robots_side_by_side_each_reach_their_own_target(ros_test):
    left, right = Robot(ros_test, "left"), Robot(ros_test, "right")
    for robot in (left, right):
        ros_test.spin_until(robot.waits_for_a_target, 40.0, "all inputs")
    home = right.joints()
    assert np.abs(left.joints() - home).max() > 0.1
    left.aim()
    ros_test.spin_until(left.there, 30.0, "the left ball at its target")
    assert not any(np.any(m.data) for m in right.commands)
    assert np.abs(right.joints() - home).max() < 1e-3
    assert right.waits_for_a_target()
    right.aim()
    ros_test.spin_until(right.there, 30.0, "the right ball at its target")
    assert left.there()
    assert_nothing_crosses_over(ros_test.node)
    for robot in (left, right):
        assert ros_test.stop(robot.process) == 0


def assert_nothing_crosses_over(node):
    names = {name for name, _ in node.get_topic_names_and_types()}
    for side in ROBOTS:
        ours = {name for name in names if name.startswith(f"/{side}/")}
        assert f"/{side}/{topics.COMMANDS.name}" in ours
        for name in ours:
            ends = node.get_publishers_info_by_topic(name)
            ends += node.get_subscriptions_info_by_topic(name)
            assert {end.node_namespace for end in ends} <= {f"/{side}", "/"}, name
            assert all(
                end.node_name == node.get_name() for end in ends if end.node_namespace == "/"
            )
    stray = {name for name in names if not name.startswith(("/left/", "/right/"))}
    assert stray <= SHARED


@pytest.mark.parametrize("module", ["fvs_sim_node", "fvs_estimator_node", "fvs_controller_node"])
def test_a_node_takes_another_name_a_namespace_and_remaps(ros_test, module):
    remaps = {"__ns": "/cell", "__node": "other", "joint_states": "arm/joint_states"}
    process = ros_test.start_node(f"{module}.node", remaps=remaps)
    statuses = ros_test.collect(DiagnosticStatus, "/cell/other/status")
    ros_test.spin_until(lambda: bool(statuses), what="a status under the new name")
    assert statuses[-1].name == "/cell/other"
    # Who is who comes on a topic of its own, and may come later than the first status.
    nodes = ros_test.node.get_node_names_and_namespaces
    ros_test.spin_until(lambda: ("other", "/cell") in nodes(), what="the node's name")

    def names():
        return {name for name, _ in ros_test.node.get_topic_names_and_types()}

    ros_test.spin_until(lambda: "/cell/arm/joint_states" in names(), what="the remapped topic")
    assert {n for n in names() if not n.startswith("/cell/")} <= SHARED
    assert not any(name.endswith("/joint_states") for name in names() - {"/cell/arm/joint_states"})
    service = {"fvs_controller_node": "stop"}.get(module, "reset")
    assert ros_test.call(Trigger, f"/cell/other/{service}").success
    assert ros_test.stop(process) == 0
