"""Pose servoing through the real nodes: the detector on rendered images, and bad poses."""

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import Float64MultiArray

from fvs_ros import ros, topics
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.kinds.pose import Pose
from fvs_sim_node.config import SimConfig
from fvs_sim_node.simulation import Simulation

KIND = Pose()
POSE = {"feature": "pose"}


def pose(stamp_s, feature_m, frame=CAMERA_FRAME):
    return ros.to_feature(stamp_s, frame, KIND, feature_m)


class Loop:
    """Estimator and controller, and what the controller says."""

    def __init__(self, harness, **controller):
        self.harness = harness
        self.statuses = harness.collect(DiagnosticStatus, topics.CONTROLLER_STATUS.name)
        simulated = {"use_sim_time": controller.get("use_sim_time", False)}
        harness.start_node("fvs_estimator_node.node", method="poe", **POSE, **simulated)
        harness.start_node("fvs_controller_node.node", **POSE, **controller)
        self.targets = harness.publisher(PoseStamped, Pose.topics.target.name, ros.QOS_LATCHED)

    def wait_for(self, state, words="", patience_s=20.0):
        def said():
            if not self.statuses:
                return False
            last = self.statuses[-1]
            return ros.from_status(last)["state"] == state and words in last.message

        self.harness.spin_until(said, patience_s, f"{state} {words}")


def test_a_tag_in_rendered_images_is_detected_and_servoed(ros_test):
    simulation = Simulation(SimConfig(feature="pose", rendered=False))
    goal = simulation.joints_rad + [0.15, -0.1, 0.1, 0.1, -0.15, 0.2]
    target = simulation.true_chain(KIND).position(goal)
    truth = ros_test.collect(PoseStamped, Pose.topics.truth.name)
    ros_test.start_node(
        "fvs_sim_node.node",
        publish_ball_position=False,
        simulated_time=True,
        joint_state_rate_hz=50,
        image_rate_hz=10.0,
        **POSE,
    )
    ros_test.start_node("fvs_detector_node.node", use_sim_time=True, **POSE)
    loop = Loop(ros_test, use_sim_time=True, law="minimum_time", autostart=True)
    loop.wait_for("WAITING", "no target_pose yet", 40.0)
    loop.targets.publish(pose(0.0, target))
    loop.wait_for("SERVOING", "on target")
    truth.clear()
    ros_test.spin_until(lambda: len(truth) > 20, what="the tag's true pose")
    errors = [
        KIND.status_values(KIND.minus(ros.from_feature(one, KIND, CAMERA_FRAME, "truth"), target))
        for one in truth
    ]
    assert max(one["way_m"] for one in errors) < 5e-3
    assert max(one["angle_rad"] for one in errors) < np.radians(1.0)


def test_poses_that_are_none_never_move_the_arm(ros_test):
    ros_test.start_node("fvs_sim_node.node", {Pose.topics.tool.name: "not_heard"}, **POSE)
    seen = ros_test.collect(PoseStamped, "not_heard")
    commands = ros_test.collect(Float64MultiArray, topics.COMMANDS.name)
    loop = Loop(ros_test, autostart=True)
    tracker = ros_test.publisher(PoseStamped, Pose.topics.tool.name)
    ros_test.spin_until(lambda: len(seen) > 5, 40.0, "the simulator's tag")
    good = ros.from_feature(seen[-1], KIND, CAMERA_FRAME, "tag")

    def short(message):
        message.pose.orientation.w = message.pose.orientation.x = 0.0
        return message

    def far(message):
        message.pose.position.z = float("nan")
        return message

    def elsewhere(message):
        message.header.frame_id = "base_link"
        return message

    loop.targets.publish(pose(0.0, good, "base_link"))
    loop.wait_for("WAITING", "it is in frame base_link, expected")
    bad = pose(0.0, good)
    bad.pose.orientation.w = 3.0
    loop.targets.publish(bad)
    loop.wait_for("WAITING", "target_pose is no pose")
    aside = KIND.retract(good, np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0]))
    loop.targets.publish(pose(0.0, aside))
    for change, words in (
        (short, "tool_pose is no pose"),
        (far, "tool_pose is no pose"),
        (elsewhere, "tool_pose is in frame 'base_link'"),
    ):
        start = len(seen)
        ros_test.spin_until(lambda start=start: len(seen) > start, what="another pose")
        tracker.publish(change(seen[-1]))
        loop.wait_for("WAITING", words)
    assert not any(any(message.data) for message in commands)
