"""What the parameters do that one tunes first, one at a time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from fvs_lab.context import Context
from fvs_lab.experiment import OURS, Claim, Experiment, Found, Named, below
from fvs_lab.figures import bound_line, dots, error_curve, panels, shades
from fvs_lab.outcome import BOUNDS_M
from fvs_lab.results import METRICS, table
from fvs_lab.trials import Variant, make_cases

_SEED = 501
_METRICS = ("to_5mm_s", "jitter_rad_s", "final_rms_m")


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
        Its default.
    of_estimator : bool
        Whether it is the estimator's.
    along : mapping of str to float
        Other parameters, which are set to the value times a factor.
    conditions : mapping
        Conditions of the world that are not as usual.
    """

    name: str
    values: tuple[Any, ...]
    default: Any
    of_estimator: bool = False
    along: Mapping[str, float] = field(default_factory=dict)
    conditions: Mapping[str, Any] = field(default_factory=dict)

    def settings(self, value: Any) -> dict[str, Any]:
        """The parameters that are set for a value."""
        return {self.name: value, **{name: factor * value for name, factor in self.along.items()}}

    def variant(self, value: Any) -> Variant:
        """The paper's scheme with this value."""
        settings = self.settings(value)
        labels = {"parameter": self.name, "value": value, "default": value == self.default}
        return Variant(
            labels,
            estimator_values=settings if self.of_estimator else {},
            controller_values={} if self.of_estimator else settings,
            conditions=self.conditions,
        )


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


def measure(context: Context) -> Found:
    """Turn one knob after the other, in the same cases."""
    cases = make_cases("U", context.count(4, 1), _SEED)
    knobs = KNOBS[:2] if context.quick else KNOBS
    variants = [knob.variant(value) for knob in knobs for value in knob.values]
    runs = context.run(variants, cases, "tuning", record=True)
    facts = {"count": len(cases), "knobs": [knob.name for knob in knobs]}
    return Found(runs, facts, {"seed": _SEED, "knobs": knobs, "cases": cases})


def claims(found: Found) -> Iterator[Claim]:
    """What each knob is for: ratios of medians at two of its values."""
    for name, parameter, value, other, metric, bound in (
        ("speed", "max_joint_velocity_rad_s", 1.0, 0.25, "to_5mm_s", 0.5),
        ("calm", "alpha3", 1.0, 2.0, "jitter_rad_s", 0.7),
        ("learning", "rbf.n1", 0.3, 0.0, "to_5mm_s", 0.7),
    ):
        runs = found.runs.where(parameter=parameter)
        if len(runs):
            ratio = runs.where(value=value).over(runs.where(value=other), metric)
            label = f"{METRICS[metric].label}: {value:g} over {other:g}"
            yield Claim(name, OURS, [below(label, ratio, bound)])


def tables(found: Found) -> Iterator[Named]:
    """All medians."""
    by = {"parameter": "parameter", "value": "value", "default": "default"}
    yield "medians", table(found.runs, by, _METRICS)


def figures(found: Found) -> Iterator[Named]:
    """A picture per parameter: runs, settling time and jitter for each of its values."""
    for name, runs in found.runs.groups("parameter").items():
        figure, ((run, *axes),) = panels(1, 3, (12.0, 3.4), width_ratios=(2.0, 1.0, 1.0))
        values = runs.groups("value")
        for (value, ones), colour in zip(values.items(), shades(len(values)), strict=True):
            first = ones.rows[0]
            width = 2.4 if first["default"] else 1.3
            error_curve(run, first["series"], color=colour, linewidth=width, label=f"{value:g}")
        bound_line(run, 1e3 * BOUNDS_M["5 mm"])
        run.set(xlabel="time since the target was given, s", ylabel="true error, mm")
        run.legend(title=name)
        for axis, metric in zip(axes, _METRICS, strict=False):
            one = METRICS[metric]
            dots(axis, {f"{value:g}": [one.factor * each for each in ones.values(metric)]
                        for value, ones in values.items()})  # fmt: skip
            axis.set(xlabel=one.label, xlim=(0.0, None))
        yield "knob", figure, {"knob": name}


EXPERIMENT = Experiment("tuning", measure, claims, tables, figures)
