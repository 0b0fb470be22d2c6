"""Robots that are not ours: an arm and its driver; with a chain and a tracker."""

import time
from collections import deque

import numpy as np
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fvs_ros import ros, topics
from fvs_ros.camera import CAMERA_FRAME

PERIOD_S, LAG_S, NOISE_M = 1.0 / 60.0, 0.02, 0.001


class ForeignArm:
    """An arm and its driver, stepped at 60 Hz; the last command holds for ever."""

    def __init__(self, harness, joints):
        self.joints, self.command = joints.copy(), np.zeros(len(joints))
        self.began_s, self.steps, node = time.time(), 0, harness.node
        self.states = node.create_publisher(JointState, topics.JOINT_STATES.name, 10)
        node.create_subscription(Float64MultiArray, topics.COMMANDS.name, self.obey, 10)
        node.create_timer(PERIOD_S, self.catch_up)

    def obey(self, message):
        assert len(message.data) == len(self.joints), "a real controller would be deactivated"
        self.command = np.array(message.data)

    def catch_up(self):
        while (now_s := self.began_s + self.steps * PERIOD_S) < time.time():
            self.steps += 1
            self.step(now_s)

    def move(self, now_s, names):
        """Move at once as commanded, and say where the joints are."""
        self.joints = self.joints + PERIOD_S * self.command
        self.states.publish(ros.to_joint_state(now_s, names, self.joints, np.zeros(0)))


class ChainRobot(ForeignArm):
    """A chain of named joints, from its reference joints on.

    Joint states are in alphabetical order, a gripper's among them, and wrapped at pi; the driver
    says that the joints begin at ``home_rad``. Poses are those of anybody's tracker: every second
    step, two steps late, while it ``sees``.
    """

    def __init__(self, harness, chain, names, kind, home_rad=None):
        super().__init__(harness, chain.reference_rad)
        self.chain, self.names, self.kind = chain, names, kind
        self.rng, self.sees = np.random.default_rng(4), True
        self.offset_rad = 0.0 if home_rad is None else home_rad - self.joints
        self.velocity, self.exposed = self.command, deque(maxlen=3)
        self.poses = harness.node.create_publisher(PoseStamped, kind.feature.name, 10)

    def step(self, now_s):
        self.velocity = self.velocity + PERIOD_S / (LAG_S + PERIOD_S) * (
            self.command - self.velocity
        )
        self.joints = self.joints + PERIOD_S * self.velocity
        angles = self.joints + self.offset_rad
        named = dict(zip(self.names, np.arctan2(np.sin(angles), np.cos(angles)), strict=True))
        named["gripper_joint"] = 0.3
        positions = np.array([named[name] for name in sorted(named)])
        self.states.publish(ros.to_joint_state(now_s, sorted(named), positions, np.zeros(0)))
        self.exposed.append((now_s, self.pose()))
        if self.steps % 2 and self.sees:
            stamp_s, pose = self.exposed[0]
            measured = self.kind.retract(pose, NOISE_M * self.rng.normal(size=self.kind.size))
            self.poses.publish(ros.to_feature(stamp_s, CAMERA_FRAME, self.kind, measured))

    def pose(self, offset_rad=None):
        """What is seen, now or at an offset from the first joints."""
        joints = self.joints if offset_rad is None else self.chain.reference_rad + offset_rad
        return self.chain.position(joints)

    def move_object(self, *motion_m):
        """Let what a camera on the arm sees jump, m, (d,)."""
        there = self.kind.retract(self.pose(), np.array(motion_m))
        self.chain = self.chain.anchored(self.joints, there)
