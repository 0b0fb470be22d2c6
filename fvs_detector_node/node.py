"""``fvs_detector_node``: images of an RGB-D camera in, position of the ball out."""

from __future__ import annotations

from fvs_ros import stop

stop.listen()

import sys
from collections import deque
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from geometry_msgs.msg import PointStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header

from fvs_detector_node.annotate import annotate
from fvs_detector_node.config import (
    AUTO,
    BEST_EFFORT,
    PARAMETERS,
    RAW,
    CameraTopics,
)
from fvs_detector_node.detector import Detector, Sighting
from fvs_detector_node.health import FAULT, TRACKING, Input, Snapshot, judge, mismatch
from fvs_detector_node.synchroniser import Pair, Synchroniser
from fvs_ros import ros, topics
from fvs_ros.camera import CameraModel
from fvs_ros.ros.images import from_color, from_depth
from fvs_ros.ros.inputs import ArrivalMonitor
from fvs_ros.topics import CAMERA_PREFIXES

_STATUS_PERIOD_S = 0.1
_PUBLISHERS_PERIOD_S = 1.0
_KEPT_INFOS = 8
#: At most so often a change of state is logged, s; the status always has it.
_TOLD_PERIOD_S = 3.0
#: What has been silent for so long has no rate, s.
_RATE_S = 1.0


@dataclass(frozen=True)
class _Picture:
    """A decoded image with the header of its message."""

    header: Header
    pixels: np.ndarray


