"""Limits and thresholds of the supervisor, and the inputs it watches."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite

from fvs_controller_node.inputs import InputSpec
from fvs_controller_node.progress import ProgressLimits
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.joints import UR_JOINT_NAMES, UR_POSITION_LIMITS_RAD
from fvs_ros.limits import JointRange

JOINT_STATES = "joint_states"
BALL = "ball_position"
JACOBIAN = "jacobian"
KINEMATIC_CHAIN = "kinematic_chain"
SPEED_SCALING = "speed_scaling"


@dataclass(frozen=True)
class SupervisorConfig:
    """Limits and thresholds of the supervisor.

    Parameters
    ----------
    autostart : bool
        Start once by itself, the first time everything is ready; for simulation only.
    max_joint_velocity_rad_s, max_joint_acceleration_rad_s2 : float
        Limits of each joint's command.
    joint_range : JointRange
        Ends of the joints' ranges.
    joint_names : tuple of 6 str
        For the words only.
    feature_frame : str
        Frame that ball and target must be in.
    workspace_min_m, workspace_max_m : tuple of 3 float
        Box that a target must be in, feature frame, m.
    joint_states_max_age_s, ball_max_age_s, jacobian_max_age_s : float
        Older inputs are stale, s.
    fresh_samples : int
        Good messages in a row after which an input counts again.
    singular_slow_m_rad, singular_hold_m_rad : float
        Smallest singular value of the Jacobian below which the arm slows down, and is held.
    prediction_slow, prediction_hold : float
        Error of the predicted motion over the motion (1: no better than predicting rest) above
        which the arm slows down, and is held.
    prediction_hold_m : float
        ... once the ball was to go so far meanwhile: an estimator that learns needs motion to mend
        itself, m.
    follow_time_s : float
        So long the arm may fail to move as commanded, s.
    resume_within_s : float
        A hold that lasts longer does not end by itself, s.
    progress : ProgressLimits
        When the error is settled, when it grows, and when it stalls.
    """

    autostart: bool = False
    max_joint_velocity_rad_s: float = 1.0
    max_joint_acceleration_rad_s2: float = 6.0
    joint_range: JointRange = field(
        default_factory=lambda: JointRange(
            tuple(-limit for limit in UR_POSITION_LIMITS_RAD), UR_POSITION_LIMITS_RAD
        )
    )
    joint_names: tuple[str, ...] = UR_JOINT_NAMES
    feature_frame: str = CAMERA_FRAME
    workspace_min_m: tuple[float, ...] = (-1.0, -1.0, 0.2)
    workspace_max_m: tuple[float, ...] = (1.0, 1.0, 3.0)
    joint_states_max_age_s: float = 0.1
    ball_max_age_s: float = 0.2
    jacobian_max_age_s: float = 0.2
    fresh_samples: int = 5
    singular_slow_m_rad: float = 0.08
    singular_hold_m_rad: float = 0.03
    prediction_slow: float = 0.8
    prediction_hold: float = 1.2
    prediction_hold_m: float = 0.05
    follow_time_s: float = 3.0
    resume_within_s: float = 30.0
    progress: ProgressLimits = field(default_factory=ProgressLimits)

    def __post_init__(self) -> None:
        for name in ("max_joint_velocity_rad_s", "max_joint_acceleration_rad_s2"):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0.0):
                raise ValueError(f"{name} must be positive, got {value}")
        for low, high in zip(self.workspace_min_m, self.workspace_max_m, strict=True):
            if not low < high:
                raise ValueError(
                    f"workspace_min_m {list(self.workspace_min_m)} must be below "
                    f"workspace_max_m {list(self.workspace_max_m)}"
                )
        if not 0.0 < self.singular_hold_m_rad < self.singular_slow_m_rad:
            raise ValueError("singular_hold_m_rad must be positive and below singular_slow_m_rad")
        if not 0.0 < self.prediction_slow < self.prediction_hold:
            raise ValueError("prediction_slow must be positive and below prediction_hold")
        if self.fresh_samples < 1:
            raise ValueError(f"fresh_samples must be at least 1, got {self.fresh_samples}")

    def input_specs(self) -> dict[str, InputSpec]:
        """List what is expected of each input, by topic name."""
        specs = (
            InputSpec(
                JOINT_STATES,
                "is the robot driver (or simulator) running?",
                self.joint_states_max_age_s,
                "joint_states_max_age_s",
            ),
            InputSpec(
                BALL,
                "is the ball in view, and the detector running?",
                self.ball_max_age_s,
                "ball_max_age_s",
            ),
            InputSpec(
                JACOBIAN,
                "is the estimator running?",
                self.jacobian_max_age_s,
                "jacobian_max_age_s",
            ),
            InputSpec(KINEMATIC_CHAIN, "", None),
            InputSpec(SPEED_SCALING, "", None),
        )
        return {spec.name: spec for spec in specs}
