"""The detector finds the ball in anybody's images, and says so when it cannot."""

import itertools

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from drawn_balls import RADIUS_M, draw
from geometry_msgs.msg import PointStamped
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from fvs_ros import ros, topics
from fvs_ros.camera import Intrinsics

NODE = "fvs_detector_node.node"
QVGA = Intrinsics(320, 240, 307.5, 307.5, 159.5, 119.5)
FRAME = "camera_color_optical_frame"
CENTRE = np.array([0.1, -0.05, 0.9])
#: The machine may be busy; nothing here is about speed.
PATIENCE_S = 40.0


class PlayedCamera:
    """Publishes drawn pictures, each topic as its `messages` make it.

    Attributes
    ----------
    rgb, depth_m : ndarray
        What is in view; none is published while it is None.
    depth_frame : str
        Frame of the depth image.
    period_s : float
        By how much the stamps advance from picture to picture.
    depth_late_s : float
        Stamp of depth less that of colour.
    """

    def __init__(
        self,
        harness,
        qos=ros.QOS_RELIABLE,
        compressed=False,
        rename=lambda topic: topic,
    ):
        self.rgb, self.depth_m = draw([(CENTRE, RADIUS_M)], QVGA)
        self.depth_frame, self.period_s, self.depth_late_s = FRAME, 1 / 30, 0.0
        self.compressed, self.calibrated = compressed, True
        self._stamp_s = harness.node.get_clock().now().nanoseconds * 1e-9
        kind = CompressedImage if compressed else Image
        node = harness.node
        color = topics.COLOR_IMAGE.name + ("/compressed" if compressed else "")
        depth = topics.DEPTH_IMAGE.name + ("/compressedDepth" if compressed else "")
        self._color = node.create_publisher(kind, rename(color), qos)
        self._depth = node.create_publisher(kind, rename(depth), qos)
        self._info = node.create_publisher(CameraInfo, rename(topics.CAMERA_INFO.name), qos)
        node.create_timer(1 / 15, self._show)

    def _show(self):
        self._stamp_s += self.period_s
        stamp_s = self._stamp_s
        if self.calibrated:
            self._info.publish(ros.to_camera_info(stamp_s, FRAME, QVGA))
        if self.rgb is not None:
            self._color.publish(self._color_message(stamp_s))
        if self.depth_m is not None:
            self._depth.publish(self._depth_message(stamp_s + self.depth_late_s))

    def _color_message(self, stamp_s):
        if not self.compressed:
            return ros.to_image(stamp_s, FRAME, self.rgb, "rgb8")
        message = CompressedImage(format="rgb8; jpeg compressed bgr8")
        message.data = cv2.imencode(".jpg", self.rgb[..., ::-1])[1].tobytes()
        return self._stamped(message, stamp_s, FRAME)

    def _depth_message(self, stamp_s):
        pixels = np.round(1e3 * self.depth_m).astype(np.uint16)
        if not self.compressed:
            return ros.to_image(stamp_s, self.depth_frame, pixels, "16UC1")
        message = CompressedImage(format="16UC1; compressedDepth png")
        message.data = bytes(12) + cv2.imencode(".png", pixels)[1].tobytes()
        return self._stamped(message, stamp_s, self.depth_frame)

    @staticmethod
    def _stamped(message, stamp_s, frame):
        message.header.stamp = ros.to_stamp(stamp_s)
        message.header.frame_id = frame
        return message


