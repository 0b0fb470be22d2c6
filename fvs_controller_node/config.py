"""The node's parameters, each declared once, and what is built from their values."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from typing import Any

from fvs_controller_node.allocation import ALLOCATION_PARAMETERS, LEAST_SPEED, Inverse, make_inverse
from fvs_controller_node.anticipation import Anticipation
from fvs_controller_node.base import N_AXES, ControlLaw
from fvs_controller_node.loop import ServoLoop
from fvs_controller_node.predictor import BallPredictor
from fvs_controller_node.progress import ProgressLimits
from fvs_controller_node.pseudo_inverse import DampedInverse
from fvs_controller_node.registry import LAWS, make_law
from fvs_controller_node.supervisor import Supervisor
from fvs_controller_node.supervisor_config import SupervisorConfig
from fvs_controller_node.target_motion import TargetFollower
from fvs_ros.joints import JOINT_PARAMETERS, N_JOINTS
from fvs_ros.limits import JointRange
from fvs_ros.params import Parameter, ParameterSet

_DEFAULT = SupervisorConfig()
_PROGRESS = ProgressLimits()

_NODE = (
    Parameter(
        "law",
        "ftsm",
        "Control law; changes only while the arm is stopped.",
        choices=tuple(LAWS),
        live=True,
    ),
    Parameter(
        "autostart",
        False,
        "Start once by itself, the first time everything is ready. For simulation only.",
    ),
    *JOINT_PARAMETERS,
    Parameter("feature_frame", _DEFAULT.feature_frame, "Frame of ball and target."),
    Parameter(
        "tick_rate_hz",
        125.0,
        "Rate of the joint states; a watchdog ticks at it when none come, Hz.",
        10.0,
        1000.0,
    ),
)

_LIMITS = (
    Parameter(
        "max_joint_velocity_rad_s",
        _DEFAULT.max_joint_velocity_rad_s,
        "Velocity limit of every joint, rad/s; the whole command is scaled.",
        0.01,
        pi,
        live=True,
    ),
    Parameter(
        "max_joint_acceleration_rad_s2",
        _DEFAULT.max_joint_acceleration_rad_s2,
        "Acceleration limit of every joint's command, rad/s^2.",
        0.1,
        40.0,
        live=True,
    ),
    Parameter(
        "joint_min_rad",
        list(_DEFAULT.joint_range.lower_rad),
        "Lower ends of the joints' ranges, rad.",
        -4.0 * pi,
        4.0 * pi,
        size=N_JOINTS,
        live=True,
    ),
    Parameter(
        "joint_max_rad",
        list(_DEFAULT.joint_range.upper_rad),
        "Upper ends of the joints' ranges, rad.",
        -4.0 * pi,
        4.0 * pi,
        size=N_JOINTS,
        live=True,
    ),
    Parameter(
        "joint_limit_margin_rad",
        _DEFAULT.joint_range.margin_rad,
        "Distance from the end of its range at which a joint begins to slow down, rad.",
        0.01,
        2.0,
        live=True,
    ),
    Parameter(
        "workspace_min_m",
        list(_DEFAULT.workspace_min_m),
        "Lower corner of the box that targets must be in, feature frame, m.",
        size=N_AXES,
        live=True,
    ),
    Parameter(
        "workspace_max_m",
        list(_DEFAULT.workspace_max_m),
        "Upper corner of the box that targets must be in, feature frame, m.",
        size=N_AXES,
        live=True,
    ),
)

_SUPERVISION = (
    Parameter(
        "joint_states_max_age_s",
        _DEFAULT.joint_states_max_age_s,
        "Older joint states are stale: the arm is held, s.",
        0.01,
        10.0,
        live=True,
    ),
    Parameter(
        "ball_max_age_s",
        _DEFAULT.ball_max_age_s,
        "An older ball position is stale: the arm is held, s.",
        0.01,
        10.0,
        live=True,
    ),
    Parameter(
        "jacobian_max_age_s",
        _DEFAULT.jacobian_max_age_s,
        "An older Jacobian is stale: the arm is held, s.",
        0.01,
        10.0,
        live=True,
    ),
    Parameter(
        "fresh_samples",
        _DEFAULT.fresh_samples,
        "Good messages in a row after which an input counts again.",
        1,
        1000,
        live=True,
    ),
    Parameter(
        "singular_slow_m_rad",
        _DEFAULT.singular_slow_m_rad,
        "Smallest singular value of the Jacobian below which the arm slows down, m/rad.",
        1e-4,
        10.0,
        live=True,
    ),
    Parameter(
        "singular_hold_m_rad",
        _DEFAULT.singular_hold_m_rad,
        "Smallest singular value of the Jacobian below which the arm is held, m/rad.",
        1e-5,
        10.0,
        live=True,
    ),
    Parameter(
        "prediction_slow",
        _DEFAULT.prediction_slow,
        "Error of the predicted motion over the motion (1 is useless) above which the arm slows "
        "down.",
        0.01,
        100.0,
        live=True,
    ),
    Parameter(
        "prediction_hold",
        _DEFAULT.prediction_hold,
        "Error of the predicted motion over the motion above which the arm is held after "
        "prediction_hold_m.",
        0.01,
        100.0,
        live=True,
    ),
    Parameter(
        "prediction_hold_m",
        _DEFAULT.prediction_hold_m,
        "Way of the ball for which the error may stay above prediction_hold, so that an estimator "
        "that learns can mend itself, m.",
        0.0,
        10.0,
        live=True,
    ),
    Parameter(
        "follow_time_s",
        _DEFAULT.follow_time_s,
        "Held when the arm does not move as commanded for so long, s.",
        0.1,
        100.0,
        live=True,
    ),
    Parameter(
        "resume_within_s",
        _DEFAULT.resume_within_s,
        "An arm that was held for longer needs a new start, s.",
        0.5,
        1e6,
        live=True,
    ),
    Parameter(
        "settled_error_m",
        _PROGRESS.settled_error_m,
        "Settled when the error stays below this, m.",
        1e-5,
        1.0,
        live=True,
    ),
    Parameter(
        "settled_time_s",
        _PROGRESS.settled_time_s,
        "Settled when the error stays small for so long, s.",
        0.0,
        100.0,
        live=True,
    ),
    Parameter(
        "growth_time_s",
        _PROGRESS.growth_time_s,
        "Held when the error stays well above its best for so long, s.",
        0.05,
        100.0,
        live=True,
    ),
    Parameter(
        "growth_factor",
        _PROGRESS.growth_factor,
        "The error has grown when it is above its best by this factor and by growth_m.",
        1.0,
        100.0,
        live=True,
    ),
    Parameter(
        "growth_m",
        _PROGRESS.growth_m,
        "The error has grown when it is above its best by this and by growth_factor, m.",
        0.0,
        1.0,
        live=True,
    ),
    Parameter(
        "stall_time_s",
        _PROGRESS.stall_time_s,
        "Held when an error above stall_error_m has not become smaller for so long, s.",
        0.1,
        1000.0,
        live=True,
    ),
    Parameter(
        "stall_error_m",
        _PROGRESS.stall_error_m,
        "Errors below this are never taken for a stall, m.",
        0.0,
        1.0,
        live=True,
    ),
)

_PREDICTION = (
    Parameter(
        "predictor",
        True,
        "Predict the ball from its exposure to now with the joints' motion.",
        live=True,
    ),
    Parameter(
        "max_latency_s",
        0.5,
        "No prediction over more than this, s.",
        0.01,
        1.9,
        live=True,
    ),
)


_TARGET = (
    Parameter(
        "target_feed_forward",
        True,
        "Go along with a target that is told often; off, every target stands where it was told.",
        live=True,
    ),
    Parameter(
        "target_window_s",
        0.15,
        "Shortest window of updates that tells how a target moves, s; noisy ones get a longer one.",
        0.02,
        2.0,
        live=True,
    ),
)


def _declared() -> tuple[Parameter, ...]:
    laws = tuple(parameter for law in LAWS.values() for parameter in law.PARAMETERS)
    return (
        _NODE
        + _LIMITS
        + _SUPERVISION
        + _PREDICTION
        + _TARGET
        + DampedInverse.PARAMETERS
        + ALLOCATION_PARAMETERS
        + laws
    )


#: Every parameter of the node; a law's own are declared in its file.
PARAMETERS = _declared()


def default_values(**overrides: Any) -> dict[str, Any]:
    """Return all values by name: the defaults, with checked overrides in their place."""
    return ParameterSet(PARAMETERS).values(overrides)


def build_law(values: Mapping[str, Any]) -> ControlLaw:
    """Build the control law that ``values`` name.

    Raises
    ------
    ValueError
        If values do not fit together; the text says which. So do the other builders.
    """
    return make_law(values["law"], values)


def build_predictor(values: Mapping[str, Any]) -> BallPredictor:
    """Build the ball predictor."""
    return BallPredictor(**_predictor_settings(values))


def build_anticipation(values: Mapping[str, Any]) -> Anticipation:
    """Build the anticipation of the drives' lag."""
    return Anticipation(values["max_joint_acceleration_rad_s2"])


