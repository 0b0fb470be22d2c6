"""The exponent of the sliding surface: how fast, how calm; figures 2 and 3 of the paper.

The surface ``s = a1 y' + a2 y + a3 |y|^g sgn y`` (14) makes an axis move at about
``a2 |y| + a3 |y|^g``: the smaller g, the longer it keeps its speed near the goal, and the more
abruptly it reverses there. All runs are without a speed limit, which would hide this.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab.contestants import FREE
from fvs_lab.results import Results, label_of, number_text
from fvs_lab.trials import Trial, crossed, make_cases

EXPONENTS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.9)
#: The paper's adaptive exponent; the same idea away from the noise, with about the same top speed.
ADAPTIVE, SCALED = "0.1 → 0.5", "0.375 → 0.9, faster (α2, α3 × 1.6)"
#: The law as printed with the reaching gains of the implicit form.
UNSTABLE = "0.5, reaching gains of the implicit form"
#: Form of the law and world, and the noise, m.
PRINTED, IMPLICIT, NOISY = "as printed, no noise", "implicit, no noise", "implicit, 1 mm noise"
FORMS = {PRINTED: 0.0, IMPLICIT: 0.0, NOISY: 0.001}


def variants() -> Iterator[Trial]:
    """Both forms of the law with all exponents, without noise and with."""
    surface = {**FREE, "damping": 1e-6, "alpha1": 1.0, "alpha2": 0.3, "alpha3": 0.45}
    implicit = {**surface, "k1": 1.63, "k2": 0.067, "k4": 0.125, "sigma": 0.82}
    # The reaching gains with which the law as printed runs at 125 Hz.
    printed = {**implicit, "k1": 0.1, "k2": 0.01, "k4": 0.001, "discretisation": "literal"}
    faster = {**implicit, "alpha2": 1.6 * 0.3, "alpha3": 1.6 * 0.45}
    for form, noise_m in FORMS.items():
        gains: dict[str, Any] = implicit if form.startswith("implicit") else printed
        values = {f"{power:g}": {**gains, "lambda1": power, "lambda2": 0.0} for power in EXPONENTS}
        values[ADAPTIVE] = {**gains, "lambda1": 0.3, "lambda2": 0.2, "switch_error_m": 0.00688}
        if gains is implicit:
            larger = {"lambda1": 0.6375, "lambda2": 0.2625, "switch_error_m": 0.005}
            values[SCALED] = {**faster, **larger}
        else:
            values[UNSTABLE] = {**values["0.5"], "k1": 1.63, "k2": 0.067, "k4": 0.125}
        for exponent, controller in values.items():
            yield Trial(record=True).changed(
                {"form": form, "exponent": exponent},
                controller=controller,
                conditions={"rendered": noise_m > 0.0, "position_noise_m": noise_m},
            )


def _pace(row: Mapping[str, Any]) -> dict[str, float]:
    """Settling time over the time that the way takes at the run's own top joint speed."""
    time_s = row["series"]["time_s"]
    speeds = np.abs(row["series"]["command_rad_s"][time_s <= row["to_5mm_s"]])
    travel_rad = float(speeds.sum(axis=0).max() * time_s[0])
    return {"pace": row["to_5mm_s"] * float(speeds.max()) / travel_rad}


def measure(context: lab.Context) -> Results:
    """Run both forms of the law with all exponents, with and without noise."""
    cases = make_cases("e", context.count(6), 301)
    return context.run(crossed(variants(), cases), "exponents").adding(_pace)


