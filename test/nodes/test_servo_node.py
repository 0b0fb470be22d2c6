"""Estimator and controller of two arms in one process."""

import signal

import numpy as np
from harness import ros_arguments
from rig import CONTROLLER, SIMULATOR, TARGETS, Loop

MODULE = "fvs_tools.servo_node"
#: What no robot has for itself: /diagnostics is absolute by custom, the others are ROS's own.
SHARED = {"/diagnostics", "/rosout", "/parameter_events"}
ARMS = ("left", "right")
#: Slower joint states and images, so that two simulated robots fit on two cores.
SLOW = {"joint_state_rate_hz": 50, "image_rate_hz": 15.0}
MOVING = {"joint_state_rate_hz": 50.0, "autostart": True, "max_joint_velocity_rad_s": 0.5}


def ends(node, name):
    """Namespaces of the nodes, but the test's own, that publish or hear a topic."""
    found = node.get_publishers_info_by_topic(name) + node.get_subscriptions_info_by_topic(name)
    return {end.node_namespace for end in found if end.node_name != node.get_name()}


def test_two_arms_in_one_process_keep_to_themselves_and_stop_with_zeros(ros_test):
    robots = [ros_test.start_node(f"{SIMULATOR}.node", {"__ns": f"/{arm}"}, **SLOW) for arm in ARMS]
    # A parameter of one of the nodes goes to that one, one of both to both.
    process = ros_test.start(MODULE, *ARMS, *ros_arguments(**MOVING, method="poe"))
    left, right = (Loop(ros_test, arm) for arm in ARMS)
    left.reach(np.array(TARGETS[0]))
    assert not any(np.any(command.data) for command in right.commands)
    (refused,) = ros_test.set_parameters(f"left/{CONTROLLER}", method="rbf")
    assert "unknown parameter 'method'" in refused.reason
    for name in {name for name, _ in ros_test.node.get_topic_names_and_types()} - SHARED:
        side = name.split("/")[1]
        assert side in ARMS, name
        assert ends(ros_test.node, name) <= {f"/{side}"}, name
    # An arm whose robot dies stops alone.
    left.aim(np.array(TARGETS[1]))
    ros_test.spin_until(lambda: np.any(left.commands[-1].data), what="motion")
    robots[0].kill()
    right.reach(np.array(TARGETS[1]))
    assert not np.any(left.commands[-1].data)
    assert left.reason() == "STALE"
    right.aim(np.array(TARGETS[0]))
    ros_test.spin_until(lambda: np.any(right.commands[-1].data), what="motion")
    assert ros_test.stop(process, signal.SIGINT) == 0, ros_test.output(process)
    ros_test.spin_for(0.2)
    for arm in (left, right):
        assert not np.any([command.data for command in arm.commands[-3:]])
