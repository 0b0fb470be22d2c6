"""The arm's model: published kinematics, exact derivatives, any UR5 URDF."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from fvs_detector_node.detection import BallColour, colour_mask
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_sim_node import kinematics
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


def test_physics_engine_agrees_with_dh_table(world):
    for joints in random_joints(50):
        world.reset(joints)
        np.testing.assert_allclose(
            world.ball_position(), kinematics.ball_position(joints), atol=1e-6
        )


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


def test_engine_jacobian_equals_closed_form(world):
    for joints in random_joints(10):
        np.testing.assert_allclose(
            world.ball_jacobian(joints), kinematics.ball_jacobian(joints), atol=1e-7
        )


def test_last_joint_does_not_move_a_ball_on_its_axis():
    assert np.abs(kinematics.ball_jacobian(random_joints(20))[..., 5]).max() < 1e-12


def test_batches_equal_single_calls():
    joints = random_joints(7)
    batch = kinematics.ball_jacobian(joints, 0.1)
    for row, single in zip(batch, joints, strict=True):
        np.testing.assert_allclose(row, kinematics.ball_jacobian(single, 0.1), atol=1e-14)


def test_every_link_has_an_inertial():
    root = ET.fromstring(urdf_text())
    assert [joint.get("name") for joint in root.iter("joint")][:6] == list(UR_JOINT_NAMES)
    for link in root.iter("link"):
        assert float(link.find("inertial/mass").get("value")) > 0.0


def test_nothing_on_the_arm_has_the_balls_colour():
    for colour in ET.fromstring(urdf_text()).iter("color"):
        rgb = np.array([float(x) for x in colour.get("rgba").split()][:3])
        for brightness in np.linspace(0.2, 1.0, 9):
            pixel = np.round(255 * brightness * rgb).astype(np.uint8).reshape(1, 1, 3)
            assert not colour_mask(pixel, BallColour()).any()


def test_limits_are_read(world):
    np.testing.assert_allclose(world.upper_rad, np.array([2, 2, 1, 2, 2, 2]) * np.pi)
    np.testing.assert_allclose(world.lower_rad, -world.upper_rad)


def test_another_urdf_by_path(tmp_path):
    path = tmp_path / "own.urdf"
    path.write_text(urdf_text(), encoding="utf-8")
    own = World(urdf_path=str(path), ball_link="wrist_3_link", ball_offset_m=0.1)
    joints = random_joints(1)[0]
    own.reset(joints)
    np.testing.assert_allclose(
        own.ball_position(), kinematics.ball_position(joints, 0.1), atol=1e-6
    )
    np.testing.assert_allclose(
        own.ball_jacobian(joints), kinematics.ball_jacobian(joints, 0.1), atol=1e-7
    )
    own.close()


def test_bad_urdfs_are_refused_with_words(tmp_path):
    with pytest.raises(ValueError, match="there is no file"):
        World(urdf_path=str(tmp_path / "missing.urdf"))
    renamed = tmp_path / "renamed.urdf"
    renamed.write_text(urdf_text().replace("elbow_joint", "knee_joint"), encoding="utf-8")
    with pytest.raises(ValueError, match=r"lacks the joints \['elbow_joint'\]"):
        World(urdf_path=str(renamed))
    broken = tmp_path / "broken.urdf"
    broken.write_text("no xml", encoding="utf-8")
    with pytest.raises(ValueError, match="cannot load"):
        World(urdf_path=str(broken))
    with pytest.raises(ValueError, match="no link 'hand'"):
        World(ball_link="hand")


def test_worlds_live_side_by_side():
    first, second = World(), World()
    first.reset(np.full(6, 0.3))
    second.reset(np.full(6, -0.3))
    np.testing.assert_allclose(
        first.ball_position(), kinematics.ball_position(np.full(6, 0.3)), atol=1e-6
    )
    first.close()
    first.close()
    np.testing.assert_allclose(
        second.ball_position(), kinematics.ball_position(np.full(6, -0.3)), atol=1e-6
    )
    second.close()
