"""Pose servoing through the real nodes: the detector on rendered images."""

import numpy as np
from geometry_msgs.msg import PoseStamped
from harness import Statuses

from fvs_ros import ros, topics
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.kinds.pose import Pose
from fvs_sim_node.config import SimConfig
from fvs_sim_node.simulation import Simulation

KIND = Pose()
POSE = {"feature": "pose"}


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
    ros_test.start_node("fvs_estimator_node.node", method="poe", use_sim_time=True, **POSE)
    controller = {"law": "minimum_time", "autostart": True, "use_sim_time": True}
    ros_test.start_node("fvs_controller_node.node", **POSE, **controller)
    targets = ros_test.publisher(PoseStamped, Pose.topics.target.name, ros.QOS_LATCHED)
    said = Statuses(ros_test, topics.CONTROLLER)
    said.wait_for("WAITING", "no target_pose yet")
    targets.publish(ros.to_feature(0.0, CAMERA_FRAME, KIND, target))
    said.wait_for("SERVOING", "on target")
    truth.clear()
    ros_test.spin_until(lambda: len(truth) > 20, what="the tag's true pose")
    errors = [
        KIND.status_values(KIND.minus(ros.from_feature(one, KIND, CAMERA_FRAME, "truth"), target))
        for one in truth
    ]
    assert max(one["way_m"] for one in errors) < 5e-3
    assert max(one["angle_rad"] for one in errors) < np.radians(1.0)
