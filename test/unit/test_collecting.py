import numpy as np
import pytest

from fvs_estimator_node.collecting import CollectionRun, RunConfig, State
from fvs_estimator_node.knowledge import Findings, Knowledge, NothingYet, Trouble
from fvs_estimator_node.motion import MotionConfig, RandomMotion
from fvs_ros.joints import UR_JOINT_NAMES

HOME = np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0])
DT_S = 0.008
VELOCITY, ACCELERATION, DURATION_S = 0.65, 3.0, 20.0


class Cell:
    """A collection run with an ideal arm, on a clock of its own."""

    def __init__(self, duration_s=DURATION_S, signs=(1.0,) * 6, lag_s=0.0, knowledge=None):
        motion = MotionConfig(
            duration_s=duration_s,
            joint_range_rad=(0.3,) * 6,
            max_joint_velocity_rad_s=VELOCITY,
            max_joint_acceleration_rad_s2=ACCELERATION,
        )
        self.run = CollectionRun(
            RunConfig(VELOCITY, ACCELERATION, give_up_s=3.0),
            lambda start: RandomMotion(start, motion, np.random.default_rng(0)),
            knowledge,
        )
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


@pytest.mark.parametrize("joint", range(6))
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
    assert cell.now_s - began_s < 0.7  # with the ramp to rest
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


def test_an_arm_that_lags_finishes_though_the_ball_and_the_joint_states_come_and_go():
    cell = Cell(lag_s=0.05)
    rng = np.random.default_rng(1)
    while not cell.run.ended and cell.now_s < 3.0 * DURATION_S:
        cell.ball_seen, cell.joints_come = rng.random() > 0.3, rng.random() > 0.1
        cell.advance(0.5)
    assert cell.run.state is State.DONE, cell.run.reason


def test_joint_states_lost_at_the_very_end_do_not_lose_the_data():
    cell = Cell()
    cell.advance(DURATION_S - 2.0)
    cell.follows = False  # so that it is away from home when the time is over
    cell.run.speed_scaling(0.01)  # and slow because it was told to be
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


def test_a_commander_without_a_name_is_waited_for_and_later_stops_the_arm():
    cell = Cell()
    nameless = ["a node whose name is not known yet"]
    cell.run.rivals(nameless)
    cell.advance(1.0)
    assert cell.run.state is State.WAITING
    assert "not known yet commands the arm as well" in cell.run.reason
    cell.run.rivals([])
    cell.advance(0.5)
    for names in (nameless, nameless, [], nameless, nameless):
        cell.run.rivals(names)
        cell.advance(0.25)
        assert cell.run.state is State.MOVING
    cell.run.rivals(nameless)
    assert cell.run.state is State.FAILED
    assert "not known yet began to command the arm" in cell.run.reason


def test_a_second_node_of_the_own_name_stops_the_arm():
    cell = Cell()
    cell.advance(1.0)
    cell.run.rivals(["another /fvs_collector_node"])
    assert cell.run.state is State.FAILED


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


class Examiner:
    """Gives the answers of a list, each after a while; a number is a deviation."""

    def __init__(self, *answers):
        self.answers, self.ticks = list(answers), 50
        self.questions = []
        self.left = 0
        self.rng = np.random.default_rng(2)

    def ask(self, question):
        assert self.left == 0
        self.questions.append(question)
        self.left = self.ticks

    def answer(self):
        self.left -= 1
        if self.left > 0 or not self.answers:
            self.left = max(self.left, 1)
            return None
        said = self.answers.pop(0)
        course = self.questions[-1].motion.draw(self.rng)
        if said == "no chain":
            return Findings(0.001, 2.0, 0.01, False, course)
        if said == "cannot be told":
            return Findings(0.001, np.nan, 0.01, False, course)
        return Findings(said, 1.0, 0.01, True, course) if isinstance(said, float) else said


def learning(*answers, duration_s=120.0):
    """A cell that stops at 1 %, and who is asked."""
    examiner = Examiner(*answers)
    cell = Cell(duration_s, knowledge=Knowledge(0.01, examiner))
    return cell, examiner


def assert_within_limits(cell):
    commands = np.array(cell.commands)
    assert np.abs(commands).max() <= VELOCITY + 1e-12
    assert np.abs(np.diff(commands, axis=0)).max() <= ACCELERATION * DT_S + 1e-12


