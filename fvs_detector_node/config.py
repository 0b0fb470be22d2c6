"""Parameters of ``fvs_detector_node``, declared once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from fvs_detector_node.detection import BallColour
from fvs_ros import topics
from fvs_ros.params import Parameter

RAW, COMPRESSED, COMPRESSED_DEPTH = "raw", "compressed", "compressedDepth"
AUTO, RELIABLE, BEST_EFFORT = "auto", "reliable", "best_effort"

_COLOUR = BallColour()

PARAMETERS = (
    Parameter(
        "camera_topics",
        "",
        "what stands before /color/image_raw and the others; empty: camera or camera/camera, "
        "whichever is published",
    ),
    Parameter(
        "color_transport",
        RAW,
        "raw: sensor_msgs/Image; compressed: jpeg or png on the topic that ends in /compressed",
        choices=(RAW, COMPRESSED),
    ),
    Parameter(
        "depth_transport",
        RAW,
        "raw: sensor_msgs/Image; compressedDepth: png on the topic that ends in /compressedDepth",
        choices=(RAW, COMPRESSED_DEPTH),
    ),
    Parameter(
        "image_reliability",
        AUTO,
        "how images are subscribed; auto: best effort if a publisher is, else reliable",
        choices=(AUTO, RELIABLE, BEST_EFFORT),
    ),
    Parameter(
        "ball_radius_m",
        0.04,
        "radius of the ball; measure it, since a wrong one spoils the distance",
        minimum=0.005,
        maximum=0.5,
        live=True,
    ),
    Parameter(
        "hue",
        _COLOUR.hue,
        "middle of the ball's hues in half degrees: red 0, yellow 30, green 60, blue 120",
        minimum=0,
        maximum=179,
        live=True,
    ),
    Parameter(
        "hue_width",
        _COLOUR.hue_width,
        "largest distance from hue, half degrees",
        minimum=1,
        maximum=89,
        live=True,
    ),
    Parameter(
        "min_saturation",
        _COLOUR.min_saturation,
        "least saturation of the ball's colour; 0: grey",
        minimum=0,
        maximum=255,
        live=True,
    ),
    Parameter(
        "min_value",
        _COLOUR.min_value,
        "least brightness of the ball's colour; 0: black",
        minimum=0,
        maximum=255,
        live=True,
    ),
    Parameter(
        "min_quality",
        0.3,
        "a ball seen worse than this is not published; 1: whole and a perfect sphere",
        minimum=0.0,
        maximum=1.0,
        live=True,
    ),
    Parameter(
        "max_ball_speed_m_s",
        3.0,
        "a position that the ball could reach only faster than this is not believed at once",
        minimum=0.01,
        maximum=100.0,
        live=True,
    ),
    Parameter(
        "gate_repeats",
        3,
        "such a position is believed when it is seen this many times in a row; 1: at once",
        minimum=1,
        maximum=1000,
        live=True,
    ),
    Parameter(
        "sync_tolerance_s",
        0.015,
        "largest difference of the stamps of a colour and a depth image that belong together",
        minimum=0.0,
        maximum=1.0,
        live=True,
    ),
    Parameter(
        "stamp_delay_s",
        0.0,
        "the camera stamps its images so long after their exposure (negative: before): the ball's "
        "stamp is put back by it; fvs_train finds it",
        minimum=-0.5,
        maximum=0.5,
        live=True,
    ),
    Parameter(
        "depth_unit_m",
        0.001,
        "unit of depth images of whole numbers (16UC1); 32FC1 is always in metres",
        minimum=1e-6,
        maximum=0.1,
        live=True,
    ),
)


def ball_colour(values: Mapping[str, Any]) -> BallColour:
    """The ball's colour that a node's parameter values describe."""
    return BallColour(
        hue=values["hue"],
        hue_width=values["hue_width"],
        min_saturation=values["min_saturation"],
        min_value=values["min_value"],
    )


@dataclass(frozen=True)
class CameraTopics:
    """Names of a camera's topics: colour and depth images, in their transports, and CameraInfo."""

    color: str
    depth: str
    info: str

    @classmethod
    def of(cls, prefix: str, values: Mapping[str, Any]) -> CameraTopics:
        """The topics below a prefix, with the transports of the node's parameters."""
        color, depth = topics.COLOR_IMAGE, topics.DEPTH_IMAGE
        if values["color_transport"] == COMPRESSED:
            color = topics.COLOR_IMAGE_COMPRESSED
        if values["depth_transport"] == COMPRESSED_DEPTH:
            depth = topics.DEPTH_IMAGE_COMPRESSED
        declared = topics.CAMERA_PREFIXES[0]
        return cls(
            *(
                prefix.rstrip("/") + topic.name.removeprefix(declared)
                for topic in (color, depth, topics.CAMERA_INFO)
            )
        )
