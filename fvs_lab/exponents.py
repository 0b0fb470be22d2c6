"""The exponent of the sliding surface: how fast, how calm; figures 2 and 3 of the paper.

The surface ``s = a1 y' + a2 y + a3 |y|^g sgn y`` (14) makes an axis move at about
``a2 |y| + a3 |y|^g``: the smaller g, the longer the speed holds up near the goal, and the more
suddenly it must turn round there. Everything runs without a speed limit that would hide this.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np

from fvs_lab.context import Context
from fvs_lab.experiment import OURS, PAPER, Claim, Experiment, Found, Named, Part, above, below
from fvs_lab.figures import (
    bound_line,
    error_curve,
    keys,
    legend,
    medians,
    panels,
    ranges,
    shades,
)
from fvs_lab.outcome import BOUNDS_M, Outcome
from fvs_lab.results import METRICS, Metric, Results, number_text, table
from fvs_lab.trials import Case, Variant, make_cases

SEED = 301
EXPONENTS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.9)

#: Limits out of the way; the largest that the controller takes.
FREE = {"max_joint_velocity_rad_s": 3.14, "max_joint_acceleration_rad_s2": 40.0, "damping": 1e-6}
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
ADAPTIVE, ADAPTIVE_LARGE = "0.1 → 0.5", "0.375 → 0.9"
ADAPTIVE_SCALED = f"0.375 → 0.9, faster (α2, α3 × {SCALE:g})"
#: The law as printed with the reaching gains of the implicit form.
UNSTABLE = "0.5, reaching gains of the implicit form"

_PERIOD_S = 0.008
_SHOWN = METRICS | {"pace": Metric("own pace")}
_COLOURS = {LITERAL: "#D55E00", IMPLICIT: "#0072B2"}


def variants() -> list[Variant]:
    """All that is run; with noise fewer exponents as printed, to save time."""
    implicit = {**FREE, **SURFACE, **REACHING}
    literal = {**FREE, **SURFACE, **LITERAL_REACHING, "discretisation": "literal"}
    faster = {name: SCALE * SURFACE[name] for name in ("alpha2", "alpha3")}
    found = []
    for world, conditions in WORLDS.items():
        values = {}
        for form, gains in ((LITERAL, literal), (IMPLICIT, implicit)):
            for one in EXPONENTS[::2] if (world, form) == (NOISY, LITERAL) else EXPONENTS:
                values[form, f"{one:g}"] = {**gains, **_fixed(one)}
            values[form, ADAPTIVE] = {**gains, **SMALL_TO_HALF}
        values[IMPLICIT, ADAPTIVE_LARGE] = {**implicit, **LARGE}
        values[IMPLICIT, ADAPTIVE_SCALED] = {**implicit, **LARGE, **faster}
        if world == SILENT:
            values[LITERAL, UNSTABLE] = {**implicit, **_fixed(0.5), "discretisation": "literal"}
        found += [
            Variant(
                {"world": world, "law": form, "exponent": exponent},
                controller_values=gains,
                conditions=conditions,
            )
            for (form, exponent), gains in values.items()
        ]
    return found


def _fixed(exponent: float) -> dict[str, Any]:
    return {"lambda1": exponent, "lambda2": 0.0}


def literal_limits() -> tuple[float, float]:
    """Largest k4 and k1 with which the law as printed is stable far from the goal.

    ``k4 < 2 a2 dt / (2 a1 + a2 dt)`` and ``k1 < 2 a2 / (a1 + a2 dt / 2)``, with the surface above
    and the time dt from command to command.
    """
    a1, a2 = SURFACE["alpha1"], SURFACE["alpha2"]
    return (
        2.0 * a2 * _PERIOD_S / (2.0 * a1 + a2 * _PERIOD_S),
        2.0 * a2 / (a1 + 0.5 * a2 * _PERIOD_S),
    )


def _pace(_: Variant, __: Case, outcome: Outcome) -> dict[str, float]:
    """Settling time over the time that the way takes at the run's own top joint speed."""
    if not np.isfinite(outcome.settled_s):
        return {"pace": float("inf")}
    moving = outcome.series["time_s"] <= outcome.settled_s
    speeds = np.abs(outcome.series["command_rad_s"][moving])
    travel_rad = float(speeds.sum(axis=0).max()) * _PERIOD_S
    return {"pace": outcome.settled_s * float(speeds.max()) / travel_rad}


