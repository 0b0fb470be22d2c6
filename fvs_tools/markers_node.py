"""``fvs_markers_node``: ball, trail, target and prediction as markers for RViz and Foxglove."""

from __future__ import annotations

from fvs_ros import stop

stop.listen()

import sys
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, PointStamped, PoseStamped, TransformStamped
from rclpy.duration import Duration
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from fvs_ros import ros, topics
from fvs_tools import markers
from fvs_tools.markers import Scene, Shape

_KINDS = {"sphere": Marker.SPHERE, "text": Marker.TEXT_VIEW_FACING, "line": Marker.LINE_STRIP}
_STATUS_S = 0.5


class MarkersNode(ros.FvsNode):
    """Shows the loop; draws only while somebody looks."""

    def __init__(self) -> None:
        super().__init__(markers.NODE, markers.PARAMETERS)
        v = self.values
        self._frame = v["feature_frame"]
        self._scene = Scene(v["ball_radius_m"], v["trail_s"])
        self._lifetime = Duration(seconds=markers.lifetime_s(v["rate_hz"])).to_msg()
        self._markers = self.create_publisher(MarkerArray, topics.MARKERS.name, ros.QOS_RELIABLE)
        self._transforms: Any = None
        self.watch(PointStamped, topics.BALL_POSITION.name, self._on_ball, ros.QOS_NEWEST)
        self.watch(DiagnosticStatus, topics.CONTROLLER_STATUS.name, self._on_status, ros.QOS_NEWEST)
        self.watch(PoseStamped, topics.TRUE_CAMERA_POSE.name, self._on_camera_pose, ros.QOS_LATCHED)
        self.create_timer(1.0 / v["rate_hz"], self._show, clock=self.steady_clock)
        self.create_timer(_STATUS_S, self._publish_state, clock=self.steady_clock)

    # --- inputs ---

    def _on_ball(self, message: PointStamped) -> None:
        position_m = ros.from_point(message, self._frame, topics.BALL_POSITION.name)
        self._scene.add_ball(self.steady_s(), position_m)

    def _on_status(self, message: DiagnosticStatus) -> None:
        self._scene.add_status(self.steady_s(), ros.from_status(message))

    def _on_camera_pose(self, message: PoseStamped) -> None:
        """Tell where the camera stands, so that a viewer draws robot and ball in one picture."""
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError:
            self.tell(
                ros.OK,
                "tf2_msgs is not installed: where the camera stands is not told on /tf_static; "
                "choose the camera's frame as the viewer's fixed frame (a recording has it)",
            )
            return
        ros.from_pose(message, topics.TRUE_CAMERA_POSE.name)  # an error if it is none
        if self._transforms is None:
            self._transforms = self.create_publisher(
                TFMessage, topics.TF_STATIC.name, ros.QOS_LATCHED
            )
        transform = TransformStamped(header=message.header, child_frame_id=self._frame)
        at = message.pose.position
        to = transform.transform.translation
        to.x, to.y, to.z = at.x, at.y, at.z
        transform.transform.rotation = message.pose.orientation
        self._transforms.publish(TFMessage(transforms=[transform]))

    # --- output ---

    def _show(self) -> None:
        if not self._markers.get_subscription_count():
            return
        shapes = self._scene.shapes(self.steady_s())
        stamp = ros.to_stamp(self.ros_s())
        self._markers.publish(MarkerArray(markers=[self._marker(one, stamp) for one in shapes]))

    def _marker(self, shape: Shape, stamp: Any) -> Marker:
        marker = Marker(ns=shape.name, type=_KINDS[shape.kind], action=Marker.ADD, text=shape.text)
        marker.header.stamp, marker.header.frame_id = stamp, self._frame
        marker.pose.orientation.w = 1.0
        marker.lifetime = self._lifetime
        size = float(shape.size_m)
        if shape.kind == "line":
            marker.scale.x = size
            marker.points = [_point(one) for one in shape.points_m]
        else:
            marker.pose.position = _point(shape.points_m[0])
            marker.scale.x = marker.scale.y = marker.scale.z = size
        red, green, blue, opacity = shape.colour
        marker.color = ColorRGBA(r=red, g=green, b=blue, a=opacity)
        return marker

    def _publish_state(self) -> None:
        watched = self._markers.get_subscription_count()
        self.publish_status(
            ros.OK,
            "SHOWING" if watched else "IDLE",
            f"markers for {watched} viewers" if watched else "nobody looks: no markers are sent",
            {"viewers": watched},
        )


def _point(position_m: Any) -> Point:
    x, y, z = (float(value) for value in position_m)
    return Point(x=x, y=y, z=z)


def main() -> int:
    """Run ``fvs_markers_node``."""
    return ros.run(MarkersNode, __doc__, markers.PARAMETERS)


if __name__ == "__main__":
    sys.exit(main())
