"""A servo from Python: what it refuses, and when the arm rests."""

from dataclasses import replace

import numpy as np
import pytest
from cases import each

from fvs_controller_node.reasons import Reason, State
from fvs_ros import Servo, SimConfig, Simulation

MODEL, URDF = "models/ur5_front.npz", "robots/ur5.urdf"
EXACT = SimConfig(rendered=False, position_noise_m=0.001)


class Arm:
    """A simulated arm that a servo moves; what it reads may be spoilt."""

    def __init__(self, config=EXACT, **values):
        self.simulation = Simulation(config)
        self.servo = Servo.load(MODEL, urdf=URDF, **values)

    def run(self, seconds, spoil=lambda joints, z: (joints, z)):
        for _ in range(round(125 * seconds)):
            arm = self.simulation.advance()
            joints, _ = spoil(arm.joints_rad, None)
            for image in arm.observations:
                self.servo.see(image.stamp_s, spoil(None, image.z)[1])
            self.servo.observe(arm.time_s, joints)
            self.command = self.servo.command()
            if self.command is not None:
                self.simulation.command(self.command)
        return self.servo.status


@pytest.fixture
def moving():
    """An arm in mid-motion."""
    arm = Arm()
    arm.run(0.3)
    arm.servo.set_target(arm.servo.feature + [0.0, 0.2, 0.1])
    assert arm.run(0.2).state is State.SERVOING
    assert arm.command.any()
    yield arm
    arm.simulation.close()


def bad_joints(joints, z):
    return (None if joints is None else joints * np.nan), z


def few_joints(joints, z):
    return (None if joints is None else joints[:5]), z


def turned_joints(joints, z):
    return (None if joints is None else joints + 1.0), z


def bad_ball(joints, z):
    return joints, (None if z is None else z * np.nan)


def flat_ball(joints, z):
    return joints, (None if z is None else z[:2])


@each(
    ("spoil", "words"),
    [
        (bad_joints, "not finite for"),
        (few_joints, "5 positions for 6 names"),
        (turned_joints, "jumped by 1.00 rad"),
        (bad_ball, "the ball is not finite"),
        (flat_ball, "shape (2,), expected (3,)"),
    ],
)
def test_what_cannot_be_used_stops_the_arm_at_once_and_is_said(moving, spoil, words):
    moving.run(0.04 if "ball" in words or "shape" in words else 0.008, spoil)
    assert not moving.command.any()
    assert moving.servo.status.reason is Reason.BAD_INPUT
    assert words in moving.servo.status.text
    moving.run(1.5)
    assert moving.servo.settled


def test_an_arm_whose_joints_fall_silent_ramps_to_rest_and_goes_on_with_them(moving):
    status = moving.run(0.3, lambda joints, z: (None, z))
    assert status.reason is Reason.STALE
    assert not moving.command.any()
    moving.run(1.5)
    assert moving.servo.settled


@each("observes", [True, False])
def test_a_driver_that_hangs_stops_the_arm(moving, observes):
    stamp_s, joints_rad = moving.simulation.time_s, moving.simulation.joints_rad
    for _ in range(40):
        if observes:
            moving.servo.observe(stamp_s, joints_rad)
        command = moving.servo.command()
    assert moving.servo.status.reason is Reason.STALE
    assert not command.any()
    moving.run(1.5)
    assert moving.servo.settled


def test_a_jacobian_asked_for_elsewhere_changes_no_command(moving):
    other = Arm()
    other.run(0.3)
    other.servo.set_target(other.servo.feature + [0.0, 0.2, 0.1])
    assert other.servo.jacobian(np.zeros(6)).shape == (3, 6)
    other.run(0.2)
    assert np.array_equal(other.command, moving.command)
    other.simulation.close()


def test_a_stop_needs_a_start(moving):
    moving.servo.stop()
    moving.run(0.5)
    assert not moving.command.any()
    moving.servo.start()
    moving.run(1.5)
    assert moving.servo.settled


def test_positions_are_sent_in_a_session_only():
    arm = Arm(replace(EXACT, command_interface="position"), command_interface="position")
    arm.run(0.3)
    assert arm.command is None
    arm.servo.set_target(arm.servo.feature + [0.0, 0.1, 0.0])
    arm.run(1.5)
    assert arm.servo.settled
    assert np.abs(arm.command - arm.simulation.joints_rad).max() < 0.01
    arm.servo.stop()
    arm.run(0.5)
    assert arm.command is None
    arm.simulation.close()


def test_what_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="did you mean max_joint_velocity_rad_s"):
        Servo.load(MODEL, max_joint_velocity=1.0)
    with pytest.raises(ValueError, match=r"made for feature ball .* expected pose"):
        Servo.load(MODEL, feature="pose")
    with pytest.raises(ValueError, match=r"known are .*METHOD"):
        Servo.load(MODEL, "poe+nothing")
    with pytest.raises(ValueError, match=r"so101\.urdf has no joint elbow_joint"):
        Servo.load(MODEL, urdf="robots/so101.urdf")
    with pytest.raises(FileNotFoundError, match=r"nowhere\.npz"):
        Servo.load("nowhere.npz")
    servo = Servo.load(MODEL, "lkf+proportional")
    servo.see(0.0, None)  # what saw nothing
    for target, words in (
        ([0.0, 0.0, 9.0], "workspace"),
        ([0.0, 1.0], "shape"),
        ([np.nan] * 3, "finite"),
    ):
        with pytest.raises(ValueError, match=words):
            servo.set_target(target)
    with pytest.raises(ValueError, match="stamp_s must be a finite time"):
        servo.observe(np.nan, np.zeros(6))
    with pytest.raises(ValueError, match="camera 1 is none of"):
        servo.see(0.0, [0.0, 0.0, 1.0], camera=1)
    with pytest.raises(ValueError, match="expected 6 finite joints"):
        servo.jacobian([0.0])
    with pytest.raises(ValueError, match="dt_s must be a finite time"):
        servo.command(np.nan)
    with pytest.raises(ValueError, match="not started: no joint_states"):
        servo.start()
    assert not servo.command().any()
