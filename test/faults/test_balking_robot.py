"""The robot does not do as it is told, or says odd things: pauses, scaling, limits, joints."""

import numpy as np
from rig import CONTROLLER, SIMULATOR, VELOCITY
from std_srvs.srv import Trigger

from fvs_ros.joints import HOME_JOINTS_RAD, UR_JOINT_NAMES


def test_a_paused_program_is_zeros_at_once_and_needs_a_start_after_it(rig):
    rig.servo()
    since_s = rig.set(SIMULATOR, program_running=False)
    rig.assert_stops(since_s, 0.05)
    rig.assert_says("HOLDING", "PROGRAM_STOPPED", "program is not running", "~/start")
    rig.wait(lambda: rig.estimator("state") == "FROZEN", what="the learning to be frozen")
    learned = rig.estimator("steps_learned")
    refusal = rig.harness.call(Trigger, f"{CONTROLLER}/start")
    assert not refusal.success
    assert "program is not running" in refusal.message
    rig.assert_stands()
    rig.set(SIMULATOR, program_running=True)
    rig.assert_says("HOLDING", "PAUSE_OVER", "call ~/start")
    assert rig.estimator("steps_learned") == learned
    rig.assert_needs_a_start()
    rig.assert_settles()


def test_speed_scaling_of_zero_is_zeros_at_once_and_needs_a_start_after_it(rig):
    rig.servo()
    since_s = rig.set(SIMULATOR, speed_scaling_percent=0.0)
    rig.assert_stops(since_s, 0.1 + 0.05)  # it is told ten times a second
    rig.assert_says("HOLDING", "SPEED_SCALING_ZERO", "0 %", "~/start")
    rig.set(SIMULATOR, speed_scaling_percent=100.0)
    rig.assert_says("HOLDING", "PAUSE_OVER", "call ~/start")
    rig.assert_needs_a_start()
    rig.assert_settles()


def test_speed_scaling_of_a_third_is_slower_and_arrives(rig):
    rig.set(SIMULATOR, speed_scaling_percent=30.0)
    rig.servo()
    fastest = 0.0

    def there():
        nonlocal fastest
        fastest = max(fastest, rig.arm_speed())
        return rig.reason() == "SETTLED"

    rig.wait(there, 20.0, "SETTLED")
    assert fastest < 0.35 * VELOCITY
    rig.assert_settles()


def test_an_arm_that_silently_does_not_follow_is_noticed_and_held(rig):
    rig.servo()
    rig.set(SIMULATOR, announce_program_running=False)
    since_s = rig.set(SIMULATOR, program_running=False)
    rig.assert_says("HOLDING", "NOT_FOLLOWING", "does not follow", "_joint", "~/start")
    rig.wait(rig.standing, what="zeros")
    # About a second of servoing; longer where a busy machine interrupts it.
    rig.assert_stops(since_s, 5.0)
    rig.set(SIMULATOR, program_running=True)
    rig.assert_needs_a_start()
    rig.assert_settles()


def test_a_joint_that_is_nan_is_zeros_at_once_until_it_is_a_number_again(rig):
    rig.servo()
    since_s = rig.set(SIMULATOR, nan_joint="wrist_1_joint")
    rig.assert_stops(since_s, 0.05)
    rig.assert_says("FAULT", "BAD_INPUT", "not finite", "wrist_1_joint")
    rig.set(SIMULATOR, nan_joint="")
    rig.assert_goes_on_by_itself()
    rig.assert_settles()


def test_joints_never_pass_their_limits_and_the_status_names_the_one_that_is_there(rig):
    room_rad = 0.12
    home = np.array(HOME_JOINTS_RAD)
    rig.set(CONTROLLER, joint_min_rad=list(home - room_rad), joint_max_rad=list(home + room_rad))
    rig.servo()
    furthest = 0.0

    def stuck():
        nonlocal furthest
        furthest = max(furthest, float(np.abs(rig.joints() - home).max()))
        return rig.reason() == "STALLED"

    rig.wait(lambda: stuck() or "range of" in rig.value("active_limit"), what="a limit")
    assert any(name in rig.value("active_limit") for name in UR_JOINT_NAMES)
    rig.wait(stuck, 40.0, "STALLED")
    rig.assert_says("HOLDING", "STALLED", "end of its range")
    rig.wait(rig.standing, what="zeros")
    stuck()
    assert 0.8 * room_rad < furthest < room_rad + 1e-3


def test_a_gripper_among_shuffled_joints_at_500_hz_changes_nothing(make_rig):
    rig = make_rig(
        wires=(),
        simulator={
            "joint_state_rate_hz": 500,
            "physics_rate_hz": 500,
            "joint_state_order": "shuffled",
            "extra_joints": "finger_joint a_thumb_joint",
        },
        controller={"tick_rate_hz": 500.0},
    )
    rig.servo()
    rig.assert_settles()
    assert len(rig.states[-1].name) == 8
    rig.wait(lambda: rig.reason() == "SETTLED", what="SETTLED")


def test_an_input_that_stops_while_the_arm_is_slowed_still_ramps(rig):
    """A ramp is a ramp from any speed: no step to zero for a stale input."""
    rig.set(SIMULATOR, speed_scaling_percent=50.0)
    rig.servo()
    said = len(rig.commands)
    rig.wires["jacobian"].silent = True
    rig.assert_says("HOLDING", "STALE", "jacobian")
    rig.wait(rig.standing, what="zeros")
    down = [command.speed for command in rig.commands[said:]]
    last = max(speed for speed in down[-200:] if speed > 0.0)
    assert min(speed for speed in down if speed > 0.0) < 0.5 * last
