"""The arm's model: published kinematics, exact derivatives, any UR5 URDF."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from fvs_detector_node.detection import BallColour, colour_mask
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_sim_node import kinematics
from fvs_sim_node.config import SimConfig
from fvs_sim_node.ur5_urdf import urdf_text
from fvs_sim_node.world import World


@pytest.fixture(scope="module")
def world():
    world = World()
    yield world
    world.close()


def random_joints(count, seed=0):
    return np.random.default_rng(seed).uniform(-3.0, 3.0, (count, 6))


def test_zero_pose_is_the_published_one():
    # All joints at zero: stretched out along -x, flange facing -y.
    flange = kinematics.flange_pose(np.zeros(6))
    expected = [-0.425 - 0.39225, -0.10915 - 0.0823, 0.089159 - 0.09465]
    np.testing.assert_allclose(flange[:3, 3], expected, atol=1e-12)
    np.testing.assert_allclose(flange[:3, 2], [0.0, -1.0, 0.0], atol=1e-12)


def test_physics_engine_agrees_with_the_closed_form_in_batches_and_single(world):
    joints = random_joints(50)
    balls_m, jacobians = kinematics.ball_position(joints), kinematics.ball_jacobian(joints)
    for one, ball_m, jacobian in zip(joints, balls_m, jacobians, strict=True):
        world.reset(one)
        np.testing.assert_allclose(world.ball_position(), ball_m, atol=1e-6)
        np.testing.assert_allclose(world.ball_jacobian(one), jacobian, atol=1e-12)
        np.testing.assert_allclose(kinematics.ball_jacobian(one), jacobian, atol=1e-14)
    # The last joint does not move a ball on its axis.
    assert np.abs(jacobians[..., -1]).max() < 1e-12


def test_jacobian_is_the_derivative():
    step = 1e-6
    for joints in random_joints(20):
        columns = [
            kinematics.ball_position(joints + step * unit)
            - kinematics.ball_position(joints - step * unit)
            for unit in np.eye(6)
        ]
        np.testing.assert_allclose(
            kinematics.ball_jacobian(joints), np.array(columns).T / (2 * step), atol=1e-8
        )


def test_the_urdf_has_inertias_limits_and_nothing_of_the_balls_colour(world):
    root = ET.fromstring(urdf_text())
    assert [joint.get("name") for joint in root.iter("joint")][:6] == list(UR_JOINT_NAMES)
    assert all(float(mass.get("value")) > 0.0 for mass in root.iter("mass"))
    for colour in root.iter("color"):
        rgb = np.array([float(x) for x in colour.get("rgba").split()][:3])
        shades = np.round(255 * np.linspace(0.2, 1.0, 9)[:, None] * rgb).astype(np.uint8)
        assert not colour_mask(shades[None], BallColour()).any()
    np.testing.assert_allclose(world.upper_rad, np.array([2, 2, 1, 2, 2, 2]) * np.pi)
    np.testing.assert_allclose(world.lower_rad, -world.upper_rad)
    np.testing.assert_allclose(world.max_speed_rad_s, np.pi)


def test_another_urdf_by_path_beside_the_built_in_one(world, tmp_path):
    path = tmp_path / "own.urdf"
    path.write_text(urdf_text(), encoding="utf-8")
    own = World(SimConfig(urdf_path=str(path), ball_link="wrist_3_link", ball_offset_m=0.1))
    joints, others = random_joints(2)
    own.reset(joints)
    world.reset(others)
    expected_m = kinematics.ball_position(joints, 0.1)
    np.testing.assert_allclose(own.ball_position(), expected_m, atol=1e-6)
    np.testing.assert_allclose(
        own.ball_jacobian(joints), kinematics.ball_jacobian(joints, 0.1), atol=1e-12
    )
    own.close()
    own.close()
    np.testing.assert_allclose(world.ball_position(), kinematics.ball_position(others), atol=1e-6)


def test_bad_urdfs_are_refused_with_words(tmp_path):
    renamed = urdf_text().replace("elbow_joint", "knee_joint")
    for text, said in (
        (None, "there is no file"),
        (renamed, r"lacks the joints \['elbow_joint'\]"),
        ("no xml", "cannot load"),
    ):
        path = tmp_path / f"{said[:5]}.urdf"
        if text is not None:
            path.write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match=said):
            World(SimConfig(urdf_path=str(path)))
    with pytest.raises(ValueError, match="no link 'hand'"):
        World(SimConfig(ball_link="hand"))
