"""What the parameters do that one tunes first, one at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fvs_lab import tuning_figures
from fvs_lab.context import Context
from fvs_lab.report import Figure, Report, Table, Verdict
from fvs_lab.statistics import ratio_of_medians
from fvs_lab.trials import Case, Outcome, Trial, make_cases, run_trial

NAME = "tuning"
_SEED = 501
DURATION_S = 4.0


@dataclass(frozen=True)
class Knob:
    """One parameter, and what it is set to.

    Parameters
    ----------
    name : str
        The parameter.
    values : tuple
        What it is set to, in the order in which they are drawn; one of them is the default.
    default : object
        What it is by default.
    advice : str
        What to do with it, and what to look at.
    of_estimator : bool
        Whether it is the estimator's.
    along : mapping of str to float
        Other parameters that are set to so many times the value.
    conditions : mapping
        Conditions of the world, where they are not as usual.
    """

    name: str
    values: tuple[Any, ...]
    default: Any
    advice: str
    of_estimator: bool = False
    along: Mapping[str, float] = field(default_factory=dict)
    conditions: Mapping[str, Any] = field(default_factory=dict)

    def settings(self, value: Any) -> dict[str, Any]:
        """The parameters that are set for a value."""
        return {self.name: value, **{name: factor * value for name, factor in self.along.items()}}


#: In the order in which one turns them.
KNOBS = (
    Knob(
        "max_joint_velocity_rad_s",
        (0.25, 0.5, 1.0, 2.0, 3.0),
        1.0,
        "The limit decides the time to a far target. Double it as long as the arm may move so "
        "fast; raise max_joint_acceleration_rad_s2 with it, here to six times the speed.",
        along={"max_joint_acceleration_rad_s2": 6.0},
    ),
    Knob(
        "alpha3",
        (0.5, 1.0, 2.0, 4.0, 8.0),
        2.0,
        "How steep the sliding surface is; alpha2 goes along, with one and a half times the value. "
        "Steeper closes in faster, until the delays of robot and camera answer with overshoot, and "
        "makes more of the noise.",
        along={"alpha2": 1.5},
    ),
    Knob(
        "switch_error_m",
        (0.001, 0.002, 0.005, 0.02, 0.1),
        0.005,
        "Where the exponent switches: the law is softer below this error, and sharp above. It "
        "matters little from a millimetre to some centimetres; keep it a few times the noise of "
        "the ball position, and raise it where the arm overshoots at the end.",
    ),
    Knob(
        "rbf.n1",
        (0.0, 0.03, 0.1, 0.3, 1.0),
        0.3,
        "How fast the networks learn from what they mispredict, shown with a camera that was "
        "carried round the scene by 45 degrees. Too fast, and they follow the noise.",
        of_estimator=True,
        conditions={"camera_turn_deg": (45.0, 0.0, 0.0)},
    ),
)


def run(context: Context) -> Report:
    """Turn one knob after the other, in the same cases."""
    cases = make_cases("U", context.count(4, 1), _SEED)
    knobs = KNOBS[:2] if context.quick else KNOBS
    trials = {
        (knob.name, value): [_trial(context, knob, value, case) for case in cases]
        for knob in knobs
        for value in knob.values
    }
    results = context.map_groups(run_trial, trials, NAME)
    folder = context.folder(NAME)
    return Report(
        name=NAME,
        title="Tuning",
        question="What does each parameter do that one turns first?",
        setup=[
            "The paper's scheme with the defaults of the nodes; one parameter at a time is set to "
            f"five values, in the same {len(cases)} cases. Settling and jitter as everywhere: time "
            "until the true error stays below 5 mm, and the change of the command from tick to "
            "tick over the last second.",
            *(f"{knob.name}: {knob.advice}" for knob in knobs),
        ],
        figures=[
            Figure(
                tuning_figures.knob(folder, knob, results),
                f"{knob.name}: {knob.advice}",
            )
            for knob in knobs
        ],
        tables=[_table(knobs, results)],
        verdicts=_verdicts(knobs, results),
        data={
            "knobs": knobs,
            "cases": cases,
            "runs": {
                f"{name} {value}": [one.summary() for one in ones]
                for (name, value), ones in results.items()
            },
        },
    )


Results = Mapping[tuple[str, Any], Sequence[Outcome]]


def _trial(context: Context, knob: Knob, value: Any, case: Case) -> Trial:
    settings = knob.settings(value)
    return Trial(
        case,
        "rbf",
        "ftsm",
        settings if knob.of_estimator else {},
        {} if knob.of_estimator else settings,
        context.conditions(**knob.conditions),
        DURATION_S,
        record=True,
    )


def _table(knobs: Sequence[Knob], results: Results) -> Table:
    rows = []
    for knob in knobs:
        for value in knob.values:
            ones = results[knob.name, value]
            settled = float(np.median([one.settled_s for one in ones]))
            rows.append(
                [
                    knob.name,
                    f"{value:g}" + (" (default)" if value == knob.default else ""),
                    f"{settled:.2f}" if np.isfinite(settled) else "never",
                    f"{np.median([1e3 * one.jitter_rad_s for one in ones]):.2f}",
                    f"{np.median([1e3 * one.final_rms_m for one in ones]):.2f}",
                ]
            )
    return Table(
        "Medians of the cases.",
        ["parameter", "value", "to 5 mm, s", "jitter, mrad/s", "final rms, mm"],
        rows,
    )


def _verdicts(knobs: Sequence[Knob], results: Results) -> list[Verdict]:
    claims = (
        (
            "max_joint_velocity_rad_s",
            1.0,
            0.25,
            0.5,
            "settled_s",
            "The speed limit decides the time to a far target.",
        ),
        (
            "alpha3",
            1.0,
            2.0,
            0.7,
            "jitter_rad_s",
            "Half the slope of the surface is a good deal calmer.",
        ),
        ("rbf.n1", 0.3, 0.0, 0.7, "settled_s", "Learning finds a view that is 45 degrees off."),
    )
    turned = {knob.name for knob in knobs}
    return [_verdict(results, *one) for one in claims if one[0] in turned]


def _verdict(
    results: Results, name: str, value: Any, other: Any, bound: float, what: str, claim: str
) -> Verdict:
    """Judge a parameter by the ratio of medians at two of its values."""
    ratio = ratio_of_medians(
        *([getattr(one, what) for one in results[name, setting]] for setting in (value, other))
    )
    words = {"settled_s": "Settling time", "jitter_rad_s": "Jitter"}[what]
    return Verdict(
        claim, f"{words} at {value:g} over that at {other:g}: {ratio.text()}.", ratio.below(bound)
    )
