"""A real controller beside a played robot: it stops in time, says why, and goes on as promised."""

import math
import time
from functools import partial

import numpy as np
import pytest
from cases import each
from geometry_msgs.msg import PointStamped
from harness import SLOWNESS, PlayedRobot, Statuses
from std_msgs.msg import Bool, Float64MultiArray, MultiArrayDimension
from std_srvs.srv import Trigger

from fvs_ros import ros, topics
from fvs_ros.kinds.ball import Ball

MODULE, NAME = "fvs_controller_node.node", "fvs_controller_node"
VELOCITY, ACCELERATION = 0.5, 5.0
LIMITS = {"max_joint_velocity_rad_s": VELOCITY, "max_joint_acceleration_rad_s2": ACCELERATION}
RAMP_S = VELOCITY / ACCELERATION
#: The supervisor counts a tick for at most this long, s.
LONGEST_TICK_S = 0.05
#: What a busy machine adds to the time between two processes, s.
BUSY_S = 0.3 * SLOWNESS
#: Two targets, m, 0.19 m from where the ball is at first.
TARGETS_M = np.array([[0.15, 0.0, 1.46], [-0.15, 0.2, 1.34]])
JOINTS, JACOBIAN = topics.JOINT_STATES.name, topics.JACOBIAN.name


class Bench(Statuses):
    """A controller among played neighbours."""

    def __init__(self, harness, process=None):
        super().__init__(harness, NAME, ros.QOS_EVERY)
        self.robot = PlayedRobot(harness)
        self.process = process or harness.start_node(MODULE, **LIMITS)
        self.target = harness.publisher(PointStamped, Ball.topics.target.name, ros.QOS_LATCHED)
        self.program = harness.node.create_publisher(
            Bool, topics.ROBOT_PROGRAM_RUNNING.name, ros.QOS_LATCHED
        )
        self.target_m, self.started_s = TARGETS_M[0], math.inf
        self.robot.meet_controller()
        self.wait(lambda: self.reason() in ("NO_TARGET", "READY"), what="all inputs")
        self.robot.commands.clear()  # some may be of an earlier session

    def commands_since(self, since_s):
        """When they were sent, s, and commands, (n, 6), rad/s."""
        since = [(sent_s, m.data) for sent_s, m in self.robot.commands if sent_s > since_s]
        return np.array([sent_s for sent_s, _ in since]), np.array([data for _, data in since])

    def aim(self, target_m):
        self.target_m = np.array(target_m)
        self.target.publish(
            ros.to_feature(self.robot.now_s(), PlayedRobot.FRAME, Ball(), self.target_m)
        )

    def start(self):
        self.started_s = min(self.started_s, time.time())
        # Refused where a busy machine makes an input late just then.
        self.wait(lambda: self.harness.call(Trigger, f"{NAME}/start").success, what="a start")

    def servo(self):
        """Have the ball under way to the target that is further off."""
        self.aim(max(TARGETS_M, key=lambda target: np.linalg.norm(target - self.robot.z)))
        self.wait(lambda: self.value("state") in ("READY", "SERVOING"), what="READY")
        if self.value("state") == "READY":
            self.start()
        self.wait(self.robot.moving, what="motion")

    def assert_stops(self, since_s, within_s=RAMP_S):
        """Zeros in time, and nothing but zeros from then on.

        A controller that gets no processor time sends nothing, and so long it is excused.
        """

        def most_s():
            times_s = self.commands_since(since_s - RAMP_S)[0]
            return within_s + BUSY_S + np.diff(times_s).max(initial=0.0)

        self.wait(lambda: self.robot.commands[-1][0] > since_s + most_s(), what="commands")
        assert not self.commands_since(since_s + most_s())[1].any()
        self.assert_keeps_sending_zeros()

    def assert_keeps_sending_zeros(self):
        count = len(self.robot.commands)
        self.wait(lambda: len(self.robot.commands) > count + 5, what="zeros")
        assert not any(np.any(command.data) for _, command in self.robot.commands[count:])

    def assert_settles(self):
        self.wait(lambda: np.linalg.norm(self.robot.z - self.target_m) < 0.005, what="arrival")
        self.wait(lambda: self.reason() == "SETTLED", what="SETTLED")

    def assert_sound(self):
        """Every command is six finite numbers within the limits, and zeros before a start."""
        times_s, commands = self.commands_since(0.0)
        assert commands.shape[1:] == (6,)
        assert np.abs(commands).max() <= VELOCITY + 1e-9  # false for NaN, too
        assert not commands[times_s < self.started_s].any()
        # A step to zero may be of any size: some faults stop the arm at once.
        steps = np.abs(np.diff(commands, axis=0))[commands[1:].any(axis=1)]
        assert steps.max(initial=0.0) <= ACCELERATION * LONGEST_TICK_S + 1e-9


