"""The detector node's part for one camera: its topics, and what is found in its images."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.detector import Detector, Sighting, annotate
from fvs_detector_node.detectors import make_detector, make_object_detector
from fvs_detector_node.pairing import Pair, Pairing
from fvs_ros import ros, topics
from fvs_ros.camera import CameraModel, Intrinsics
from fvs_ros.ros.images import from_color, from_depth
from fvs_ros.ros.inputs import ArrivalMonitor

WAITING, TRACKING, LOST, FAULT = "WAITING", "TRACKING", "LOST", "FAULT"
#: Time without messages after which an input is missing, s; the slowest cameras have 5 Hz.
_MISSING_S = 1.0


class _Picture(NamedTuple):
    """A decoded image with the header of its message."""

    header: Header
    pixels: np.ndarray


class CameraWatch:
    """Publishes what is found in the images of a camera; ``config`` is for this one alone."""

    def __init__(self, node: ros.FvsNode, config: DetectorConfig) -> None:
        self._node, self._config, self._kind = node, config, config.kind
        self._detector = make_detector(config)
        self._outputs = {self._detector: node.publisher(self._kind.feature)}
        object_detector = make_object_detector(config)
        if object_detector is not None:
            self._outputs[object_detector] = node.publisher(self._kind.topics.object)
        # A little less than half the period at 30 Hz.
        self._pairing = Pairing(0.015, self._detector.needs_depth)
        self._camera: CameraModel | None = None
        self._sightings: dict[Detector, Sighting] = {}  # the tool's first
        self._pairs, self._published = ArrivalMonitor(), ArrivalMonitor()
        self._problem, self._problem_s = "", -np.inf
        self._latency_s = self._processing_ms = np.nan
        camera = self._kind.cameras[0]
        self._annotated = node.publisher(topics.of_camera(topics.ANNOTATED_IMAGE, camera))
        self._topics = self._possible_topics()[0]
        self._subscribed: dict[str, tuple[Any, QoSProfile]] = {}
        self._subscribe()

    def configure(self, config: DetectorConfig, anew: bool) -> None:
        """Take changed parameters into use at once; patches may begin anew."""
        if anew or config.track_px != self._config.track_px:
            detector = make_detector(config)
            self._outputs = {detector: self._outputs.pop(self._detector), **self._outputs}
            self._detector = detector
        self._config = config
        self._detector.configure(config)

    # --- inputs ---

    def _possible_topics(self) -> list[dict[str, str]]:
        """Names that the camera's topics may have, by what they hold."""
        prefix, camera = self._config.camera_topics, self._kind.cameras[0]
        declared = topics.COLOR_IMAGE, topics.DEPTH_IMAGE, topics.CAMERA_INFO
        names = [topics.camera_names(each, prefix, camera) for each in declared]
        whats = "colour", "depth", "info"
        possible = [dict(zip(whats, each, strict=True)) for each in zip(*names, strict=True)]
        apart = [each for each in possible if each["depth"] != each["colour"]]
        return apart if self._detector.needs_depth else possible

    def look_for_camera(self) -> None:
        """Search all possible names if the present ones have no publisher."""
        if not self._publishers_of(self._topics["colour"]):
            for names in self._possible_topics():
                if self._publishers_of(names["colour"]):
                    self._topics, self._camera = names, None
        self._subscribe()

    def _publishers_of(self, topic: str) -> list[TopicEndpointInfo]:
        return self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(topic))

    def _subscribe(self) -> None:
        """Subscribe with a QoS that matches the publishers; again when topics or QoS change."""
        names = self._topics
        wanted: dict[str, tuple[type, Callable[[Any], None], QoSProfile]] = {}
        if self._detector.needs_calibration:
            wanted[names["info"]] = CameraInfo, self._on_camera_info, ros.QOS_NEWEST
        for name in ("colour", "depth") if self._detector.needs_depth else ("colour",):
            on_image = partial(self._on_image, name)
            wanted[names[name]] = Image, on_image, self._image_qos(names[name])
        for topic, (subscription, qos) in list(self._subscribed.items()):
            if topic not in wanted or wanted[topic][2] is not qos:
                self._node.destroy_subscription(subscription)
                del self._subscribed[topic]
        for topic, (kind, callback, qos) in wanted.items():
            if topic not in self._subscribed:
                self._subscribed[topic] = (self._node.watch(kind, topic, callback, qos), qos)

    def _image_qos(self, topic: str) -> QoSProfile:
        """Best effort if a publisher is, else reliable."""
        offered = {p.qos_profile.reliability for p in self._publishers_of(topic)}
        best_effort = ReliabilityPolicy.BEST_EFFORT in offered
        return ros.QOS_NEWEST if best_effort else ros.QOS_RELIABLE

    def _on_camera_info(self, message: CameraInfo) -> None:
        try:
            self._camera = ros.from_camera_info(message)
        except ros.MessageError as error:
            self._complain(self._topics["info"], str(error))

    def _on_image(self, name: str, message: Any) -> None:
        decode = from_color if name == "colour" else from_depth
        try:
            picture = _Picture(message.header, decode(message))
        except ros.MessageError as error:
            self._complain(self._topics[name], str(error))
            return
        pair = self._pairing.add(name, ros.from_stamp(message.header.stamp), picture)
        if pair is not None:
            self._pairs.arrived(self._node.now_s())
            self._detect(pair)

    # --- from a pair of images to a position ---

    def _detect(self, pair: Pair) -> None:
        start_s = self._node.steady_s()
        self._sightings = {}
        camera = self._camera
        if not self._detector.needs_calibration:
            camera = CameraModel(Intrinsics.of_pixels(*pair.colour.pixels.shape[1::-1]))
        if camera is None or not self._consistent(pair, camera):
            return
        rgb, depth_m = pair.colour.pixels, pair.depth and pair.depth.pixels
        try:
            sightings = {}
            for detector, publisher in self._outputs.items():
                sightings[detector] = detector.detect(pair.stamp_s, rgb, depth_m, camera)
                self._publish(pair, sightings[detector], publisher)
            if self._annotated.get_subscription_count():
                self._publish_annotated(pair, camera, list(sightings.values()))
        except Exception as error:  # a bad image must not stop the node
            for detector in self._outputs:
                detector.reset()
            self._complain(self._topics["colour"], f"image not understood: {error!r:.200}")
            return
        self._sightings = sightings
        self._processing_ms = 1e3 * (self._node.steady_s() - start_s)

    def _consistent(self, pair: Pair, camera: CameraModel) -> bool:
        """Whether calibration and depth are of the colour image."""
        header, view = pair.colour.header, camera.intrinsics
        size, calibrated = pair.colour.pixels.shape[:2], (view.height, view.width)
        if calibrated != size:
            words = f"is for {_px(calibrated)} pixels, but the colour images have {_px(size)}"
            self._complain(self._topics["info"], words)
            return False
        differs = ""
        if pair.depth is not None:
            depth_size, frame = pair.depth.pixels.shape, pair.depth.header.frame_id
            if depth_size != size:
                differs = f"{_px(depth_size)} pixels against {_px(size)}"
            elif frame != header.frame_id:
                differs = f"frame {frame[:60]!r} against {header.frame_id[:60]!r}"
        if differs:
            self._complain(
                self._topics["depth"],
                f"depth is not registered to colour: {differs}; start the camera with "
                "align_depth.enable:=true, and take the aligned topic",
            )
        return not differs

    # --- outputs ---

    def _publish(self, pair: Pair, sighting: Sighting, publisher: Publisher) -> None:
        body = sighting.detection
        if body is None:
            return
        exposed_s = pair.stamp_s - self._config.stamp_delay_s
        z = self._kind.of_detection(body)
        message = ros.to_feature(exposed_s, pair.colour.header.frame_id, self._kind, z)
        if exposed_s == pair.stamp_s:
            message.header.stamp = pair.colour.header.stamp  # to the nanosecond, as it came
        publisher.publish(message)
        if publisher is self._outputs[self._detector]:
            self._published.arrived(self._node.now_s())
            self._latency_s = self._node.ros_s() - exposed_s

    def _publish_annotated(
        self, pair: Pair, camera: CameraModel, sightings: list[Sighting]
    ) -> None:
        rgb = self._detector.rectified(pair.colour.pixels, camera)
        picture = annotate(rgb, sightings, camera.intrinsics)
        message = ros.to_image(pair.stamp_s, pair.colour.header.frame_id, picture, "rgb8")
        message.header.stamp = pair.colour.header.stamp
        self._annotated.publish(message)

    def _complain(self, topic: str, problem: str) -> None:
        self._problem = f"{self._node.resolve_topic_name(topic)}: {problem}"
        self._problem_s = self._node.now_s()

    # --- status ---

    def _missing_input(self, now_s: float) -> str:
        """Which subscribed topic is silent, and what to check; empty if none is."""
        wanted = [("colour images", self._topics["colour"], "check the camera and camera_topics")]
        if self._detector.needs_depth:
            wanted.append(("depth images", self._topics["depth"], "set align_depth.enable:=true"))
        if self._camera is None and self._detector.needs_calibration:
            wanted.append(("camera_info", self._topics["info"], "is it remapped as well?"))
        for what, topic, hint in wanted:
            age_s = self._node.monitor(topic).age_s(now_s)
            if age_s > _MISSING_S:
                heard = "none arrives" if age_s == np.inf else f"the last is {age_s:.1f} s old"
                why = heard if self._publishers_of(topic) else "no node publishes there"
                return f"no {what} on {self._node.resolve_topic_name(topic)}: {why}; {hint}"
        return ""

    def judge(self, now_s: float) -> tuple[str, str]:
        """State, and one sentence with the remedy."""
        if now_s - self._problem_s < _MISSING_S:
            return FAULT, self._problem
        missing = self._missing_input(now_s)
        if missing:
            return WAITING, missing
        if self._pairs.age_s(now_s) > _MISSING_S:
            return self._unpaired()
        if not self._sightings:
            return WAITING, "waiting for the first images"
        tool, *others = self._sightings.values()
        kind = self._kind
        words = tool.problem or f"the {kind.what} is seen, {kind.feature.name} is published"
        for sighting in others:
            words += f"; object: {sighting.problem or kind.topics.object.name + ' is published'}"
        return (LOST if tool.problem else TRACKING), words

    def _unpaired(self) -> tuple[str, str]:
        repeats, offset_s = self._pairing.repeats, self._pairing.offset_s
        if repeats >= 5:
            return FAULT, f"image stamps do not advance, {repeats} in a row: is the camera frozen?"
        apart = "" if offset_s is None else f", {1e3 * offset_s:+.1f} ms"
        hint = f"are there at least {1 / _MISSING_S:g} per second? Else set enable_sync:=true"
        return WAITING, f"no pair of colour and depth images{apart}: {hint}"

    @property
    def level(self) -> bytes:
        """Level of the status: that something is not seen is a warning."""
        lost = any(sighting.problem for sighting in self._sightings.values())
        return ros.WARN if lost else ros.OK

    def status_values(self, now_s: float, state: str) -> dict[str, Any]:
        """Key numbers."""
        sighting = self._sightings.get(self._detector)
        body = sighting and sighting.detection
        rate_hz = self._published.report(now_s)["rate_hz"]
        return {
            **{key: getattr(body, key, None) for key in self._detector.measured},
            "latency_s": self._latency_s,
            "published_rate_hz": rate_hz if state == TRACKING else 0.0,
            "offset_s": self._pairing.offset_s,
            "processing_ms": self._processing_ms,
        }


def _px(size: tuple[int, ...]) -> str:
    return f"{size[1]}x{size[0]}"
