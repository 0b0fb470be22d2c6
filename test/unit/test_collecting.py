import numpy as np
import pytest

from fvs_estimator_node.collecting import CollectionRun, RunConfig, State
from fvs_estimator_node.motion import MotionConfig, RandomMotion

HOME = np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0])
DT_S = 0.008
VELOCITY, ACCELERATION, DURATION_S = 0.65, 3.0, 20.0


class Cell:
    """A collection run with an ideal arm, on a clock of its own."""

    def __init__(self, duration_s=DURATION_S):
        motion = MotionConfig(
            duration_s=duration_s,
            joint_range_rad=(0.3,) * 6,
            max_joint_velocity_rad_s=VELOCITY,
            max_joint_acceleration_rad_s2=ACCELERATION,
        )
        self.run = CollectionRun(
            RunConfig(VELOCITY, ACCELERATION, give_up_s=3.0),
            lambda start: RandomMotion(start, motion, np.random.default_rng(0)),
        )
        self.now_s, self.joints = 0.0, HOME.copy()
        self.commands = []
        self.joints_come = self.ball_seen = self.follows = True
        self.ticks = 0

    def advance(self, seconds):
        for _ in range(round(seconds / DT_S)):
            self.now_s += DT_S
            self.ticks += 1
            if self.joints_come:
                self.run.joint_states(self.now_s, self.now_s, self.joints.copy())
            if self.ball_seen and self.ticks % 4 == 0:
                position = np.array([0.1, 0.2, 1.4]) + 0.3 * self.joints[:3]
                self.run.ball(self.now_s, self.now_s - 0.04, position)
            command = self.run.tick(self.now_s, DT_S)
            self.commands.append(command)
            if self.follows:
                self.joints = self.joints + DT_S * command
        return self.run.state


def test_a_run_moves_records_and_comes_home():
    cell = Cell()
    assert cell.advance(0.1) is State.WAITING
    assert not np.any(cell.commands)
    cell.advance(DURATION_S + 4.0)
    assert cell.run.state is State.DONE
    assert cell.run.ended
    assert cell.run.progress == 1.0
    assert np.abs(cell.joints - HOME).max() < 0.05
    assert len(cell.run.samples) > 0.8 * DURATION_S * 31
    commands = np.array(cell.commands)
    assert np.abs(commands).max() <= VELOCITY + 1e-12
    assert np.abs(np.diff(commands, axis=0)).max() <= ACCELERATION * DT_S + 1e-12


def test_without_joint_states_the_arm_stops_and_goes_on_when_they_are_back():
    cell = Cell()
    cell.advance(5.0)
    cell.joints_come = False
    cell.advance(0.5)
    assert cell.run.state is State.HOLDING
    assert "joint_states" in cell.run.reason
    assert not np.any(cell.commands[-1])
    cell.joints_come = True
    cell.advance(0.5)
    assert cell.run.state is State.MOVING
    assert np.any(cell.commands[-1])


def test_a_lost_ball_sends_the_arm_home_until_it_is_seen_again():
    cell = Cell()
    cell.advance(5.0)
    away = np.abs(cell.joints - HOME).max()
    cell.ball_seen = False
    cell.advance(2.0)
    assert cell.run.state is State.RETURNING
    assert np.abs(cell.joints - HOME).max() < 0.5 * away
    cell.ball_seen = True
    cell.advance(1.0)
    assert cell.run.state is State.MOVING


@pytest.mark.parametrize("what", ["joints_come", "ball_seen"])
def test_a_trouble_that_lasts_ends_the_run_at_rest(what):
    cell = Cell()
    cell.advance(5.0)
    setattr(cell, what, False)
    cell.advance(5.0)
    assert cell.run.state is State.FAILED
    assert cell.run.ended
    assert "gave up" in cell.run.reason
    assert not np.any(cell.commands[-1])


def test_an_arm_that_does_not_move_as_told_ends_the_run_and_says_so():
    cell = Cell()
    cell.follows = False
    cell.advance(6.0)
    assert cell.run.state is State.FAILED
    assert "does not follow" in cell.run.reason
    assert "velocity controller is active" in cell.run.reason
    assert not np.any(cell.commands[-1])


def test_joint_states_lost_at_the_very_end_do_not_lose_the_data():
    cell = Cell()
    cell.advance(DURATION_S - 2.0)
    cell.follows = False  # so that it is away from home when the time is over
    cell.advance(2.5)
    cell.joints_come = False
    cell.advance(5.0)
    assert cell.run.state is State.DONE
    assert "not back at the start" in cell.run.reason
    assert len(cell.run.samples) > 0.8 * DURATION_S * 31


def test_it_waits_while_another_node_commands_the_arm():
    cell = Cell()
    cell.run.rivals(["/fvs_controller_node"])
    cell.advance(1.0)
    assert cell.run.state is State.WAITING
    assert "/fvs_controller_node commands the arm as well" in cell.run.reason
    assert not np.any(cell.commands)
    cell.run.rivals([])
    cell.advance(0.5)
    assert cell.run.state is State.MOVING
    cell.run.rivals(["/fvs_controller_node"])
    cell.advance(1.0)
    assert cell.run.state is State.FAILED
    assert not np.any(cell.commands[-1])


def test_failing_from_outside_brings_the_arm_to_rest():
    cell = Cell()
    cell.advance(5.0)
    cell.run.fail("the robot program is not running")
    cell.advance(1.0)
    assert cell.run.ended
    assert not np.any(cell.commands[-1])
    assert cell.run.reason == "the robot program is not running"


@pytest.mark.parametrize("dt_s", [DT_S, 0.0])
def test_a_frozen_stream_of_joint_states_stops_the_arm(dt_s):
    """The same joints and stamp again and again, in real time and in simulated time."""
    cell = Cell()
    cell.advance(5.0)
    stamp_s, joints = cell.now_s, cell.joints.copy()
    for _ in range(100):
        cell.now_s += DT_S
        cell.run.joint_states(cell.now_s, stamp_s, joints)
        command = cell.run.tick(cell.now_s, dt_s)
    assert not np.any(command)
    assert cell.run.state is State.HOLDING


def test_failing_comes_to_rest_though_simulated_time_stands_still():
    cell = Cell()
    cell.advance(5.0)
    cell.run.fail("asked")
    for _ in range(100):
        cell.now_s += DT_S
        cell.run.tick(cell.now_s, 0.0)
    assert cell.run.ended