def claims(runs: Results) -> Iterator[lab.Claim]:
    """The paper's claims on the exponent, and ours."""
    groups = runs.groups("form", "exponent")
    stable = groups[PRINTED, UNSTABLE]
    yield lab.papers("printed", lab.kept("runs within 5 mm", stable.values("settled"), 0.95))
    for name, metric in (("faster", "to_5mm_s"), ("pace", "pace")):
        medians = [groups[IMPLICIT, f"{power:g}"].median(metric).value for power in EXPONENTS]
        text = ", ".join(
            f"{number_text(middle, 2)} at {exponent:g}"
            for middle, exponent in zip(medians, EXPONENTS, strict=True)
        )
        rising = all(after >= before for before, after in pairwise(medians))
        yield lab.papers(name, lab.Part(label_of(metric), text, rising))
    jitter, time = "jitter_rad_s", "to_5mm_s"
    chatter = groups[PRINTED, "0.1"].over(groups[PRINTED, "0.5"], jitter)
    yield lab.papers("chatter", lab.above("jitter as printed, 0.1 over 0.5", chatter, 2.0))
    quick = groups[IMPLICIT, ADAPTIVE].over(groups[IMPLICIT, "0.1"], time)
    calm = [
        lab.below(
            f"jitter over that of 0.5, {form}",
            groups[form, ADAPTIVE].over(groups[form, "0.5"], jitter),
            2.0,
        )
        for form in (PRINTED, NOISY)
    ]
    yield lab.papers("adaptive", lab.below("settling time over that of 0.1", quick, 1.2), *calm)
    ours, paper = groups[NOISY, SCALED], groups[NOISY, ADAPTIVE]
    yield lab.ours(
        "large",
        lab.above("jitter of 0.1 → 0.5 over ours", paper.over(ours, jitter), 2.0),
        lab.below("settling time over that of 0.1 → 0.5", ours.over(paper, time), 1.2),
    )


TABLES = (
    lab.Table("exponents", ("exponent",), ("to_5mm_s:half", "jitter_rad_s:half"), across="form"),
)


def figures(runs: Results) -> Iterator[lab.Drawn]:
    """Figures 2 and 3 of the paper, a panel each."""
    forms = runs.where(case=runs.rows[0]["case"]).groups("form")
    yield "exponents", _errors(forms), {}
    yield "adaptive", _adaptive(forms), {}


def _errors(forms: Mapping[str, Results]):
    """One run with each fixed exponent, a panel per form and world; figure 2."""
    looks = {
        f"{exponent:g}": {"color": colour, "linewidth": 1.3}
        for exponent, colour in zip(EXPONENTS, draw.shades(len(EXPONENTS)), strict=True)
    }
    figure, axes = draw.grid(1, 3, (12, 4.2), sharey=True)
    for axis, (form, runs) in zip(axes.flat, forms.items(), strict=True):
        draw.errors_over_time(axis, runs, "exponent", looks)
        axis.set(title=form, xlabel="time, s", ylabel="distance to the goal, mm")
        axis.label_outer()
    draw.legend(figure, len(EXPONENTS))
    return figure


def _fastest_joint(row: Mapping[str, Any]) -> np.ndarray:
    commands = row["series"]["command_rad_s"]
    return commands[:, int(np.abs(commands).max(axis=0).argmax())]


def _adaptive(forms: Mapping[str, Results]):
    """One run with the adaptive exponent and two fixed ones; figure 3."""
    colours = zip(("0.1", "0.5", ADAPTIVE), ("#D55E00", "#009E73", "#0072B2"), strict=True)
    looks: dict[str, dict[str, Any]] = {name: {"color": colour} for name, colour in colours}
    axis_names = {ADAPTIVE: {"label": ["x", "y", "z"]}}
    figure, axes = draw.grid(3, 3, (12, 8), sharex=True, sharey="row")
    for column, form in zip(axes.T, (PRINTED, IMPLICIT, NOISY), strict=True):
        error, command, exponent = column
        draw.errors_over_time(error, forms[form], "exponent", looks)
        draw.over_time(command, forms[form], _fastest_joint, "exponent", looks)
        draw.over_time(
            exponent, forms[form], lambda row: row["series"]["exponent"], "exponent", axis_names
        )
        error.set(title=form, ylabel="distance to the target, mm")
        command.set_ylabel("fastest joint's command, rad/s")
        exponent.set(ylabel="adaptive exponent γ of x, y and z", ylim=(0.0, 0.6))
        for axis in column:
            axis.set(xlabel="time, s", xlim=(0.0, 2.5))
            axis.label_outer()
    draw.legend(figure)
    return figure


EXPERIMENT = lab.Experiment("exponents", measure, claims, TABLES, globals(), figures)
