"""What the supervisor goes by: limits and thresholds."""

from __future__ import annotations

from dataclasses import dataclass, field
from operator import lt

from fvs_controller_node.progress import ProgressLimits
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.joints import ArmJoints
from fvs_ros.limits import JointRange, SpeedLimits
from fvs_ros.params import ParameterError, Parameters, live_parameter, parameter


@dataclass(frozen=True)
class SupervisorConfig(Parameters):
    """Limits and thresholds of the supervisor."""

    autostart: bool = parameter(
        False,
        "Start once by itself, the first time everything is ready. For simulation only.",
    )
    feature_frame: str = parameter(CAMERA_FRAME, "Frame of ball and target.")
    joints: ArmJoints = field(default_factory=ArmJoints)
    speed: SpeedLimits = field(default_factory=SpeedLimits)
    joint_range: JointRange = field(default_factory=JointRange)
    progress: ProgressLimits = field(default_factory=ProgressLimits)
    workspace_min_m: tuple[float, ...] = live_parameter(
        (-1.0, -1.0, 0.2), "Lower corner of the box that targets must be in, feature frame, m."
    )
    workspace_max_m: tuple[float, ...] = live_parameter(
        (1.0, 1.0, 3.0), "Upper corner of the box that targets must be in, feature frame, m."
    )
    joint_states_max_age_s: float = live_parameter(
        0.1, "Older joint states are stale: the arm is held, s.", 0.01, 10.0
    )
    ball_max_age_s: float = live_parameter(
        0.2, "An older ball position is stale: the arm is held, s.", 0.01, 10.0
    )
    jacobian_max_age_s: float = live_parameter(
        0.2, "An older Jacobian is stale: the arm is held, s.", 0.01, 10.0
    )
    singular_hold_m_rad: float = live_parameter(
        0.03,
        "Smallest singular value of the Jacobian below which the arm is held, m/rad; it slows down "
        "from 8/3 of that on.",
        1e-5,
        10.0,
    )
    prediction_hold: float = live_parameter(
        1.2,
        "Error of the predicted motion over the motion (1 is useless) above which the arm is held "
        "after 50 mm of motion; it slows down from 2/3 of that on.",
        0.01,
        100.0,
    )
    resume_within_s: float = live_parameter(
        30.0, "An arm that was held for longer needs a new start, s.", 0.5, 1e6
    )

    #: Good messages in a row after which an input counts again: one could be a remainder.
    fresh_samples = 5
    #: Motion for which the prediction may be bad, m: an estimator that learns needs some to mend
    #: itself after the camera was moved.
    prediction_hold_m = 0.05

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = self.workspace_min_m, self.workspace_max_m
        if len(low) != len(high) or not all(map(lt, low, high)):
            raise ParameterError(
                "workspace_min_m must be a list of numbers, each below that of workspace_max_m "
                f"{list(high)}, got {list(low)}"
            )
        if len(self.joint_range.joint_min_rad) != len(self.joints.joint_names):
            raise ParameterError(
                f"joint_min_rad and joint_max_rad need {len(self.joints.joint_names)} numbers, one "
                "for each of joint_names"
            )

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joints in kinematic order."""
        return self.joints.joint_names

    @property
    def follow_time_s(self) -> float:
        """The arm may fail to move as commanded for this time, s."""
        return 0.5 * self.progress.stall_time_s

    @property
    def singular_slow_m_rad(self) -> float:
        """Smallest singular value below which the arm slows down, m/rad."""
        return self.singular_hold_m_rad * 8.0 / 3.0

    @property
    def prediction_slow(self) -> float:
        """Prediction error above which the arm slows down."""
        return self.prediction_hold * 2.0 / 3.0

    @property
    def features(self) -> int:
        """Length m of the feature."""
        return len(self.workspace_min_m)

    def wrong_frame(self, frame: str) -> str:
        """Why a message in another frame than the feature's is refused."""
        if not frame:
            return f"it names no frame; set header.frame_id to {self.feature_frame}"
        return f"it is in frame {frame}, expected {self.feature_frame} (feature_frame)"
