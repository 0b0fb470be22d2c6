"""The exponent of the sliding surface: how fast, how calm; figures 2 and 3 of the paper.

The surface ``s = a1 y' + a2 y + a3 |y|^g sgn y`` (14) makes an axis move at about
``a2 |y| + a3 |y|^g``: the smaller g, the longer it keeps its speed near the goal, and the more
abruptly it reverses there. All runs are without a speed limit, which would hide this.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise, product
from typing import Any

import numpy as np

from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab.outcome import Outcome
from fvs_lab.results import Results, label_of, number_text
from fvs_lab.search import FREE
from fvs_lab.trials import Conditions, Variant, make_cases

EXPONENTS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.9)

SURFACE = {"alpha1": 1.0, "alpha2": 0.3, "alpha3": 0.45}
REACHING = {"k1": 1.63, "k2": 0.067, "k4": 0.125, "sigma": 0.82}
#: Reaching gains with which the law as printed runs at 125 Hz with the surface above.
LITERAL_REACHING = {"k1": 0.1, "k2": 0.01, "k4": 0.001, "sigma": 0.82}
#: The paper's adaptive exponent, and the same idea away from the noise.
SMALL_TO_HALF = {"lambda1": 0.3, "lambda2": 0.2, "switch_error_m": 0.00688}
LARGE = {"lambda1": 0.6375, "lambda2": 0.2625, "switch_error_m": 0.005}
#: Factor on alpha2 and alpha3 that gives the larger exponents about the same top speed.
SCALE = 1.6

WORLDS: dict[str, dict[str, Any]] = {
    "no noise": {"rendered": False, "position_noise_m": 0.0},
    "1 mm noise": {"position_noise_m": 0.001},
}
IMPLICIT, LITERAL = "implicit", "as printed"
#: Form of the law and world.
PRINTED_SILENT, PRINTED_NOISY = (f"{LITERAL}, {world}" for world in WORLDS)
SILENT, NOISY = (f"{IMPLICIT}, {world}" for world in WORLDS)
DURATION_S = 4.0
ADAPTIVE = "0.1 → 0.5"
ADAPTIVE_SCALED = f"0.375 → 0.9, faster (α2, α3 × {SCALE:g})"
#: The law as printed with the reaching gains of the implicit form.
UNSTABLE = "0.5, reaching gains of the implicit form"

_PERIOD_S = 0.008


def variants() -> list[Variant]:
    """All that is run; with noise fewer exponents as printed, to save time."""
    implicit: dict[str, Any] = {**FREE, "damping": 1e-6, **SURFACE, **REACHING}
    literal: dict[str, Any] = {**implicit, **LITERAL_REACHING, "discretisation": "literal"}
    faster = {name: SCALE * SURFACE[name] for name in ("alpha2", "alpha3")}
    found = []
    for (world, conditions), (form, gains) in product(
        WORLDS.items(), ((LITERAL, literal), (IMPLICIT, implicit))
    ):
        name = f"{form}, {world}"
        values = {
            f"{one:g}": {**gains, "lambda1": one, "lambda2": 0.0}
            for one in (EXPONENTS[::2] if name == PRINTED_NOISY else EXPONENTS)
        }
        values[ADAPTIVE] = {**gains, **SMALL_TO_HALF}
        if form == IMPLICIT:
            values[ADAPTIVE_SCALED] = {**gains, **LARGE, **faster}
        elif name == PRINTED_SILENT:
            values[UNSTABLE] = {**values["0.5"], **REACHING}
        found += [
            Variant({"form": name, "exponent": one}, controller_values=each, conditions=conditions)
            for one, each in values.items()
        ]
    return found


def _pace(outcome: Outcome) -> dict[str, float]:
    """Settling time over the time that the way takes at the run's own top joint speed."""
    moving = outcome.series["time_s"] <= outcome.to_5mm_s
    speeds = np.abs(outcome.series["command_rad_s"][moving])
    travel_rad = float(speeds.sum(axis=0).max()) * _PERIOD_S
    return {"pace": outcome.to_5mm_s * float(speeds.max()) / travel_rad}


def measure(context: lab.Context) -> lab.Found:
    """Run both forms of the law with all exponents, with and without noise."""
    cases = make_cases("e", context.count(6), 301)
    trials = [
        variant.trial(case, Conditions(), duration_s=DURATION_S, record=True)
        for variant, case in product(variants(), cases)
    ]
    runs = context.run(trials, "exponents", _pace)
    return lab.Found(runs, {"count": len(cases)}, {"cases": cases})


