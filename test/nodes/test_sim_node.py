"""The simulator node as others see it: over DDS, in the contract of a real UR5."""

from xml.etree import ElementTree

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped, PoseStamped
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Bool, Float64MultiArray, String
from std_srvs.srv import Trigger
from ur5_dh import axes_origins_ball

from fvs_ros import ros, topics
from fvs_ros.joints import UR_JOINT_NAMES, JointMap
from fvs_ros.kinds.ball import Ball
from fvs_ros.kinds.pose import Pose
from fvs_sim_node.config import PARAMETERS

MODULE = "fvs_sim_node.node"


@pytest.fixture
def simulator(ros_module, ros_beside):
    """One beside a simulator that other tests use as well; it is put back afterwards."""
    ros_module.keep(MODULE)
    yield ros_beside
    live = {parameter.name: parameter.default for parameter in PARAMETERS if parameter.live}
    assert all(result.successful for result in ros_beside.set_parameters("fvs_sim_node", **live))
    assert ros_beside.call(Trigger, "fvs_sim_node/reset").success


def positions(message):
    return JointMap().positions(message.name, message.position)


def set_parameter(harness, name, value):
    return harness.set_parameters("fvs_sim_node", **{name: value})[0]


def test_it_publishes_what_a_ur_and_a_detector_publish(simulator):
    states = simulator.collect(JointState, topics.JOINT_STATES.name)
    balls = simulator.collect(PointStamped, Ball.topics.tool.name)
    truths = simulator.collect(PointStamped, "fvs_sim_node/true_ball_position")
    running = simulator.collect(Bool, topics.ROBOT_PROGRAM_RUNNING.name, ros.QOS_LATCHED)
    simulator.spin_until(lambda: len(states) > 60 and len(balls) > 10 and truths and running)
    assert list(states[-1].name) == sorted(UR_JOINT_NAMES)  # as a UR's driver
    assert np.isfinite([states[-1].position, states[-1].velocity, states[-1].effort]).all()
    assert running[0].data
    assert balls[-1].header.frame_id == "camera_color_optical_frame"
    # A ball position is published latency_s after the exposure that it is stamped with.
    age_s = ros.from_stamp(states[-1].header.stamp) - ros.from_stamp(balls[-1].header.stamp)
    assert 0.03 < age_s < 0.2
    ball, truth = (np.array([m.point.x, m.point.y, m.point.z]) for m in (balls[-1], truths[-1]))
    assert 0.0 < np.linalg.norm(ball - truth) < 0.01


def test_it_obeys_a_command_in_kinematic_order_and_holds_it(simulator):
    states = simulator.collect(JointState, topics.JOINT_STATES.name)
    colours = simulator.collect(Image, topics.COLOR_IMAGE.name, ros.QOS_RELIABLE)
    commands = simulator.publisher(Float64MultiArray, topics.COMMANDS.name)
    simulator.spin_until(lambda: len(states) > 0)
    start = positions(states[-1])
    commands.publish(Float64MultiArray(data=[0.0, 0.0, 0.2, 0.0, 0.0, 0.0]))
    simulator.spin_until(lambda: abs(positions(states[-1]) - start).max() > 0.1)
    moved = positions(states[-1]) - start
    assert UR_JOINT_NAMES[int(np.argmax(np.abs(moved)))] == "elbow_joint"
    assert np.abs(np.delete(moved, 2)).max() < 1e-3
    # Not finite: dropped, the old velocity goes on.
    commands.publish(Float64MultiArray(data=[float("nan")] * 6))
    here = positions(states[-1])
    simulator.spin_until(lambda: positions(states[-1])[2] - here[2] > 0.1)
    # Another size: the controller is deactivated, the arm stands until a reset.
    commands.publish(Float64MultiArray(data=[0.1] * 5))
    simulator.spin_until(lambda: abs(states[-1].velocity[0]) < 1e-3, what="the arm to stand")
    assert simulator.call(Trigger, "fvs_sim_node/reset").success
    simulator.spin_until(lambda: np.abs(positions(states[-1]) - start).max() < 1e-3)
    count = len(colours)  # one is drawn while the simulation begins at zero again
    simulator.spin_until(lambda: len(colours) > count + 1)
    stamps_s = [ros.from_stamp(image.header.stamp) for image in colours]
    assert stamps_s == sorted(stamps_s)


def test_images_are_rendered_for_subscribers_and_match_camera_info(ros_test):
    simulator = ros_test
    slow = {"joint_state_rate_hz": 50, "image_rate_hz": 5.0}
    simulator.start_node(MODULE, simulated_time=True, **slow)
    states = simulator.collect(JointState, topics.JOINT_STATES.name)
    infos = simulator.collect(CameraInfo, topics.CAMERA_INFO.name, ros.QOS_RELIABLE)
    simulator.spin_until(lambda: states and infos, what="camera_info without a look at images")
    colours = simulator.collect(Image, topics.COLOR_IMAGE.name, ros.QOS_RELIABLE)
    depths = simulator.collect(Image, topics.DEPTH_IMAGE.name, ros.QOS_RELIABLE)
    balls = simulator.collect(PointStamped, Ball.topics.tool.name)
    shown = []

    def looked():
        stamps = [info.header.stamp for info in infos]
        shown[:] = [image for image in colours if image.header.stamp in stamps]
        return len(shown) > 2 and len(depths) > 2 and len(balls) > 2

    simulator.spin_until(looked, what="images with their camera_info")
    colour, depth = shown[-1], depths[-1]
    info = next(info for info in infos if info.header.stamp == colour.header.stamp)
    assert (colour.encoding, depth.encoding) == ("rgb8", "16UC1")
    assert (colour.width, colour.height) == (info.width, info.height) == (640, 480)
    ball = balls[-1].point
    u = round(info.k[0] * ball.x / ball.z + info.k[2])
    v = round(info.k[4] * ball.y / ball.z + info.k[5])
    red, green, _ = np.frombuffer(colour.data, np.uint8).reshape(480, 640, 3)[v, u].astype(int)
    assert red > max(100, 2 * green)
    surface_m = np.frombuffer(depth.data, np.uint16).reshape(480, 640)[v, u] * 1e-3
    assert surface_m == pytest.approx(ball.z - 0.04, abs=0.02)


