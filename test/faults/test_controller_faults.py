"""A real controller among played neighbours: targets, other commanders, and what it says."""

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped
from harness import PlayedRobot, Statuses
from std_msgs.msg import Float64MultiArray, MultiArrayDimension
from std_srvs.srv import Trigger

from fvs_ros import ros, topics
from fvs_ros.kinds.ball import Ball

MODULE = "fvs_controller_node.node"
VELOCITY, ACCELERATION = 0.5, 6.0
LIMITS = {"max_joint_velocity_rad_s": VELOCITY, "max_joint_acceleration_rad_s2": ACCELERATION}
FAR = (0.25, -0.15, 0.1)
#: From a fault to zeros: 0.2 s, the ramp, and what a busy machine adds.
STOP_S = 0.2 + VELOCITY / ACCELERATION + 0.15


class Bench(Statuses):
    """A controller among played neighbours."""

    def __init__(self, harness, process=None):
        super().__init__(harness, "fvs_controller_node")
        self.robot = PlayedRobot(harness)
        self.process = process or harness.start_node(MODULE, **LIMITS)
        self.target = harness.publisher(PointStamped, Ball.topics.target.name, ros.QOS_LATCHED)
        self.robot.meet_controller()
        self.wait(lambda: self.reason() in ("NO_TARGET", "READY"), what="all inputs")

    def reason(self):
        return self.value("reason")

    def state(self):
        return self.value("state")

    def start(self):
        response = self.harness.call(Trigger, "fvs_controller_node/start")
        assert response.success, response.message

    def servo(self):
        self.robot.give_target(self.target, FAR)
        self.wait_for("READY")
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
def bench(ros_module, ros_beside):
    return Bench(ros_beside, ros_module.keep(MODULE, **LIMITS))


def test_a_target_is_heard_again_but_not_the_same_message_twice(bench):
    target = bench.robot.ball + np.array([0.1, 0.0, 0.0])
    wanted = f"{target[0]:.5g}"
    for stamp_s, heard in ((0.0, True), (bench.robot.now_s(), False)):
        point = ros.to_point(stamp_s, PlayedRobot.FRAME, target)
        bench.target.publish(point)
        bench.wait(lambda: bench.value("target_x_m") == wanted, what="the target")
        bench.harness.spin_for(0.6)
        assert bench.harness.call(Trigger, "fvs_controller_node/set_current_as_target").success
        bench.wait(lambda: bench.value("target_x_m") != wanted, what="the current position")
        bench.target.publish(point)  # with a stamp, it is a latched one delivered once more
        if heard:
            bench.wait(lambda: bench.value("target_x_m") == wanted, what="the target again")
        else:
            bench.harness.spin_for(0.3)
            assert bench.value("target_x_m") != wanted


def test_another_nodes_commands_hold_the_arm_and_the_node_is_named(bench):
    bench.servo()
    conflicting = bench.harness.node.create_publisher(
        Float64MultiArray, topics.COMMANDS.name, ros.QOS_RELIABLE
    )
    timer = bench.harness.node.create_timer(
        0.02, lambda: conflicting.publish(ros.to_command(np.full(6, 0.01)))
    )
    bench.wait(lambda: bench.reason() == "CONFLICT", what="CONFLICT")
    assert "/test_node commands the arm as well" in bench.text()
    timer.cancel()
    bench.harness.node.destroy_publisher(conflicting)
    bench.wait(lambda: "publishes commands as well" not in bench.text(), what="it to be gone")
    bench.assert_keeps_sending_zeros()


def test_huge_and_malformed_messages_are_dropped_and_told_in_a_line(bench):
    bench.servo()
    huge = ros.to_point(0.0, "x" * 10**6, bench.robot.ball)
    for message in (huge, b"", b"\0\1\0\0" + b"\xff" * 40):
        bench.target.publish(message)
        bench.harness.spin_for(0.05)
    jacobian = Float64MultiArray()
    jacobian.layout.dim = [MultiArrayDimension(label="x" * 100)] * 1000
    publisher = bench.harness.publisher(Float64MultiArray, topics.JACOBIAN.name)
    for _ in range(3):  # best effort: one of them arrives
        publisher.publish(jacobian)
        bench.harness.spin_for(0.05)
    bench.target.publish(ros.to_point(0.0, "no \x1b[2J frame", bench.robot.ball))
    bench.wait(lambda: "refused" in bench.text(), what="a target that is small enough to be heard")
    bench.wait_for("SERVOING")
    output = bench.harness.output(bench.process)
    assert "a message was dropped" in output
    assert "no  [2J frame" in output
    assert max(map(len, output.splitlines())) < 1200
    assert not any("dimensions" in status.message for status in bench.statuses)
