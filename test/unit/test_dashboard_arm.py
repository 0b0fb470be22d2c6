"""The robot's model as a driver tells it."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("yourdfpy", reason="yourdfpy is not installed (pip install 'viser[urdf]')")

from fvs_ros.apps.dashboard.arm import Arm
from fvs_ros.core.joints import UR_JOINT_NAMES
from fvs_sim_node.kinematics import flange_pose
from fvs_sim_node.ur5_urdf import urdf_text

JOINTS = np.array([0.3, -1.35, 1.6, -1.75, -1.57, 0.4])
#: ``base_link`` is the closed form's base, turned by half a turn.
HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])


@pytest.mark.parametrize("prefix", ["", "left_"])
def test_the_flange_is_where_the_closed_form_says(prefix):
    arm = Arm(urdf_text(prefix), [prefix + name for name in UR_JOINT_NAMES], prefix)
    np.testing.assert_allclose(arm.flange(JOINTS), HALF_TURN @ flange_pose(JOINTS), atol=1e-6)
    np.testing.assert_allclose(arm.base, np.eye(4), atol=1e-12)


def test_a_robot_on_a_table_knows_its_base():
    text = urdf_text().replace(
        "</robot>",
        '<link name="world"/><joint name="stands" type="fixed"><parent link="world"/>'
        '<child link="base_link"/><origin xyz="0.5 0 0.8" rpy="0 0 0"/></joint></robot>',
    )
    arm = Arm(text, UR_JOINT_NAMES)
    np.testing.assert_allclose(arm.base[:3, 3], [0.5, 0.0, 0.8])
    np.testing.assert_allclose(arm.flange(JOINTS), HALF_TURN @ flange_pose(JOINTS), atol=1e-6)


def test_meshes_that_are_not_here_leave_the_kinematics():
    mesh = '<mesh filename="package://ur_description/meshes/ur5/visual/base.dae"/>'
    text = urdf_text().replace('<cylinder radius="0.085" length="0.022"/>', mesh)
    assert mesh in text
    arm = Arm(text, UR_JOINT_NAMES)
    np.testing.assert_allclose(arm.flange(JOINTS), HALF_TURN @ flange_pose(JOINTS), atol=1e-6)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("no xml", "cannot be read"),
        ("", "cannot be read"),
        ('<robot name="r"><link name="a"/></robot>', "has no joint shoulder_pan_joint"),
    ],
)
def test_what_is_no_robot_is_refused_in_words(text, words):
    with pytest.raises(ValueError, match=words):
        Arm(text, UR_JOINT_NAMES)
