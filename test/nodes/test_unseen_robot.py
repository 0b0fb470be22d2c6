"""Collector, trainer, estimator and controller beside a driver and a detector that are not ours."""

import time
from collections import deque
from dataclasses import replace

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from harness import Statuses
from recordings import seen_from_anywhere
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from fvs_ros import ros, topics
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.chain import SerialChain
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_ros.kinds.kind import MOUNTS
from fvs_ros.kinds.pose import Pose
from fvs_ros.rotations import rotation_from_vector

NAMES = [*UR_JOINT_NAMES, "wrist_4_joint"]
PERIOD_S, LAG_S, NOISE_M, COLLECT_S = 1.0 / 60.0, 0.02, 0.001, 15.0
#: Where the driver says that the arm stands at first, rad: where it wraps, but for the elbow.
HOME_RAD = np.pi * (np.arange(len(NAMES)) != 2)


class Robot:
    """Seven joints, a tag on the last link and a camera somewhere, or there, stepped at 60 Hz.

    Joint states are in alphabetical order, a gripper's among them, and wrapped at pi. Poses are
    those of anybody's tracker: every second step, two steps late. The last command holds for ever.
    """

    def __init__(self, harness, kind):
        self.rng, self.kind = np.random.default_rng(4), kind
        arm = seen_from_anywhere(self.rng)
        axis, offset, rotation = self.rng.normal(size=(3, 3))
        self.chain = SerialChain(
            np.vstack([arm.axes, axis]),
            np.vstack([arm.points_m, arm.feature_m + 0.1 * offset]),
            kind.of_body(arm.feature_m, rotation_from_vector(rotation)),
            np.append(arm.reference_rad, 0.2),
        )
        self.joints = self.chain.reference_rad.copy()
        if kind.on_arm:
            at_hand = replace(self.chain, on_arm=True).moved(np.eye(3), -arm.feature_m)
            facing = rotation_from_vector(np.array([2.8, 0.2, 0.1]))
            seen = kind.of_body(np.array([0.02, 0.01, 0.4]), facing)
            self.chain = at_hand.anchored(self.joints, seen)
        self.velocity = self.command = np.zeros(len(NAMES))
        self.began_s, self.steps, self.exposed = time.time(), 0, deque(maxlen=3)
        node = harness.node
        self.states = node.create_publisher(JointState, topics.JOINT_STATES.name, 10)
        self.poses = node.create_publisher(PoseStamped, kind.feature.name, 10)
        node.create_subscription(Float64MultiArray, topics.COMMANDS.name, self.obey, 10)
        node.create_timer(PERIOD_S, self.catch_up)

    def obey(self, message):
        assert len(message.data) == len(NAMES), "a real controller would be deactivated"
        self.command = np.array(message.data)

    def catch_up(self):
        while (now_s := self.began_s + self.steps * PERIOD_S) < time.time():
            self.step(now_s)

    def step(self, now_s):
        self.steps += 1
        self.velocity = self.velocity + PERIOD_S / (LAG_S + PERIOD_S) * (
            self.command - self.velocity
        )
        self.joints = self.joints + PERIOD_S * self.velocity
        angles = self.joints - self.chain.reference_rad + HOME_RAD
        named = dict(zip(NAMES, np.arctan2(np.sin(angles), np.cos(angles)), strict=True))
        named["gripper_joint"] = 0.3
        positions = np.array([named[name] for name in sorted(named)])
        self.states.publish(ros.to_joint_state(now_s, sorted(named), positions, np.zeros(0)))
        self.exposed.append((now_s, self.pose()))
        if self.steps % 2:
            stamp_s, pose = self.exposed[0]
            measured = self.kind.retract(pose, NOISE_M * self.rng.normal(size=self.kind.size))
            self.poses.publish(ros.to_feature(stamp_s, CAMERA_FRAME, self.kind, measured))

    def pose(self, offset_rad=None):
        """Of the tag, now or at an offset from the first joints."""
        joints = self.joints if offset_rad is None else self.chain.reference_rad + offset_rad
        return self.chain.position(joints)


@pytest.mark.parametrize("mount", MOUNTS)
def test_a_robot_never_seen_before_is_learned_and_servoed_over_its_topics_alone(ros_test, mount):
    kind = Pose(camera_mount=mount)
    robot = Robot(ros_test, kind)
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
