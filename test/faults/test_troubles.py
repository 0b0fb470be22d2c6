"""Trouble while the arm moves to and fro: it stops in time, says why, and goes on as promised."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from rig import CONTROLLER, ESTIMATOR, RAMP_S, SIMULATOR, VELOCITY, Rig
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from fvs_ros import ros, topics
from fvs_ros.kinds.ball import Ball

JOINTS, BALL, JACOBIAN = (
    topic.name for topic in (topics.JOINT_STATES, Ball.topics.tool, topics.JACOBIAN)
)
PROGRAM = topics.ROBOT_PROGRAM_RUNNING.name
#: Age from which an input is late, s: the controller's defaults.
JOINTS_S, LATE_S = 0.1, 0.2


@dataclass(frozen=True)
class Trouble:
    """What is done to a rig, how it is mended, and what the arm does and says meanwhile."""

    begin: Callable[[Rig], object]
    end: Callable[[Rig], object]
    within_s: float  # to rest
    says: tuple[str, ...]  # state, reason, and words of the status
    needs_start: bool = False


def wire(topic: str, within_s: float, *says: str, **harm: object) -> Trouble:
    """Trouble on the way of a topic."""
    return Trouble(
        lambda rig: vars(rig.wires[topic]).update(harm), lambda rig: rig.calm(), within_s, says
    )


def late(topic: str, after_s: float, *words: str, **harm: object) -> Trouble:
    """An input whose messages stop, or stop to count."""
    return wire(topic, after_s + RAMP_S, "HOLDING", "STALE", topic, *words, **harm)


def unusable(topic: str, words: str, spoil: Callable) -> Trouble:
    """Messages that cannot be used."""
    return wire(topic, 0.0, "FAULT", "BAD_INPUT", topic, words, spoil=spoil)


def killed(node: str, after_s: float, *words: str) -> Trouble:
    """A node that dies, and is started again."""
    says = ("HOLDING", "STALE", *words)
    return Trouble(
        lambda rig: rig.kill(node), lambda rig: rig.restart(node), after_s + RAMP_S, says
    )


def spoiled(**values: object) -> Callable:
    """A message with one of its numbers or names replaced: ``data=(7, nan)``."""

    def spoil(message):
        for name, (index, value) in values.items():
            getattr(message, name)[index] = value

    return spoil


def elsewhere(message):
    message.header.frame_id = "base_link"


def lose_rank(message):
    message.data[12:18] = message.data[6:12]


def pause_unannounced(rig, paused):
    rig.wires[PROGRAM].silent = True
    rig.set(SIMULATOR, program_running=not paused)


TROUBLES = {
    "joints fall silent": late(JOINTS, JOINTS_S, " s old", "robot driver", silent=True),
    "jacobian falls silent": late(JACOBIAN, LATE_S, "is the estimator running?", silent=True),
    "joint stamps freeze": late(JOINTS, JOINTS_S, "stamps do not advance", freeze="stamp"),
    "ball freezes": late(BALL, LATE_S, "stamps do not advance", "frozen", freeze="message"),
    "ball clock jumps back": wire(
        *(BALL, LATE_S + RAMP_S, "HOLDING", "NO_POSITION", "older", "clocks agree"), shift_s=-1.0
    ),
    "joint unknown": unusable(JOINTS, "lacks", spoiled(name=(2, "wrist_4_joint"))),
    "ball in another frame": unusable(BALL, "base_link", elsewhere),
    "jacobian not a number": unusable(JACOBIAN, "not finite", spoiled(data=(7, math.nan))),
    "jacobian singular": wire(
        JACOBIAN, 0.05 + RAMP_S, "HOLDING", "NEAR_SINGULAR", "0.0000 m/rad", spoil=lose_rank
    ),
    # What was exposed before is under way for 0.04 s, and may be an image period old.
    "lens covered": Trouble(
        lambda rig: rig.set(SIMULATOR, camera_covered=True),
        lambda rig: rig.set(SIMULATOR, camera_covered=False),
        0.08 + LATE_S + RAMP_S,
        ("HOLDING", "STALE", "ball_position", "in view"),
    ),
    "speed scaling 0": Trouble(
        lambda rig: rig.set(SIMULATOR, speed_scaling_percent=0.0),
        lambda rig: rig.set(SIMULATOR, speed_scaling_percent=100.0),
        0.15,
        ("HOLDING", "SPEED_SCALING_ZERO", "0 %", "~/start"),
        needs_start=True,
    ),
    # About a second of servoing; longer where a busy machine interrupts it.
    "arm does not follow": Trouble(
        lambda rig: pause_unannounced(rig, True),
        lambda rig: pause_unannounced(rig, False),
        5.0,
        ("HOLDING", "NOT_FOLLOWING", "_joint", "~/start"),
        needs_start=True,
    ),
    "estimator killed": killed(ESTIMATOR, LATE_S, "jacobian", "is the estimator running?"),
    "simulator killed": killed(SIMULATOR, JOINTS_S, "joint_states", "robot driver"),
}


@pytest.mark.parametrize("name", TROUBLES)
def test_trouble_stops_the_arm_in_time_with_a_sentence_until_it_is_over(rig, name):
    trouble = TROUBLES[name]
    rig.servo()
    trouble.begin(rig)
    rig.assert_stops(time.time(), trouble.within_s)
    rig.assert_says(*trouble.says)
    trouble.end(rig)
    if trouble.needs_start:
        rig.assert_stands()
        rig.start()
    rig.assert_goes_on()


def shuffled(message):
    names = [*message.name, "finger_joint"]
    order = np.random.default_rng().permutation(len(names))
    both = {"position": [*message.position, 0.4], "velocity": [*message.velocity, math.nan]}
    for field, values in both.items():
        setattr(message, field, [values[i] for i in order])
    message.name, message.effort = [names[i] for i in order], []


def others_joints(rig):
    """A gripper's joints among the arm's, and in messages of their own."""
    rig.wires[JOINTS].spoil = shuffled
    message = JointState(name=["finger_joint"], position=[0.4])

    def send():
        message.header.stamp = ros.to_stamp(time.time())
        rig.wires[JOINTS].send(message)

    rig.timers.append(rig.harness.node.create_timer(0.02, send))


def every_wire(rig, topics=(JOINTS, BALL, JACOBIAN), **harm):
    for topic in topics:
        vars(rig.wires[topic]).update(harm)


def slow(rig):
    rig.wires[BALL].delay_s = 0.16  # and the camera's 0.04 s
    rig.set(SIMULATOR, speed_scaling_percent=60.0)


def other_targets(rig):
    rig.send_target((5.0, 0.0, 1.5))
    rig.wait(lambda: "target refused" in rig.text() and "workspace" in rig.text(), what="refusal")
    rig.aim()


def hidden(rig):
    rig.wires[BALL].silent = True
    rig.harness.spin_for(0.1)
    rig.wires[BALL].silent = False


HARMLESS = {
    "messages lost, repeated, swapped": lambda rig: every_wire(rig, loss=0.2, repeat=0.3, swap=0.2),
    "all clocks jump": lambda rig: every_wire(rig, (JOINTS, BALL), shift_s=3600.0),
    "old images of a slowed arm": slow,
    "another device's joints": others_joints,
    "ball hidden for 0.1 s": hidden,
    "targets in mid motion, one too far": other_targets,
}


@pytest.mark.parametrize("name", HARMLESS)
def test_what_is_harmless_neither_stops_the_arm_nor_misses_the_target(rig, name):
    rig.servo()
    HARMLESS[name](rig)
    rig.assert_settles()
    rig.set(SIMULATOR, speed_scaling_percent=100.0)


def test_a_program_that_stops_stops_arm_and_learning_and_refuses_a_start(rig):
    rig.servo()
    rig.set(SIMULATOR, program_running=False)
    rig.assert_stops(time.time(), 0.05)
    rig.assert_says("HOLDING", "PROGRAM_STOPPED", "~/start")
    rig.wait(lambda: rig.estimator("state") == "FROZEN", what="the learning to be frozen")
    learned = rig.estimator("steps_learned")
    refusal = rig.harness.call(Trigger, f"{CONTROLLER}/start")
    assert not refusal.success
    assert "the robot program stopped" in refusal.message
    rig.set(SIMULATOR, program_running=True)
    rig.assert_says("HOLDING", "PROGRAM_STOPPED", "call ~/start")
    rig.assert_stands()
    assert rig.estimator("steps_learned") == learned
    rig.start()
    rig.assert_goes_on()


def test_a_controller_that_is_killed_leaves_the_arm_moving_and_a_new_one_stops_it(rig):
    """The limit of what can be done from here: a velocity controller holds its last command."""
    rig.servo()
    rig.wait(lambda: rig.arm_speed() > 0.3 * VELOCITY, what="the arm to move")
    rig.kill(CONTROLLER)
    rig.harness.spin_for(0.2)
    count, statuses = len(rig.commands), len(rig.statuses)
    rig.harness.spin_for(0.3)
    assert len(rig.commands) == count
    assert rig.arm_speed() > 0.2 * VELOCITY
    rig.restart(CONTROLLER)
    rig.wait(lambda: rig.arm_speed() < 1e-3, what="the arm to stand")
    # The runaway may have taken the ball out of view; apart from that it lacks a start only.
    assert rig.harness.call(Trigger, f"{SIMULATOR}/reset").success
    rig.wait(lambda: len(rig.statuses) > statuses and rig.value("state") == "READY", what="READY")
    assert all(command.zero for command in rig.commands[count:])
    rig.start()
    rig.assert_settles()
