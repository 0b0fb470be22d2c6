"""Collector, trainer, estimator and controller beside a driver and a detector that are not ours."""

from dataclasses import replace

import numpy as np
import pytest
from chain_robot import ChainRobot
from geometry_msgs.msg import PoseStamped
from harness import Statuses
from recordings import seen_from_anywhere
from std_srvs.srv import Trigger

from fvs_ros import ros, topics
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.chain import SerialChain
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_ros.kinds.kind import MOUNTS
from fvs_ros.kinds.pose import Pose
from fvs_ros.rotations import rotation_from_vector

NAMES = [*UR_JOINT_NAMES, "wrist_4_joint"]
COLLECT_S = 15.0
#: Where the driver says that the arm stands at first, rad: where it wraps, but for the elbow.
HOME_RAD = np.pi * (np.arange(len(NAMES)) != 2)


def seven_joints(kind):
    """An arm with a tag on the last link and a camera somewhere, or there."""
    rng = np.random.default_rng(4)
    arm = seen_from_anywhere(rng)
    axis, offset, rotation = rng.normal(size=(3, 3))
    chain = SerialChain(
        np.vstack([arm.axes, axis]),
        np.vstack([arm.points_m, arm.feature_m + 0.1 * offset]),
        kind.of_body(arm.feature_m, rotation_from_vector(rotation)),
        np.append(arm.reference_rad, 0.2),
    )
    if not kind.on_arm:
        return chain
    at_hand = replace(chain, on_arm=True).moved(np.eye(3), -arm.feature_m)
    facing = rotation_from_vector(np.array([2.8, 0.2, 0.1]))
    seen = kind.of_body(np.array([0.02, 0.01, 0.4]), facing)
    return at_hand.anchored(chain.reference_rad, seen)


@pytest.mark.parametrize("mount", MOUNTS)
def test_a_robot_never_seen_before_is_learned_and_servoed_over_its_topics_alone(ros_test, mount):
    kind = Pose(camera_mount=mount)
    robot = ChainRobot(ros_test, seven_joints(kind), NAMES, kind, HOME_RAD)
    data, model = ros_test.folder / "data.npz", ros_test.folder / "model.npz"
    common = {"feature": "pose", "camera_mount": mount, "joint_names": NAMES}
    collector = ros_test.start_node(
        "fvs_estimator_node.collector_node", output_path=data, duration_s=COLLECT_S, **common
    )
    assert ros_test.wait(collector, COLLECT_S + 40.0) == 0, ros_test.output(collector)
    trainer = ros_test.start("fvs_tools.train", str(data), "-o", str(model), "--method", "poe")
    assert ros_test.wait(trainer, 60.0) == 0, ros_test.output(trainer)

    status = Statuses(ros_test, topics.CONTROLLER)
    ros_test.start_node("fvs_estimator_node.node", model_path=model, method="poe", **common)
    ros_test.start_node("fvs_controller_node.node", law="minimum_time", **common)
    publisher = ros_test.publisher(PoseStamped, kind.topics.target.name, ros.QOS_LATCHED)

    def started():
        servoing = status.value("state") == "SERVOING"
        return servoing or ros_test.call(Trigger, f"{topics.CONTROLLER}/start").success

    for sign in (1.0, -1.0):
        share = 0.4 if kind.on_arm else 1.0  # it must stay in view
        target = robot.pose(share * sign * np.array([0.2, -0.1, 0.15, 0.2, -0.1, 0.2, 0.1]))
        publisher.publish(ros.to_feature(0.0, CAMERA_FRAME, kind, target))
        status.wait(started, what="a start")
        target_x = f"{target[0]:.5g}"
        status.wait(
            lambda x=target_x: status.reason() == "SETTLED" and status.value("target_x_m") == x,
            what="SETTLED",
        )
        errors_m = []

        def stays(target=target, errors_m=errors_m):
            errors_m.append(np.linalg.norm(kind.minus(robot.pose(), target)))
            return len(errors_m) > 20 and max(errors_m[-20:]) < 0.005

        status.wait(stays, what="the tag on its target for a while")