def claims(found: lab.Found) -> Iterator[lab.Claim]:
    """The paper's claims on the exponent, and ours."""
    runs = found.runs.groups("form", "exponent")
    stable = runs[PRINTED_SILENT, UNSTABLE]
    yield lab.papers("printed", lab.kept("runs within 5 mm", stable.values("settled"), 0.95))
    for name, metric in (("faster", "to_5mm_s"), ("pace", "pace")):
        medians = [runs[SILENT, f"{one:g}"].median(metric).value for one in EXPONENTS]
        text = ", ".join(
            f"{number_text(one, 2)} at {exponent:g}"
            for one, exponent in zip(medians, EXPONENTS, strict=True)
        )
        rising = all(after >= before for before, after in pairwise(medians))
        yield lab.papers(name, lab.Part(label_of(metric), text, rising))
    jitter, time = "jitter_rad_s", "to_5mm_s"
    chatter = runs[PRINTED_SILENT, "0.1"].over(runs[PRINTED_SILENT, "0.5"], jitter)
    yield lab.papers("chatter", lab.above("jitter as printed, 0.1 over 0.5", chatter, 2.0))
    quick = runs[SILENT, ADAPTIVE].over(runs[SILENT, "0.1"], time)
    calm = [
        lab.below(
            f"jitter over that of 0.5, {form}",
            runs[form, ADAPTIVE].over(runs[form, "0.5"], jitter),
            2.0,
        )
        for form in (PRINTED_SILENT, NOISY)
    ]
    yield lab.papers("adaptive", lab.below("settling time over that of 0.1", quick, 1.2), *calm)
    ours, paper = runs[NOISY, ADAPTIVE_SCALED], runs[NOISY, ADAPTIVE]
    calmer, slower = paper.over(ours, jitter), ours.over(paper, time)
    yield lab.ours(
        "large",
        lab.above("jitter of 0.1 → 0.5 over ours", calmer, 2.0),
        lab.below("settling time over that of 0.1 → 0.5", slower, 1.2),
    )


TABLES = (
    lab.TableOf(
        "exponents",
        ("exponent",),
        ("to_5mm_s:half", "jitter_rad_s:half"),
        across="form",
    ),
)


def figures(found: lab.Found) -> Iterator[lab.Drawn]:
    """Figures 2 and 3 of the paper, a panel each."""
    forms = found.runs.where(case=found.runs.rows[0]["case"]).groups("form")
    yield "exponents", _errors(forms), {}
    yield "adaptive", _adaptive(forms), {}


def _errors(forms: Mapping[str, Results]):
    """One run with each fixed exponent, a panel per form and world; figure 2."""
    looks = {
        f"{exponent:g}": {"color": colour, "linewidth": 1.3}
        for exponent, colour in zip(EXPONENTS, draw.shades(len(EXPONENTS)), strict=True)
    }
    figure, axes = draw.grid(2, 2, (11, 7), sharex=True, sharey=True)
    for axis, (form, runs) in zip(axes.flat, forms.items(), strict=True):
        draw.errors_over_time(axis, runs, "exponent", looks)
        axis.set(title=form, xlabel="time, s", ylabel="distance to the goal, mm")
        axis.label_outer()
    draw.legend(figure, len(EXPONENTS))
    return figure


def _fastest_joint(row: Mapping[str, Any]) -> np.ndarray:
    commands = row["series"]["command_rad_s"]
    return commands[:, int(np.abs(commands).max(axis=0).argmax())]


_ADAPTIVE_SIGNALS: tuple[draw.Signal, ...] = (
    draw.ERROR,
    ("fastest joint's command, rad/s", _fastest_joint),
    ("adaptive exponent γ of x, y and z", lambda row: row["series"]["exponent"]),
)


def _adaptive(forms: Mapping[str, Results]):
    """One run with the adaptive exponent and two fixed ones; figure 3."""
    looks: dict[str, dict[str, Any]] = {
        "0.1": {"color": "#D55E00"},
        "0.5": {"color": "#009E73"},
        ADAPTIVE: {"color": "#0072B2"},
    }
    each = {ADAPTIVE: {"label": ["x", "y", "z"]}}
    figure, axes = draw.grid(3, 3, (12, 8), sharex=True, sharey="row")
    for column, form in zip(axes.T, (PRINTED_SILENT, SILENT, NOISY), strict=True):
        for axis, signal in zip(column, _ADAPTIVE_SIGNALS, strict=True):
            last = signal is _ADAPTIVE_SIGNALS[-1]
            draw.over_time(axis, forms[form], signal, "exponent", each if last else looks)
            axis.set(xlabel="time, s", ylabel=signal[0], xlim=(0.0, 2.5))
            axis.label_outer()
        column[0].set(title=form, yscale="log", ylim=(0.05, 600.0))
        column[2].set_ylim(0.0, 0.6)
    draw.legend(figure)
    return figure


EXPERIMENT = lab.Experiment("exponents", measure, claims, TABLES, figures, globals())
