"""Parameters of ``fvs_estimator_node``, declared once."""

from __future__ import annotations

from dataclasses import dataclass

from fvs_estimator_node.registry import ESTIMATORS, estimator_parameters
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.joints import JOINT_PARAMETERS
from fvs_ros.params import Parameters, parameter


@dataclass(frozen=True)
class CameraConfig(Parameters):
    """What estimator and collector must know of the ball positions."""

    feature_frame: str = parameter(CAMERA_FRAME, "frame of the ball positions")
    max_latency_s: float = parameter(
        0.5,
        "a ball position stamped further before the newest joint state is not paired with it, s",
        0.01,
        1.9,
    )


@dataclass(frozen=True)
class EstimatorConfig(CameraConfig):
    """Parameters of the node; those of the methods are the estimators'."""

    method: str = parameter(
        "rbf",
        "how the Jacobian is estimated; changes only while the controller does not servo",
        choices=tuple(ESTIMATORS),
        live=True,
    )
    model_path: str = parameter(
        "models/ur5_front.npz",
        "file that fvs_train has written: a path, or a name within the project's config folder",
    )


PARAMETERS = (*EstimatorConfig.declared(), *JOINT_PARAMETERS, *estimator_parameters())
