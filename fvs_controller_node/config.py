"""The node's parameters: those of the supervisor, of the loop and of the control laws."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from operator import lt
from typing import Any

from fvs_controller_node.base import ControlLaw
from fvs_controller_node.ftsm import FtsmLaw
from fvs_controller_node.minimum_time import MinimumTimeLaw
from fvs_controller_node.proportional import MfacLaw, MpcLaw, ProportionalLaw
from fvs_controller_node.redundancy import RedundancyConfig
from fvs_ros.interface import CommandInterface
from fvs_ros.kinds import KindConfig
from fvs_ros.limits import JointLimits
from fvs_ros.params import ParameterError, Parameters, ParameterSet, live_parameter, parameter
from fvs_ros.paths import registered
from fvs_ros.view import ViewConfig

#: The control laws by name. A new law is one file in this folder and one line here, or an entry
#: point ``fvs_ros.laws`` of another package.
LAWS: dict[str, type[ControlLaw]] = registered(
    "laws",
    {
        "ftsm": FtsmLaw,
        "proportional": ProportionalLaw,
        "mfac": MfacLaw,
        "mpc": MpcLaw,
        "minimum_time": MinimumTimeLaw,
    },
)


@dataclass(frozen=True)
class ControllerConfig(CommandInterface):
    """Parameters of the loop."""

    law: str = live_parameter(
        "ftsm", "Control law; changes only while the arm is stopped.", choices=LAWS.keys()
    )
    reference: str = live_parameter(
        "grasp", "Name of the reference that ~/teach writes and ~/go_to_reference reads."
    )
    references_path: str = live_parameter("references.yaml", "File of the taught references.")
    target_feed_forward: bool = live_parameter(
        True, "Feed-forward for targets that are updated often; off, every target is fixed."
    )
    rest_when_settled: bool = live_parameter(
        False,
        "Whether the arm rests once settled, until the error exceeds settled_error_m again: servos "
        "that stop short would hunt. Where the model knows of play it always does.",
    )


@dataclass(frozen=True)
class SupervisorConfig(JointLimits, KindConfig, ViewConfig):
    """Limits and thresholds of the supervisor."""

    #: Consecutive good messages after which an input is valid again: a single one may be left over.
    fresh_samples = 5
    #: Motion allowed with a bad prediction, m: a learning estimator needs some to recover after the
    #: camera was moved.
    prediction_hold_m = 0.05
    settled_time_s = 0.3
    #: The error has grown when it is above its best by both.
    growth_factor, growth_m = 1.5, 0.03
    #: Errors below this are never taken for a stall.
    stall_error_m = 0.02

    autostart: bool = parameter(
        False,
        "Start without ~/start as soon as all inputs are ready, once. For simulation only.",
    )
    object_moves: bool = live_parameter(
        False,
        "Whether the object that a camera on the arm sees moves by itself and is followed; then "
        "an image that does not follow holds the arm after a motion by twice the error in vain.",
    )
    workspace_min_m: tuple[float, ...] = live_parameter(
        (-1.0, -1.0, 0.1), "Lower corner of the box that targets must be in, feature frame, m."
    )
    workspace_max_m: tuple[float, ...] = live_parameter(
        (1.0, 1.0, 3.0), "Upper corner of the box that targets must be in, feature frame, m."
    )
    joint_states_max_age_s: float = live_parameter(
        0.1, "Age above which joint states are stale and the arm is held, s.", 0.01, 10.0
    )
    ball_max_age_s: float = live_parameter(
        0.2,
        "Age above which a ball position is stale and the arm is held, s; of a slow camera 2.5 of "
        "its periods, up to 0.5 s.",
        0.01,
        10.0,
    )
    object_may_be_hidden_s: float = live_parameter(
        0.0,
        "How long the last place of an object that stood still counts while it is hidden from a "
        "fixed camera, s.",
        0.0,
        60.0,
    )
    jacobian_max_age_s: float = live_parameter(
        0.2, "Age above which the Jacobian is stale and the arm is held, s.", 0.01, 10.0
    )
    singular_hold_m_rad: float = live_parameter(
        0.03,
        "Smallest singular value below which the arm is held, m/rad; it slows down below 8/3 of "
        "that.",
        1e-5,
        10.0,
    )
    prediction_hold: float = live_parameter(
        1.2,
        "Ratio of prediction error to motion (1: useless) above which the arm is held after "
        f"{1e3 * prediction_hold_m:g} mm of motion; it slows down above 2/3 of that.",
        0.01,
        100.0,
    )
    settled_error_m: float = live_parameter(
        0.005, f"Settled when the error stays below this for {settled_time_s:g} s, m.", 1e-5, 1.0
    )
    stall_time_s: float = live_parameter(
        6.0,
        "The arm is held after this time without progress, s, at an error above "
        f"{1e3 * stall_error_m:g} mm; and after a sixth of it if the error grew by "
        f"{100.0 * (growth_factor - 1.0):g} % and {1e3 * growth_m:g} mm.",
        0.1,
        60.0,
    )
    resume_within_s: float = live_parameter(
        30.0, "Longest hold after which the arm resumes without a new start, s.", 0.5, 1e6
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = self.workspace_min_m, self.workspace_max_m
        if len(low) != len(high) or not all(map(lt, low, high)):
            raise ParameterError(
                "workspace_min_m must be a list of numbers, each below that of workspace_max_m "
                f"{list(high)}, got {list(low)}"
            )
        kind, joints = self.kind, len(self.joint_names)
        if kind.box_size and len(low) != kind.box_size:
            raise ParameterError(
                f"workspace_min_m of a {kind.name} needs {kind.box_size} numbers, got {len(low)}"
            )
        if joints < kind.least_joints:
            raise ParameterError(
                f"a {kind.name} needs {kind.least_joints} joints or more, got {joints}; with fewer "
                "set task_axes"
            )
        if kind.on_arm and self.object_may_be_hidden_s:
            raise ParameterError("object_may_be_hidden_s is not for camera_mount arm: set it to 0")

    @property
    def follows_object(self) -> bool:
        """Whether a camera on the arm follows an object that moves."""
        return self.object_moves and self.kind.on_arm

    @property
    def growth_time_s(self) -> float:
        """Time that the error may stay grown, s."""
        return self.stall_time_s / 6.0

    @property
    def singular_slow_m_rad(self) -> float:
        """Smallest singular value below which the arm slows down, m/rad."""
        return self.singular_hold_m_rad * 8.0 / 3.0

    @property
    def prediction_slow(self) -> float:
        """Prediction error above which the arm slows down."""
        return self.prediction_hold * 2.0 / 3.0


_GROUPS: list[type[Parameters]] = [ControllerConfig, SupervisorConfig, RedundancyConfig]
_GROUPS += [law.Gains for law in LAWS.values()]
#: Every parameter of the node, once: some belong to more than one law.
PARAMETERS = tuple({p.name: p for group in _GROUPS for p in group.declared()}.values())


def default_values(**overrides: Any) -> dict[str, Any]:
    """Return all values by name: the defaults, with checked overrides in their place."""
    return ParameterSet(PARAMETERS).values(overrides)


def make_law(values: Mapping[str, Any]) -> ControlLaw:
    """Build the law that ``values`` name; a ``ValueError`` says what does not fit together."""
    return LAWS[values["law"]].from_values(values)
