"""The schemes that are compared beyond the paper, with the limits that all have."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from fvs_lab.floor import Limits, fastest
from fvs_lab.outcome import BOUNDS_M
from fvs_lab.search import CLIPPED, ORACLE, ORACLES, PROPOSED
from fvs_lab.trials import Case, Variant
from fvs_ros.chain import SerialChain
from fvs_tools.schemes import BEYOND, SCHEMES, Scheme

EXTENDED, BEST = "extended", "best"
FROZEN, BEST_ORACLE = "frozen", "oracle, law of best"
#: Of every joint.
LIMITS = Limits(*CLIPPED.values())

#: All of them, with the defaults of the nodes except for what is named here.
CONTESTANTS: dict[str, Scheme] = {
    one.name: one
    for one in (
        *SCHEMES.values(),
        *BEYOND.values(),
        ORACLES[ORACLE],
        replace(SCHEMES[PROPOSED], name=FROZEN, method="frozen"),
        replace(BEYOND[BEST], name=BEST_ORACLE, method="oracle", estimator_values={}),
    )
}
#: The paper's schemes and the oracle have neither additions nor searched gains.
PUBLISHED = (*SCHEMES, ORACLE)


def floor_s(case: Case, arm: SerialChain | None = None) -> float:
    """Least time until the ball stays within 5 mm, by the joints' limits, s."""
    return fastest(case, LIMITS, BOUNDS_M["5mm"], arm).time_s


def variant(name: str, **controller_values: Any) -> Variant:
    """A contestant with the limits that all have, and further parameters of its controller."""
    return Variant.of(CONTESTANTS[name], **CLIPPED, **controller_values)
