"""Parameters of ``fvs_dashboard``, declared once."""

from __future__ import annotations

from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.joints import JOINT_PARAMETERS
from fvs_ros.params import Parameter

#: What the page is served by; its guard reaches into viser, so that a later one is unknown.
VISER = "viser[urdf]>=1.1,<1.2"

PARAMETERS = (
    Parameter(
        "host",
        "127.0.0.1",
        "address the page is served at; 0.0.0.0 lets whoever reaches it move the arm",
    ),
    Parameter("port", 8080, "port of the page; 0 takes any free one", minimum=0, maximum=65535),
    Parameter("rate_hz", 10.0, "pictures a second", minimum=1.0, maximum=30.0),
    Parameter("feature_frame", CAMERA_FRAME, "frame of ball and target"),
    *JOINT_PARAMETERS,
    Parameter(
        "ball_radius_m", 0.04, "radius of the ball, as it is drawn", minimum=0.001, maximum=0.2
    ),
    Parameter(
        "image", True, "show the camera's image; the simulator draws it only while it is looked at"
    ),
    Parameter(
        "camera_topics",
        "",
        "what stands before /color/image_raw; empty: camera, and camera/camera where there is one",
    ),
    Parameter("tour", False, "send the ball to one target after another until a person takes over"),
    Parameter("tour_period_s", 5.0, "time given to each target of the tour", minimum=1.0),
    Parameter(
        "model_path",
        "",
        "trained model of this arm and camera: the tour's targets are positions it saw; without "
        "one there is no tour",
    ),
)