def measure(context: Context) -> Found:
    """Run both forms of the law with all exponents, with and without noise."""
    duration_s = 1.6 if context.quick else 4.0
    cases = make_cases("e", context.count(6, 1), SEED)
    runs = context.run(variants(), cases, "exponents", _pace, duration_s=duration_s, record=True)
    k4_limit, k1_limit = literal_limits()
    facts = {
        "count": len(cases),
        "duration_s": duration_s,
        "k1_limit": k1_limit,
        "k4_limit": k4_limit,
        "reaching": REACHING,
        "literal": LITERAL_REACHING,
        "surface": SURFACE,
    }
    return Found(runs, facts, {"seed": SEED, "cases": cases, "variants": variants()})


def claims(found: Found) -> Iterator[Claim]:
    """The paper's claims on the exponent, and ours."""

    def runs(world: str, law: str, exponent: str) -> Results:
        return found.runs.where(world=world, law=law, exponent=exponent)

    stable = float(np.mean(runs(SILENT, LITERAL, UNSTABLE).values("settled")))
    text = f"{100 * stable:.0f} %, asked: 95 %"
    yield Claim("printed", PAPER, [Part("runs within 5 mm", text, stable >= 0.95)])
    for name, metric in (("faster", "to_5mm_s"), ("pace", "pace")):
        chosen = [runs(SILENT, IMPLICIT, f"{one:g}").median(metric).value for one in EXPONENTS]
        text = ", ".join(
            f"{number_text(one, 2)} at {exponent:g}"
            for one, exponent in zip(chosen, EXPONENTS, strict=True)
        )
        rising = all(after >= before for before, after in pairwise(chosen))
        yield Claim(name, PAPER, [Part(_SHOWN[metric].label, text, rising)])
    small, half, adaptive = (
        {
            place: runs(*place, exponent)
            for place in ((SILENT, LITERAL), (SILENT, IMPLICIT), (NOISY, IMPLICIT))
        }
        for exponent in ("0.1", "0.5", ADAPTIVE)
    )
    chatter = small[SILENT, LITERAL].over(half[SILENT, LITERAL], "jitter_rad_s")
    yield Claim("chatter", PAPER, [above("jitter as printed, 0.1 over 0.5", chatter, 2.0)])
    time = adaptive[SILENT, IMPLICIT].over(small[SILENT, IMPLICIT], "to_5mm_s")
    calm = [
        below(
            f"jitter over that of 0.5, {law}, {world}",
            one.over(half[world, law], "jitter_rad_s"),
            2.0,
        )
        for (world, law), one in adaptive.items()
        if (world, law) != (SILENT, IMPLICIT)
    ]
    yield Claim("adaptive", PAPER, [below("settling time over that of 0.1", time, 1.2), *calm])
    ours, paper = runs(NOISY, IMPLICIT, ADAPTIVE_SCALED), adaptive[NOISY, IMPLICIT]
    yield Claim(
        "large",
        OURS,
        [
            above("jitter of 0.1 → 0.5 over ours", paper.over(ours, "jitter_rad_s"), 2.0),
            below("settling time over that of 0.1 → 0.5", ours.over(paper, "to_5mm_s"), 1.2),
        ],
    )


def tables(found: Found) -> Iterator[Named]:
    """Medians, a table per world."""
    metrics = (
        "to_5mm_s", "to_2mm_s", "to_1mm_s", "final_rms_m", "jitter_rad_s",
        "peak_joint_speed_rad_s", "pace", "path_ratio", "limited_share",
    )  # fmt: skip
    for world, runs in found.runs.groups("world").items():
        rows = table(runs, {"law": "law", "exponent": "exponent"}, metrics, known=_SHOWN)
        yield "world", rows, {"world": world}


