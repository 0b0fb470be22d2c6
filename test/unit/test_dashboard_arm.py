"""The robot's model as a driver publishes it."""

import numpy as np
import pytest
from cases import each

pytest.importorskip("viser", reason="viser is not installed (pip install 'viser[urdf]')")

from fvs_dashboard.scene import Arm
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_sim_node.robot import ROBOTS, robot_description

UR5 = ROBOTS["ur5"]
JOINTS = np.array([0.3, -1.35, 1.6, -1.75, -1.57, 0.4])
ON_A_TABLE = (
    '<link name="world"/><joint name="stands" type="fixed"><parent link="world"/>'
    '<child link="base_link"/><origin xyz="0.5 0 0.8" rpy="0 0 0"/></joint></robot>'
)


@each(
    ("text", "prefix", "base_m"),
    [
        (robot_description(UR5), "", [0.0, 0.0, 0.0]),
        (robot_description(UR5, "left_"), "left_", [0.0, 0.0, 0.0]),
        (robot_description(UR5).replace("</robot>", ON_A_TABLE), "", [0.5, 0.0, 0.8]),
    ],
)
def test_the_camera_stands_in_the_link_that_its_pose_names(text, prefix, base_m):
    arm = Arm(text, [prefix + name for name in UR_JOINT_NAMES])
    pose = arm.in_root(f"{prefix}base_link", np.eye(4))
    np.testing.assert_allclose(pose[:3, 3], base_m, atol=1e-12)
    assert arm.bars(JOINTS).shape == (6, 2, 3)
    assert arm.missing == ""
