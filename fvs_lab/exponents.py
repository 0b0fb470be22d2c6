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
from fvs_lab.results import METRICS, Results, number_text
from fvs_lab.search import FREE
from fvs_lab.trials import Variant, make_cases

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
SILENT, NOISY = WORLDS
IMPLICIT, LITERAL = "implicit", "as printed"
ADAPTIVE = "0.1 → 0.5"
ADAPTIVE_SCALED = f"0.375 → 0.9, faster (α2, α3 × {SCALE:g})"
#: The law as printed with the reaching gains of the implicit form.
UNSTABLE = "0.5, reaching gains of the implicit form"

_PERIOD_S = 0.008


def variants() -> list[Variant]:
    """All that is run; with noise fewer exponents as printed, to save time."""
    implicit = {**FREE, "damping": 1e-6, **SURFACE, **REACHING}
    literal = {**implicit, **LITERAL_REACHING, "discretisation": "literal"}
    faster = {name: SCALE * SURFACE[name] for name in ("alpha2", "alpha3")}
    found = []
    for world, conditions in WORLDS.items():
        values = {}
        for form, gains in ((LITERAL, literal), (IMPLICIT, implicit)):
            for one in EXPONENTS[::2] if (world, form) == (NOISY, LITERAL) else EXPONENTS:
                values[form, f"{one:g}"] = {**gains, "lambda1": one, "lambda2": 0.0}
            values[form, ADAPTIVE] = {**gains, **SMALL_TO_HALF}
        values[IMPLICIT, ADAPTIVE_SCALED] = {**implicit, **LARGE, **faster}
        if world == SILENT:
            values[LITERAL, UNSTABLE] = {**values[IMPLICIT, "0.5"], "discretisation": "literal"}
        for (form, exponent), gains in values.items():
            labels = {"world": world, "law": form, "exponent": exponent}
            found.append(Variant(labels, controller_values=gains, conditions=conditions))
    return found


def literal_limits() -> dict[str, float]:
    """Largest k4 and k1 with which the law as printed is stable far from the goal.

    ``k4 < 2 a2 dt / (2 a1 + a2 dt)`` and ``k1 < 2 a2 / (a1 + a2 dt / 2)``, with the surface above
    and the time dt from command to command.
    """
    a1, a2 = SURFACE["alpha1"], SURFACE["alpha2"]
    k4 = 2.0 * a2 * _PERIOD_S / (2.0 * a1 + a2 * _PERIOD_S)
    return {"k4_limit": k4, "k1_limit": 2.0 * a2 / (a1 + 0.5 * a2 * _PERIOD_S)}


def _pace(outcome: Outcome) -> dict[str, float]:
    """Settling time over the time that the way takes at the run's own top joint speed."""
    if not np.isfinite(outcome.settled_s):
        return {"pace": float("inf")}
    moving = outcome.series["time_s"] <= outcome.settled_s
    speeds = np.abs(outcome.series["command_rad_s"][moving])
    travel_rad = float(speeds.sum(axis=0).max()) * _PERIOD_S
    return {"pace": outcome.settled_s * float(speeds.max()) / travel_rad}


def measure(context: lab.Context) -> lab.Found:
    """Run both forms of the law with all exponents, with and without noise."""
    duration_s = 1.6 if context.quick else 4.0
    cases = make_cases("e", context.count(6, 1), 301)
    runs = context.run(
        product(variants(), cases), "exponents", _pace, duration_s=duration_s, record=True
    )
    facts = {
        "count": len(cases),
        "duration_s": duration_s,
        **literal_limits(),
    }
    return lab.Found(runs, facts, {"cases": cases, "variants": variants()})


