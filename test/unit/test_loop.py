"""What the controller's loop thinks of joint states before anything else."""

import numpy as np
import pytest

from fvs_controller_node.config import default_values
from fvs_controller_node.loop import ServoLoop
from fvs_controller_node.reasons import Reason
from fvs_ros.chain import SerialChain

HOME = np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0])
DT_S = 0.008
FRAME = "camera_color_optical_frame"
JACOBIAN = np.eye(3, 6) * 0.5
_DRAWN = np.random.default_rng(2)
CHAIN = SerialChain(_DRAWN.normal(size=(6, 3)), _DRAWN.normal(size=(6, 3)), np.ones(3), HOME)


class Cell:
    """A loop that hears everything at 125 Hz."""

    def __init__(self, **values):
        self.loop = ServoLoop(default_values(**values))
        self.now_s, self.joints, self.jacobian = 10.0, HOME.copy(), JACOBIAN

    def tick(self, joints=None, ball=True):
        self.now_s += DT_S
        self.loop.add_jacobian(self.now_s, self.jacobian)
        self.loop.add_joints(self.now_s, self.now_s, self.joints if joints is None else joints)
        if ball:
            self.loop.add_ball(self.now_s, self.now_s - 0.02, np.array([0.0, 0.0, 1.0]))
        return self.loop.tick(self.now_s, DT_S)

    def begin(self):
        for _ in range(20):
            self.tick()
        assert self.loop.supervisor.goal.set(np.array([0.2, 0.1, 1.2]), FRAME)[0]
        assert self.loop.supervisor.start(self.now_s)[0]
        for _ in range(20):
            command = self.tick()
        assert command.velocity_rad_s.any()


@pytest.fixture
def servoing():
    cell = Cell()
    cell.begin()
    return cell


def test_a_joint_that_jumps_is_zeros_at_once_and_named(servoing):
    command = servoing.tick(HOME + np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.0]))
    assert command.reason is Reason.BAD_INPUT
    assert not command.velocity_rad_s.any()
    assert "elbow_joint jumped by 0.50 rad in 0.008 s" in command.text


@pytest.fixture
def reading():
    """A loop whose law reads chains, on its way, and the chains that law was shown."""
    cell = Cell(law="minimum_time")
    cell.jacobian = CHAIN.jacobian(HOME)
    cell.begin()
    seen, law = [], cell.loop.law
    asked = law.command
    law.command = lambda one: (seen.append(one.chain), asked(one))[1]
    return cell, seen


def test_a_chain_that_is_told_no_more_is_used_no_more(reading):
    cell, seen = reading
    cell.loop.add_chain(cell.now_s, CHAIN)
    cell.tick()
    assert seen[-1] is CHAIN
    for _ in range(round(1.6 / DT_S)):
        cell.tick()
    assert seen[-1] is None


def test_a_bad_chain_is_told_by_its_name_and_held_until_good_ones_come_or_none(reading):
    cell, _ = reading
    loop = cell.loop
    for heals in (lambda: loop.add_chain(cell.now_s, CHAIN), lambda: None):
        loop.bad_chain(cell.now_s, "it is no chain")
        command = cell.tick()
        assert command.reason is Reason.BAD_INPUT
        assert command.text.startswith("kinematic_chain is not usable: it is no chain")
        assert not command.velocity_rad_s.any()
        for _ in range(round(1.6 / DT_S)):
            heals()
            command = cell.tick()
        assert command.velocity_rad_s.any()


def test_a_moving_target_is_tracked_and_the_watch_on_its_error_goes_on(servoing):
    loop = servoing.loop
    first = np.array([0.2, 0.1, 1.2])
    for k in range(12):
        servoing.tick()
        assert loop.add_target(first + [0.002 * k, 0.0, 0.0], FRAME, servoing.now_s)[0]
    servoing.tick()
    # 2 mm every 8 ms is a quarter of a metre a second: by now it has gone on
    np.testing.assert_allclose(loop.supervisor.goal.target_m, first + [0.024, 0.0, 0.0], atol=1e-6)
    velocity = loop.target.at(servoing.now_s).velocity_m_s
    np.testing.assert_allclose(velocity, [0.25, 0.0, 0.0], atol=1e-6)
    stands, text = loop.add_target(np.array([0.0, 0.0, 9.0]), FRAME, servoing.now_s)
    assert not stands
    assert "workspace" in text
    velocity = loop.target.at(servoing.now_s).velocity_m_s
    np.testing.assert_allclose(velocity, [0.25, 0.0, 0.0], atol=1e-6)


def test_the_current_position_as_target_stands_also_while_the_target_moves(servoing):
    loop = servoing.loop
    for k in range(12):
        servoing.tick()
        assert loop.add_target(np.array([0.05 + 0.002 * k, 0.0, 1.0]), FRAME, servoing.now_s)[0]
    assert loop.set_current_as_target(servoing.now_s)[0]
    here = loop.supervisor.goal.target_m
    for _ in range(40):
        servoing.tick()
        np.testing.assert_array_equal(loop.supervisor.goal.target_m, here)


@pytest.mark.parametrize("moves", [False, True])
def test_an_overtaken_target_is_passed_over_whether_the_newer_one_stands_or_moves(servoing, moves):
    loop, newer = servoing.loop, np.array([0.1, 0.0, 1.1])
    now_s = servoing.now_s
    if moves:
        assert loop.add_target(newer - [0.01, 0.0, 0.0], FRAME, now_s - 0.05)[0]
    assert loop.add_target(newer, FRAME, now_s)[0]
    accepted, text = loop.add_target(newer - [0.03, 0.0, 0.0], FRAME, now_s - 0.1)
    assert accepted
    assert text == "target ignored: a newer one has arrived"
    assert not loop.add_target(newer - [0.03, 0.0, 0.0], "another_frame", now_s - 0.1)[0]
    for _ in range(50):
        servoing.tick()
    np.testing.assert_allclose(loop.supervisor.goal.target_m, newer, atol=1e-9)


def test_the_posture_to_come_back_to_is_that_of_the_last_start(servoing):
    loop, told = servoing.loop, []
    command = loop.law.command
    loop.law.command = lambda one: (told.append(one.home_rad), command(one))[1]
    servoing.joints = HOME + 0.05
    servoing.tick()
    np.testing.assert_array_equal(told[-1], HOME)
    loop.supervisor.inputs["joint_states"].bad("a hold that ends by itself")
    for _ in range(20):
        servoing.tick()
    np.testing.assert_array_equal(told[-1], HOME)
    loop.supervisor.stop()
    for _ in range(50):
        servoing.tick()
    assert loop.supervisor.start(servoing.now_s)[0]
    servoing.tick()
    np.testing.assert_array_equal(told[-1], HOME + 0.05)


def test_beyond_the_workspace_the_arm_does_not_follow_a_target(servoing):
    loop, follows = servoing.loop, []
    command = loop.law.command
    loop.law.command = lambda one: (follows.append(one.feed_forward_rad_s), command(one))[1]
    edge_m = loop.supervisor.config.workspace_max_m[0]
    for k in range(10):
        at = np.array([edge_m - 0.003 * (9 - k), 0.0, 1.2])
        assert loop.add_target(at, FRAME, servoing.now_s)[0]
        servoing.tick()
    assert follows[-2] is not None  # while it was inside
    assert follows[-1] is None  # by now it would be outside
    assert loop.supervisor.goal.target_m[0] <= edge_m
