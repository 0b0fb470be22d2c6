"""The markers as a viewer gets them."""

import importlib.util

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from visualization_msgs.msg import Marker, MarkerArray

from fvs_ros import ros, topics
from fvs_ros.camera import CAMERA_FRAME

MODULE = "fvs_tools.markers_node"
BALL = np.array([0.1, 0.2, 1.5])


@pytest.fixture
def loop(ros_test):
    """A markers node, and what says ball and status to it."""
    ros_test.start_node(MODULE, rate_hz=30.0)
    ball = ros_test.publisher(PointStamped, topics.BALL_POSITION.name)
    status = ros_test.publisher(DiagnosticStatus, topics.CONTROLLER_STATUS.name)

    def say():
        now_s = ros_test.node.get_clock().now().nanoseconds * 1e-9
        ball.publish(ros.to_point(now_s, CAMERA_FRAME, BALL))
        values = {"state": "SERVOING", "error_m": 0.01}
        values |= {f"target_{axis}_m": 0.5 for axis in "xyz"}
        status.publish(ros.to_status(ros.OK, "", "", values))

    return say


def test_a_viewer_sees_ball_and_target_in_the_cameras_frame(ros_test, loop):
    seen = ros_test.collect(MarkerArray, topics.MARKERS.name)

    def complete():
        loop()
        return bool(seen) and {"ball", "target", "distance"} <= {m.ns for m in seen[-1].markers}

    ros_test.spin_until(complete, what="the markers")
    found = {marker.ns: marker for marker in seen[-1].markers}
    for marker in found.values():
        assert marker.header.frame_id == CAMERA_FRAME
        assert 0.1 < marker.lifetime.sec + marker.lifetime.nanosec * 1e-9 < 1.0
    at = found["ball"].pose.position
    assert [at.x, at.y, at.z] == pytest.approx(BALL)
    assert found["distance"].text == "10.0 mm"
    assert found["distance"].type == Marker.TEXT_VIEW_FACING


def test_nothing_is_sent_while_nobody_looks(ros_test, loop):
    states = ros_test.collect(DiagnosticStatus, "fvs_markers_node/status")
    ros_test.spin_until(lambda: bool(states), what="a status")
    assert ros.from_status(states[-1])["state"] == "IDLE"
    seen = ros_test.collect(MarkerArray, topics.MARKERS.name)
    ros_test.spin_until(
        lambda: ros.from_status(states[-1])["state"] == "SHOWING", what="the viewer to count"
    )
    ros_test.spin_until(lambda: bool(seen), what="markers, be they empty")


@pytest.mark.skipif(importlib.util.find_spec("tf2_msgs") is not None, reason="tf2_msgs is there")
def test_without_tf2_msgs_the_node_says_so_once_and_goes_on(ros_test):
    from geometry_msgs.msg import PoseStamped

    process = ros_test.start_node(MODULE)
    pose = ros_test.publisher(PoseStamped, topics.TRUE_CAMERA_POSE.name, ros.QOS_LATCHED)
    pose.publish(ros.to_pose(1.0, "base_link", np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])))
    ros_test.spin_until(
        lambda: "tf2_msgs is not installed" in ros_test.output(process), what="a line"
    )
    assert process.poll() is None
