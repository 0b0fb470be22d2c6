"""Each way of estimating, in its node over DDS."""

from itertools import cycle

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Vector3Stamped
from harness import PlayedRobot
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fvs_ros import ros, topics
from fvs_ros.joints import JointMap
from fvs_sim_node.simulation import SimConfig, Simulation

MODULE = "fvs_estimator_node.node"


class Watched:
    """An estimator node, its Jacobians and statuses."""

    def __init__(self, harness, **parameters):
        self.process = harness.start_node(MODULE, **parameters)
        self.jacobians = harness.collect(Float64MultiArray, topics.JACOBIAN.name)
        self.statuses = harness.collect(DiagnosticStatus, topics.ESTIMATOR_STATUS.name)

    def values(self):
        return ros.from_status(self.statuses[-1]) if self.statuses else {}

    def reason(self):
        return self.statuses[-1].message if self.statuses else ""


@pytest.mark.parametrize("method", ["lkf", "ukf", "rls", "broyden", "oracle"])
def test_at_rest_the_jacobian_is_that_of_the_arm(ros_module, ros_beside, method):
    ros_module.keep("fvs_sim_node.node")
    estimator = Watched(ros_beside, method=method)
    states = ros_beside.collect(JointState, topics.JOINT_STATES.name)
    wanted = "FROZEN" if method == "oracle" else "LEARNING"
    ros_beside.spin_until(lambda: estimator.values().get("state") == wanted)
    ros_beside.spin_until(lambda: states and estimator.jacobians)
    joints = JointMap().positions(states[-1].name, states[-1].position)
    with Simulation(SimConfig()) as simulation:
        true = simulation.true_jacobian(joints)
    error = np.linalg.norm(ros.from_jacobian(estimator.jacobians[-1], 3, 6) - true)
    assert error < (1e-6 if method == "oracle" else 0.05) * np.linalg.norm(true)
    assert estimator.values()["method"] == method
    if method != "oracle":
        assert float(estimator.values()["updates"]) == float(estimator.values()["refused"]) == 0.0


def test_the_oracle_is_silent_without_a_simulator_that_tells_it(ros_test):
    robot = PlayedRobot(ros_test)
    robot.silent.add(topics.JACOBIAN.name)
    oracle = Watched(ros_test, method="oracle", model_path="not_needed.npz")
    ros_test.spin_until(lambda: "waiting for fvs_sim_node/true_jacobian" in oracle.reason())
    assert "only a simulator knows the true Jacobian" in oracle.reason()
    assert oracle.values()["state"] == "WAITING"
    assert not oracle.jacobians

    truth = ros_test.publisher(Float64MultiArray, topics.TRUE_JACOBIAN.name)
    teller = ros_test.node.create_timer(
        0.008, lambda: truth.publish(ros.to_jacobian(robot.jacobian))
    )
    ros_test.spin_until(lambda: oracle.jacobians and oracle.values()["state"] == "FROZEN")
    np.testing.assert_array_equal(ros.from_jacobian(oracle.jacobians[-1], 3, 6), robot.jacobian)

    # What was true a moment ago is not handed on as if it were of now.
    teller.cancel()
    ros_test.spin_until(lambda: oracle.values()["state"] == "WAITING")
    heard = len(oracle.jacobians)
    ros_test.spin_for(0.4)
    assert len(oracle.jacobians) == heard


def test_from_zero_it_learns_without_a_model(ros_test):
    robot = PlayedRobot(ros_test)
    robot.silent.add(topics.JACOBIAN.name)
    estimator = Watched(
        ros_test,
        method="lkf",
        model_path="not_needed.npz",
        **{"online.initial": "zero", "online.initial_deviation_m_rad": 0.5},
    )
    ros_test.spin_until(
        lambda: estimator.statuses and "has seen no motion" in estimator.statuses[-1].message
    )
    assert not estimator.jacobians
    for joint in range(5):
        robot.velocity = 0.3 * np.eye(6)[joint]
        ros_test.spin_for(0.4)
    robot.velocity = np.zeros(6)
    ros_test.spin_until(lambda: float(estimator.values()["updates"]) > 10.0)
    error = ros.from_jacobian(estimator.jacobians[-1], 3, 6) - robot.jacobian
    assert np.linalg.norm(error) < 0.1 * np.linalg.norm(robot.jacobian)
    assert 0.0 < float(estimator.values()["entry_deviation_m_rad"]) < 0.5


def test_a_missing_model_is_one_clear_sentence(ros_test):
    process = ros_test.start_node(MODULE, method="ukf", model_path="nowhere.npz")
    assert ros_test.wait(process) == 2
    assert "model_path" in ros_test.output(process)
    assert "Traceback" not in ros_test.output(process)


def test_another_method_is_chosen_while_the_controller_rests_and_at_no_other_time(ros_test):
    robot = PlayedRobot(ros_test)
    robot.silent.add(topics.JACOBIAN.name)
    estimator = Watched(ros_test, method="rbf")
    ros_test.spin_until(lambda: estimator.values().get("state") == "LEARNING")
    sliding = ros_test.publisher(Vector3Stamped, topics.SLIDING_VARIABLE.name)
    servoes = ros_test.node.create_timer(0.02, lambda: sliding.publish(Vector3Stamped()))

    def choose(method):
        values = [Parameter("method", value=method).to_parameter_msg()]
        service = "fvs_estimator_node/set_parameters"
        return ros_test.call(
            SetParameters, service, SetParameters.Request(parameters=values)
        ).results[0]

    others = cycle(("lkf", "rls"))  # the first may be chosen before the controller is heard

    def is_refused():
        answer = choose(next(others))
        return not answer.successful and "call its ~/stop first" in answer.reason

    ros_test.spin_until(is_refused, what="a refusal in motion")
    servoes.cancel()
    ros_test.spin_until(lambda: choose("poe").successful, what="poe")
    chains = ros_test.collect(Float64MultiArray, topics.KINEMATIC_CHAIN.name)
    ros_test.spin_until(lambda: chains and estimator.values()["method"] == "poe")
    assert choose("oracle").successful
    truth = ros_test.publisher(Float64MultiArray, topics.TRUE_JACOBIAN.name)
    count = len(estimator.jacobians)

    def tells_the_truth():
        truth.publish(ros.to_jacobian(robot.jacobian))
        new = estimator.jacobians[count:]
        return new and np.array_equal(ros.from_jacobian(new[-1], 3, 6), robot.jacobian)

    ros_test.spin_until(tells_the_truth, what="the true Jacobian")
