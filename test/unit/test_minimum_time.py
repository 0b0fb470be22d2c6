"""The goal that the minimum-time law searches."""

import numpy as np
import pytest
import ur5_dh
from cases import each

from fvs_controller_node.base import ControlInput
from fvs_controller_node.config import default_values, make_law
from fvs_ros.chain import SerialChain
from fvs_ros.kinds import KINDS
from fvs_ros.rotations import rotation_from_vector

FACING = np.diag([1.0, -1.0, -1.0])


def camera_at(joints_rad, z):
    """The chain of a camera beside the flange, aslant, that sees a tag at z."""
    *frames, (rotation, origin_m) = ur5_dh.frames(joints_rad)
    camera = rotation @ rotation_from_vector(np.array([0.26, 0.0, 0.0]))
    origin_m = origin_m + rotation @ np.array([0.05, 0.02, 0.04])
    axes = np.array([frame[:, 2] for frame, _ in frames]) @ camera
    points_m = (np.array([point for _, point in frames]) - origin_m) @ camera
    return SerialChain(axes, points_m, z, joints_rad, on_arm=True)


@each("roll_deg", [30.0, 120.0, 150.0, 170.0])
def test_large_rotations_are_reached_without_detours(roll_deg):
    kind = KINDS["pose"](camera_mount="arm")
    seen = kind.of_body(np.array([0.0, 0.0, 0.3]), FACING)
    roll = rotation_from_vector(np.radians([0.0, 0.0, roll_deg]))
    aslant = rotation_from_vector(np.array([-0.3, 0.0, 0.0])) @ FACING
    wanted = kind.of_body(np.array([0.1, 0.0, 0.25]), roll @ aslant)
    joints, still = np.array(ur5_dh.HOME_RAD), np.zeros(6)
    chain = camera_at(joints, seen)
    jacobian = kind.moved_by(*chain.motion(joints))
    law = make_law(default_values(law="minimum_time", feature="pose", camera_mount="arm"))
    error_m = kind.minus(seen, wanted)
    state = ControlInput(error_m, jacobian, still, joints, 0.008, joints, chain, kind=kind)
    goal = law._find_goal(state)
    assert kind.minus(chain.position(goal), wanted) == pytest.approx(np.zeros(6), abs=0.02)
    assert np.abs(goal - joints).max() < np.radians(abs(roll_deg)) + 0.5
