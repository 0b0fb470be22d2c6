"""The markers as a viewer gets them."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from visualization_msgs.msg import Marker, MarkerArray

from fvs_ros import ros, topics
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.kinds.ball import Ball

MODULE = "fvs_tools.markers_node"
BALL = np.array([0.1, 0.2, 1.5])
STATUS = {"state": "SERVOING", "error_m": 0.01}
STATUS |= {f"target_{axis}_m": 0.5 for axis in "xyz"}
STATUS |= dict(zip(("position_x_m", "position_y_m", "position_z_m"), BALL, strict=True))


@pytest.fixture
def viewer(ros_test):
    """A markers node; says ball and status to it until a viewer sees the markers of these names."""
    ros_test.start_node(MODULE)
    states = ros_test.collect(DiagnosticStatus, "fvs_markers_node/status")
    ros_test.spin_until(lambda: bool(states), what="a status")
    assert ros.from_status(states[-1])["state"] == "IDLE"
    ball = ros_test.publisher(PointStamped, Ball.topics.tool.name)
    status = ros_test.publisher(DiagnosticStatus, topics.CONTROLLER_STATUS.name)
    seen = ros_test.collect(MarkerArray, topics.MARKERS.name)

    def until(names, ball_m=BALL, **values):
        def complete():
            now_s = ros_test.node.get_clock().now().nanoseconds * 1e-9
            if ball_m is not None:
                ball.publish(ros.to_point(now_s, CAMERA_FRAME, ball_m))
            if values:
                status.publish(ros.to_status(ros.OK, "", "", values))
            return bool(seen) and {marker.ns for marker in seen[-1].markers} == names

        ros_test.spin_until(complete, what=f"the markers {names}")
        return {marker.ns: marker for marker in seen[-1].markers}

    return until


def test_a_viewer_sees_ball_target_and_prediction_in_the_cameras_frame(viewer):
    found = viewer({"ball", "trail", "target", "distance", "predicted"}, **STATUS)
    for marker in found.values():
        assert marker.header.frame_id == CAMERA_FRAME
        assert 0.1 < marker.lifetime.sec + marker.lifetime.nanosec * 1e-9 < 1.0
    at = found["ball"].pose.position
    assert [at.x, at.y, at.z] == pytest.approx(BALL)
    assert found["ball"].scale.x == pytest.approx(0.08)
    assert found["trail"].type == Marker.LINE_STRIP
    assert len(found["trail"].points) > 1
    assert found["distance"].text == "10.0 mm"
    assert found["distance"].type == Marker.TEXT_VIEW_FACING
    assert found["distance"].pose.position.y < 0.5, "above: the camera's y points down"
    assert found["target"].color.a < 1.0, "it must not hide the ball"
