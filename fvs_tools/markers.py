"""Parameters of ``fvs_markers_node``."""

from __future__ import annotations

from dataclasses import dataclass

from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.params import Parameters, parameter


@dataclass(frozen=True)
class MarkersConfig(Parameters):
    """What a viewer is shown of the loop."""

    feature_frame: str = parameter(CAMERA_FRAME, "frame of ball and target")
    ball_radius_m: float = parameter(0.04, "radius of the ball", 0.005, 0.2)


PARAMETERS = MarkersConfig.declared()
