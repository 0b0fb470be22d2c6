"""The simulated arm: published kinematics, and any URDF."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pybullet
import pytest
from ur5_dh import axes_origins_ball, frames

from fvs_detector_node.ball_detector import colour_mask
from fvs_detector_node.config import BallColour
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_sim_node.config import SimConfig
from fvs_sim_node.robot import ROBOTS, Robot, robot_description
from fvs_sim_node.world import World

UR5 = ROBOTS["ur5"]


@pytest.fixture(scope="module")
def world():
    world = World()
    yield world
    world.close()


def test_physics_engine_and_chain_agree_with_the_published_kinematics(world):
    # All joints at zero: stretched out along -x, flange facing -y.
    expected = [-0.425 - 0.39225, -0.10915 - 0.0823, 0.089159 - 0.09465]
    np.testing.assert_allclose(frames(np.zeros(6))[-1][1], expected, atol=1e-12)
    joints = np.random.default_rng(0).uniform(-3.0, 3.0, (50, 6))
    axes, origins, balls_m = axes_origins_ball(joints)
    jacobians = np.swapaxes(np.cross(axes, balls_m[:, None] - origins), -1, -2)
    # The URDF's root, base_link, is the closed form's base turned half about z.
    half_turn = np.diag([-1.0, -1.0, 1.0])
    balls_m, jacobians = balls_m @ half_turn, half_turn @ jacobians
    np.testing.assert_allclose(world.chain.position(joints), balls_m, atol=1e-6)
    np.testing.assert_allclose(world.chain.jacobian(joints), jacobians, atol=1e-12)
    for angles, ball_m in zip(joints, balls_m, strict=True):
        world.reset(angles)
        np.testing.assert_allclose(world.carried_position(), ball_m, atol=1e-6)


def test_nothing_of_the_ur5_has_the_balls_colour(world):
    for colour in ET.fromstring(robot_description(UR5)).iter("color"):
        rgb = np.array([float(x) for x in colour.get("rgba").split()][:3])
        shades = np.round(255 * np.linspace(0.2, 1.0, 9)[:, None] * rgb).astype(np.uint8)
        assert not colour_mask(shades[None], BallColour()).any()


def test_a_urdf_without_its_meshes_is_simulated_with_cubes(tmp_path):
    mesh = '<geometry><mesh filename="package://some_arm/meshes/part.stl"/></geometry>'
    text = re.sub("<geometry>.*?</geometry>", mesh, robot_description(UR5), flags=re.DOTALL)
    path, words = tmp_path / "arm.urdf", []
    path.write_text(text, encoding="utf-8-sig")
    assert "mesh" not in robot_description(Robot(str(path)), say=words.append)
    (sentence,) = words
    assert "1 meshes that are not here, such as package://some_arm/meshes/part.stl" in sentence
    world = World(SimConfig(urdf_path=str(path)))
    assert world.joint_names == UR_JOINT_NAMES
    shapes = world.client.getVisualShapeData(world.client.getBodyUniqueId(0))
    assert {shape[2] for shape in shapes} == {pybullet.GEOM_BOX}
    world.close()
    # One that is here is drawn.
    (tmp_path / "meshes").mkdir()
    Path(tmp_path, "meshes/part.stl").write_bytes(b"solid")
    assert f"file://{tmp_path}/meshes/part.stl" in robot_description(Robot(str(path)))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (robot_description(UR5).replace('type="revolute"', 'type="fixed"'), "no moving joint"),
        ("no xml", "no XML"),
    ],
    ids=["fixed", "no xml"],
)
def test_bad_urdfs_are_refused_with_words(tmp_path, text, words):
    (tmp_path / "bad.urdf").write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=words):
        World(SimConfig(urdf_path=str(tmp_path / "bad.urdf")))
