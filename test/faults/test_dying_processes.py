"""A process dies in mid-motion, politely or not: what the arm does, and what a restart does."""

import signal
import time

from rig import BUSY_S, CONTROLLER, ESTIMATOR, RAMP_S, SIMULATOR, VELOCITY
from std_srvs.srv import Trigger


def test_an_estimator_that_is_killed_holds_the_arm_and_a_new_one_moves_it_on(rig):
    rig.servo()
    since_s = rig.kill(ESTIMATOR)
    rig.assert_says("HOLDING", "STALE", "jacobian", "is the estimator running?")
    rig.assert_stops(max(since_s, rig.last_said("jacobian")), 0.2 + RAMP_S)
    rig.restart(ESTIMATOR)
    rig.assert_goes_on_by_itself()
    rig.assert_settles()


def test_a_simulator_that_is_killed_leaves_zeros_and_a_new_one_is_taken_up(rig):
    rig.servo()
    since_s = rig.kill(SIMULATOR)
    rig.assert_says("HOLDING", "STALE", "joint_states", "robot driver")
    rig.assert_stops(max(since_s, rig.last_said("joint_states")), 0.1 + RAMP_S)
    rig.restart(SIMULATOR)
    rig.assert_goes_on_by_itself()
    rig.assert_settles()


def test_a_controller_that_is_terminated_leaves_a_standing_arm(rig):
    rig.servo()
    since_s = time.time()
    assert rig.harness.stop(rig.processes[CONTROLLER], signal.SIGTERM) == 0
    rig.wait(lambda: rig.arm_speed() < 1e-3, what="the arm to stand")
    last = rig.commands[-3:]
    assert all(command.zero for command in last)
    moving_s = max(command.sent_s for command in rig.commands if not command.zero)
    assert moving_s - since_s < BUSY_S


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
    rig.wait(lambda: len(rig.commands) > count, what="commands again")
    assert rig.commands[count].zero
    rig.wait(lambda: rig.arm_speed() < 1e-3, what="the arm to stand")
    # The runaway may have taken the ball out of view. Apart from that, the target is latched and
    # everything is fresh: a start is all that it lacks.
    assert rig.harness.call(Trigger, f"{SIMULATOR}/reset").success
    rig.wait(lambda: len(rig.statuses) > statuses and rig.state() == "READY", what="READY")
    assert all(command.zero for command in rig.commands[count:])
    rig.assert_needs_a_start()
    rig.assert_settles()
