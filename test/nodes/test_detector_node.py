"""The detector finds the ball in anybody's images, and says so when it cannot."""

import json

import cv2
import drawn_tags
import numpy as np
import pytest
from drawn_balls import RADIUS_M, VGA, draw
from geometry_msgs.msg import PointStamped, PoseStamped
from harness import Statuses
from sensor_msgs.msg import CameraInfo, Image

from fvs_ros import ros, topics
from fvs_ros.camera import Intrinsics
from fvs_ros.kinds.ball import Ball
from fvs_ros.kinds.kind import MOUNTS
from fvs_ros.kinds.pose import Pose

NODE = "fvs_detector_node.node"
QVGA = Intrinsics(320, 240, 307.5, 307.5, 159.5, 119.5)
FRAME = "camera_color_optical_frame"
CENTRE = np.array([0.1, -0.05, 0.9])
#: The machine may be busy; nothing here is about speed.
PATIENCE_S = 40.0


class PlayedCamera:
    """Publishes what is in view, ``rgb`` and ``depth_m``, unless it is None.

    Stamps advance by ``period_s``; those of depth are late by ``depth_late_s``.
    """

    def __init__(self, harness, qos=ros.QOS_RELIABLE, prefix="camera"):
        self.rgb, self.depth_m = draw([(CENTRE, RADIUS_M)], QVGA)
        self.depth_frame, self.period_s, self.depth_late_s = FRAME, 1 / 30, 0.0
        self.calibrated, self.view = True, QVGA
        node = harness.node
        self.stamp_s = node.get_clock().now().nanoseconds * 1e-9
        self._color, self._depth, self._info = (
            node.create_publisher(kind, topic.name.replace("camera", prefix, 1), qos)
            for kind, topic in (
                (Image, topics.COLOR_IMAGE),
                (Image, topics.DEPTH_IMAGE),
                (CameraInfo, topics.CAMERA_INFO),
            )
        )
        node.create_timer(1 / 15, self._show)

    def _show(self):
        self.stamp_s += self.period_s
        if self.calibrated:
            self._info.publish(ros.to_camera_info(self.stamp_s, FRAME, self.view))
        if self.rgb is not None:
            self._color.publish(self._color_message())
        if self.depth_m is not None:
            self._depth.publish(self._depth_message())

    def _color_message(self):
        return ros.to_image(self.stamp_s, FRAME, self.rgb, "rgb8")

    def _depth_message(self):
        stamp_s = self.stamp_s + self.depth_late_s
        pixels = np.round(1e3 * self.depth_m).astype(np.uint16)
        return ros.to_image(stamp_s, self.depth_frame, pixels, "16UC1")


class Watched(Statuses):
    """What a detector publishes and says."""

    def __init__(self, harness):
        super().__init__(harness, "fvs_detector_node")
        self.balls = harness.collect(PointStamped, Ball.topics.tool.name)

    def wait_for_balls(self, count=3):
        """Wait for this many more positions, and return them."""
        before = len(self.balls)
        self.wait(lambda: len(self.balls) >= before + count, PATIENCE_S, f"{count} balls")
        return self.balls[before:]


@pytest.fixture
def watched(ros_module, ros_beside):
    """Beside a detector with default parameters that several tests share."""
    process = ros_module.keep(NODE)
    watched = Watched(ros_beside)
    yield watched
    assert process.poll() is None
    assert "Traceback" not in ros_module.output(process)


def position(message):
    return np.array([message.point.x, message.point.y, message.point.z])


def test_each_missing_input_is_named_in_turn(watched):
    watched.wait_for("WAITING", "no colour images on /camera/color/image_raw", "no node publishes")
    camera = PlayedCamera(watched.harness)
    rgb, depth_m = camera.rgb, camera.depth_m
    camera.depth_m, camera.calibrated = None, False
    watched.wait_for("WAITING", "no depth images", "align_depth.enable:=true")
    camera.depth_m = depth_m
    watched.wait_for("WAITING", "no camera_info on /camera/color/camera_info")
    assert not watched.balls
    camera.calibrated = True
    watched.wait_for("TRACKING")
    camera.depth_late_s, camera.period_s = 0.2, 1.0
    watched.wait_for("WAITING", "+200.0 ms", "enable_sync:=true")
    camera.depth_late_s = 0.0
    watched.wait_for("TRACKING")
    camera.period_s = 0.0
    watched.wait_for("FAULT", "image stamps do not advance")
    silent = len(watched.balls)
    watched.harness.spin_for(0.5)
    assert len(watched.balls) == silent
    camera.period_s = 1 / 30
    watched.wait_for("TRACKING")
    camera.rgb = np.full_like(rgb, 150)
    watched.wait_for("LOST", "out of view")


def test_depth_that_is_not_registered_is_refused(watched):
    camera = PlayedCamera(watched.harness)
    camera.depth_frame = "camera_depth_optical_frame"
    watched.wait_for("FAULT", "not registered", "frame 'camera_depth_optical_frame'")
    depth_m = camera.depth_m
    camera.depth_frame, camera.depth_m = FRAME, depth_m[::2, ::2].copy()
    watched.wait_for("FAULT", "not registered", "160x120 pixels against 320x240")
    camera.view = VGA
    words = "camera_info: is for 640x480 pixels, but the colour images have 320x240"
    watched.wait_for("FAULT", words)
    assert not watched.balls
    camera.depth_m, camera.view = depth_m, QVGA
    watched.wait_for("TRACKING")


