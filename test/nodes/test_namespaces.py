"""Two robots side by side on one host, of different schemes: nothing crosses over."""

import numpy as np
from rig import TARGETS, Launched

#: What no robot has for itself: /diagnostics is absolute by custom, the others are ROS's own.
SHARED = {"/diagnostics", "/rosout", "/parameter_events"}
#: Slower joint states and images, so that two robots fit on two cores.
SLOW = ("-p", "joint_state_rate_hz:=50", "-p", "image_rate_hz:=15.0")
#: Start of each robot, and its scheme: any estimator with any law.
ROBOTS = {
    "left": ("[0.2, -1.4, 1.6, -1.75, -1.57, 0.0]", "extended"),
    "right": ("[-0.1, -1.3, 1.5, -1.7, -1.5, 0.1]", "ukf+mpc", "-p", "method:=lkf"),
}


def ends(node, name):
    """Nodes that publish or hear a topic: (namespace, name)."""
    found = node.get_publishers_info_by_topic(name) + node.get_subscriptions_info_by_topic(name)
    return {(end.node_namespace, end.node_name) for end in found}


def test_two_robots_side_by_side_each_reach_their_own_target(ros_test):
    left, right = robots = [
        Launched(
            ros_test, "-p", f"initial_joints_rad:={start}", *SLOW,
            "--scheme", *scheme, namespace=name,
        )
        for name, (start, *scheme) in ROBOTS.items()
    ]  # fmt: skip
    left.reach(np.array(TARGETS[0]))
    assert not any(np.any(m.data) for m in right.commands)
    assert "target set to" not in ros_test.output(right.process)
    right.reach(np.array(TARGETS[1]))
    assert left.distance_m(TARGETS[0]) < 0.005
    node = ros_test.node
    for name in {name for name, _ in node.get_topic_names_and_types()} - SHARED:
        side = name.split("/")[1]
        assert side in ROBOTS, name
        others = ends(node, name) - {("/", node.get_name())}
        assert {namespace for namespace, _ in others} <= {f"/{side}"}, name
    for robot in robots:
        assert ros_test.stop(robot.process) == 0
