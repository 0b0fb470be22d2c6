"""Effect of the parameters that one tunes first, one at a time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from fvs_lab import figures as draw
from fvs_lab.experiment import Claim, Context, Drawn, Experiment, Found, TableOf, below, ours
from fvs_lab.results import label_of
from fvs_lab.trials import Conditions, Variant, make_cases


@dataclass(frozen=True)
class Knob:
    """One parameter, and what it is set to."""

    name: str
    #: In the order in which they are drawn; one of them is the default.
    values: tuple[float, ...]
    default: float
    of_estimator: bool = False
    #: Other parameters, which are set to the value times a factor.
    along: Mapping[str, float] = field(default_factory=dict)
    #: Conditions of the world that are not as usual.
    conditions: Mapping[str, Any] = field(default_factory=dict)

    def settings(self, value: float) -> dict[str, float]:
        """The parameters that are set for a value."""
        return {self.name: value, **{name: factor * value for name, factor in self.along.items()}}


#: In the order in which one turns them; what to do with each is in the template.
KNOBS = (
    Knob(
        "max_joint_velocity_rad_s",
        (0.25, 0.5, 1.0, 2.0, 3.0),
        1.0,
        along={"max_joint_acceleration_rad_s2": 6.0},
    ),
    Knob("alpha3", (0.5, 1.0, 2.0, 4.0, 8.0), 2.0, along={"alpha2": 1.5}),
    Knob("switch_error_m", (0.001, 0.002, 0.005, 0.02, 0.1), 0.005),
    Knob(
        "rbf.n1",
        (0.0, 0.03, 0.1, 0.3, 1.0),
        0.3,
        of_estimator=True,
        conditions={"camera_turn_deg": (45.0, 0.0, 0.0)},
    ),
)
#: Claims on the knobs: claim, knob, two of its values, metric, and the required ratio of the
#: metric's medians.
_CLAIMS = (
    ("speed", "max_joint_velocity_rad_s", 1.0, 0.25, "to_5mm_s", 0.5),
    ("calm", "alpha3", 1.0, 2.0, "jitter_rad_s", 0.7),
    ("learning", "rbf.n1", 0.3, 0.0, "to_5mm_s", 0.7),
)


def measure(context: Context) -> Found:
    """Turn one knob after the other, in the same cases."""
    cases = make_cases("U", context.count(12), 501)
    knobs = KNOBS[:2] if context.quick else KNOBS
    variants = [
        Variant(
            {"parameter": knob.name, "value": value, "default": value == knob.default},
            conditions=knob.conditions,
            estimator_values=knob.settings(value) if knob.of_estimator else {},
            controller_values={} if knob.of_estimator else knob.settings(value),
        )
        for knob in knobs
        for value in knob.values
    ]
    trials = [
        variant.trial(case, Conditions(), record=True) for variant in variants for case in cases
    ]
    facts = {"count": len(cases)}
    return Found(context.run(trials, "tuning"), facts, {"knobs": knobs, "cases": cases})


def claims(found: Found) -> Iterator[Claim]:
    """What each knob is for; none for knobs that were not turned."""
    knobs = found.runs.groups("parameter", "value")
    for name, parameter, value, other, metric, bound in _CLAIMS:
        if (parameter, value) in knobs:
            ratio = knobs[parameter, value].over(knobs[parameter, other], metric)
            label = f"{label_of(metric)}: {value:g} over {other:g}"
            yield ours(name, below(label, ratio, bound))


TABLES = (
    TableOf("medians", ("parameter", "value"), ("to_5mm_s", "jitter_rad_s", "final_rms_m:half")),
)


def figures(found: Found) -> Iterator[Drawn]:
    """A picture per parameter: runs, settling time and jitter for each of its values."""
    for name, runs in found.runs.groups("parameter").items():
        figure, ((run, *axes),) = draw.grid(1, 3, (12.0, 3.4), width_ratios=(2.0, 1.0, 1.0))
        values = runs.groups("value")
        looks = {
            value: {"color": colour, "linewidth": 2.4 if some.rows[0]["default"] else 1.3}
            for (value, some), colour in zip(values.items(), draw.shades(len(values)), strict=True)
        }
        draw.errors_over_time(run, runs.where(case=runs.rows[0]["case"]), "value", looks)
        run.set(xlabel="time since the target was given, s", ylabel="true error, mm")
        run.legend(title=name)
        for axis, metric in zip(axes, ("to_5mm_s", "jitter_rad_s"), strict=True):
            draw.dots_of(axis, runs, "value", metric)
            axis.set_xlim(0.0, None)
        yield "knob", figure, {"knob": name}


EXPERIMENT = Experiment("tuning", measure, claims, TABLES, figures, globals())
