"""Parameters of ``fvs_detector_node``, declared once."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from fvs_detector_node.tags import TagsConfig
from fvs_ros.camera import CameraTopicsConfig
from fvs_ros.params import ParameterError, Parameters, live_parameter, parameter


@dataclass(frozen=True)
class BallColour(Parameters):
    """Range of the ball's colour, in OpenCV's HSV units."""

    hue: int = live_parameter(
        0,
        "middle of the ball's hues in half degrees: red 0, yellow 30, green 60, blue 120",
        0,
        179,
    )
    hue_width: int = live_parameter(10, "largest distance from hue, half degrees", 1, 89)
    # Low enough for the shaded side.
    min_saturation: int = live_parameter(
        110, "least saturation of the ball's colour; 0: grey", 0, 255
    )
    min_value: int = live_parameter(35, "least brightness of the ball's colour; 0: black", 0, 255)


@dataclass(frozen=True)
class DetectorConfig(TagsConfig, CameraTopicsConfig):
    """Parameters of ball or tags, and of the image topics."""

    ball_radius_m: float = live_parameter(
        0.04,
        "radius of the ball; measure it: a wrong radius gives a wrong distance",
        0.005,
        0.5,
    )
    use_depth: bool = parameter(
        True,
        "whether depth images tell the ball's distance; false: its size in colour images does",
    )
    stamp_delay_s: float = live_parameter(
        0.0,
        "time from exposure to stamp of an image (negative: stamped early), subtracted from the "
        "ball's stamp; fvs_train estimates it",
        -0.5,
        0.5,
    )
    track_px: tuple[float, ...] = live_parameter(
        (),
        "u and v, px, of each image point, for any thing: what is there in the next image is "
        "followed, and set again it begins anew; empty: ball or tags are looked for; for points",
    )
    colour: BallColour = field(default_factory=BallColour)

    def __post_init__(self) -> None:
        super().__post_init__()
        numbers = len(self.track_px)
        if numbers and (self.kind.rigid or numbers != self.kind.numbers):
            raise ParameterError(
                f"track_px: u and v of {self.points.point_count} points (point_count) are expected "
                f"with feature points of each camera, got {numbers} numbers"
            )

    @property
    def parts(self) -> dict[str, DetectorConfig]:
        """For each camera alone, by its name."""
        if self.kind.rigid:
            return {self.kind.cameras[0]: self}
        parts = zip(self.points.parts, self.kind.rows, strict=True)
        return {
            part.cameras[0]: replace(self, points=part, track_px=self.track_px[rows])
            for part, rows in parts
        }


PARAMETERS = DetectorConfig.declared()
