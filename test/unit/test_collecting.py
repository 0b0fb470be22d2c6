import numpy as np
import pytest

from fvs_estimator_node.collecting import GIVE_UP_S, CollectionRun, CollectorConfig, State
from fvs_estimator_node.stopping import StopCriterion
from fvs_ros.joints import UR_JOINT_NAMES

HOME = np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0])
DT_S = 0.008
VELOCITY, ACCELERATION, DURATION_S = 0.65, 3.0, 20.0


class Cell:
    """A collection run with an ideal arm, on a clock of its own."""

    def __init__(self, duration_s=DURATION_S, signs=(1.0,) * 6, lag_s=0.0, stop=None):
        config = CollectorConfig(
            duration_s=duration_s,
            joint_range_rad=(0.3,) * 6,
            max_joint_velocity_rad_s=VELOCITY,
            max_joint_acceleration_rad_s2=ACCELERATION,
        )
        self.run = CollectionRun(config, stop=stop)
        self.now_s, self.joints = 0.0, HOME.copy()
        self.signs, self.share = np.array(signs), DT_S / (lag_s + DT_S)
        self.speed = np.zeros(6)
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
                self.speed = self.speed + self.share * (command - self.speed)
                self.joints = self.joints + DT_S * self.signs * self.speed
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
    cell.advance(GIVE_UP_S + 2.0)
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


@pytest.mark.parametrize("joint", [0, 3, 5])
def test_a_joint_that_runs_opposite_to_its_command_ends_the_run_before_it_gets_far(joint):
    signs = np.ones(6)
    signs[joint] = -1.0
    cell = Cell(signs=signs, lag_s=0.035)
    furthest, began_s = 0.0, None
    while cell.now_s < 10.0 and not cell.run.ended:
        cell.advance(DT_S)
        away = abs(cell.joints[joint] - HOME[joint])
        furthest = max(furthest, away)
        if began_s is None and away > 0.003:
            began_s = cell.now_s
    assert cell.run.state is State.FAILED
    assert "moves against its command" in cell.run.reason
    assert UR_JOINT_NAMES[joint] in cell.run.reason
    assert furthest < 0.1
    assert cell.now_s - began_s < 0.8  # with the ramp to rest
    assert not np.any(cell.commands[-1])


@pytest.mark.parametrize("state", [State.MOVING, State.RETURNING, State.HOLDING])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_joint_outside_its_box_ends_the_run_at_once(state, side):
    cell = Cell()
    cell.advance(5.0)
    cell.ball_seen = state is not State.RETURNING
    cell.joints_come = state is not State.HOLDING
    cell.advance(0.7)
    assert cell.run.state is state
    cell.joints_come = True
    cell.joints[2] = HOME[2] + side * 0.39
    cell.advance(DT_S)
    assert cell.run.state is not State.FAILED
    cell.joints[2] = HOME[2] + side * 0.41
    cell.advance(DT_S)
    assert cell.run.state is State.FAILED
    assert "elbow_joint left its box" in cell.run.reason
    assert f"is at {HOME[2] + side * 0.41:.2f} rad, the box is 1.30 to 1.90 rad" in cell.run.reason
    cell.advance(1.0)
    assert cell.run.ended
    assert not np.any(cell.commands[-1])


def test_joint_states_lost_at_the_very_end_do_not_lose_the_data():
    cell = Cell()
    cell.advance(DURATION_S - 2.0)
    cell.follows = False  # so that it is away from home when the time is over
    cell.run.speed_scaling(0.01)  # and slow because it was told to be
    cell.advance(2.5)
    cell.joints_come = False
    cell.advance(GIVE_UP_S + 2.0)
    assert cell.run.state is State.DONE
    assert "not back at the start" in cell.run.reason
    assert len(cell.run.samples) > 0.8 * DURATION_S * 31


def test_it_waits_while_another_node_commands_the_arm():
    cell = Cell()
    cell.run.other_publishers(["/fvs_controller_node"])
    cell.advance(1.0)
    assert cell.run.state is State.WAITING
    assert "/fvs_controller_node commands the arm as well" in cell.run.reason
    assert not np.any(cell.commands)
    cell.run.other_publishers([])
    cell.advance(0.5)
    assert cell.run.state is State.MOVING
    cell.run.other_publishers(["/fvs_controller_node"])
    cell.advance(1.0)
    assert cell.run.state is State.FAILED
    assert not np.any(cell.commands[-1])


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


class KnownAfter(StopCriterion):
    """Has enough after a time, or trouble."""

    def __init__(self, enough_s=np.inf, trouble=""):
        super().__init__(0.01)
        self.enough_s, self.said = enough_s, trouble

    def look(self, time_s, samples, box_rad):
        self.found = {"jacobian_deviation": 0.007, "misfit": 1.0, "is_chain": True}
        self.enough, self.trouble = time_s >= self.enough_s, self.said


@pytest.mark.parametrize("ball_seen", [True, False], ids=["", "the ball lost on the way"])
def test_it_comes_home_softly_when_the_chain_is_known(ball_seen):
    cell = Cell(120.0, stop=KnownAfter(17.0))
    cell.advance(16.5)
    assert cell.run.reason == "moving and recording"
    cell.advance(1.0)
    assert cell.run.reason == "coming home: Jacobian known to 0.7 %"
    assert cell.run.state is State.MOVING
    cell.ball_seen = ball_seen
    cell.advance(4.0)
    assert cell.run.state is State.DONE
    assert cell.run.reason == "finished: Jacobian known to 0.7 %"
    assert np.abs(cell.joints - HOME).max() < 0.05
    assert cell.run.progress == 1.0
    commands = np.array(cell.commands)
    assert np.abs(commands).max() <= VELOCITY + 1e-12
    assert np.abs(np.diff(commands, axis=0)).max() <= ACCELERATION * DT_S + 1e-12