def test_another_cameras_names_lossy_images_and_late_stamps(ros_test):
    watched, delay_s = Watched(ros_test), 0.08
    camera = PlayedCamera(ros_test, ros.QOS_NEWEST, prefix="/cell/eye")
    ros_test.start_node(NODE, camera_topics="/cell/eye", stamp_delay_s=delay_s)
    last = watched.wait_for_balls()[-1]
    np.testing.assert_allclose(position(last), CENTRE, atol=0.004)
    assert last.header.frame_id == FRAME
    behind_s = (camera.stamp_s - ros.from_stamp(last.header.stamp)) % camera.period_s
    ahead_s = (behind_s - delay_s) % camera.period_s
    assert min(ahead_s, camera.period_s - ahead_s) < 1e-5


def start_with_file(ros_test, section="/**", remaps=(), **parameters):
    """A detector with a file of parameters, of all nodes or of one."""
    file = ros_test.folder / "all.yaml"
    file.write_text(f"{section}: {{ros__parameters: {json.dumps(parameters)}}}\n")
    return ros_test.start(NODE, "--ros-args", "--params-file", str(file), *remaps)


def test_a_file_of_all_nodes_may_hold_no_slip_and_one_of_a_node_nothing_of_others(ros_test):
    detector = start_with_file(ros_test, ball_radus_m=0.03)
    assert ros_test.wait(detector) == 2
    assert "unknown parameter 'ball_radus_m'" in ros_test.output(detector)
    for section, remaps in (
        ("/**/fvs_detector_node", ()),
        ("/left/fvs_detector_node", ("-r", "__ns:=/left")),
        ("own_name", ("-r", "__node:=own_name")),
    ):
        detector = start_with_file(ros_test, section, remaps, tf_prefix="left_")
        assert ros_test.wait(detector) == 2
        assert "unknown parameter 'tf_prefix'" in ros_test.output(detector)


@pytest.mark.parametrize("mount", MOUNTS)
def test_a_tag_is_published_as_a_pose_from_colour_images_alone(ros_test, mount):
    kind = Pose(camera_mount=mount)
    own = {"feature": "pose", "tag_id": 7, "tag_size_m": 0.06, "camera_mount": mount}
    detector = start_with_file(ros_test, tf_prefix="left_", **own)
    watched, tag_m = Watched(ros_test), np.array([0.02, 0.01, 0.4])
    poses = ros_test.collect(PoseStamped, kind.feature.name)
    rotation = cv2.Rodrigues(np.array([0.5, 0.0, 0.0]))[0] @ np.diag([1.0, -1.0, -1.0])
    camera = PlayedCamera(ros_test)
    camera.depth_m, camera.calibrated = None, False
    watched.wait_for("WAITING", "no camera_info")
    camera.calibrated = True
    watched.wait_for("LOST", "tag 7 of APRILTAG_36h11 is not in view")
    camera.rgb = drawn_tags.draw([(7, rotation, tag_m)], QVGA)
    watched.wait_for("TRACKING", f"{kind.feature.name} is published")
    ros_test.spin_until(lambda: len(poses) > 3, what="poses")
    tag = Pose().read(poses[-1])
    assert np.linalg.norm(tag[:3] - tag_m) < 5e-3
    np.testing.assert_allclose(Pose().rotation(tag), rotation, atol=0.1)
    assert poses[-1].header.frame_id == FRAME
    camera.rgb = drawn_tags.draw([(7, rotation, tag_m + [x, 0, 0]) for x in (-0.1, 0.1)], QVGA)
    watched.wait_for("LOST", "2 tags have the number 7")
    assert not watched.balls
    assert ros_test.stop(detector) == 0
    assert "Traceback" not in ros_test.output(detector)
    assert "given to all nodes, no parameters of this one: tf_prefix" in ros_test.output(detector)


def test_tool_and_object_are_published_from_one_image_and_each_without_the_other(ros_test):
    own = {
        "tag_id": 7,
        "tag_size_m": 0.06,
        "object_tag_size_m": 0.06,
        "object_tag_layout": "single",
    }
    ros_test.start_node(NODE, feature="pose", object_tag_id=10, **own)
    watched, camera = Watched(ros_test), PlayedCamera(ros_test)
    tools, objects = (
        ros_test.collect(PoseStamped, topic.name)
        for topic in (Pose.topics.tool, Pose.topics.object)
    )
    rotation = cv2.Rodrigues(np.array([0.5, 0.0, 0.0]))[0] @ np.diag([1.0, -1.0, -1.0])

    def assert_seen(numbers, *words):
        tags = [(number, rotation, [0.12 * i - 0.12, 0.0, 0.5]) for i, number in enumerate(numbers)]
        camera.rgb = drawn_tags.draw(tags, QVGA)
        watched.wait_for(*words)
        ros_test.spin_for(0.2)
        published = numbers.count(7) == 1, numbers.count(10) == 1
        tools.clear(), objects.clear()
        ros_test.spin_until(lambda: max(len(tools), len(objects)) > 3)
        assert (bool(tools), bool(objects)) == published

    assert_seen([7, 10], "TRACKING", "tool_pose is published; object: object_pose is published")
    stamps = [{str(message.header) for message in messages} for messages in (tools, objects)]
    assert stamps[0] & stamps[1]
    for messages, x in ((tools, -0.12), (objects, 0.0)):
        assert np.linalg.norm(Pose().read(messages[-1])[:3] - [x, 0.0, 0.5]) < 5e-3
    assert_seen([7, 11], "TRACKING", "object: tag 10 of", "seen are [7, 11]: is the number right?")
    assert_seen([7, 10, 10], "TRACKING", "object: 2 tags have the number 10: cover all but one")
    assert_seen([10], "LOST", "tag 7 of", "object: object_pose is published")