def test_a_detector_sees_tool_and_object_and_the_object_jumps(ros_test):
    own = {"feature": "pose", "object_tag_id": 10}
    slow = {"joint_state_rate_hz": 50, "image_rate_hz": 5.0, "publish_ball_position": False}
    ros_test.start_node(MODULE, simulated_time=True, **slow, **own)
    ros_test.start_node("fvs_detector_node.node", use_sim_time=True, **own)
    measured, true = (
        [ros_test.collect(PoseStamped, topic.name) for topic in both]
        for both in (
            (Pose.topics.tool, Pose.topics.object),
            (Pose.topics.truth, Pose.topics.object_truth),
        )
    )

    def right():
        pairs = [(a[-1], b[-1]) for a, b in zip(measured, true, strict=True) if a and b]
        errors_m = [np.linalg.norm(Pose().minus(*map(Pose().read, pair))) for pair in pairs]
        return len(errors_m) == 2 and max(errors_m) < 5e-3

    ros_test.spin_until(right, what="tool and object where they are")
    assert set_parameter(ros_test, "object_position_m", [0.4, 0.1, 0.1]).successful
    ros_test.spin_until(lambda: not right(), what="the jump")
    ros_test.spin_until(right, what="tool and object where they are")


def test_a_viewer_learns_of_robot_and_camera_whenever_it_comes(ros_test):
    ros_test.start_node("fvs_sim_node.node", tf_prefix="left_")
    descriptions = ros_test.collect(String, topics.ROBOT_DESCRIPTION.name, ros.QOS_LATCHED)
    poses = ros_test.collect(PoseStamped, topics.TRUE_CAMERA_POSE.name, ros.QOS_LATCHED)
    balls = ros_test.collect(PointStamped, Ball.topics.truth.name)
    states = ros_test.collect(JointState, topics.JOINT_STATES.name)
    ros_test.spin_until(lambda: descriptions and poses and balls and states)
    robot = ElementTree.fromstring(descriptions[0].data)
    joints = {joint.get("name") for joint in robot.iter("joint") if joint.get("type") == "revolute"}
    assert joints == {f"left_{name}" for name in UR_JOINT_NAMES}
    assert poses[0].header.frame_id == "left_base_link"

    def in_base_link():
        camera = Pose().read(poses[-1])
        ball = np.array([getattr(balls[-1].point, axis) for axis in "xyz"])
        return Pose().rotation(camera) @ ball + camera[:3]

    joints_rad = JointMap(tf_prefix="left_").positions(states[-1].name, states[-1].position)
    ball_m = axes_origins_ball(joints_rad)[2] * [-1.0, -1.0, 1.0]  # base_link: half a turn
    np.testing.assert_allclose(in_base_link(), ball_m, atol=1e-4)
    assert set_parameter(ros_test, "camera_rotation_deg", [0.0, 20.0, 0.0]).successful
    ros_test.spin_until(lambda: len(poses) > 1)
    ros_test.spin_for(0.1)
    np.testing.assert_allclose(in_base_link(), ball_m, atol=1e-4)


def fastest(message):
    return max(abs(v) for v in message.velocity)


def test_a_pause_is_announced_once_and_a_controller_that_comes_back_stands(simulator):
    states = simulator.collect(JointState, topics.JOINT_STATES.name)
    running = simulator.collect(Bool, topics.ROBOT_PROGRAM_RUNNING.name, ros.QOS_LATCHED)
    commands = simulator.publisher(Float64MultiArray, topics.COMMANDS.name)
    simulator.spin_until(lambda: states and running)
    commands.publish(Float64MultiArray(data=[0.2, 0.0, 0.0, 0.0, 0.0, 0.0]))
    simulator.spin_until(lambda: fastest(states[-1]) > 0.19, what="motion")
    for _ in range(2):
        assert set_parameter(simulator, "program_running", False).successful
    simulator.spin_until(lambda: fastest(states[-1]) < 1e-3, what="the arm to stand")
    # A command in the pause is lost, and whoever listens only now hears of the pause as well.
    commands.publish(Float64MultiArray(data=[0.3, 0.0, 0.0, 0.0, 0.0, 0.0]))
    late = simulator.collect(Bool, topics.ROBOT_PROGRAM_RUNNING.name, ros.QOS_LATCHED)
    simulator.spin_until(lambda: bool(late), what="the latched pause")
    assert [m.data for m in late] == [False]
    for _ in range(2):
        assert set_parameter(simulator, "program_running", True).successful
    simulator.spin_until(lambda: len(running) == 3, what="the end of the pause")
    count = len(states)
    simulator.spin_for(0.3)
    assert len(states) > count
    assert max(fastest(m) for m in states[count:]) < 1e-3
    commands.publish(Float64MultiArray(data=[0.3, 0.0, 0.0, 0.0, 0.0, 0.0]))
    simulator.spin_until(lambda: fastest(states[-1]) > 0.29, what="motion")
    assert [m.data for m in running] == [True, False, True]
