"""The estimator with a fitted chain over DDS: what it publishes, and a camera that is turned."""

from dataclasses import replace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from recordings import Recording, relative_error, turn
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from fvs_estimator_node.distilling import train_structured
from fvs_estimator_node.model_file import save_model
from fvs_ros import ros, topics
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.joints import UR_JOINT_NAMES

MODULE = "fvs_estimator_node.node"
RECORDING = Recording(seconds=20.0, outliers=0.0, late_s=0.0)


@pytest.fixture(scope="module")
def trained():
    return train_structured(RECORDING.data(), neurons=20)


@pytest.fixture(scope="module")
def model_path(trained, tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "model.npz"
    save_model(path, trained)
    return path


class MovingArm:
    """An arm that moves on its own before a noisy camera, and says so on the topics."""

    def __init__(self, harness):
        self.chain = RECORDING.chain()
        self._rng = np.random.default_rng(0)
        self._path = RECORDING.joints(np.arange(1500) / 125.0)
        self._at = 0
        self.moving = True
        self._harness = harness
        node = harness.node
        self._states = node.create_publisher(JointState, topics.JOINT_STATES.name, ros.QOS_RELIABLE)
        self._balls = node.create_publisher(
            PointStamped, topics.BALL_POSITION.name, ros.QOS_RELIABLE
        )
        node.create_timer(0.008, self._tell_joints)
        node.create_timer(1.0 / 30.0, self._tell_ball)

    @property
    def joints(self):
        return self._path[self._at]

    def _now_s(self):
        return self._harness.node.get_clock().now().nanoseconds * 1e-9

    def _tell_joints(self):
        if self.moving:
            self._at = (self._at + 1) % len(self._path)
        message = ros.to_joint_state(self._now_s(), UR_JOINT_NAMES, self.joints, np.zeros(6))
        self._states.publish(message)

    def _tell_ball(self):
        seen = self.chain.position(self.joints) + 0.001 * self._rng.normal(size=3)
        self._balls.publish(ros.to_point(self._now_s(), CAMERA_FRAME, seen))


def error_of(chain, arm):
    places = RECORDING.places(50)
    true = arm.chain.jacobian(places)
    return float(np.median(relative_error(chain.jacobian(places), true)))


def test_chain_and_jacobian_are_those_of_the_arm_and_follow_a_turned_camera(ros_test, model_path):
    arm = MovingArm(ros_test)
    ros_test.start_node(MODULE, method="poe", model_path=model_path)
    chains = ros_test.collect(Float64MultiArray, topics.KINEMATIC_CHAIN.name)
    jacobians = ros_test.collect(Float64MultiArray, topics.JACOBIAN.name)
    statuses = ros_test.collect(DiagnosticStatus, topics.ESTIMATOR_STATUS.name)

    def told(key):
        return float(ros.from_status(statuses[-1])[key]) if statuses else 0.0

    def at_rest():
        arm.moving = False
        heard = len(jacobians)
        ros_test.spin_until(lambda: len(jacobians) > heard + 8)
        arm.moving = True
        return relative_error(
            ros.from_jacobian(jacobians[-1], 3, 6), arm.chain.jacobian(arm.joints)
        )

    ros_test.spin_until(lambda: chains and jacobians and told("updates") > 20.0)
    assert error_of(ros.from_chain(chains[-1], 6), arm) < 0.02
    assert at_rest() < 0.02

    arm.chain = arm.chain.moved(turn([0.1, 0.3, 1.0], np.radians(45.0)), np.array([0.1, 0.0, 0.2]))
    assert error_of(ros.from_chain(chains[-1], 6), arm) > 0.5
    ros_test.spin_until(lambda: error_of(ros.from_chain(chains[-1], 6), arm) < 0.02)
    assert at_rest() < 0.05
    joints = RECORDING.places(20)
    now = ros.from_chain(chains[-1], 6)
    np.testing.assert_allclose(now.position(joints), arm.chain.position(joints), atol=0.03)
    assert told("camera_turned_deg") == pytest.approx(45.0, abs=3.0)
    assert told("camera_bumps") >= 1.0

    arm.moving = False
    assert ros_test.call(Trigger, "fvs_estimator_node/reset").success
    ros_test.spin_until(lambda: error_of(ros.from_chain(chains[-1], 6), arm) > 0.5)


def test_who_has_just_started_hears_of_the_chain_of_an_arm_at_rest(ros_test, model_path):
    arm = MovingArm(ros_test)
    arm.moving = False
    ros_test.start_node(MODULE, method="poe", model_path=model_path)
    jacobians = ros_test.collect(Float64MultiArray, topics.JACOBIAN.name)
    ros_test.spin_until(lambda: jacobians)
    late = ros_test.collect(Float64MultiArray, topics.KINEMATIC_CHAIN.name)
    ros_test.spin_until(lambda: len(late) > 3)
    assert error_of(ros.from_chain(late[-1], 6), arm) < 0.01
    shape = [(dim.label, dim.size) for dim in late[-1].layout.dim]
    assert shape == [("joint", 7), ("axis_point_reference", 7)]


def test_what_the_training_found_wrong_is_said_when_the_model_is_loaded(ros_test, trained):
    notes = ["the ball does not move on a rigid chain", 7]
    path = ros_test.folder / "doubtful.npz"
    save_model(path, replace(trained, provenance={**trained.provenance, "notes": notes}))
    MovingArm(ros_test)
    process = ros_test.start_node(MODULE, method="poe", model_path=path)
    ros_test.spin_until(lambda: "doubtful.npz: 7" in ros_test.output(process))
    assert "doubtful.npz: the ball does not move on" in ros_test.output(process)


def test_without_a_chain_there_is_none_on_the_wire(ros_test, model_path):
    MovingArm(ros_test)
    ros_test.start_node(MODULE, method="rbf_left", model_path=model_path)
    chains = ros_test.collect(Float64MultiArray, topics.KINEMATIC_CHAIN.name)
    statuses = ros_test.collect(DiagnosticStatus, topics.ESTIMATOR_STATUS.name)
    ros_test.spin_until(lambda: statuses and float(ros.from_status(statuses[-1])["updates"]) > 10.0)
    ros_test.spin_for(0.5)
    assert ros.from_status(statuses[-1])["method"] == "rbf_left"
    assert not chains


def test_a_model_without_a_chain_is_one_clear_sentence(ros_test, trained):
    bare = ros_test.folder / "bare.npz"
    save_model(bare, replace(trained, chain=None))
    process = ros_test.start_node(MODULE, method="poe", model_path=bare)
    assert ros_test.wait(process) == 2
    assert "method poe needs a fitted chain" in ros_test.output(process)
    assert "fvs_train --method poe" in ros_test.output(process)
    assert "Traceback" not in ros_test.output(process)


# --- the message ---