class DetectorNode(ros.FvsNode):
    """Publishes where the ball is whenever it is well seen."""

    def __init__(self) -> None:
        super().__init__("fvs_detector_node", PARAMETERS)
        cv2.setNumThreads(1)  # one small image at a time: threads only cost
        v = self.values
        self._detector = Detector(v)
        self._pairing: Synchroniser[_Picture, _Picture] = Synchroniser(v["sync_tolerance_s"])
        self._restarts = 0
        self._cameras: deque[tuple[float, CameraModel]] = deque(maxlen=_KEPT_INFOS)
        self._sighting: Sighting | None = None
        self._pairs, self._published = ArrivalMonitor(), ArrivalMonitor()
        self._problem, self._problem_s = "", -np.inf
        self._latency_s = self._processing_ms = np.nan
        # A camera needs a moment to be found; a ball at the edge of being seen comes and goes.
        self._told, self._told_s = "", self.now_s()

        self._ball = self.create_publisher(
            PointStamped, topics.BALL_POSITION.name, ros.QOS_RELIABLE
        )
        self._annotated = self.create_publisher(Image, "~/annotated_image", ros.QOS_RELIABLE)
        self._topics = CameraTopics.of(v["camera_topics"] or CAMERA_PREFIXES[0], v)
        self._heard: dict[str, tuple[Any, QoSProfile]] = {}
        self._subscribe()
        self.create_timer(_PUBLISHERS_PERIOD_S, self._find_camera, clock=self.steady_clock)
        self.create_timer(_STATUS_PERIOD_S, self._publish_status, clock=self.steady_clock)

    # --- inputs ---

    def _find_camera(self) -> None:
        """Look where a camera publishes, if that is left open and none does where it did."""
        if not self.values["camera_topics"] and not self._publishers_of(self._topics.color):
            for prefix in CAMERA_PREFIXES:
                topics = CameraTopics.of(prefix, self.values)
                if self._publishers_of(topics.color):
                    self._topics = topics
                    self._cameras.clear()
        self._subscribe()

    def _publishers_of(self, topic: str) -> list[TopicEndpointInfo]:
        return self.get_publishers_info_by_topic(self.resolve_topic_name(topic))

    def _subscribe(self) -> None:
        """Subscribe so that messages arrive; again if topics or publishers have changed."""
        v, topics = self.values, self._topics
        color = Image if v["color_transport"] == RAW else CompressedImage
        depth = Image if v["depth_transport"] == RAW else CompressedImage
        wanted = {
            topics.color: (color, self._on_color, self._image_qos(topics.color)),
            topics.depth: (depth, self._on_depth, self._image_qos(topics.depth)),
            topics.info: (CameraInfo, self._on_camera_info, ros.QOS_NEWEST),
        }
        for topic, (subscription, qos) in list(self._heard.items()):
            if topic not in wanted or wanted[topic][2] is not qos:
                self.destroy_subscription(subscription)
                del self._heard[topic]
        for topic, (kind, callback, qos) in wanted.items():
            if topic not in self._heard:
                self._heard[topic] = (self.watch(kind, topic, callback, qos), qos)

    def _image_qos(self, topic: str) -> QoSProfile:
        wanted = self.values["image_reliability"]
        if wanted == AUTO:
            offered = {p.qos_profile.reliability for p in self._publishers_of(topic)}
            if ReliabilityPolicy.BEST_EFFORT in offered:
                wanted = BEST_EFFORT
        return ros.QOS_NEWEST if wanted == BEST_EFFORT else ros.QOS_RELIABLE

    def _on_camera_info(self, message: CameraInfo) -> None:
        try:
            camera = ros.from_camera_info(message)
        except ros.MessageError as error:
            self._complain(self._topics.info, str(error))
            return
        self._cameras.append((ros.from_stamp(message.header.stamp), camera))

    def _on_color(self, message: Any) -> None:
        try:
            picture = _Picture(message.header, from_color(message))
        except ros.MessageError as error:
            self._complain(self._topics.color, str(error))
            return
        stamp_s = ros.from_stamp(message.header.stamp)
        self._take(self._pairing.add_colour(stamp_s, picture))

    def _on_depth(self, message: Any) -> None:
        try:
            depth_m = from_depth(message, self.values["depth_unit_m"])
        except ros.MessageError as error:
            self._complain(self._topics.depth, str(error))
            return
        picture = _Picture(message.header, depth_m)
        self._take(self._pairing.add_depth(ros.from_stamp(message.header.stamp), picture))

    # --- from a pair of images to a position ---

    def _take(self, pair: Pair[_Picture, _Picture] | None) -> None:
        if self._pairing.restarts != self._restarts:
            self._restarts = self._pairing.restarts
            self._detector.reset()
            self._cameras.clear()
            self.get_logger().warning("the stamps of the images went back: starting anew")
        if pair is None:
            return
        start_s = self.steady_s()
        self._pairs.arrived(start_s)
        camera = self._camera_at(pair.stamp_s)
        problem = "" if camera is None else self._mismatch(pair, camera)
        if problem:
            self._complain(self._topics.depth, problem)
        if camera is None or problem:
            self._sighting = None
            return
        rgb, depth_m = pair.colour.pixels, pair.depth.pixels
        try:
            sighting = self._detector.look(pair.stamp_s, rgb, depth_m, camera)
            self._publish(pair, sighting)
            if self._annotated.get_subscription_count():
                self._publish_annotated(pair, camera, sighting)
        except Exception as error:  # whatever an image does to us, the next one may be good
            self._sighting = None
            self._detector.reset()
            self._complain(self._topics.color, f"image not understood: {error!r:.200}")
            return
        self._sighting = sighting
        self._processing_ms = 1e3 * (self.steady_s() - start_s)

    def _camera_at(self, stamp_s: float) -> CameraModel | None:
        """Calibration of an image: that with its stamp, else the newest."""
        same = (camera for info_s, camera in self._cameras if info_s == stamp_s)
        return next(same, self._cameras[-1][1] if self._cameras else None)

    def _mismatch(self, pair: Pair[_Picture, _Picture], camera: CameraModel) -> str:
        colour, depth, view = pair.colour, pair.depth, camera.intrinsics
        return mismatch(
            (colour.pixels.shape[1], colour.pixels.shape[0]),
            (depth.pixels.shape[1], depth.pixels.shape[0]),
            colour.header.frame_id,
            depth.header.frame_id,
            (view.width, view.height),
        )

    # --- outputs ---

    def _publish(self, pair: Pair[_Picture, _Picture], sighting: Sighting) -> None:
        if sighting.detection is None or sighting.problem:
            return
        position_m = sighting.detection.position_m
        exposed_s = pair.stamp_s - self.values["stamp_delay_s"]
        message = ros.to_point(exposed_s, pair.colour.header.frame_id, position_m)
        if exposed_s == pair.stamp_s:
            message.header.stamp = pair.colour.header.stamp  # to the nanosecond, as it came
        self._ball.publish(message)
        self._published.arrived(self.now_s())
        self._latency_s = self.ros_s() - exposed_s

    def _publish_annotated(
        self, pair: Pair[_Picture, _Picture], camera: CameraModel, sighting: Sighting
    ) -> None:
        rgb = self._detector.rectified(pair.colour.pixels, pair.depth.pixels, camera)
        frame = pair.colour.header.frame_id
        message = ros.to_image(pair.stamp_s, frame, annotate(rgb, sighting), "rgb8")
        message.header.stamp = pair.colour.header.stamp
        self._annotated.publish(message)

    def on_parameters(self, values: dict[str, Any], changed: set[str]) -> None:
        """Take changed parameters into use at once."""
        self._detector.configure(values)
        self._pairing.tolerance_s = values["sync_tolerance_s"]

    def _complain(self, topic: str, problem: str) -> None:
        self._problem = f"{self.resolve_topic_name(topic)}: {problem}"
        self._problem_s = self.now_s()

    # --- status ---

    def _input(self, topic: str, now_s: float) -> Input:
        return Input(
            self.resolve_topic_name(topic),
            self.monitor(topic).age_s(now_s),
            len(self._publishers_of(topic)),
        )

    def _publish_status(self) -> None:
        now_s = self.now_s()
        pairing = self._pairing
        state, reason = judge(
            Snapshot(
                colour=self._input(self._topics.color, now_s),
                depth=self._input(self._topics.depth, now_s),
                info=self._input(self._topics.info, now_s),
                problem=self._problem,
                problem_age_s=now_s - self._problem_s,
                pair_age_s=self._pairs.age_s(now_s),
                offset_s=pairing.offset_s,
                tolerance_s=pairing.tolerance_s,
                repeats=pairing.repeats,
                calibrated=bool(self._cameras),
                sighting=self._sighting,
            )
        )
        level = {TRACKING: ros.OK, FAULT: ros.ERROR}.get(state, ros.WARN)
        if state != self._told and now_s - self._told_s > _TOLD_PERIOD_S:
            self._told, self._told_s = state, now_s
            self.tell(level, f"{state}: {reason}")
        found = self._sighting.detection if self._sighting is not None else None
        self.publish_status(
            level,
            state,
            reason,
            {
                "quality": found and found.quality,
                "visible_fraction": found and found.visible_fraction,
                "residual_m": found and found.residual_m,
                "radius_px": found and found.radius_px,
                "latency_s": self._latency_s,
                "color_rate_hz": _rate_hz(self.monitor(self._topics.color), now_s),
                "paired_rate_hz": _rate_hz(self._pairs, now_s),
                "published_rate_hz": _rate_hz(self._published, now_s),
                "offset_s": pairing.offset_s,
                "refused_by_gate": self._detector.gate.refused,
                "processing_ms": self._processing_ms,
            },
        )


def _rate_hz(monitor: ArrivalMonitor, now_s: float) -> float:
    return monitor.report(now_s)["rate_hz"] if monitor.age_s(now_s) < _RATE_S else 0.0


def main() -> int:
    """Run ``fvs_detector_node``."""
    return ros.run(DetectorNode, __doc__, PARAMETERS)


if __name__ == "__main__":
    sys.exit(main())
