"""Targets and chains in the controller's loop, fed at 125 Hz."""

import numpy as np
import pytest
from cases import each

from bench.fuzz_world import FRESH_TICKS, HOME_BALL_M, World
from fvs_controller_node.config import LAWS, default_values
from fvs_controller_node.loop import ServoLoop
from fvs_ros import ros
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.chain import SerialChain
from fvs_ros.kinds.ball import Ball

DT_S = 0.008
TARGET = HOME_BALL_M + [0.2, 0.1, 0.0]


@pytest.fixture
def servoing():
    world = World()
    world.run(FRESH_TICKS)
    world.send_target(TARGET)
    world.start()
    world.run(20)
    assert world.session
    return world


def test_a_chain_gives_the_jacobian_until_it_comes_no_more(servoing):
    rng, loop = np.random.default_rng(2), servoing.node._loop
    chain = SerialChain(*rng.normal(size=(2, 6, 3)), np.ones(3), servoing.home_rad)
    loop.add_chain(servoing.now_s, chain)
    servoing.run(1)
    np.testing.assert_allclose(loop.jacobian, chain.jacobian(servoing.joints), rtol=1e-3)
    servoing.run(round(0.25 / DT_S))
    np.testing.assert_array_equal(loop.jacobian, servoing.true)


def test_an_estimator_with_another_camera_mount_stops_the_arm(servoing):
    rng = np.random.default_rng(2)
    chain = SerialChain(*rng.normal(size=(2, 6, 3)), np.ones(3), servoing.home_rad, on_arm=True)
    for _ in range(30):
        servoing.run(1)
        servoing.send_chain(ros.to_chain(chain))
    servoing.run(1)
    last = servoing.node._loop.supervisor.last
    assert "camera_mount arm, expected fixed" in last.text
    assert not last.velocity_rad_s.any()


def test_a_moving_target_is_extrapolated_until_it_is_set_to_the_current_position(servoing):
    for k in range(12):
        servoing.run(1)
        servoing.send_target(TARGET + [0.002 * k, 0.0, 0.0])
    servoing.run(1)
    # 2 mm every 8 ms is a quarter of a metre a second: by now it has gone on
    np.testing.assert_allclose(servoing.target_m, TARGET + [0.024, 0.0, 0.0], atol=1e-6)
    servoing.send_target([0.0, 0.0, 9.0])
    velocity = servoing.node._loop.supervisor.goal.velocity_m_s
    np.testing.assert_allclose(velocity, [0.25, 0.0, 0.0], atol=1e-6)
    assert servoing.node.call("~/set_current_as_target")[0]
    here = servoing.target_m
    servoing.run(40)
    np.testing.assert_array_equal(servoing.target_m, here)


@pytest.mark.parametrize("moves", [False, True])
def test_an_overtaken_target_is_passed_over_whether_the_newer_one_stands_or_moves(servoing, moves):
    newer = np.array([0.1, 0.0, 1.1])
    at_x_m = {0.05: -0.01, 0.0: 0.0, 0.1: -0.03} if moves else {0.0: 0.0, 0.1: -0.03}
    for age_s, x_m in at_x_m.items():
        message = ros.to_feature(
            servoing.ros_s - age_s, CAMERA_FRAME, Ball(), newer + [x_m, 0.0, 0.0]
        )
        servoing.node._on_target(message)
    servoing.run(50)
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
            loop.add_target(target, CAMERA_FRAME, now_s)
        moved = moved + DT_S * loop.tick(now_s, DT_S).velocity_rad_s
    np.testing.assert_allclose(jacobian @ moved, target, atol=0.005)
