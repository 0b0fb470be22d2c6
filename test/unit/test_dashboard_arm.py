"""The robot's model as a driver tells it."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest

pytest.importorskip("yourdfpy", reason="yourdfpy is not installed (pip install 'viser[urdf]')")

import trimesh

from fvs_dashboard import arm as module
from fvs_dashboard.arm import Arm
from fvs_ros.joints import UR_JOINT_NAMES
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


MESH = "package://ur_description/meshes/ur5/visual/part.stl"


def of_meshes():
    """The UR5 with nothing but meshes, as its driver tells it."""
    shape = f'<geometry><mesh filename="{MESH}"/></geometry>'
    return re.sub("<geometry>.*?</geometry>", shape, urdf_text(), flags=re.DOTALL)


def drawn(arm):
    """The corners of all that is drawn, in the model's root, m, shape (n, 3)."""
    return trimesh.Scene.to_mesh(arm.urdf.scene).vertices


def put_mesh(prefix, data=None):
    path = prefix / "share" / MESH.removeprefix("package://")
    path.parent.mkdir(parents=True)
    path.write_bytes(data or trimesh.creation.box([0.07] * 3).export(file_type="stl"))


def test_without_meshes_bars_are_drawn_from_joint_to_joint(monkeypatch, tmp_path):
    monkeypatch.setattr(module, "_INSTALLED", tmp_path)
    arm = Arm(of_meshes(), UR_JOINT_NAMES)
    np.testing.assert_allclose(arm.flange(JOINTS), HALF_TURN @ flange_pose(JOINTS), atol=1e-6)
    points = drawn(arm)
    origins = [arm.urdf.get_transform(arm.urdf.joint_map[name].child) for name in UR_JOINT_NAMES]
    for origin in (np.eye(4), *origins):
        assert np.linalg.norm(points - origin[:3, 3], axis=1).min() < 0.05
    # Nothing stands elsewhere: every corner is near a line from joint to joint.
    ends = np.array([np.zeros(3), *(origin[:3, 3] for origin in origins)])
    along = ends[:-1, None] + np.linspace(0.0, 1.0, 50)[:, None] * np.diff(ends, axis=0)[:, None]
    away = np.linalg.norm(points[:, None] - along.reshape(-1, 3), axis=2).min(axis=1)
    assert away.max() < 0.06
    for words in (MESH, "install ros-jazzy-ur-description", "AMENT_PREFIX_PATH"):
        assert words in arm.missing


@pytest.mark.parametrize("sourced", [True, False])
def test_meshes_are_found_where_ros_is_sourced_and_where_it_is_installed(
    monkeypatch, tmp_path, sourced
):
    put_mesh(tmp_path / "jazzy")
    monkeypatch.setattr(module, "_INSTALLED", tmp_path / "none" if sourced else tmp_path)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "jazzy") if sourced else "")
    arm = Arm(of_meshes(), UR_JOINT_NAMES)
    assert arm.missing == ""
    assert len(arm.urdf.scene.geometry) == of_meshes().count("<mesh")


def test_a_robot_with_its_shapes_gets_no_bars():
    arm = Arm(urdf_text(), UR_JOINT_NAMES)
    assert arm.missing == ""
    assert not any("bar" in name for name in arm.urdf.scene.geometry)


def test_a_link_whose_mesh_is_not_here_gets_a_bar_and_the_others_keep_their_shapes():
    shape = '<cylinder radius="0.044" length="0.35"/>'
    alone = re.sub(
        '(<link name="upper_arm_link">.*?)(<visual>.*</visual>)(</link>)',
        rf'\1<visual><geometry><mesh filename="{MESH}"/></geometry></visual>\3',
        urdf_text(),
    )
    assert shape in urdf_text()
    assert shape not in alone
    arm = Arm(alone, UR_JOINT_NAMES)
    names = set(arm.urdf.scene.geometry)
    assert {name for name in names if "bar" in name} == {"upper_arm_link_bar"}
    assert len(names) > 10
    assert "part.stl is not on this computer" in arm.missing


def test_a_mesh_that_cannot_be_read_leaves_bars_and_words(monkeypatch, tmp_path):
    monkeypatch.setattr(sys.modules[__name__], "MESH", MESH.replace("stl", "dae"))
    put_mesh(tmp_path / "jazzy", b"no mesh")
    monkeypatch.setattr(module, "_INSTALLED", tmp_path)
    arm = Arm(of_meshes(), UR_JOINT_NAMES)
    assert len(arm.urdf.scene.geometry) == 5
    assert "a mesh cannot be read" in arm.missing


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
