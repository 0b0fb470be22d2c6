"""The node's parameters, and the controller that is built from their values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from fvs_controller_node.anticipation import Anticipation
from fvs_controller_node.base import ControlLaw
from fvs_controller_node.loop import ServoLoop
from fvs_controller_node.predictor import BallPredictor, PredictorConfig
from fvs_controller_node.redundancy import LEAST_SPEED, Inverse, RedundancyConfig, make_inverse
from fvs_controller_node.registry import LAWS, make_law
from fvs_controller_node.supervisor import Supervisor
from fvs_controller_node.supervisor_config import SupervisorConfig
from fvs_controller_node.target_motion import TargetFollower
from fvs_ros.limits import SpeedLimits
from fvs_ros.params import Parameters, ParameterSet, parameter


@dataclass(frozen=True)
class ControllerConfig(Parameters):
    """What belongs to no part of the loop."""

    law: str = parameter(
        "ftsm",
        "Control law; changes only while the arm is stopped.",
        choices=tuple(LAWS),
        live=True,
    )
    joint_state_rate_hz: float = parameter(
        125.0,
        "Rate of the joint states; a watchdog ticks at it when none come, Hz.",
        10.0,
        1000.0,
    )
    target_feed_forward: bool = parameter(
        True,
        "Go along with a target that is updated often; off, every target stands where it was set.",
        live=True,
    )


#: Those of the laws, declared in their files, by name: some belong to more than one law.
_OF_LAWS = {one.name: one for law in LAWS.values() for one in law.PARAMETERS}
#: Every parameter of the node.
PARAMETERS = (
    *ControllerConfig.declared(),
    *SupervisorConfig.declared(),
    *PredictorConfig.declared(),
    *RedundancyConfig.declared(),
    *_OF_LAWS.values(),
)


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


def build_loop(values: Mapping[str, Any]) -> ServoLoop:
    """Build the whole controller."""
    return ServoLoop(
        build_law(values),
        BallPredictor(PredictorConfig.from_values(values)),
        Supervisor(SupervisorConfig.from_values(values)),
        TargetFollower(values["target_feed_forward"], _follower_inverse(values)),
        Anticipation(SpeedLimits.from_values(values).max_joint_acceleration_rad_s2),
    )


def reconfigure(loop: ServoLoop, values: Mapping[str, Any]) -> None:
    """Take over changed values in a running controller; nothing changes if one is refused."""
    law, config = build_law(values), SupervisorConfig.from_values(values)
    loop.law = law
    loop.anticipation = Anticipation(config.speed.max_joint_acceleration_rad_s2)
    loop.supervisor.configure(config)
    loop.predictor.configure(PredictorConfig.from_values(values))
    loop.follower.configure(values["target_feed_forward"], _follower_inverse(values))


def _follower_inverse(values: Mapping[str, Any]) -> Inverse:
    # The law pulls towards the posture already.
    own = {"redundancy_resolution": LEAST_SPEED} if LAWS[values["law"]].least_speed else {}
    return make_inverse({**values, **own, "posture_gain_1_s": 0.0})