def figures(found: Found) -> Iterator[Named]:
    """Figures 2 and 3 of the paper, and settling and jitter over the exponent."""
    first = found.runs.groups("world", "law", "exponent")
    yield "exponents", _errors(first)
    yield "adaptive", _adaptive(first)
    yield "summary", _summary(found.runs)


def _errors(groups: dict[Any, Results]):
    figure, axes = panels(2, 2, (11, 7), sharex=True, sharey=True)
    for row, world in zip(axes, WORLDS, strict=True):
        for axis, law in zip(row, _COLOURS, strict=True):
            for exponent, colour in zip(EXPONENTS, shades(len(EXPONENTS)), strict=True):
                if runs := groups.get((world, law, f"{exponent:g}")):
                    look = {"color": colour, "linewidth": 1.3, "label": f"{exponent:g}"}
                    error_curve(axis, runs.rows[0]["series"], **look)
            bound_line(axis, 1e3 * BOUNDS_M["5 mm"])
            axis.set(title=f"{law}, {world}", ylim=(0.05, 600.0))
        row[0].set_ylabel("distance to the goal, mm")
    axes[1, 0].set_xlabel("time, s")
    legend(figure, axes[0, 0], len(EXPONENTS))
    return figure


def _adaptive(groups: dict[Any, Results]):
    places = ((SILENT, LITERAL), (SILENT, IMPLICIT), (NOISY, IMPLICIT))
    shown = {"0.1": "#D55E00", "0.5": "#009E73", ADAPTIVE: "#0072B2"}
    figure, axes = panels(3, 3, (12, 8), sharex=True, sharey="row")
    for (error, command, profile), (world, law) in zip(axes.T, places, strict=True):
        for exponent, colour in shown.items():
            series = groups[world, law, exponent].rows[0]["series"]
            error_curve(error, series, color=colour, label=exponent)
            joint = int(np.abs(series["command_rad_s"]).max(axis=0).argmax())
            command.plot(series["time_s"], series["command_rad_s"][:, joint], color=colour)
        profile.plot(series["time_s"], series["exponent"], label=["x", "y", "z"])
        bound_line(error, 1e3 * BOUNDS_M["5 mm"])
        error.set(title=f"{law}, {world}", ylim=(0.05, 600.0))
        profile.set(xlabel="time, s", xlim=(0.0, 2.5), ylim=(0.0, 0.6))
    names = ("distance to the goal, mm", "fastest joint's command, rad/s", "adaptive exponent γ")
    for axis, name in zip(axes[:, 0], names, strict=True):
        axis.set_ylabel(name)
    axes[0, 2].legend(title="exponent")
    axes[2, 2].legend(title="axis", ncols=3)
    return figure


def _summary(runs: Results):
    figure, (axes,) = panels(1, 2, (11, 4.4))
    looks = {}
    for (world, law), ones in runs.groups("world", "law").items():
        fixed = Results(
            {**row, "exponent": float(row["exponent"])}
            for row in ones
            if row["exponent"].replace(".", "").isdigit()
        )
        style = ":" if world == SILENT else "-"
        look: dict[str, Any] = {"color": _COLOURS[law], "linestyle": style}
        looks[f"{law}, {world}"] = look
        medians(axes[0], fixed, "exponent", "to_5mm_s", **look)
        medians(axes[1], fixed, "exponent", "jitter_rad_s", least=0.01, **look)
    for exponent, place, colour in ((ADAPTIVE, 0.5, "black"), (ADAPTIVE_SCALED, 0.9, "#CC79A7")):
        chosen = runs.where(world=NOISY, law=IMPLICIT, exponent=exponent)
        look = {"color": colour, "marker": "*", "linestyle": ""}
        looks[f"adaptive {exponent}"] = look
        for axis, metric in zip(axes, ("to_5mm_s", "jitter_rad_s"), strict=True):
            value = METRICS[metric].factor * chosen.median(metric).value
            ranges(axis, [place], [(value, value, value)], **look, markersize=12)
    axes[1].set_yscale("log")
    for axis in axes:
        axis.set_xlabel("exponent γ (of stars: near the goal)")
    keys(figure, looks, 3)
    return figure


EXPERIMENT = Experiment("exponents", measure, claims, tables, figures)