class Watched:
    """What a detector publishes, and a wait for what its status says."""

    def __init__(self, harness):
        self.harness = harness
        self.balls = harness.collect(PointStamped, topics.BALL_POSITION.name)
        self.status = harness.collect(DiagnosticStatus, "fvs_detector_node/status")

    def wait_for(self, state, *said):
        """Wait until the newest status is this state with these words."""

        def seen():
            if not self.status:
                return False
            last = self.status[-1]
            right = ros.from_status(last)["state"] == state
            return right and all(words in last.message for words in said)

        self._spin_until(seen, f"{state} {said}")
        return ros.from_status(self.status[-1])

    def wait_for_balls(self, count=3):
        """Wait for this many more positions, and return them."""
        before = len(self.balls)
        self._spin_until(lambda: len(self.balls) >= before + count, f"{count} balls")
        return self.balls[before:]

    def _spin_until(self, condition, what):
        try:
            self.harness.spin_until(condition, PATIENCE_S, what)
        except AssertionError as error:
            last = [message.message for message in self.status[-3:]]
            raise AssertionError(f"{error}\nthe last statuses are {last}") from error


@pytest.fixture
def beside(ros_module, ros_beside):
    """A context beside a detector with default parameters that several tests share."""
    ros_module.keep(NODE)
    return ros_beside


def position(message):
    return np.array([message.point.x, message.point.y, message.point.z])


def stamp(message):
    return (message.header.stamp.sec, message.header.stamp.nanosec)


def set_parameter(ros_test, name, value):
    request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    return ros_test.call(SetParameters, "fvs_detector_node/set_parameters", request).results[0]


# --------------------------------------------------------------------- what others publish
def test_it_agrees_with_the_simulators_own_detection(ros_test):
    watched = Watched(ros_test)
    expected = ros_test.collect(PointStamped, "sim_ball")
    ros_test.start_node(NODE, use_sim_time=True)
    watched.wait_for("WAITING", "no colour images")
    options = {
        "simulated_time": True,
        "image_width": 320,
        "image_height": 240,
        "depth_noise": 0.0,
    }
    arguments = ["--ros-args", "-r", f"{topics.BALL_POSITION.name}:=sim_ball"]
    for name, value in options.items():
        arguments += ["-p", f"{name}:={str(value).lower() if value is True else value}"]
    ros_test.start("fvs_sim_node.node", *arguments)

    def compared():
        known = {stamp(message): position(message) for message in expected}
        return [
            (position(message), known[stamp(message)])
            for message in watched.balls
            if stamp(message) in known
        ]

    ros_test.spin_until(lambda: len(compared()) >= 10, PATIENCE_S, "positions at the same stamps")
    for found, own in compared():
        np.testing.assert_allclose(found, own, atol=5e-4)  # depth in whole millimetres
    assert watched.balls[-1].header.frame_id == FRAME


@pytest.mark.parametrize("qos", [ros.QOS_NEWEST, ros.QOS_RELIABLE])
def test_images_arrive_whatever_the_publishers_reliability(beside, qos):
    watched = Watched(beside)
    PlayedCamera(beside, qos)
    for message in watched.wait_for_balls():
        np.testing.assert_allclose(position(message), CENTRE, atol=2e-3)
        assert message.header.frame_id == FRAME
    values = watched.wait_for("TRACKING")
    assert float(values["quality"]) > 0.8
    assert float(values["processing_ms"]) > 0.0


@pytest.mark.parametrize(
    ("prefix", "values"),
    [("camera/camera", {}), ("/cell/eye", {"camera_topics": "/cell/eye"})],
    ids=["realsense", "parameter"],
)
def test_a_camera_is_found_by_its_drivers_names_and_its_late_stamps_are_put_right(
    ros_test, prefix, values
):
    watched, delay_s = Watched(ros_test), 0.08
    camera = PlayedCamera(ros_test, rename=lambda topic: topic.replace("camera", prefix, 1))
    ros_test.start_node(NODE, stamp_delay_s=delay_s, **values)
    last = watched.wait_for_balls()[-1]
    np.testing.assert_allclose(position(last), CENTRE, atol=0.002)
    behind_s = (camera._stamp_s - ros.from_stamp(last.header.stamp)) % camera.period_s
    assert behind_s == pytest.approx(delay_s % camera.period_s, abs=1e-5)


