"""Parameters of ``fvs_calibrate_node``."""

from __future__ import annotations

from dataclasses import dataclass

from fvs_ros.kinds import BodyConfig
from fvs_ros.params import parameter


@dataclass(frozen=True)
class CalibrateConfig(BodyConfig):
    """Parameters of ``fvs_calibrate_node``."""

    urdf_path: str = parameter("", "URDF of the arm; empty: robot_description")
    tip_link: str = parameter(
        "", "link that carries ball, tag or camera; empty: tool0, flange, or the arm's last link"
    )
    camera_on_arm: bool = parameter(False, "the arm carries the camera, ball or tag is at rest")
    output_path: str = parameter(
        "out/calibrate/camera.yaml", "file to write; a picture of the residuals is put beside it"
    )
    duration_s: float = parameter(
        120.0, "time after the first image in which the motion has to be enough, s", 10.0, 3600.0
    )
    stop_at_m: float = parameter(
        0.0005, "standard deviation of the camera's position that is good enough, m", 1e-5, 1.0
    )
    stop_at_rad: float = parameter(
        0.001, "standard deviation of its rotation that is good enough, rad", 1e-5, 1.0
    )


PARAMETERS = CalibrateConfig.declared()