def build_supervisor_config(values: Mapping[str, Any]) -> SupervisorConfig:
    """Build the supervisor's limits and thresholds."""
    return SupervisorConfig(
        joint_range=JointRange(
            tuple(values["joint_min_rad"]),
            tuple(values["joint_max_rad"]),
            values["joint_limit_margin_rad"],
        ),
        joint_names=tuple(values["joint_names"]),
        workspace_min_m=tuple(values["workspace_min_m"]),
        workspace_max_m=tuple(values["workspace_max_m"]),
        progress=ProgressLimits(
            settled_error_m=values["settled_error_m"],
            settled_time_s=values["settled_time_s"],
            growth_time_s=values["growth_time_s"],
            growth_factor=values["growth_factor"],
            growth_m=values["growth_m"],
            stall_time_s=values["stall_time_s"],
            stall_error_m=values["stall_error_m"],
        ),
        **{name: values[name] for name in _SAME_NAME},
    )


def build_loop(values: Mapping[str, Any]) -> ServoLoop:
    """Build the whole controller."""
    return ServoLoop(
        build_law(values),
        build_predictor(values),
        Supervisor(build_supervisor_config(values)),
        TargetFollower(*_follower_settings(values)),
        build_anticipation(values),
    )


def reconfigure(loop: ServoLoop, values: Mapping[str, Any]) -> None:
    """Take over changed values in a running controller; nothing changes if one is refused."""
    law, config = build_law(values), build_supervisor_config(values)
    build_predictor(values)  # refuses what does not fit before anything is changed
    loop.law = law
    loop.anticipation = build_anticipation(values)
    loop.supervisor.configure(config)
    loop.predictor.configure(**_predictor_settings(values))
    loop.follower.configure(*_follower_settings(values))


_SAME_NAME = (
    "autostart",
    "max_joint_velocity_rad_s",
    "max_joint_acceleration_rad_s2",
    "feature_frame",
    "joint_states_max_age_s",
    "ball_max_age_s",
    "jacobian_max_age_s",
    "fresh_samples",
    "singular_slow_m_rad",
    "singular_hold_m_rad",
    "prediction_slow",
    "prediction_hold",
    "prediction_hold_m",
    "follow_time_s",
    "resume_within_s",
)


def _predictor_settings(values: Mapping[str, Any]) -> dict[str, Any]:
    return {"max_latency_s": values["max_latency_s"], "enabled": values["predictor"]}


def _follower_settings(values: Mapping[str, Any]) -> tuple[float, bool, Inverse]:
    # The law pulls towards the posture already.
    own = {"allocation": LEAST_SPEED} if LAWS[values["law"]].least_speed else {}
    inverse = make_inverse({**values, **own, "posture_gain_1_s": 0.0})
    return values["target_window_s"], values["target_feed_forward"], inverse
