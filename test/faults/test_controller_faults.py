"""The controller against everything that goes wrong: what was on the wire, and what it said."""

import math
import signal
import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from harness import PlayedRobot
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from fvs_ros.core import ros
from fvs_ros.core.status import ESTIMATOR_WAITING

MODULE = "fvs_controller_node.node"
VELOCITY, ACCELERATION = 0.5, 6.0
FAR = (0.25, -0.15, 0.1)
#: From a fault to zeros: 0.2 s, the ramp, and what a busy machine adds.
STOP_S = 0.2 + VELOCITY / ACCELERATION + 0.15


class Bench:
    """A controller among played neighbours."""

    def __init__(self, harness, **parameters):
        self.harness = harness
        self.robot = PlayedRobot(harness)
        self.process = harness.start_node(
            MODULE,
            max_joint_velocity_rad_s=VELOCITY,
            max_joint_acceleration_rad_s2=ACCELERATION,
            **parameters,
        )
        self.statuses = harness.collect(DiagnosticStatus, "fvs_controller_node/status")
        self.target = harness.publisher(PointStamped, ros.TARGET_POSITION, ros.QOS_LATCHED)
        harness.spin_until(lambda: self.reason() == "NO_TARGET", what="all inputs")

    def reason(self):
        return ros.from_status(self.statuses[-1]).get("reason") if self.statuses else None

    def state(self):
        return ros.from_status(self.statuses[-1]).get("state") if self.statuses else None

    def text(self):
        return self.statuses[-1].message

    def wait(self, condition, timeout_s=10.0, what="the condition"):
        self.harness.spin_until(condition, timeout_s, what)

    def start(self):
        response = self.harness.call(Trigger, "fvs_controller_node/start")
        assert response.success, response.message

    def servo(self):
        self.robot.give_target(self.target, FAR)
        self.wait(lambda: self.state() == "READY", what="READY")
        self.start()
        self.wait(self.robot.moving, what="motion")

    def assert_stops(self, since_s):
        self.wait(self.robot.standing, what="zeros")
        first_zero_s = next(t for t, m in self.robot.commands if t > since_s and not np.any(m.data))
        assert first_zero_s - since_s < STOP_S

    def assert_keeps_sending_zeros(self, seconds=0.3):
        count = len(self.robot.commands)
        self.harness.spin_for(seconds)
        since = self.robot.commands[count:]
        assert len(since) > 10 * seconds
        assert not any(np.any(m.data) for _, m in since)


@pytest.fixture
def bench(ros_test):
    return Bench(ros_test)


def assert_commands_are_sound(commands):
    for _, message in commands:
        assert len(message.data) == 6
        assert all(math.isfinite(value) for value in message.data)
        assert max(abs(value) for value in message.data) <= VELOCITY + 1e-12


def test_nothing_moves_before_it_is_told_to_and_then_the_ball_arrives(bench):
    bench.assert_keeps_sending_zeros()
    response = bench.harness.call(Trigger, "fvs_controller_node/start")
    assert not response.success
    assert "target" in response.message
    target = bench.robot.give_target(bench.target, FAR)
    bench.wait(lambda: bench.state() == "READY", what="READY")
    bench.assert_keeps_sending_zeros()
    bench.start()
    bench.wait(lambda: np.linalg.norm(bench.robot.ball - target) < 0.003, what="the ball there")
    assert bench.state() == "SERVOING"
    assert_commands_are_sound(bench.robot.commands)
    assert max(np.abs(m.data).max() for _, m in bench.robot.commands) > 0.3


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_in_motion_leaves_zeros_on_the_wire(bench, number):
    bench.servo()
    assert bench.harness.stop(bench.process, number) == 0
    bench.harness.spin_for(0.2)
    last = [m.data for _, m in bench.robot.commands[-3:]]
    assert len(last) == 3
    assert not np.any(last)


