"""The camera is calibrated while the collector moves the arm, over topics."""

import numpy as np
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import JointState

from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_ros.paths import find_file
from fvs_sim_node.camera import CAMERAS

MODULE = "fvs_tools.calibrate_node"


def test_the_camera_is_found_while_the_arm_moves(ros_test, tmp_path):
    out = tmp_path / "camera.yaml"
    states = ros_test.collect(DiagnosticStatus, "fvs_calibrate_node/status")
    calibrating = ros_test.start_node(
        MODULE, use_sim_time=True, output_path=str(out), stop_at_m=0.004
    )
    ros_test.spin_until(
        lambda: states and "waiting for the robot's description" in states[-1].message,
        what="the wait for a URDF",
    )
    # Fewer exchanges and images for a simulated second than with a UR.
    slow = {"joint_state_rate_hz": 50, "image_rate_hz": 15.0}
    ros_test.start_node("fvs_sim_node.node", simulated_time=True, **slow)
    ros_test.start_node(
        "fvs_estimator_node.collector_node", use_sim_time=True,
        output_path=str(tmp_path / "data.npz"), joint_range_rad=[0.5],
        max_joint_velocity_rad_s=0.65,
    )  # fmt: skip
    assert ros_test.wait(calibrating, 120.0) == 0
    content = yaml.safe_load(out.read_text())
    np.testing.assert_allclose(content["translation_m"], CAMERAS["front"].position_m, atol=6e-3)
    assert content["verdict"] == "good"
    assert "static_transform_publisher" in ros_test.output(calibrating)
    assert any("the camera is known to" in status.message for status in states)


def test_what_is_missing_is_named_and_odd_joints_end_nothing(ros_test, tmp_path):
    states = ros_test.collect(DiagnosticStatus, "fvs_calibrate_node/status")
    calibrating = ros_test.start_node(
        MODULE, urdf_path=str(find_file("robots/ur5.urdf")), output_path=str(tmp_path / "c.yaml")
    )
    joints = ros_test.publisher(JointState, "joint_states")
    ball = ros_test.publisher(PointStamped, "ball_position")

    def expect(words, publisher, message):
        def says_so():
            publisher.publish(message)
            return bool(states) and words in states[-1].message

        ros_test.spin_until(says_so, what=words)

    names = list(UR_JOINT_NAMES)
    expect("no joint_states yet", ball, PointStamped())
    expect("none of the wanted", joints, JointState(name=["finger"], position=[0.0]))
    expect("joint_states lacks", joints, JointState(name=names[:3], position=[0.0] * 3))
    expect("not finite", joints, JointState(name=names, position=[np.nan] * 6))
    good = JointState(name=names, position=[0.0] * 6)
    expect("no stamp", joints, good)
    good.header.stamp.sec = 1
    expect("frame", joints, good)  # of the ball
    ball_in_frame = PointStamped()
    ball_in_frame.header.frame_id = CAMERA_FRAME
    expect("collecting", ball, ball_in_frame)
    ros_test.stop(calibrating)
    assert "no calibration: collecting" in ros_test.output(calibrating)
