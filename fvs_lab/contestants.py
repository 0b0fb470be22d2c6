"""The schemes that are compared, with the limits that all have, and the least time possible."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from fvs_lab.floor import Limits, least_time_s
from fvs_lab.trials import Case, Conditions, Trial
from fvs_ros.chain import SerialChain
from fvs_tools.schemes import BEYOND, SCHEMES, Scheme
from fvs_tools.score import SETTLED_ERROR_M

#: Limits as on a real arm, the nodes' defaults; and out of the way, the largest that the controller
#: takes.
CLIPPED = {"max_joint_velocity_rad_s": 1.0, "max_joint_acceleration_rad_s2": 6.0}
FREE = {"max_joint_velocity_rad_s": 3.14, "max_joint_acceleration_rad_s2": 40.0}
#: True positions with the same noise.
EXACT = Conditions(rendered=False)
ORACLE = "oracle, proportional"
#: The contestants, with the defaults of the nodes: the paper's, laws that are told the true
#: Jacobian, and those beyond the paper.
CONTESTANTS: dict[str, Scheme] = {
    **SCHEMES,
    ORACLE: Scheme(ORACLE, "oracle", "proportional", ""),
    **BEYOND,
    "oracle, law of best": replace(
        BEYOND["best"], name="oracle, law of best", method="oracle", estimator_values={}
    ),
}


def variant(name: str, conditions: Conditions = EXACT, **labels: Any) -> Trial:
    """A contestant with the limits that all have, and further labels."""
    trial = Trial(CONTESTANTS[name], conditions, {"scheme": name, **labels})
    return trial.changed(controller=CLIPPED)


def floor_s(case: Case, arm: SerialChain | None = None) -> float:
    """Least time until ball or tag stays within 5 mm, by the joints' limits, s."""
    return least_time_s(case, Limits(*CLIPPED.values()), SETTLED_ERROR_M, arm)
