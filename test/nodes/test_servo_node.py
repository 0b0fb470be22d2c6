"""Estimator and controller of two arms in one process."""

import signal
import time

import numpy as np
from geometry_msgs.msg import PointStamped
from harness import Statuses, ros_arguments
from std_msgs.msg import Float64MultiArray

from fvs_ros import ros, topics
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.kinds.ball import Ball

MODULE = "fvs_tools.servo_node"
SIMULATOR, CONTROLLER = "fvs_sim_node", "fvs_controller_node"
#: Well inside the box of joints that the model was trained in, camera frame, m.
TARGETS_M = np.array([[-0.15, 0.09, 1.58], [0.16, 0.20, 1.67]])
#: What no robot has for itself: /diagnostics is absolute by custom, the others are ROS's own.
SHARED = {"/diagnostics", "/rosout", "/parameter_events"}
ARMS = ("left", "right")
#: Slower joint states and images, so that two simulated robots fit on two cores.
SLOW = {"joint_state_rate_hz": 50, "image_rate_hz": 15.0}
MOVING = {"joint_state_rate_hz": 50.0, "autostart": True, "max_joint_velocity_rad_s": 0.5}


class Loop(Statuses):
    """A loop in a namespace, as a test hears it."""

    def __init__(self, harness, namespace):
        super().__init__(harness, f"{namespace}/{CONTROLLER}")
        self.commands = harness.collect(Float64MultiArray, f"{namespace}/{topics.COMMANDS.name}")
        self.balls = harness.collect(PointStamped, f"{namespace}/{Ball.topics.tool.name}")
        name = f"{namespace}/{Ball.topics.target.name}"
        self.targets = harness.publisher(PointStamped, name)
        self.wait(lambda: self.reason() == "NO_TARGET" and len(self.balls) > 5, 60.0, "all inputs")

    def aim(self, target_m):
        self.targets.publish(ros.to_feature(time.time(), CAMERA_FRAME, Ball(), target_m))

    def reach(self, target_m):
        """Have the ball brought to a target, m."""

        def there():
            last = [[m.point.x, m.point.y, m.point.z] for m in self.balls[-6:]]
            return np.linalg.norm(last - target_m, axis=1).max() < 0.005

        self.aim(target_m)
        self.wait(there, 30.0, "the ball there")


def ends(node, name):
    """Namespaces of the nodes, but the test's own, that publish or hear a topic."""
    infos = node.get_publishers_info_by_topic(name) + node.get_subscriptions_info_by_topic(name)
    return {end.node_namespace for end in infos if end.node_name != node.get_name()}


def test_two_arms_in_one_process_keep_to_themselves_and_stop_with_zeros(ros_test):
    robots = [ros_test.start_node(f"{SIMULATOR}.node", {"__ns": f"/{arm}"}, **SLOW) for arm in ARMS]
    # A parameter of one of the nodes goes to that one, one of both to both.
    process = ros_test.start(MODULE, *ARMS, *ros_arguments(**MOVING, method="poe"))
    left, right = (Loop(ros_test, arm) for arm in ARMS)
    left.reach(TARGETS_M[0])
    assert not any(np.any(command.data) for command in right.commands)
    (refused,) = ros_test.set_parameters(f"left/{CONTROLLER}", method="rbf")
    assert "unknown parameter 'method'" in refused.reason
    for name in {name for name, _ in ros_test.node.get_topic_names_and_types()} - SHARED:
        side = name.split("/")[1]
        assert side in ARMS, name
        assert ends(ros_test.node, name) <= {f"/{side}"}, name
    # An arm whose robot dies stops alone.
    left.aim(TARGETS_M[1])
    ros_test.spin_until(lambda: np.any(left.commands[-1].data), what="motion")
    robots[0].kill()
    right.reach(TARGETS_M[1])
    assert not np.any(left.commands[-1].data)
    assert left.reason() == "STALE"
    right.aim(TARGETS_M[0])
    ros_test.spin_until(lambda: np.any(right.commands[-1].data), what="motion")
    assert ros_test.stop(process, signal.SIGINT) == 0, ros_test.output(process)
    ros_test.spin_for(0.2)
    for arm in (left, right):
        assert not np.any([command.data for command in arm.commands[-3:]])
