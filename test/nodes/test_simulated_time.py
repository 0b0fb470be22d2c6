"""Simulated time is lock step: a busy machine makes it slower, never wrong."""

import json
import signal

import numpy as np
from geometry_msgs.msg import PointStamped
from harness import Statuses
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fvs_ros import ros, topics
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_ros.kinds.ball import Ball
from fvs_sim_node.robot import HOME_JOINTS_RAD

STEP_S = 0.008
JACOBIAN = np.array(
    [[0.5, 0.1, 0.1, 0, 0, 0], [0.1, 0.5, -0.3, 0, 0, 0], [0.1, -0.2, 0.4, 0, 0, 0]]
)


def test_the_simulator_waits_for_a_command_to_each_joint_state_and_for_nodes_far_behind(ros_test):
    ros_test.start_node("fvs_sim_node.node", simulated_time=True, publish_ball_position=False)
    states = ros_test.collect(JointState, topics.JOINT_STATES.name)
    ros_test.spin_until(lambda: len(states) > 0)

    def stamp_s():
        return ros.from_stamp(states[-1].header.stamp)

    for topic, message, behind_s in (
        (topics.COMMANDS, ros.to_command(np.zeros(6)), 0.008),
        (topics.JACOBIAN, ros.to_jacobian(JACOBIAN), 0.1),
        (Ball.topics.tool, ros.to_feature(1.0, "camera", Ball(), np.zeros(3)), 0.15),
    ):
        answers = ros_test.publisher(type(message), topic.name)
        answers.publish(message)
        ros_test.spin_for(0.5)
        for _ in range(2):
            before_s = stamp_s()
            answers.publish(message)
            ros_test.spin_until(lambda b=before_s, late=behind_s: stamp_s() > b + late - 1e-6)
            ros_test.spin_for(0.3)
            assert stamp_s() < before_s + behind_s + STEP_S
        # From a node that responds no more, nothing is awaited.
        count = len(states)
        ros_test.spin_until(lambda n=count: len(states) > n + 100, what="the simulator to go on")


def test_the_simulator_awaits_the_first_command_of_each_program_in_turn(ros_test):
    ros_test.start_node("fvs_sim_node.node", simulated_time=True)
    states = ros_test.collect(JointState, topics.JOINT_STATES.name)
    for _ in range(2):
        count = len(states)
        ros_test.spin_until(lambda n=count: len(states) > n + 50, what="the simulator to go on")
        commands = ros_test.publisher(Float64MultiArray, topics.COMMANDS.name)
        ros_test.spin_for(0.5)  # until it knows the publisher
        count = len(states)
        ros_test.spin_for(0.3)
        assert count < len(states) < count + 10  # for a node that waits for the first, too
        commands.publish(ros.to_command(np.zeros(6)))
        ros_test.spin_until(lambda n=count: len(states) > n + 1, what="steps")
        ros_test.node.destroy_publisher(commands)


def test_the_demo_moves_a_camera_on_the_arm_to_where_it_shall_see_a_tag(ros_test):
    few = "targets:=1", "target_s:=2.0", "image_rate_hz:=15.0", "output_dir:=out"
    on_arm = "camera_mount:=arm", "feature:=pose", "simulated_time:=true", "use_sim_time:=true"
    arguments = (word for value in (*few, *on_arm) for word in ("-p", value))
    process = ros_test.start("fvs_tools.launcher", "demo", *arguments)
    assert ros_test.wait(process, 120.0) == 0, ros_test.output(process)
    (result,) = json.loads((ros_test.folder / "out" / "results.json").read_text())
    assert result["start_distance_m"] > 0.1
    assert result["final_rms_m"] < 0.001


def test_the_collector_answers_each_joint_state_once_and_ctrl_c_leaves_zeros(ros_test):
    collector = ros_test.start_node(
        "fvs_estimator_node.collector_node",
        use_sim_time=True,
        output_path=ros_test.folder / "part.npz",
    )
    watched = Statuses(ros_test, topics.COLLECTOR, ros.QOS_EVERY)
    commands = ros_test.collect(Float64MultiArray, topics.COMMANDS.name, ros.QOS_RELIABLE)
    clock = ros_test.publisher(Clock, "/clock")
    states = ros_test.publisher(JointState, topics.JOINT_STATES.name)
    balls = ros_test.publisher(PointStamped, Ball.topics.tool.name)
    joints, stamp_s = np.array(HOME_JOINTS_RAD), 1.0

    def step():
        nonlocal joints, stamp_s
        stamp_s += STEP_S
        joints = joints + STEP_S * np.array(commands[-1].data if commands else np.zeros(6))
        ball = JACOBIAN @ joints + [0.0, 0.0, 1.4]
        answered = len(commands)
        clock.publish(Clock(clock=ros.to_stamp(stamp_s)))
        balls.publish(ros.to_feature(stamp_s, "camera_color_optical_frame", Ball(), ball))
        states.publish(ros.to_joint_state(stamp_s, UR_JOINT_NAMES, joints, np.zeros(6)))
        ros_test.spin_until(lambda: len(commands) > answered, what="an answer")

    def moves():
        step()
        return watched.value("state") == "MOVING"

    ros_test.spin_until(moves, what="motion")
    watched.statuses.clear()
    count = len(commands)
    for _ in range(3):
        ros_test.spin_for(0.3)  # longer than joint states may be old
        step()
    ros_test.spin_for(0.3)
    assert len(commands) == count + 3
    assert {ros.from_status(status)["state"] for status in watched.statuses} <= {"MOVING"}
    assert np.any(commands[-1].data)
    assert ros_test.stop(collector, signal.SIGINT) == 0
    ros_test.spin_for(0.2)
    assert not np.any(commands[-1].data)
