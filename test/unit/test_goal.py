"""The target in force, and the progress towards it."""

from dataclasses import replace

import numpy as np

from fvs_controller_node.config import SupervisorConfig
from fvs_controller_node.goal import Goal
from fvs_ros.camera import CAMERA_FRAME as FRAME
from fvs_ros.kinds.pose import Pose

DT_S = 0.008
HERE, THERE = np.array([0.0, 0.0, 1.0]), np.array([0.8, 0.0, 1.0])


def test_a_target_that_a_new_box_dropped_does_not_come_back_by_itself():
    config = SupervisorConfig()
    goal = Goal(config)
    goal.set(THERE, FRAME)
    for _ in range(100):
        goal.see(THERE, DT_S, True)
    goal.configure(replace(config, workspace_max_m=(0.5, 1.0, 3.0)))
    assert goal.target is None
    assert goal.set(HERE, FRAME)[0]  # another task: going there is no swing
    for share in np.linspace(1.0, 0.0, 300):
        goal.see(HERE + share * (THERE - HERE), DT_S, True)
        assert goal.progress.check(config) is None


def test_the_direction_of_rotation_is_not_that_of_another_task():
    pose, goal = Pose(), Goal(SupervisorConfig(feature="pose"))
    at = pose.of_body(HERE, np.eye(3))
    goal.set(pose.retract(at, np.array([0.0, 0.0, 0.0, -0.001, 0.0, 0.0])), FRAME)
    goal.see(at, DT_S, False)
    goal.set(pose.retract(at, np.array([0.0, 0.0, 0.0, 0.3 * np.radians(165.0), 0.0, 0.0])), FRAME)
    goal.see(at, DT_S, False)
    assert np.degrees(np.linalg.norm(goal.error_m) / 0.3) < 166.0
