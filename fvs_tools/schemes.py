"""Schemes: pairs of an estimator method and a control law, the paper's and those beyond it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from fvs_ros.arguments import unknown


@dataclass(frozen=True)
class Scheme:
    """One pair."""

    name: str  #: the paper's, in lower case
    method: str  #: the estimator's parameter
    law: str  #: the controller's
    description: str  #: one sentence for a user
    #: Further parameters of the two nodes, where they differ from the defaults.
    estimator_values: Mapping[str, Any] = field(default_factory=dict)
    controller_values: Mapping[str, Any] = field(default_factory=dict)


def _by_name(*schemes: Scheme) -> dict[str, Scheme]:
    return {scheme.name: scheme for scheme in schemes}


#: Those that the paper compares.
SCHEMES = _by_name(
    Scheme(
        "proposed",
        "rbf",
        "ftsm",
        "The paper's: networks that learn by (17), sliding mode law (16), adaptive exponent (29).",
    ),
    Scheme(
        "rbf+pid",
        "rbf",
        "proportional",
        "The paper's baseline: networks that learn by (45), proportional law (46).",
    ),
    Scheme("ukf+mfac", "ukf", "mfac", "Unscented Kalman filter, model free adaptive law (48)."),
    Scheme("ukf+mpc", "ukf", "mpc", "Unscented Kalman filter, model predictive law (49)."),
)

#: Those beyond the paper.
BEYOND = _by_name(
    Scheme(
        "extended",
        "rbf_left",
        "ftsm",
        "The paper's networks with camera rotation correction; its law with a straight path and "
        "least joint speeds.",
        controller_values={"redundancy_resolution": "least_speed", "ftsm_path": "straight"},
    ),
    Scheme(
        "best",
        "poe",
        "minimum_time",
        "A serial chain fitted to a minute of motion, minimum-time law.",
    ),
)


def scheme(name: Scheme | str) -> Scheme:
    """The scheme of a name, or of any ``METHOD+LAW``; a ``ValueError`` lists those known."""
    if isinstance(name, Scheme):
        return name
    known = {**SCHEMES, **BEYOND}
    if name in known:
        return known[name]
    from fvs_controller_node.config import LAWS
    from fvs_estimator_node.registry import ESTIMATORS

    method, _, law = name.partition("+")
    if method in ESTIMATORS and law in LAWS:
        return Scheme(name, method, law, "")
    raise ValueError(unknown("scheme", name, [*known, "METHOD+LAW"]))
