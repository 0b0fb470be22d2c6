"""What is changed, one thing at a time, and what is kept of the runs with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from fvs_controller_node.config import default_values
from fvs_lab.statistics import Interval, ratio_of_medians
from fvs_lab.trials import BOUNDS_M, Outcome, seconds

DURATION_S, QUICK_DURATION_S = 3.4, 1.6

BASE = "as it comes"
LITERAL, LITERAL_SAME = "as printed, its own gains", "as printed, same gains"
CAPPED, UNCAPPED = "gain 100 times as high, capped", "gain 100 times as high, cap off"
FROZEN, ORACLE = "no online update", "true Jacobian"

#: Reaching gains of the law as printed: of 24 combinations of k1 (0.3 to 3), k2 (0.01, 0.05) and
#: k4 (0 to 0.008) below its stability limits the one that was soonest within 2 mm, on other cases.
_LITERAL = {"discretisation": "literal", "k1": 2.0, "k2": 0.01, "k4": 0.003}

_GAINS = default_values(law="ftsm")
_TERMS = (0.0, 0.03, 0.1, -0.005, -0.03, -0.1)
LATENCIES_MS = (40, 80, 120)
#: Factors on alpha2 and alpha3 with which the law is soonest within 5 mm without prediction, of
#: 0.5, 0.35, 0.25 and 0.15, on other cases.
SOFTER = {40: 0.35, 80: 0.25, 120: 0.15}
TURNS_DEG = (20, 45)


@dataclass(frozen=True)
class Change:
    """A row: what is different.

    Parameters
    ----------
    name : str
        What the tables call it.
    group : str
        Heading above it.
    against : str
        Name of the row that it is compared with.
    over : str
        What that row is, in the figure, unless it is the first.
    estimator, controller, conditions : mapping
        What differs from the defaults.
    method : str
        Estimator.
    """

    name: str
    group: str
    against: str = BASE
    over: str = ""
    estimator: Mapping[str, Any] = field(default_factory=dict)
    controller: Mapping[str, Any] = field(default_factory=dict)
    conditions: Mapping[str, Any] = field(default_factory=dict)
    method: str = "rbf"


def sliding_name(gain: float) -> str:
    """Name of the row with this gain of the sliding term; negative for the printed sign."""
    if gain == 0.0:
        return "no sliding term"
    sign = "printed sign, " if gain < 0.0 else ""
    return f"{sign}sliding term {abs(gain):g}"


def _latency_name(latency_ms: int) -> str:
    return BASE if latency_ms == LATENCIES_MS[0] else f"{latency_ms} ms latency"


def blind_name(latency_ms: int) -> str:
    """Name of the row without prediction at this latency."""
    return f"{latency_ms} ms, no prediction"


def soft_name(latency_ms: int) -> str:
    """Name of the row without prediction, with gains to suit."""
    return f"{latency_ms} ms, no prediction, softer gains"


def turned_name(turn_deg: int) -> str:
    """Name of the row with the camera carried round."""
    return f"camera carried round by {turn_deg}°"


def turned_frozen_name(turn_deg: int) -> str:
    """Name of the row with the camera carried round and frozen networks."""
    return f"{turn_deg}°, no online update"


def all_changes() -> list[Change]:
    """List all rows, those of equal conditions together: a process keeps few simulations."""
    law, update, images = "control law", "Jacobian", "images"
    high = {"rbf.n1": 30.0}
    rows = [
        Change(BASE, "", ""),
        Change(LITERAL, law, controller=_LITERAL),
        Change(LITERAL_SAME, law, controller={"discretisation": "literal"}),
        Change(FROZEN, update, method="frozen"),
        Change(ORACLE, update, method="oracle"),
        *(
            Change(sliding_name(gain), update, estimator={"rbf.alpha2": gain})
            for gain in sorted(_TERMS, key=lambda gain: (gain < 0.0, abs(gain)))
        ),
        Change(CAPPED, update, estimator=high),
        Change(UNCAPPED, update, CAPPED, "capped", estimator={**high, "rbf.mu": 1.9}),
    ]
    for latency_ms in LATENCIES_MS:
        name, conditions = _latency_name(latency_ms), {"latency_s": 1e-3 * latency_ms}
        if name != BASE:
            rows.append(Change(name, images, conditions=conditions))
        over = "" if name == BASE else "with"
        blind = {"predictor": False}
        softer = {gain: SOFTER[latency_ms] * _GAINS[gain] for gain in ("alpha2", "alpha3")}
        rows.append(Change(blind_name(latency_ms), images, name, over, {}, blind, conditions))
        rows.append(
            Change(soft_name(latency_ms), images, name, over, {}, {**blind, **softer}, conditions)
        )
    for turn_deg in TURNS_DEG:
        name, turn = turned_name(turn_deg), {"camera_turn_deg": (0.0, float(turn_deg), 0.0)}
        rows.append(Change(name, "camera", conditions=turn))
        frozen = turned_frozen_name(turn_deg)
        rows.append(Change(frozen, "camera", name, "with", conditions=turn, method="frozen"))
    return rows


# ---- what came of it ------------------------------------------------------------------------


@dataclass(frozen=True)
class Row:
    """The runs of a row, a number a case.

    Parameters
    ----------
    against : str
        Name of the row that it is compared with; empty for the first.
    settling_s : mapping of str to sequence of float
        Settling times by the bound's name, s; infinite for never.
    jitter_rad_s, final_rms_m, jacobian_error : sequence of float
        As in :class:`~fvs_lab.trials.Outcome`.
    failures : sequence of str
        Causes of runs that did not settle.
    """

    against: str
    settling_s: Mapping[str, Sequence[float]]
    jitter_rad_s: Sequence[float]
    final_rms_m: Sequence[float]
    jacobian_error: Sequence[float]
    failures: Sequence[str] = ()


def row_of(against: str, outcomes: Sequence[Outcome]) -> Row:
    """What is kept of a row's outcomes."""
    return Row(
        against,
        {name: [seconds(one.settling_s[name]) for one in outcomes] for name in BOUNDS_M},
        [one.jitter_rad_s for one in outcomes],
        [one.final_rms_m for one in outcomes],
        [one.jacobian_error for one in outcomes],
        [one.failure for one in outcomes if one.failure],
    )


def settling_ratio(
    rows: Mapping[str, Row], name: str, against: str = "", bound: str = "5 mm"
) -> Interval:
    """Settling time of a row over that of another, with its paired interval.

    Parameters
    ----------
    rows : mapping of str to Row
        By name.
    name : str
        Numerator.
    against : str
        Denominator; by default the row that it is compared with.
    bound : str
        Which settling time.
    """
    other = rows[against or rows[name].against]
    return ratio_of_medians(rows[name].settling_s[bound], other.settling_s[bound])


def jitter_ratio(rows: Mapping[str, Row], name: str, against: str = "") -> Interval:
    """Jitter of a row over that of another, with its paired interval."""
    other = rows[against or rows[name].against]
    return ratio_of_medians(rows[name].jitter_rad_s, other.jitter_rad_s)
