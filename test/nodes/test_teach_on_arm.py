"""Teach and repeat with the camera on the arm: an object is put elsewhere, and found again."""

import numpy as np
from chain_robot import ChainRobot
from harness import Statuses

from fvs_estimator_node.files import load_model
from fvs_ros import topics
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_ros.kinds.pose import Pose
from fvs_ros.paths import find_file
from fvs_ros.rotations import rotation_from_vector
from fvs_ros.yaml_text import read_yaml_file

KIND = Pose(camera_mount="arm")
COMMON = {"feature": "pose", "camera_mount": "arm"}
SEEN = KIND.of_body(np.array([0.02, 0.01, 0.4]), rotation_from_vector(np.array([2.8, 0.2, 0.1])))


def test_a_view_is_taught_and_found_again_where_the_object_is(ros_test):
    chain = load_model(find_file(KIND.model)).chain
    chain = chain.anchored(chain.reference_rad, SEEN)
    robot = ChainRobot(ros_test, chain, UR_JOINT_NAMES, KIND)
    path, status = ros_test.folder / "references.yaml", Statuses(ros_test, topics.CONTROLLER)
    ros_test.start_node("fvs_estimator_node.node", method="poe", **COMMON)
    own = {"law": "minimum_time", "references_path": path}
    ros_test.start_node("fvs_controller_node.node", **own, **COMMON)
    status.wait(lambda: status.reason() == "NO_TARGET", 40.0, "all inputs")
    ros_test.spin_for(1.0)  # for a mean

    def servo(*words):
        process = ros_test.start("fvs_tools.client_node", *words)
        return ros_test.wait(process, 40.0), ros_test.output(process)

    taught = KIND.inverse(robot.pose())
    code, words = servo("teach", "dock")
    assert code == 0, words
    entry = read_yaml_file(path)["dock"]
    assert (entry["mount"], entry["frame"]) == ("arm", "object")

    robot.move_object(0.04, -0.03, 0.05, 0.03, -0.02, 0.04)
    assert np.linalg.norm(KIND.minus(KIND.inverse(robot.pose()), taught)) > 0.05
    code, words = servo("go", "dock")
    assert code == 0, words
    assert "dock: reached, " in words
    assert np.linalg.norm(KIND.minus(KIND.inverse(robot.pose()), taught)) < 0.005

    ros_test.spin_for(0.5)
    there_rad = robot.joints
    robot.move_object(0.05, *np.zeros(5))
    ros_test.spin_for(0.5)
    assert np.abs(robot.joints - there_rad).max() < 1e-3, "it goes after the object"

    robot.sees = False  # a hand before the lens
    status.wait(lambda: status.reason() == "STALE", what="a late image")
    code, words = servo("teach", "dock")
    assert code == 1
    assert "not taught: object_pose is" in words
    robot.sees = True
    status.wait(lambda: status.reason() == "READY", what="READY")

    path.write_text(path.read_text().replace("mount: arm", "mount: fixed"))
    code, words = servo("go", "dock")
    assert code == 1
    assert "dock: it is of mount fixed, expected arm" in words


def test_a_model_of_a_fixed_camera_is_refused(ros_test):
    fixed = ros_test.start_node("fvs_estimator_node.node", model_path=Pose().model, **COMMON)
    assert ros_test.wait(fixed) == 2
    assert "expected pose (12 numbers), camera_mount arm" in ros_test.output(fixed)
