"""Parameters of ``fvs_detector_node``, declared once."""

from __future__ import annotations

from dataclasses import dataclass, field

from fvs_detector_node.tags import Tag
from fvs_ros.camera import CameraTopicsConfig
from fvs_ros.kinds import KINDS, KindConfig
from fvs_ros.params import Parameters, parameter


@dataclass(frozen=True)
class BallColour(Parameters):
    """Range of the ball's colour, in OpenCV's HSV units."""

    hue: int = parameter(
        0,
        "middle of the ball's hues in half degrees: red 0, yellow 30, green 60, blue 120",
        0,
        179,
        live=True,
    )
    hue_width: int = parameter(10, "largest distance from hue, half degrees", 1, 89, live=True)
    # Low enough for the shaded side.
    min_saturation: int = parameter(
        110, "least saturation of the ball's colour; 0: grey", 0, 255, live=True
    )
    min_value: int = parameter(
        35, "least brightness of the ball's colour; 0: black", 0, 255, live=True
    )


@dataclass(frozen=True)
class DetectorConfig(CameraTopicsConfig):
    """Parameters of ball or tag, and of the image topics."""

    feature: str = parameter(
        KindConfig.feature,
        "ball, or pose of a tag from the colour image alone",
        choices=tuple(KINDS),
    )
    compressed_images: bool = parameter(
        False,
        "subscribe to the topics that end in /compressed (jpeg or png) and /compressedDepth (png), "
        "for a camera on another computer",
    )
    ball_radius_m: float = parameter(
        0.04,
        "radius of the ball; measure it: a wrong radius gives a wrong distance",
        0.005,
        0.5,
        live=True,
    )
    stamp_delay_s: float = parameter(
        0.0,
        "time from exposure to stamp of an image (negative: stamped early), subtracted from the "
        "ball's stamp; fvs_train estimates it",
        -0.5,
        0.5,
        live=True,
    )
    colour: BallColour = field(default_factory=BallColour)
    tag: Tag = field(default_factory=Tag)


PARAMETERS = DetectorConfig.declared()
