"""Targets, chains and postures in the controller's loop, fed at 125 Hz."""

import numpy as np
import pytest
from cases import each

from fvs_controller_node.config import LAWS, default_values
from fvs_controller_node.loop import ServoLoop
from fvs_ros.chain import SerialChain
from fvs_ros.kinds.ball import Ball

HOME = np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0])
DT_S = 0.008
FRAME = "camera_color_optical_frame"
TARGET = np.array([0.2, 0.1, 1.2])
_DRAWN = np.random.default_rng(2)
CHAIN = SerialChain(_DRAWN.normal(size=(6, 3)), _DRAWN.normal(size=(6, 3)), np.ones(3), HOME)


class Cell:
    """A loop in motion, and what its law was given."""

    def __init__(self, jacobian=np.eye(3, 6) * 0.5, **values):  # noqa: B008
        self.loop = ServoLoop(default_values(**values))
        self.now_s, self.joints, self.jacobian = 10.0, HOME.copy(), jacobian
        self.states, command = [], self.loop.law.command
        self.loop.law.command = lambda state: (self.states.append(state), command(state))[1]
        self.loop.supervisor.inputs.add_speed_scaling(self.now_s, 0.1)  # the arm hardly moves
        self.tick(20)
        assert self.target(TARGET, 0.0)
        self.start()
        assert self.tick(20).velocity_rad_s.any()

    def tick(self, count=1):
        for _ in range(count):
            self.now_s += DT_S
            self.loop.add_jacobian(self.now_s, self.jacobian)
            self.loop.add_joints(self.now_s, self.now_s, self.joints)
            self.loop.add_image(self.now_s, self.now_s - 0.02, np.array([0.0, 0.0, 1.0]))
            command = self.loop.tick(self.now_s, DT_S)
        return command

    def start(self):
        assert self.loop.supervisor.start(self.now_s)[0]

    def target(self, position_m, age_s=0.0, frame=FRAME):
        return self.loop.add_target(position_m, frame, self.now_s - age_s)[0]

    @property
    def target_m(self):
        return self.loop.supervisor.goal.target


@pytest.fixture
def servoing():
    return Cell()


def test_a_chain_gives_the_jacobian_until_it_comes_no_more():
    cell = Cell(law="minimum_time")
    cell.loop.add_chain(cell.now_s, CHAIN)
    cell.tick()
    assert cell.states[-1].chain is CHAIN
    np.testing.assert_array_equal(cell.states[-1].jacobian, CHAIN.jacobian(HOME))
    cell.tick(round(0.25 / DT_S))
    assert cell.states[-1].chain is None
    np.testing.assert_array_equal(cell.states[-1].jacobian, cell.jacobian)


def test_a_moving_target_is_extrapolated_until_it_is_set_to_the_current_position(servoing):
    for k in range(12):
        servoing.tick()
        assert servoing.target(TARGET + [0.002 * k, 0.0, 0.0])
    servoing.tick()
    # 2 mm every 8 ms is a quarter of a metre a second: by now it has gone on
    np.testing.assert_allclose(servoing.target_m, TARGET + [0.024, 0.0, 0.0], atol=1e-6)
    assert not servoing.target(np.array([0.0, 0.0, 9.0]))
    velocity = servoing.loop.supervisor.goal.velocity_m_s
    np.testing.assert_allclose(velocity, [0.25, 0.0, 0.0], atol=1e-6)
    assert servoing.loop.set_current_as_target(servoing.now_s)[0]
    here = servoing.target_m
    servoing.tick(40)
    np.testing.assert_array_equal(servoing.target_m, here)


@pytest.mark.parametrize("moves", [False, True])
def test_an_overtaken_target_is_passed_over_whether_the_newer_one_stands_or_moves(servoing, moves):
    newer = np.array([0.1, 0.0, 1.1])
    if moves:
        assert servoing.target(newer - [0.01, 0.0, 0.0], 0.05)
    assert servoing.target(newer)
    assert servoing.target(newer - [0.03, 0.0, 0.0], 0.1)
    assert not servoing.target(newer - [0.03, 0.0, 0.0], 0.1, "another_frame")
    servoing.tick(50)
    np.testing.assert_allclose(servoing.target_m, newer, atol=1e-9)


@each("law", LAWS)
@each(("features", "joints"), [(1, 1), (3, 2), (6, 7)])
def test_every_law_drives_any_number_of_features_with_any_number_of_joints(
    monkeypatch, law, features, joints
):
    monkeypatch.setattr(Ball, "axes", tuple("abcdefgh"[:features]))
    monkeypatch.setattr(Ball, "box_size", features)
    loop = ServoLoop(
        default_values(
            law=law,
            redundancy_resolution="least_speed",
            autostart=True,
            joint_names=[f"joint_{i}" for i in range(joints)],
            joint_min_rad=[-3.0] * joints,
            joint_max_rad=[3.0] * joints,
            workspace_min_m=[-9.0] * features,
            workspace_max_m=[9.0] * features,
        )
    )
    rng = np.random.default_rng(features + joints)
    jacobian, moved = rng.normal(size=(features, joints)), np.zeros(joints)
    target = jacobian @ rng.uniform(-0.2, 0.2, joints)
    for tick in range(300):
        now_s = DT_S * tick
        if tick % 4 == 0:
            loop.add_image(now_s, now_s, jacobian @ moved)
        loop.add_jacobian(now_s, jacobian)
        loop.add_joints(now_s, now_s, moved)
        if tick == 40:
            loop.add_target(target, FRAME, now_s)
        moved = moved + DT_S * loop.tick(now_s, DT_S).velocity_rad_s
    np.testing.assert_allclose(jacobian @ moved, target, atol=0.005)
