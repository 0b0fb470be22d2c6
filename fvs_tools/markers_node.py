"""``fvs_markers_node``: ball, trail, target and prediction as markers for RViz and Foxglove."""

from __future__ import annotations

from fvs_ros import stop

stop.listen()

import sys
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, PoseStamped, TransformStamped
from rclpy.duration import Duration
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from fvs_ros import ros, topics
from fvs_ros.kinds.pose import Pose
from fvs_ros.status import number, vector
from fvs_tools.observing import MARKERS_PARAMETERS, MarkersConfig

_PERIOD_S, _STATUS_S = 0.1, 0.5
_TRAIL_S = 10.0
#: Time without updates after which a marker disappears, s.
_FRESH_S = 0.5
_LINE_M, _TEXT_M = 0.006, 0.035
#: Red, green, blue, opacity: the target must not hide the ball.
_COLOURS = {
    "ball": (0.85, 0.1, 0.1, 1.0),
    "trail": (0.95, 0.75, 0.1, 0.9),
    "target": (0.2, 0.75, 0.35, 0.4),
    "predicted": (0.1, 0.45, 0.7, 0.9),
    "distance": (1.0, 1.0, 1.0, 1.0),
}


class MarkersNode(ros.FvsNode):
    """Shows the loop in the camera's optical frame; draws only while a viewer subscribes."""

    def __init__(self) -> None:
        super().__init__("fvs_markers_node", MARKERS_PARAMETERS)
        self._config = MarkersConfig.from_values(self.values)
        self._trail: deque[tuple[float, Point]] = deque()
        self._status_values: Mapping[str, str] = {}
        self._status_s = float("-inf")
        self._markers = self.publisher(topics.MARKERS)
        self._transforms: Any = None
        self._kind = self._config.kind
        self.subscribe(self._kind.topics.tool, self._on_feature)
        self.subscribe(topics.CONTROLLER_STATUS, self._on_status)
        self.subscribe(topics.TRUE_CAMERA_POSE, self._on_camera_pose)
        self.create_timer(_PERIOD_S, self._show, clock=self.steady_clock)
        self.create_timer(_STATUS_S, self._publish_state, clock=self.steady_clock)

    # --- inputs ---

    def _on_feature(self, message: Any) -> None:
        kind, frame = self._kind, self._config.feature_frame
        x, y, z, *_ = ros.from_feature(message, kind, frame, kind.topics.tool.name).tolist()
        self._trail.append((self.steady_s(), Point(x=x, y=y, z=z)))
        self._forget()

    def _on_status(self, message: DiagnosticStatus) -> None:
        self._status_values, self._status_s = ros.from_status(message), self.steady_s()

    def _on_camera_pose(self, message: PoseStamped) -> None:
        """Publish the camera pose as a transform, so that viewers show robot and ball together."""
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError:
            self.tell(
                ros.OK,
                "tf2_msgs is not installed: no camera on /tf_static; "
                "choose the camera's frame as the viewer's fixed frame (a recording has it)",
            )
            return
        frame = message.header.frame_id
        ros.from_feature(message, Pose(), frame, topics.TRUE_CAMERA_POSE.name)  # an error if none
        if self._transforms is None:
            self._transforms = self.publisher(topics.TF_STATIC)
        transform = TransformStamped(
            header=message.header, child_frame_id=self._config.feature_frame
        )
        at, to = message.pose.position, transform.transform.translation
        to.x, to.y, to.z = at.x, at.y, at.z
        transform.transform.rotation = message.pose.orientation
        self._transforms.publish(TFMessage(transforms=[transform]))

    # --- output ---

    def _forget(self) -> None:
        while self._trail and self.steady_s() - self._trail[0][0] > _TRAIL_S:
            self._trail.popleft()

    def _show(self) -> None:
        if self._markers.get_subscription_count():
            self._markers.publish(MarkerArray(markers=self.shown()))

    def shown(self) -> list[Marker]:
        """The markers of this moment."""
        self._forget()
        now_s, size_m = self.steady_s(), 2.0 * self._config.ball_radius_m
        points = [point for _, point in self._trail]
        found = []
        if self._trail and now_s - self._trail[-1][0] < _FRESH_S:
            found.append(self._marker("ball", size_m, points[-1:]))
        if len(points) > 1:
            found.append(self._marker("trail", _LINE_M, points, Marker.LINE_STRIP))
        if now_s - self._status_s >= _FRESH_S:
            return found
        target_m, predicted_m = (
            vector(self._status_values, f"{name}_{{}}_m") for name in ("target", "position")
        )
        if target_m is not None:
            above = [_point(target_m - [0.0, 0.75 * size_m + _TEXT_M, 0.0])]  # y points down
            text = self._marker("distance", _TEXT_M, above, Marker.TEXT_VIEW_FACING)
            text.text = self._distance_text()
            found += [self._marker("target", size_m, [_point(target_m)]), text]
        if predicted_m is not None:
            found.append(self._marker("predicted", 0.4 * size_m, [_point(predicted_m)]))
        return found

    def _distance_text(self) -> str:
        error_m = number(self._status_values, "error_m")
        distance = f"{1e3 * error_m:.1f} mm" if np.isfinite(error_m) else "no ball"
        state = self._status_values.get("state", "")
        return distance if state in ("", "SERVOING") else f"{distance}, {state.lower()}"

    def _marker(
        self, name: str, size_m: float, points: list[Point], kind: int = Marker.SPHERE
    ) -> Marker:
        red, green, blue, opacity = _COLOURS[name]
        colour = ColorRGBA(r=red, g=green, b=blue, a=opacity)
        marker = Marker(ns=name, type=kind, action=Marker.ADD, color=colour)
        marker.header.stamp = ros.to_stamp(self.ros_s())
        marker.header.frame_id = self._config.feature_frame
        marker.pose.orientation.w = 1.0
        marker.lifetime = Duration(seconds=_FRESH_S).to_msg()
        if kind == Marker.LINE_STRIP:
            marker.points = points
        else:
            marker.pose.position = points[0]
        marker.scale.x = marker.scale.y = marker.scale.z = float(size_m)
        return marker

    def _publish_state(self) -> None:
        viewers = self._markers.get_subscription_count()
        self.publish_status(
            ros.OK,
            "SHOWING" if viewers else "IDLE",
            f"markers for {viewers} viewers" if viewers else "no viewer: no markers are sent",
            {"viewers": viewers},
        )


def _point(position_m: np.ndarray) -> Point:
    x, y, z = (float(value) for value in position_m)
    return Point(x=x, y=y, z=z)


def main() -> int:
    """Run ``fvs_markers_node``."""
    return ros.run(MarkersNode, __doc__, MARKERS_PARAMETERS)


if __name__ == "__main__":
    sys.exit(main())