def claims(found: lab.Found) -> Iterator[lab.Claim]:
    """The paper's claims on the exponent, and ours."""

    def runs(world: str, law: str, exponent: str) -> Results:
        return found.runs.where(world=world, law=law, exponent=exponent)

    stable = runs(SILENT, LITERAL, UNSTABLE)
    part = lab.kept("runs within 5 mm", sum(stable.values("settled")), len(stable), 0.95)
    yield lab.papers("printed", part)
    for name, metric in (("faster", "to_5mm_s"), ("pace", "pace")):
        chosen = [runs(SILENT, IMPLICIT, f"{one:g}").median(metric).value for one in EXPONENTS]
        text = ", ".join(
            f"{number_text(one, 2)} at {exponent:g}"
            for one, exponent in zip(chosen, EXPONENTS, strict=True)
        )
        rising = all(after >= before for before, after in pairwise(chosen))
        yield lab.papers(name, lab.Part(METRICS[metric].label, text, rising))
    jitter, time = "jitter_rad_s", "to_5mm_s"
    printed, silent, noisy = (SILENT, LITERAL), (SILENT, IMPLICIT), (NOISY, IMPLICIT)
    chatter = runs(*printed, "0.1").over(runs(*printed, "0.5"), jitter)
    yield lab.papers("chatter", lab.above("jitter as printed, 0.1 over 0.5", chatter, 2.0))
    quick = runs(*silent, ADAPTIVE).over(runs(*silent, "0.1"), time)
    calm = [
        lab.below(
            f"jitter over that of 0.5, {law}, {world}",
            runs(world, law, ADAPTIVE).over(runs(world, law, "0.5"), jitter),
            2.0,
        )
        for world, law in (printed, noisy)
    ]
    yield lab.papers("adaptive", lab.below("settling time over that of 0.1", quick, 1.2), *calm)
    ours, paper = runs(*noisy, ADAPTIVE_SCALED), runs(*noisy, ADAPTIVE)
    calmer, slower = paper.over(ours, jitter), ours.over(paper, time)
    yield lab.ours(
        "large",
        lab.above("jitter of 0.1 → 0.5 over ours", calmer, 2.0),
        lab.below("settling time over that of 0.1 → 0.5", slower, 1.2),
    )


_COLUMNS = (
    "to_5mm_s",
    "to_2mm_s",
    "to_1mm_s",
    "final_rms_m",
    "jitter_rad_s",
    "peak_joint_speed_rad_s",
    "pace",
    "path_ratio",
    "limited_share",
)
TABLES = (lab.TableOf("world", ("law", "exponent"), _COLUMNS, each="world"),)


def figures(found: lab.Found) -> Iterator[lab.Drawn]:
    """Figures 2 and 3 of the paper, a panel each."""
    case = found.runs.rows[0]["case"]
    places = found.runs.where(case=case).groups("world", "law")
    yield "exponents", _errors(places), {}
    yield "adaptive", _adaptive(places), {}


def _errors(places: Mapping[Any, Results]):
    """One run with each fixed exponent, a panel per form and world; figure 2."""
    looks = {
        f"{exponent:g}": {"color": colour, "linewidth": 1.3}
        for exponent, colour in zip(EXPONENTS, draw.shades(len(EXPONENTS)), strict=True)
    }
    figure, axes = draw.grid(2, 2, (11, 7), sharex=True, sharey=True)
    for axis, ((world, law), runs) in zip(axes.flat, places.items(), strict=True):
        draw.errors_over_time(axis, runs, "exponent", looks)
        axis.set(title=f"{law}, {world}", xlabel="time, s", ylabel="distance to the goal, mm")
        axis.label_outer()
    draw.legend(figure, len(EXPONENTS))
    return figure


def _fastest_joint(row: Mapping[str, Any]) -> np.ndarray:
    commands = row["series"]["command_rad_s"]
    return commands[:, int(np.abs(commands).max(axis=0).argmax())]


_ADAPTIVE_SIGNALS: tuple[draw.Signal, ...] = (
    ("fastest joint's command, rad/s", _fastest_joint),
    ("adaptive exponent γ of x, y and z", lambda row: row["series"]["exponent"]),
)


def _adaptive(places: Mapping[Any, Results]):
    """One run with the adaptive exponent and two fixed ones; figure 3."""
    looks = {"0.1": {"color": "#D55E00"}, "0.5": {"color": "#009E73"}}
    own = {ADAPTIVE: {"color": "#0072B2"}}
    each = {ADAPTIVE: {"label": ["x", "y", "z"]}}
    chosen = ((SILENT, LITERAL), (SILENT, IMPLICIT), (NOISY, IMPLICIT))
    figure, axes = draw.grid(3, 3, (12, 8), sharex=True, sharey="row")
    command, exponent = _ADAPTIVE_SIGNALS
    for column, place in zip(axes.T, chosen, strict=True):
        draw.errors_over_time(column[0], places[place], "exponent", looks | own)
        draw.over_time(column[1], places[place], command, "exponent", looks | own)
        draw.over_time(column[2], places[place], exponent, "exponent", each)
        column[0].set_title(", ".join(reversed(place)))
        column[2].set(xlabel="time, s", xlim=(0.0, 2.5), ylim=(0.0, 0.6))
    names = ("distance to the goal, mm", command[0], exponent[0])
    for axis, name in zip(axes[:, 0], names, strict=True):
        axis.set_ylabel(name)
    draw.legend(figure)
    return figure


EXPERIMENT = lab.Experiment("exponents", measure, claims, TABLES, figures, globals())