@pytest.mark.parametrize("topic", [ros.JOINT_STATES, ros.BALL_POSITION, ros.JACOBIAN])
def test_an_input_that_stops_holds_the_arm_until_it_is_back(bench, topic):
    bench.servo()
    bench.robot.silent.add(topic)
    since_s = time.monotonic()
    limit_s = 0.1 if topic == ros.JOINT_STATES else 0.2
    bench.wait(bench.robot.standing, what="zeros")
    assert time.monotonic() - since_s < limit_s + STOP_S
    bench.wait(lambda: bench.state() == "HOLDING", what="HOLDING")
    assert topic in bench.text()
    bench.assert_keeps_sending_zeros()
    bench.robot.silent.clear()
    bench.wait(lambda: bench.state() == "SERVOING", what="SERVOING again")


@pytest.mark.parametrize("topic", [ros.JOINT_STATES, ros.BALL_POSITION])
def test_a_frozen_stream_with_old_stamps_holds_the_arm(bench, topic):
    bench.servo()
    stamp = ros.to_stamp(bench.robot._now_s())

    def freeze(message):
        message.header.stamp = stamp
        return message

    bench.robot.spoil[topic] = freeze
    since_s = time.monotonic()
    bench.wait(bench.robot.standing, what="zeros")
    assert time.monotonic() - since_s < 0.2 + STOP_S
    bench.wait(lambda: "do not advance" in bench.text(), what="the reason")
    assert topic in bench.text()
    bench.robot.spoil.clear()
    bench.wait(lambda: bench.state() == "SERVOING", what="SERVOING again")


def test_a_target_is_heard_again_after_another_took_its_place(bench):
    target = bench.robot.ball + np.array([0.1, 0.0, 0.0])
    point = ros.to_point(0.0, PlayedRobot.FRAME, target)
    values = lambda: ros.from_status(bench.statuses[-1])  # noqa: E731
    bench.target.publish(point)
    bench.wait(lambda: values()["target_x_m"] == f"{target[0]:.5g}", what="the target")
    bench.harness.spin_for(0.6)
    assert bench.harness.call(Trigger, "fvs_controller_node/set_current_as_target").success
    bench.wait(lambda: values()["target_x_m"] != f"{target[0]:.5g}", what="the current position")
    bench.target.publish(point)
    bench.wait(lambda: values()["target_x_m"] == f"{target[0]:.5g}", what="the target again")


def test_a_latched_target_that_is_delivered_once_more_undoes_no_later_one(bench):
    target = bench.robot.ball + np.array([0.1, 0.0, 0.0])
    point = ros.to_point(bench.robot._now_s(), PlayedRobot.FRAME, target)
    values = lambda: ros.from_status(bench.statuses[-1])  # noqa: E731
    bench.target.publish(point)
    bench.wait(lambda: values()["target_x_m"] == f"{target[0]:.5g}", what="the target")
    assert bench.harness.call(Trigger, "fvs_controller_node/set_current_as_target").success
    bench.wait(lambda: values()["target_x_m"] != f"{target[0]:.5g}", what="the current position")
    chosen = values()["target_x_m"]
    bench.target.publish(point)  # the same message, as a latched one comes again
    bench.harness.spin_for(0.3)
    assert values()["target_x_m"] == chosen


def spoilt_joints(message):
    message.position[2] = float("nan")
    return message


def spoilt_ball(message):
    message.point.y = float("inf")
    return message


def spoilt_jacobian(message):
    message.data = [float("nan")] * 18
    return message


def short_jacobian(message):
    message.data = [0.1] * 17
    return message


def ball_elsewhere(message):
    message.header.frame_id = "base_link"
    return message


def unknown_joints(message):
    message.name = [*message.name[:5], "wrist_4_joint"]
    return message


@pytest.mark.parametrize(
    ("topic", "spoil", "words"),
    [
        (ros.JOINT_STATES, spoilt_joints, "not finite"),
        (ros.JOINT_STATES, unknown_joints, "lacks"),
        (ros.BALL_POSITION, spoilt_ball, "not finite"),
        (ros.BALL_POSITION, ball_elsewhere, "base_link"),
        (ros.JACOBIAN, spoilt_jacobian, "not finite"),
        (ros.JACOBIAN, short_jacobian, "17 values"),
    ],
)
def test_an_input_that_cannot_be_used_is_zeros_and_a_reason(bench, topic, spoil, words):
    bench.servo()
    bench.robot.spoil[topic] = spoil
    bench.assert_stops(time.monotonic())
    bench.wait(lambda: bench.state() == "FAULT", what="FAULT")
    assert topic in bench.text()
    assert words in bench.text()
    bench.assert_keeps_sending_zeros()
    assert_commands_are_sound(bench.robot.commands)