def test_compressed_images(ros_test):
    watched = Watched(ros_test)
    PlayedCamera(ros_test, compressed=True)
    ros_test.start_node(NODE, compressed_images=True)
    for message in watched.wait_for_balls():
        np.testing.assert_allclose(position(message), CENTRE, atol=4e-3)


# ------------------------------------------------------------------------- what goes wrong


def test_each_missing_input_is_named_in_turn(ros_test):
    watched = Watched(ros_test)
    detector = ros_test.start_node(NODE)
    watched.wait_for("WAITING", "no colour images on /camera/color/image_raw", "no node publishes")
    camera = PlayedCamera(ros_test)
    rgb, depth_m = camera.rgb, camera.depth_m
    camera.depth_m, camera.calibrated = None, False
    watched.wait_for("WAITING", "no depth images", "align_depth.enable:=true")
    camera.depth_m = depth_m
    watched.wait_for("WAITING", "no camera_info on /camera/color/camera_info")
    assert not watched.balls
    camera.calibrated = True
    watched.wait_for("TRACKING")
    camera.depth_late_s = 0.2
    camera.period_s = 1.0
    watched.wait_for("WAITING", "+200.0 ms", "enable_sync:=true")
    camera.depth_late_s = 0.0
    watched.wait_for("TRACKING")
    camera.period_s = 0.0
    watched.wait_for("FAULT", "image stamps do not advance")
    silent = len(watched.balls)
    ros_test.spin_for(0.5)
    assert len(watched.balls) == silent
    camera.period_s = 1 / 30
    watched.wait_for("TRACKING")
    camera.rgb = np.full_like(rgb, 150)
    watched.wait_for("LOST", "out of view")
    assert ros_test.stop(detector) == 0


def test_depth_that_is_not_registered_is_refused(beside):
    watched = Watched(beside)
    camera = PlayedCamera(beside)
    camera.depth_frame = "camera_depth_optical_frame"
    watched.wait_for("FAULT", "not registered", "frame 'camera_depth_optical_frame'")
    depth_m = camera.depth_m
    camera.depth_frame, camera.depth_m = FRAME, depth_m[::2, ::2].copy()
    watched.wait_for("FAULT", "not registered", "160x120 pixels against 320x240")
    assert not watched.balls
    camera.depth_m = depth_m
    watched.wait_for("TRACKING")


def test_parameters_are_live(beside):
    watched = Watched(beside)
    PlayedCamera(beside)
    watched.wait_for("TRACKING")
    assert set_parameter(beside, "min_value", 254).successful
    watched.wait_for("LOST", "too dark")
    assert set_parameter(beside, "min_value", 35).successful
    watched.wait_for("TRACKING")
    refused = set_parameter(beside, "compressed_images", True)
    assert not refused.successful


def test_no_message_ends_it(ros_test):
    watched = Watched(ros_test)
    detector = ros_test.start_node(NODE)
    color = ros_test.publisher(Image, topics.COLOR_IMAGE.name)
    depth = ros_test.publisher(Image, topics.DEPTH_IMAGE.name)
    info = ros_test.publisher(CameraInfo, topics.CAMERA_INFO.name)
    rgb, _ = draw([], QVGA)
    sizes = (0, 1, 7, 2**32 - 1)
    for i, (width, height) in enumerate(itertools.product(sizes, sizes)):
        message = ros.to_image(float(i), "\n" * i, rgb, ("rgb8", "16UC1", "32FC1", "")[i % 4])
        message.width, message.height = width, height
        color.publish(message)
        depth.publish(message)
        calibration = ros.to_camera_info(float(i), FRAME, QVGA)
        calibration.k = [float("nan")] * 9 if i % 2 else [1e300] * 9
        calibration.d = [1e300] * (i % 9)
        info.publish(calibration)
        ros_test.spin_for(0.02)
    watched.wait_for("FAULT")
    assert detector.poll() is None
    PlayedCamera(ros_test)
    watched.wait_for("TRACKING")
    assert ros_test.stop(detector) == 0
    assert "Traceback" not in ros_test.output(detector)
