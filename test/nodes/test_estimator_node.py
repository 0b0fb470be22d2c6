"""The estimator node over DDS, fed by the simulator or by hand."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PointStamped
from harness import PlayedRobot
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from fvs_ros import ros, topics
from fvs_ros.joints import JointMap
from fvs_sim_node.simulation import SimConfig, Simulation

MODULE = "fvs_estimator_node.node"
STATUS = "fvs_estimator_node/status"


def test_the_jacobian_is_that_of_the_arm_at_the_newest_joints_often_enough(ros_test):
    ros_test.start_node("fvs_sim_node.node")
    ros_test.start_node(MODULE)
    jacobians = ros_test.collect(Float64MultiArray, topics.JACOBIAN.name)
    balls = ros_test.collect(PointStamped, topics.BALL_POSITION.name)
    states = ros_test.collect(JointState, topics.JOINT_STATES.name)
    ros_test.spin_until(lambda: jacobians and balls)
    before = len(jacobians), len(balls)
    ros_test.spin_for(1.0)
    assert len(jacobians) - before[0] >= len(balls) - before[1]
    message = jacobians[-1]
    assert [(dim.label, dim.size) for dim in message.layout.dim] == [("feature", 3), ("joint", 6)]
    joints = JointMap().positions(states[-1].name, states[-1].position)
    with Simulation(SimConfig()) as simulation:
        true = simulation.true_jacobian(joints)
    error = ros.from_jacobian(message, 3, 6) - true
    assert np.linalg.norm(error) < 0.05 * np.linalg.norm(true)


class Learner:
    """An estimator fed by a linear plant whose Jacobian is not the model's."""

    def __init__(self, harness, **parameters):
        self.harness = harness
        self.robot = PlayedRobot(harness)
        self.robot.silent.add(topics.JACOBIAN.name)
        harness.start_node(MODULE, **parameters)
        self.jacobians = harness.collect(Float64MultiArray, topics.JACOBIAN.name)
        self.statuses = harness.collect(DiagnosticStatus, STATUS)
        harness.spin_until(lambda: self.jacobians and self.statuses, what="Jacobian and status")

    def values(self):
        return ros.from_status(self.statuses[-1])

    def swing(self, seconds=2.0):
        """Move the joints there and back."""
        home = self.robot.joints.copy()
        for sign in (1.0, -1.0):
            self.robot.velocity = sign * np.array([0.2, -0.1, 0.15, 0.1, -0.2, 0.1])
            self.harness.spin_for(seconds / 2)
        self.robot.velocity = np.zeros(6)
        self.robot.joints = home
        self.harness.spin_for(0.1)

    def error(self):
        return np.linalg.norm(ros.from_jacobian(self.jacobians[-1], 3, 6) - self.robot.jacobian)


def test_it_learns_from_motion_and_reset_forgets(ros_test):
    learner = Learner(ros_test, **{"rbf.n1": 3.0})
    at_first = learner.error()
    learner.swing()
    ros_test.spin_until(lambda: int(learner.values()["steps_learned"]) > 5)
    learned = learner.error()
    assert learned < 0.95 * at_first
    assert ros_test.call(Trigger, "fvs_estimator_node/reset").success
    ros_test.spin_for(0.2)
    assert learner.error() == pytest.approx(at_first, rel=1e-2)


def test_frozen_it_does_not_learn(ros_test):
    learner = Learner(ros_test, **{"rbf.n1": 3.0})
    request = SetBool.Request(data=True)
    assert ros_test.call(SetBool, "fvs_estimator_node/freeze", request).success
    ros_test.spin_until(lambda: learner.values()["state"] == "FROZEN")
    at_first = learner.error()
    learner.swing(1.0)
    assert learner.values()["steps_learned"] == "0"
    assert learner.error() == pytest.approx(at_first, rel=1e-2)


def test_what_it_cannot_use_is_said_and_makes_no_jacobian_nonsense(ros_test):
    learner = Learner(ros_test)

    def elsewhere(message):
        message.header.frame_id = "base_link"
        return message

    learner.robot.spoil[topics.BALL_POSITION.name] = elsewhere
    ros_test.spin_until(lambda: "base_link" in learner.statuses[-1].message)
    assert learner.values()["state"] == "FAULT"
    learner.robot.spoil.clear()
    ros_test.spin_until(lambda: learner.values()["state"] == "LEARNING")
    learner.robot.silent.add(topics.BALL_POSITION.name)
    ros_test.spin_until(lambda: "waiting for ball_position" in learner.statuses[-1].message)
    assert all(np.all(np.isfinite(m.data)) for m in learner.jacobians)


def test_every_node_reports_ages_rates_and_jitter(ros_test):
    learner = Learner(ros_test)
    arrays = ros_test.collect(DiagnosticArray, topics.DIAGNOSTICS.name)
    ros_test.spin_until(lambda: len(arrays) > 2)
    values = ros.from_status(arrays[-1].status[0])
    assert arrays[-1].status[0].name == "/fvs_estimator_node"
    assert float(values["joint_states rate_hz"]) == pytest.approx(125.0, rel=0.3)
    assert float(values["ball_position age_s"]) < 0.2
    assert "joint_states jitter_ms" in values
    assert learner.jacobians


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"method": "psychic"}, "method must be one of"),
        ({"feature_frame": "other_frame"}, "other_frame"),
        ({"joint_names": "[a, b, c, d, e, f]"}, "joint"),
        ({"rbf.n1": -1.0}, "rbf.n1 must be"),
    ],
)
def test_a_wrong_parameter_is_one_clear_sentence(ros_test, parameters, words):
    process = ros_test.start_node(MODULE, **parameters)
    assert ros_test.wait(process) == 2
    assert words in ros_test.output(process)
    assert "Traceback" not in ros_test.output(process)
