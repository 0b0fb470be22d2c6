"""Parameters of ``fvs_estimator_node``, declared once."""

from __future__ import annotations

from fvs_estimator_node.registry import ESTIMATORS, estimator_parameters
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.joints import JOINT_PARAMETERS
from fvs_ros.params import Parameter

#: Of the camera; the collector has it, too.
MAX_LATENCY = Parameter(
    "max_latency_s",
    0.5,
    "a ball position stamped further before the newest joint state is not paired with it, s",
    minimum=0.01,
    maximum=1.9,
)

PARAMETERS = (
    Parameter(
        "method",
        "rbf",
        "how the Jacobian is estimated; changes only while the controller does not servo",
        choices=tuple(ESTIMATORS),
        live=True,
    ),
    Parameter(
        "model_path",
        "models/ur5_front.npz",
        "file that fvs_train has written: a path, or a name within the project's config folder",
    ),
    *JOINT_PARAMETERS,
    Parameter("feature_frame", CAMERA_FRAME, "frame of the ball positions"),
    Parameter(
        "jacobian_rate_hz", 62.5, "most Jacobians published a second", minimum=1.0, maximum=1000.0
    ),
    Parameter(
        "min_step_rad",
        0.01,
        "joint motion (largest joint) between two images that makes a step to learn from, rad",
        minimum=1e-4,
        maximum=1.0,
    ),
    Parameter("max_step_s", 0.5, "longest step to learn from, s", minimum=0.01, maximum=10.0),
    Parameter(
        "max_gap_s",
        0.25,
        "ball positions further apart than this are never paired, s",
        minimum=0.01,
        maximum=10.0,
    ),
    MAX_LATENCY,
    *estimator_parameters(),
)
