"""Estimator and controller of two arms in one process."""

import signal

import numpy as np
from harness import ros_arguments
from rig import CONTROLLER, SIMULATOR, TARGETS, Loop

MODULE = "fvs_tools.servo_node"
ARMS = ("left", "right")
#: Slower joint states and images, so that two simulated robots fit on two cores.
SLOW = {"joint_state_rate_hz": 50, "image_rate_hz": 15.0}
MOVING = {"joint_state_rate_hz": 50.0, "autostart": True, "max_joint_velocity_rad_s": 0.5}


def test_two_arms_in_one_process_reach_their_targets_and_stop_with_zeros(ros_test):
    for arm in ARMS:
        ros_test.start_node(f"{SIMULATOR}.node", {"__ns": f"/{arm}"}, **SLOW)
    # A parameter of one of the nodes goes to that one, one of both to both.
    process = ros_test.start(MODULE, *ARMS, *ros_arguments(**MOVING, method="poe"))
    left, right = (Loop(ros_test, arm) for arm in ARMS)
    left.reach(np.array(TARGETS[0]))
    assert not any(np.any(command.data) for command in right.commands)
    (refused,) = ros_test.set_parameters(f"left/{CONTROLLER}", method="rbf")
    assert "unknown parameter 'method'" in refused.reason
    for arm, target in ((left, TARGETS[1]), (right, TARGETS[0])):
        arm.aim(np.array(target))
        ros_test.spin_until(lambda arm=arm: np.any(arm.commands[-1].data), what="motion")
    assert ros_test.stop(process, signal.SIGINT) == 0, ros_test.output(process)
    ros_test.spin_for(0.2)
    for arm in (left, right):
        assert not np.any([command.data for command in arm.commands[-3:]])


def test_an_arm_whose_robot_dies_stops_alone(ros_test):
    left_robot, _ = (
        ros_test.start_node(f"{SIMULATOR}.node", {"__ns": f"/{arm}"}, **SLOW) for arm in ARMS
    )
    ros_test.start(MODULE, *ARMS, *ros_arguments(**MOVING))
    left, right = (Loop(ros_test, arm) for arm in ARMS)
    left.aim(np.array(TARGETS[0]))
    ros_test.spin_until(lambda: np.any(left.commands[-1].data), what="motion")
    left_robot.kill()
    right.reach(np.array(TARGETS[1]))
    assert not np.any(left.commands[-1].data)
    assert left.reason() == "STALE"