def test_it_comes_home_softly_when_the_chain_is_known_twice_in_a_row():
    cell, examiner = learning(0.03, 0.009, 0.02, 0.008, 0.007)
    cell.advance(28.0)
    assert cell.run.reason == "moving and recording"
    cell.advance(1.5)
    assert cell.run.reason == "coming home: Jacobian known to 0.7 %"
    assert cell.run.state is State.MOVING
    cell.advance(4.0)
    assert cell.run.state is State.DONE
    assert cell.run.ended
    assert cell.run.reason == "finished: Jacobian known to 0.7 %"
    assert np.abs(cell.joints - HOME).max() < 0.05
    assert cell.run.progress == 1.0
    assert len(examiner.questions) == 5
    assert_within_limits(cell)


def test_it_asks_every_few_seconds_and_tells_each_sample_once():
    cell, examiner = learning(*[0.5] * 3)
    cell.advance(30.0)
    times = [question.time_s for question in examiner.questions]
    np.testing.assert_allclose(times, [12.0, 16.0, 20.0, 24.0], atol=0.05)
    told = [sample for question in examiner.questions for sample in question.samples]
    assert all(a is b for a, b in zip(told, cell.run.samples, strict=False))
    assert len(told) > 23.5 * 31


def test_what_cannot_be_told_is_not_said_to_be_known():
    knowledge = Knowledge(0.01, Examiner(*["cannot be told"] * 4))
    cell = Cell(120.0, knowledge=knowledge)
    cell.advance(30.0)
    assert cell.run.reason == "moving and recording"
    assert knowledge.words().startswith("Jacobian known to 0.1 % if this is a serial chain")


def test_the_motion_changes_over_to_what_was_found():
    cell, _ = learning(0.5)
    same = Cell(120.0)
    cell.advance(12.2)
    same.advance(12.2)
    np.testing.assert_array_equal(cell.commands, same.commands)
    cell.advance(5.0)
    same.advance(5.0)
    assert np.abs(cell.joints - same.joints).max() > 0.05
    assert_within_limits(cell)


@pytest.mark.parametrize(
    "between", [NothingYet(), "no chain", 0.02], ids=["no fit", "no chain", "not known"]
)
def test_one_good_answer_or_one_that_does_not_fit_is_not_enough(between):
    cell, examiner = learning(0.005, between, 0.005, between)
    cell.advance(30.0)
    assert len(examiner.questions) == 5
    assert cell.run.state is State.MOVING
    assert cell.run.reason == "moving and recording"


@pytest.mark.parametrize("answers", [(), (Trouble("the process died"),)], ids=["hangs", "dies"])
def test_without_answers_the_arm_moves_as_if_nobody_had_been_asked(answers):
    cell, examiner = learning(*answers)
    same = Cell(120.0)
    cell.advance(24.0)
    same.advance(24.0)
    np.testing.assert_array_equal(cell.commands, same.commands)
    assert len(examiner.questions) == 1
    assert cell.run.state is State.MOVING
    assert ("for the whole duration: the process died" in cell.run.reason) == bool(answers)


@pytest.mark.parametrize("seed", range(2))
def test_answers_at_any_time_keep_the_limits(seed):
    rng = np.random.default_rng(seed)
    cell, examiner = learning(*[0.5] * 100, duration_s=60.0)
    while not cell.run.ended and cell.now_s < 150.0:
        cell.ball_seen, cell.joints_come = rng.random() > 0.1, rng.random() > 0.1
        examiner.ticks = int(rng.integers(1, 300))
        cell.advance(0.6)
        low, high = HOME - 0.3, HOME + 0.3
        assert np.all((cell.joints > low - 0.05) & (cell.joints < high + 0.05))
    assert cell.run.state is State.DONE, cell.run.reason
    assert len(examiner.questions) > 5
    assert_within_limits(cell)


def test_known_well_enough_with_the_ball_lost_on_the_way_home_it_still_finishes():
    cell, _ = learning(0.005, 0.005)
    cell.advance(17.5)
    assert cell.run.reason.startswith("coming home")
    cell.ball_seen = False
    cell.advance(4.0)
    assert cell.run.state is State.DONE
    assert cell.run.reason == "finished: Jacobian known to 0.5 %"
