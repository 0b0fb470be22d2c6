"""Effect of the parameters that one tunes first, one at a time."""

from __future__ import annotations

from collections.abc import Iterator

from fvs_controller_node.config import default_values
from fvs_estimator_node.rbf import RbfConfig
from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab.results import Results
from fvs_lab.trials import Trial, crossed, make_cases

#: In the order in which one turns them, with the values in the order in which they are drawn; what
#: to do with each is in docs/tuning.md.
KNOBS = {
    "max_joint_velocity_rad_s": (0.25, 0.5, 1.0, 2.0, 3.0),
    "alpha3": (0.5, 1.0, 2.0, 4.0, 8.0),
    "switch_error_m": (0.001, 0.002, 0.005, 0.02, 0.1),
    "rbf.n1": (0.0, 0.03, 0.1, 0.3, 1.0),
}


def variant(knob: str, value: float) -> Trial:
    """A value of a knob, and of what goes with it."""
    trial = Trial(record=True).changed({"parameter": knob, "value": value})
    if knob == "rbf.n1":
        carried = {"camera_carried_deg": (45.0, 0.0, 0.0)}
        return trial.changed(estimator={knob: value}, conditions=carried)
    goes_with = {
        "max_joint_velocity_rad_s": {"max_joint_acceleration_rad_s2": 6.0 * value},
        "alpha3": {"alpha2": 1.5 * value},
    }
    return trial.changed(controller={knob: value, **goes_with.get(knob, {})})


def measure(context: lab.Context) -> Results:
    """Turn one knob after the other, in the same cases."""
    variants = [variant(knob, value) for knob in context.first(KNOBS, 2) for value in KNOBS[knob]]
    cases = make_cases("U", context.count(12), 501)
    return context.run(crossed(variants, cases), "tuning")


def figures(runs: Results) -> Iterator[lab.Drawn]:
    """A picture per parameter: runs, settling time and jitter for each of its values."""
    defaults = {**default_values(law="ftsm"), "rbf.n1": RbfConfig.n1}
    for name, group in runs.groups("parameter").items():
        figure, ((run, *axes),) = draw.grid(1, 3, (12.0, 3.4), width_ratios=(2.0, 1.0, 1.0))
        looks = {
            value: {"color": colour, "linewidth": 2.4 if value == defaults[name] else 1.3}
            for value, colour in zip(KNOBS[name], draw.shades(len(KNOBS[name])), strict=True)
        }
        draw.errors_over_time(run, group.where(case=group.rows[0]["case"]), "value", looks)
        run.set(xlabel="time since the target was given, s", ylabel="true error, mm")
        run.legend(title=name)
        for axis, metric in zip(axes, ("to_5mm_s", "jitter_rad_s"), strict=True):
            draw.dots_of(axis, group, "value", metric)
            axis.set_xlim(0.0, None)
        yield "knob", figure, {"knob": name}


TABLES = (lab.Table("knobs", ("parameter", "value"), ("to_5mm_s:half", "jitter_rad_s:half")),)
EXPERIMENT = lab.Experiment("tuning", measure, lambda _: (), TABLES, globals(), figures)
