"""Parameters of ``fvs_collector_node``, declared once."""

from __future__ import annotations

from dataclasses import dataclass, field

from fvs_estimator_node.config import CameraConfig
from fvs_estimator_node.motion import MotionConfig
from fvs_ros.joints import ArmJoints
from fvs_ros.params import ParameterError, parameter

#: A joint may be this far outside its box, or as far as it can brake within, rad.
_BOX_MARGIN_RAD = 0.1


@dataclass(frozen=True)
class CollectorConfig(MotionConfig, CameraConfig):
    """What is recorded, how the arm moves, and what ends it."""

    output_path: str = parameter("out/collect/dataset.npz", "data set file to write")
    stop_at_error: float = parameter(
        0.0,
        "relative standard deviation of the Jacobian in the box of motion at which collecting ends "
        "early (0.002 is a good value for `fvs_train --method poe`); 0 is off",
        0.0,
        0.5,
    )
    seed: int = parameter(0, "seed of the motion", 0)
    joints: ArmJoints = field(default_factory=ArmJoints)

    def __post_init__(self) -> None:
        super().__post_init__()
        names, ends = self.joints.joint_names, self.joint_min_rad
        if len(names) != len(ends):
            raise ParameterError(
                f"joint_min_rad and joint_max_rad need {len(names)} numbers, one for each of "
                f"joint_names, got {len(ends)}"
            )

    @property
    def box_margin_rad(self) -> float:
        """A joint further than this outside the motion's box ends the run, rad."""
        braking_rad = 0.5 * self.max_joint_velocity_rad_s**2 / self.max_joint_acceleration_rad_s2
        return max(_BOX_MARGIN_RAD, braking_rad)


PARAMETERS = CollectorConfig.declared()
