"""Simulated time is lock step: a busy machine makes it slower, never wrong."""

import signal

import numpy as np
import pytest
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
        (Ball.topics.tool, ros.to_point(1.0, "camera", np.zeros(3)), 0.15),
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
    ("name", "module"),
    [
        (topics.CONTROLLER, "fvs_controller_node.node"),
        (topics.COLLECTOR, "fvs_estimator_node.collector_node"),
    ],
)
def test_who_commands_answers_each_joint_state_once_and_ctrl_c_leaves_zeros(ros_test, name, module):
    servoes = name == topics.CONTROLLER
    own = {"autostart": True} if servoes else {"output_path": ros_test.folder / "part.npz"}
    node = ros_test.start_node(module, use_sim_time=True, **own)
    watched = Statuses(ros_test, name, ros.QOS_EVERY)
    simulator = SlowSimulator(ros_test)
    if servoes:
        point = ros.to_point(1.0, "camera_color_optical_frame", simulator.ball + 0.1)
        target = Ball.topics.target.name
        ros_test.publisher(PointStamped, target, ros.QOS_LATCHED).publish(point)

    def moves():
        simulator.step()
        return watched.value("state") in ("MOVING", "SERVOING")

    ros_test.spin_until(moves, what="motion")
    watched.statuses.clear()
    count = len(simulator.commands)
    for _ in range(3):
        ros_test.spin_for(0.3)
        simulator.step()
    ros_test.spin_for(0.3)
    assert len(simulator.commands) == count + 3
    states = {ros.from_status(status)["state"] for status in watched.statuses}
    assert states <= {"MOVING", "SERVOING"}
    assert np.any(simulator.commands[-1].data)
    assert ros_test.stop(node, signal.SIGINT) == 0
    ros_test.spin_for(0.2)
    assert not np.any(simulator.commands[-1].data)
