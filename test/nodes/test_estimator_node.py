"""The estimator over DDS, beside the simulator or a played robot: what it says, learns, refuses."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped, Vector3Stamped
from harness import PlayedRobot, Statuses
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from fvs_estimator_node.files import load_model, save_model
from fvs_ros import ros, topics
from fvs_ros.joints import JointMap
from fvs_ros.kinds.ball import Ball
from fvs_ros.paths import find_file
from fvs_sim_node.simulation import SimConfig, Simulation

NAME = "fvs_estimator_node"
MODULE = f"{NAME}.node"


class Watched(Statuses):
    """An estimator node, its Jacobians and statuses."""

    def __init__(self, harness, **parameters):
        super().__init__(harness, NAME)
        self.process = harness.start_node(MODULE, **parameters)
        self.jacobians = harness.collect(Float64MultiArray, topics.JACOBIAN.name)

    def number(self, key):
        return float(self.value(key) or "nan")

    def jacobian(self):
        """One from now on."""
        count = len(self.jacobians)
        self.wait(lambda: len(self.jacobians) > count + 2, what="a Jacobian")
        return ros.from_jacobian(self.jacobians[-1], 6)

    def choose(self, method):
        return self.harness.set_parameters(NAME, method=method)[0]


def test_by_every_method_the_jacobian_is_that_of_the_arm_often_enough(ros_test):
    ros_test.start_node("fvs_sim_node.node")
    balls = ros_test.collect(PointStamped, Ball.topics.tool.name)
    states = ros_test.collect(JointState, topics.JOINT_STATES.name)
    estimator = Watched(ros_test)
    estimator.wait(lambda: states and balls and estimator.jacobians)
    before = len(estimator.jacobians), len(balls)
    ros_test.spin_for(0.5)
    assert len(estimator.jacobians) - before[0] >= len(balls) - before[1]
    shape = [(dim.label, dim.size) for dim in estimator.jacobians[-1].layout.dim]
    assert shape == [("feature", 3), ("joint", 6)]
    with Simulation(SimConfig()) as simulation:
        true = simulation.true_jacobian(JointMap().positions(states[-1].name, states[-1].position))
    for method in ("rbf", "lkf", "ukf", "rls", "rbf_left", "poe"):
        assert estimator.choose(method).successful
        estimator.wait(lambda method=method: estimator.value("method") == method)
        estimator.wait_for("LEARNING")
        error = np.linalg.norm(estimator.jacobian() - true)
        assert error < 0.05 * np.linalg.norm(true), method


def test_it_learns_from_motion_unless_frozen_and_a_reset_forgets(ros_test):
    robot = PlayedRobot(ros_test)
    robot.silent.add(topics.JACOBIAN.name)
    estimator = Watched(ros_test, **{"rbf.n1": 3.0})
    estimator.wait_for("LEARNING")
    home = robot.joints.copy()

    def error():
        return np.linalg.norm(estimator.jacobian() - robot.jacobian)

    program = ros_test.publisher(Bool, topics.ROBOT_PROGRAM_RUNNING.name, ros.QOS_LATCHED)

    def freeze(frozen):
        request = SetBool.Request(data=frozen)
        assert ros_test.call(SetBool, f"{NAME}/freeze", request).success

    def stop_program(stopped):
        program.publish(Bool(data=not stopped))

    def swing(seconds):
        for sign in (1.0, -1.0):
            robot.velocity = sign * np.array([0.2, -0.1, 0.15, 0.1, -0.2, 0.1])
            ros_test.spin_for(seconds / 2)
        robot.velocity, robot.joints = np.zeros(6), home
        ros_test.spin_for(0.1)

    at_first = error()
    for pause in (freeze, stop_program):
        pause(True)
        estimator.wait_for("FROZEN")
        swing(0.6)
        assert estimator.value("steps_learned") == "0"
        assert error() == pytest.approx(at_first, rel=1e-2)
        pause(False)
    swing(2.0)
    estimator.wait(lambda: estimator.number("steps_learned") > 5)
    assert error() < 0.95 * at_first
    assert ros_test.call(Trigger, f"{NAME}/reset").success
    assert error() == pytest.approx(at_first, rel=1e-2)

    # What it cannot use is said, and makes no nonsense of the Jacobian.
    def elsewhere(message):
        message.header.frame_id = "base_link"

    robot.spoil[Ball.topics.tool.name] = elsewhere
    estimator.wait_for("FAULT", "base_link")
    robot.spoil.clear()
    estimator.wait_for("LEARNING")
    robot.silent.add(Ball.topics.tool.name)
    estimator.wait(lambda: "waiting for ball_position" in estimator.text())
    assert all(np.all(np.isfinite(m.data)) for m in estimator.jacobians)


def test_another_method_is_chosen_while_the_controller_rests_and_one_without_model_waits(ros_test):
    robot = PlayedRobot(ros_test)
    robot.silent.add(topics.JACOBIAN.name)
    estimator = Watched(ros_test, **{"online.initial": "zero"})
    estimator.wait_for("LEARNING")
    sliding = ros_test.publisher(Vector3Stamped, Ball.topics.sliding.name)
    servoes = ros_test.node.create_timer(0.02, lambda: sliding.publish(Vector3Stamped()))
    ros_test.spin_for(0.1)
    answer = estimator.choose("lkf")
    assert not answer.successful
    assert "call its ~/stop first" in answer.reason
    servoes.cancel()
    estimator.wait(lambda: estimator.choose("lkf").successful)
    estimator.wait(lambda: "has seen no motion" in estimator.text())
    assert estimator.value("state") == "WAITING"
    count = len(estimator.jacobians)
    ros_test.spin_for(0.4)
    assert len(estimator.jacobians) == count


def test_whoever_comes_late_hears_of_the_chain_and_a_doubtful_model_says_so(ros_test):
    trained, path = load_model(find_file(Ball().model)), ros_test.folder / "doubtful.npz"
    notes = ["the ball does not move on a rigid chain", 7]
    save_model(path, replace(trained, provenance={**trained.provenance, "notes": notes}))
    robot = PlayedRobot(ros_test)
    robot.silent.add(topics.JACOBIAN.name)
    estimator = Watched(ros_test, method="poe", model_path=path)
    jacobian = estimator.jacobian()
    late = ros_test.collect(Float64MultiArray, topics.KINEMATIC_CHAIN.name)
    estimator.wait(lambda: bool(late), what="the chain of an arm at rest")
    shape = [(dim.label, dim.size) for dim in late[-1].layout.dim]
    assert shape == [("joint", 7), ("axis_point_reference", 9)]
    chain = ros.from_chain(late[-1], 6)
    np.testing.assert_allclose(chain.jacobian(robot.joints), jacobian, atol=0.01)
    for words in notes:
        assert f"doubtful.npz: {words}" in ros_test.output(estimator.process)
    # Without a chain there is none on the wire.
    assert estimator.choose("rbf_left").successful
    estimator.wait(lambda: estimator.value("method") == "rbf_left")
    late.clear()
    ros_test.spin_for(0.6)
    assert not late