@pytest.fixture
def bench(ros_module, ros_beside):
    bench = Bench(ros_beside, ros_module.keep(MODULE, **LIMITS))
    yield bench
    bench.assert_sound()


# ---- troubles: what is done to a bench, within which time the arm rests, and what is said ------


def not_a_number(message):
    message.data[7] = math.nan


TROUBLES = [
    (lambda bench: bench.robot.silent.add(JOINTS), 0.1 + RAMP_S, "STALE", "joint_states"),
    (
        lambda bench: bench.robot.spoil.update({JACOBIAN: not_a_number}),
        *(0.0, "BAD_INPUT", "not finite"),
    ),
    (lambda bench: bench.program.publish(Bool(data=False)), 0.0, "PROGRAM_STOPPED", "~/start"),
]


@each(("begin", "within_s", "reason", "words"), TROUBLES)
def test_trouble_stops_the_arm_in_time_with_a_sentence_until_it_is_over(
    bench, begin, within_s, reason, words
):
    bench.servo()
    begin(bench)
    bench.assert_stops(time.time(), within_s)
    bench.wait(lambda: bench.reason() == reason and words in bench.text(), what=reason)
    bench.robot.silent.clear()
    bench.robot.spoil.clear()
    if reason == "PROGRAM_STOPPED":
        bench.program.publish(Bool(data=True))
        bench.assert_keeps_sending_zeros()
        bench.start()
    bench.assert_settles()


# ---- neighbours and operators ------------------------------------------------------------------


def test_another_nodes_commands_hold_the_arm_and_the_node_is_named(bench):
    bench.servo()
    conflicting = bench.harness.node.create_publisher(
        Float64MultiArray, topics.COMMANDS.name, ros.QOS_RELIABLE
    )
    timer = bench.harness.node.create_timer(  # so rarely that the arm still follows the controller
        0.2, lambda: conflicting.publish(ros.to_command(np.full(6, 0.01)))
    )
    bench.wait(lambda: bench.reason() == "CONFLICT", what="CONFLICT")
    assert "/test_node commands the arm as well" in bench.text()
    timer.cancel()
    bench.harness.node.destroy_publisher(conflicting)
    commanders = partial(bench.harness.node.count_publishers, topics.COMMANDS.name)
    bench.wait(lambda: commanders() == 1, what="it to be gone")
    count = len(bench.robot.commands)
    bench.wait(lambda: len(bench.robot.commands) > count + 50, what="its last command")
    bench.robot.commands.clear()  # some are not the controller's
    bench.assert_keeps_sending_zeros()


def test_huge_and_malformed_messages_are_dropped_and_told_in_a_line(bench):
    bench.servo()
    huge = ros.to_feature(0.0, "x" * 10**6, Ball(), bench.robot.z)
    for message in (huge, b"", b"\0\1\0\0" + b"\xff" * 40):
        bench.target.publish(message)
        bench.harness.spin_for(0.05)
    jacobian = Float64MultiArray()
    jacobian.layout.dim = [MultiArrayDimension(label="x" * 100)] * 1000
    publisher = bench.harness.publisher(Float64MultiArray, topics.JACOBIAN.name)
    for _ in range(3):  # best effort: one of them arrives
        publisher.publish(jacobian)
        bench.harness.spin_for(0.05)
    bench.target.publish(ros.to_feature(0.0, "no \x1b[2J frame", Ball(), bench.robot.z))
    bench.wait(lambda: "refused" in bench.text(), what="a target that is small enough to be heard")
    bench.wait_for("SERVOING")
    output = bench.harness.output(bench.process)
    assert "a message was dropped" in output
    assert "no  [2J frame" in output
    assert max(map(len, output.splitlines())) < 1200
    assert not any("dimensions" in status.message for status in bench.statuses)