@pytest.mark.parametrize(
    ("offset", "frame", "words"),
    [
        ((5.0, 0.0, 0.0), PlayedRobot.FRAME, "workspace"),
        ((0.1, 0.0, 0.0), "base_link", "base_link"),
    ],
)
def test_a_target_out_of_the_workspace_or_in_another_frame_is_refused(bench, offset, frame, words):
    point = ros.to_point(1.0, frame, bench.robot.ball + np.array(offset))
    bench.target.publish(point)
    bench.wait(lambda: "target refused" in bench.text(), what="a refusal")
    assert words in bench.text()
    bench.assert_keeps_sending_zeros()


def test_a_paused_program_needs_a_new_start(bench):
    running = bench.harness.node.create_publisher(Bool, ros.ROBOT_PROGRAM_RUNNING, ros.QOS_LATCHED)
    bench.servo()
    running.publish(Bool(data=False))
    bench.assert_stops(time.monotonic())
    bench.wait(lambda: bench.reason() == "PROGRAM_STOPPED", what="the reason")
    assert not bench.harness.call(Trigger, "fvs_controller_node/start").success
    running.publish(Bool(data=True))
    bench.wait(lambda: bench.reason() == "PAUSE_OVER", what="the pause to be over")
    bench.assert_keeps_sending_zeros()
    bench.start()
    bench.wait(bench.robot.moving, what="motion")


def test_where_the_estimator_gives_no_jacobian_the_controller_says_why_in_its_words(bench):
    why = "the image does not fit the arm's motion: its stamps are too late by about 0.15 s"
    estimator = bench.harness.publisher(DiagnosticStatus, ros.ESTIMATOR_STATUS, ros.QOS_RELIABLE)
    bench.servo()
    bench.robot.silent.add(ros.JACOBIAN)
    bench.assert_stops(time.monotonic())
    estimator.publish(ros.to_status(ros.WARN, "", "a remark", {"state": "LEARNING"}))
    bench.wait(lambda: "is the estimator running?" in bench.text(), what="no word of a remark")
    estimator.publish(ros.to_status(ros.WARN, "", why, {"state": ESTIMATOR_WAITING}))
    bench.wait(lambda: f"the estimator says: {why}" in bench.text(), what="the estimator's words")
    assert bench.reason() == "STALE"
    # What it said of itself is no reason for ever: it may have died since.
    bench.wait(lambda: "is the estimator running?" in bench.text(), what="the usual question")
    bench.assert_keeps_sending_zeros()


def test_a_jacobian_of_the_wrong_sign_is_noticed_and_held(bench):
    bench.robot.spoil[ros.JACOBIAN] = lambda m: ros.to_jacobian(-bench.robot.jacobian)
    bench.harness.spin_for(0.2)
    bench.robot.give_target(bench.target, FAR)
    bench.wait(lambda: bench.state() == "READY", what="READY")
    bench.start()
    bench.wait(lambda: bench.reason() == "ERROR_GROWING", what="ERROR_GROWING")
    bench.wait(bench.robot.standing, what="zeros")
    bench.assert_keeps_sending_zeros()
    assert "start" in bench.text()


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"law": "pid"}, "law must be one of"),
        ({"max_joint_velocity_rad_s": -1.0}, "max_joint_velocity_rad_s must be number from"),
        ({"sigma": 0.3}, "sigma must be"),
        ({"lambda1": 0.2, "lambda2": 0.3}, "lambda"),
        ({"alpha_1": 1.0}, "unknown parameter alpha_1"),
    ],
)
def test_a_wrong_parameter_is_one_clear_sentence_and_nothing_moves(ros_test, parameters, words):
    robot = PlayedRobot(ros_test)
    process = ros_test.start_node(MODULE, autostart=True, **parameters)
    assert ros_test.wait(process) == 2
    output = ros_test.output(process)
    assert words in output
    assert "Traceback" not in output
    assert not any(np.any(m.data) for _, m in robot.commands)
