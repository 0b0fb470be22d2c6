"""Simulated time is lock step: a busy machine makes it slower, never wrong."""

import signal

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
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


def test_the_simulator_waits_for_a_slow_answer_to_each_joint_state(ros_test):
    ros_test.start_node("fvs_sim_node.node", simulated_time=True)
    states = ros_test.collect(JointState, topics.JOINT_STATES.name)
    commands = ros_test.publisher(Float64MultiArray, topics.COMMANDS.name)
    ros_test.spin_until(lambda: len(states) > 0)
    stamps_s = []
    for _ in range(4):
        count = len(states)
        commands.publish(Float64MultiArray(data=[0.0] * 6))
        ros_test.spin_until(lambda count=count: len(states) > count, what="the next joint state")
        ros_test.spin_for(0.3)
        assert len(states) == count + 1 or not stamps_s
        stamps_s.append(ros.from_stamp(states[-1].header.stamp))
    assert np.diff(stamps_s[1:]) == pytest.approx(STEP_S)
    # From who answers no more, nothing is awaited.
    ros_test.spin_until(lambda: len(states) > count + 100, what="the simulator to go on alone")


@pytest.mark.parametrize(
    ("topic", "message", "behind_s"),
    [
        (topics.JACOBIAN, ros.to_jacobian(JACOBIAN), 0.1),
        (Ball.topics.tool, ros.to_point(1.0, "camera", np.zeros(3)), 0.15),
    ],
    ids=["estimator", "detector"],
)
def test_the_simulator_waits_for_a_node_that_is_far_behind(ros_test, topic, message, behind_s):
    ros_test.start_node("fvs_sim_node.node", simulated_time=True, publish_ball_position=False)
    states = ros_test.collect(JointState, topics.JOINT_STATES.name)
    answers = ros_test.publisher(type(message), topic.name)
    ros_test.spin_until(lambda: len(states) > 0)
    for _ in range(2):
        answers.publish(message)
        ros_test.spin_for(0.3)
    first_s = ros.from_stamp(states[-1].header.stamp)
    answers.publish(message)
    ros_test.spin_for(0.3)
    passed_s = ros.from_stamp(states[-1].header.stamp) - first_s
    assert passed_s == pytest.approx(behind_s, abs=1.01 * STEP_S)


class SlowSimulator:
    """Steps when its joint states were answered, and takes its time."""

    def __init__(self, harness):
        node = harness.node
        self.harness = harness
        self.commands = harness.collect(Float64MultiArray, topics.COMMANDS.name, ros.QOS_RELIABLE)
        self._clock = node.create_publisher(Clock, "/clock", ros.QOS_RELIABLE)
        self._states = node.create_publisher(JointState, topics.JOINT_STATES.name, ros.QOS_RELIABLE)
        self._balls = node.create_publisher(PointStamped, Ball.topics.tool.name, ros.QOS_RELIABLE)
        self._jacobians = node.create_publisher(
            Float64MultiArray, topics.JACOBIAN.name, ros.QOS_RELIABLE
        )
        self.joints, self.ball = np.array(HOME_JOINTS_RAD), np.array([0.0, 0.1, 1.4])
        self.stamp_s = 1.0
        harness.spin_until(lambda: self._states.get_subscription_count() > 0)

    def step(self):
        self.stamp_s += STEP_S
        moved = STEP_S * np.array(self.commands[-1].data if self.commands else np.zeros(6))
        self.joints, self.ball = self.joints + moved, self.ball + JACOBIAN @ moved
        answered = len(self.commands)
        self._clock.publish(Clock(clock=ros.to_stamp(self.stamp_s)))
        self._balls.publish(ros.to_point(self.stamp_s, "camera_color_optical_frame", self.ball))
        self._jacobians.publish(ros.to_jacobian(JACOBIAN))
        self._states.publish(
            ros.to_joint_state(self.stamp_s, UR_JOINT_NAMES, self.joints, np.zeros(6))
        )
        self.harness.spin_until(lambda: len(self.commands) > answered, what="an answer")


@pytest.mark.parametrize(
    ("module", "name"),
    [
        ("fvs_controller_node.node", "fvs_controller_node"),
        ("fvs_estimator_node.collector_node", "fvs_collector_node"),
    ],
)
def test_who_commands_answers_each_joint_state_once_and_ctrl_c_leaves_zeros(ros_test, module, name):
    own = (
        {"autostart": True}
        if name == "fvs_controller_node"
        else {"output_path": str(ros_test.folder / "part.npz")}
    )
    node = ros_test.start_node(module, use_sim_time=True, **own)
    statuses = ros_test.collect(DiagnosticStatus, f"{name}/status", ros.QOS_EVERY)
    targets = ros_test.publisher if name == "fvs_controller_node" else None
    simulator = SlowSimulator(ros_test)
    if targets:
        point = ros.to_point(1.0, "camera_color_optical_frame", simulator.ball + 0.1)
        targets(PointStamped, Ball.topics.target.name, ros.QOS_LATCHED).publish(point)

    def state():
        return ros.from_status(statuses[-1])["state"] if statuses else ""

    def moves():
        simulator.step()
        return state() in ("MOVING", "SERVOING")

    ros_test.spin_until(moves, what="motion")
    told, count = len(statuses), len(simulator.commands)
    for _ in range(3):
        ros_test.spin_for(0.3)
        simulator.step()
    ros_test.spin_for(0.3)
    assert len(simulator.commands) == count + 3
    assert {ros.from_status(one)["state"] for one in statuses[told:]} <= {"MOVING", "SERVOING"}
    assert np.any(simulator.commands[-1].data)
    assert ros_test.stop(node, signal.SIGINT) == 0
    ros_test.spin_for(0.2)
    assert not np.any(simulator.commands[-1].data)
