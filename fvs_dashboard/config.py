"""Parameters of ``fvs_dashboard``, declared once."""

from __future__ import annotations

from dataclasses import dataclass

from fvs_ros.camera import CameraTopicsConfig
from fvs_ros.joints import JOINT_PARAMETERS
from fvs_ros.kinds import KindConfig
from fvs_ros.params import parameter

#: Versions of viser that the guard is known to work with: it reaches into viser.
VISER = "viser[urdf]>=1.1,<1.2"


@dataclass(frozen=True)
class DashboardConfig(KindConfig, CameraTopicsConfig):
    """Parameters of the page, apart from the joint names."""

    host: str = parameter(
        "127.0.0.1",
        "address of the page; with 0.0.0.0 everyone on the network can move the arm",
    )
    ball_radius_m: float = parameter(0.04, "radius of the ball", 0.005, 0.5)
    port: int = parameter(8080, "port of the page; 0 takes any free one", 0, 65535)
    tour: bool = parameter(
        False, "send what is servoed through random targets until a user takes over"
    )
    model_path: str = parameter(
        "",
        "trained model; the tour's targets come from its training data; empty: that of the "
        "simulated UR5, if tour is on",
    )


PARAMETERS = (*DashboardConfig.declared(), *JOINT_PARAMETERS)
