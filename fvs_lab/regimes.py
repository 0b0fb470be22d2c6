"""Schemes whose gains are searched, on what terms, and which of their gains are free."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from fvs_lab.search import ESTIMATOR, Knob, Limit, Search
from fvs_lab.trials import Variant
from fvs_tools.schemes import SCHEMES, Scheme

PROPOSED = "proposed"
#: The paper's other schemes.
BASELINES = tuple(name for name in SCHEMES if name != PROPOSED)
#: Laws that are told the true Jacobian: yardsticks.
ORACLE_SLIDING, ORACLE = "oracle, sliding mode", "oracle, proportional"
ORACLES = {
    name: Scheme(name, "oracle", law, "")
    for name, law in ((ORACLE_SLIDING, "ftsm"), (ORACLE, "proportional"))
}
#: Schemes whose gains are searched.
SEARCHED = {**SCHEMES, **ORACLES}
#: Rows of a regime: the last one has the gains of the proposed scheme.
FROZEN = "frozen networks, sliding mode"
ROWS = (*SEARCHED, FROZEN)

#: The gains of each law that the search may turn; what is fixed are units (alpha1) and what a
#: knob already scales.
_LAW_KNOBS = {
    "ftsm": (
        Knob("alpha2", 0.1, 10.0),
        Knob("alpha3", 0.1, 20.0),
        Knob("lambda1", 0.35, 0.7, log=False),
        Knob("lambda2", 0.0, 0.3, log=False),
        Knob("switch_error_m", 0.002, 0.04),
        Knob("k4", 0.005, 0.5),
    ),
    "proportional": (Knob("proportional_gain_1_s", 0.3, 60.0), Knob("damping", 1e-6, 1e-2)),
    "mfac": (Knob("mfac_lambda", 1e-4, 3.0), Knob("control_interval_s", 0.015, 3.0)),
    "mpc": (
        Knob("mpc_horizon", 1.5, 60.0),
        Knob("mpc_alpha", 0.3, 1.0, log=False),
        Knob("mpc_rho", 0.03, 10.0),
        Knob("mpc_q", 0.0003, 3.0),
    ),
}
#: Of the estimators, the filter has a number that servoing depends on: how fast it follows the arm.
#: The networks know the whole box, and their n1 is left alone.
_METHOD_KNOBS = {"ukf": (Knob("online.process_noise", 1e-5, 1e-1, ESTIMATOR),)}


@dataclass(frozen=True)
class Regime:
    """What is held equal.

    Parameters
    ----------
    name, title : str
        In data, and on the page.
    controller_values : mapping
        Limits of the supervisor.
    limit : Limit, optional
        What tuning must keep.
    duration_s : float
        Length of a run, s.
    rest_s : float
        Rest at the end of a tuning run, s.
    """

    name: str
    title: str
    controller_values: Mapping[str, Any]
    limit: Limit | None
    duration_s: float
    rest_s: float = 1.0


_CLIPPED = {"max_joint_velocity_rad_s": 1.0, "max_joint_acceleration_rad_s2": 6.0}
_FREE = {"max_joint_velocity_rad_s": 3.14, "max_joint_acceleration_rad_s2": 40.0}
PEAK_RAD_S = 0.8
JITTER_RAD_S = 0.001

#: As on a real arm; nothing clips the command, as in the paper's figures; calm at rest.
REGIMES = (
    Regime("limit", "Equal joint-speed limit", _CLIPPED, None, 4.0),
    Regime(
        "peak",
        "Equal peak speed, no limit",
        _FREE,
        Limit("peak_joint_speed_rad_s", PEAK_RAD_S),
        6.0,
    ),
    Regime(
        "jitter", "Equal command jitter", _CLIPPED, Limit("jitter_rad_s", JITTER_RAD_S), 5.0, 2.0
    ),
)
#: What was tried for one regime counts for others of the same world: a calm candidate may be the
#: fastest. Not the other way: the runs of ``limit`` end too early to know jitter at rest.
SAME_WORLD = {"limit": ("jitter",)}


def search_of(scheme: Scheme, regime: Regime) -> Search:
    """The search for the gains of a scheme in a regime."""
    return Search(
        f"{regime.name} {scheme.name}",
        Variant.of(scheme, **regime.controller_values),
        (*_LAW_KNOBS[scheme.law], *_METHOD_KNOBS.get(scheme.method, ())),
        regime.limit,
        regime.duration_s,
        regime.rest_s,
    )
