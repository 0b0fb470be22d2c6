"""The robot's model as a driver publishes it."""

import re

import numpy as np
import pytest
from cases import each

pytest.importorskip("viser", reason="viser is not installed (pip install 'viser[urdf]')")

import trimesh
from ur5_dh import flange_pose

from fvs_dashboard.scene import Arm
from fvs_ros import paths
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_sim_node.robot import ROBOTS, robot_description

UR5 = ROBOTS["ur5"]
JOINTS = np.array([0.3, -1.35, 1.6, -1.75, -1.57, 0.4])
#: ``base_link`` is the closed form's base, turned by half a turn.
FLANGE = np.diag([-1.0, -1.0, 1.0, 1.0]) @ flange_pose(JOINTS)
ON_A_TABLE = (
    '<link name="world"/><joint name="stands" type="fixed"><parent link="world"/>'
    '<child link="base_link"/><origin xyz="0.5 0 0.8" rpy="0 0 0"/></joint></robot>'
)
MESH = "package://ur_description/meshes/ur5/visual/part"


def of_meshes(ending):
    """The UR5 with nothing but meshes."""
    shape = f'<geometry><mesh filename="{MESH}.{ending}"/></geometry>'
    return re.sub("<geometry>.*?</geometry>", shape, robot_description(UR5), flags=re.DOTALL)


@each(
    ("text", "prefix", "base_m"),
    [
        (robot_description(UR5), "", [0.0, 0.0, 0.0]),
        (robot_description(UR5, "left_"), "left_", [0.0, 0.0, 0.0]),
        (robot_description(UR5).replace("</robot>", ON_A_TABLE), "", [0.5, 0.0, 0.8]),
    ],
)
def test_base_and_flange_are_where_the_closed_form_says(text, prefix, base_m):
    arm = Arm(text, [prefix + name for name in UR_JOINT_NAMES], prefix)
    np.testing.assert_allclose(arm.flange(JOINTS), FLANGE, atol=1e-6)
    np.testing.assert_allclose(arm.base[:3, 3], base_m, atol=1e-12)
    assert arm.missing == ""


def test_without_meshes_bars_lead_from_joint_to_joint(monkeypatch, tmp_path):
    monkeypatch.setattr(paths, "_INSTALLED", tmp_path)
    arm = Arm(of_meshes("stl"), UR_JOINT_NAMES)
    bars = arm.bars(JOINTS)
    assert bars.shape == (7, 2, 3)
    np.testing.assert_array_equal(bars[1:, 0], bars[:-1, 1])
    np.testing.assert_allclose(bars[-1, 1], FLANGE[:3, 3], atol=1e-6)
    for words in (MESH, "install ros-jazzy-ur-description", "AMENT_PREFIX_PATH"):
        assert words in arm.missing


@pytest.mark.parametrize("sourced", [True, False])
@pytest.mark.parametrize("ending", ["stl", "dae"])
def test_meshes_are_found_where_ros_is_sourced_or_installed(monkeypatch, tmp_path, sourced, ending):
    path = tmp_path / "jazzy/share" / f"{MESH}.{ending}".removeprefix("package://")
    path.parent.mkdir(parents=True)
    path.write_bytes(trimesh.creation.box([0.07] * 3).export(file_type="stl"))
    monkeypatch.setattr(paths, "_INSTALLED", tmp_path / "none" if sourced else tmp_path)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "jazzy") if sourced else "")
    arm = Arm(of_meshes(ending), UR_JOINT_NAMES)
    if ending == "stl":
        assert arm.missing == ""
        assert len(arm.urdf.scene.geometry) == of_meshes(ending).count("<mesh")
    else:  # what it holds is no such mesh
        assert "a mesh cannot be read" in arm.missing
