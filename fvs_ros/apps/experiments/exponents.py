"""The exponent of the sliding surface: how fast, how calm; figures 2 and 3 of the paper.

The surface ``s = a1 y' + a2 y + a3 |y|^g sgn y`` (14) makes an axis move at about
``a2 |y| + a3 |y|^g``: the smaller g, the longer the speed holds up near the goal, and the more
suddenly it must turn round there. Everything runs without a speed limit that would hide this.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from fvs_ros.apps.experiments.context import Context
from fvs_ros.apps.experiments.report import Figure, Report, Table, Verdict
from fvs_ros.apps.experiments.statistics import Interval, all_hold, median, ratio_of_medians
from fvs_ros.apps.experiments.style import pyplot, save
from fvs_ros.apps.experiments.trials import (
    BOUNDS_M,
    Conditions,
    Outcome,
    Trial,
    make_cases,
    run_trial,
    seconds,
)

SEED = 301
EXPONENTS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.9)
DURATION_S, QUICK_DURATION_S = 4.0, 2.4

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

SILENT, NOISY = "no noise", "1 mm noise"
IMPLICIT, LITERAL = "implicit", "as printed"
ADAPTIVE, ADAPTIVE_LARGE = "0.1 → 0.5", "0.375 → 0.9"
ADAPTIVE_SCALED = f"0.375 → 0.9, faster (α2, α3 × {SCALE:g})"
#: The law as printed with the reaching gains of the implicit form.
UNSTABLE = "0.5, reaching gains of the implicit form"

_PERIOD_S = 0.008


@dataclass(frozen=True)
class Variant:
    """A form of the law with an exponent.

    Parameters
    ----------
    form : str
        ``as printed`` or ``implicit``.
    exponent : str
        Its exponent or exponents, as the tables call it.
    values : mapping
        The controller's parameters.
    """

    form: str
    exponent: str
    values: Mapping[str, Any]


def _fixed(exponent: float) -> dict[str, Any]:
    return {"exponent": "fixed", "fixed_exponent": exponent}


def variants_of(world: str) -> list[Variant]:
    """List what is run in a world; with noise fewer as printed, for the time it takes."""
    implicit = {**FREE, **SURFACE, **REACHING}
    literal = {**FREE, **SURFACE, **LITERAL_REACHING, "discretisation": "literal"}
    faster = {name: SCALE * SURFACE[name] for name in ("alpha2", "alpha3")}
    found = []
    for form, values in ((LITERAL, literal), (IMPLICIT, implicit)):
        found += [
            Variant(form, f"{one:g}", {**values, **_fixed(one)}) for one in _exponents(world, form)
        ]
        found.append(Variant(form, ADAPTIVE, {**values, **SMALL_TO_HALF}))
    found.append(Variant(IMPLICIT, ADAPTIVE_LARGE, {**implicit, **LARGE}))
    found.append(Variant(IMPLICIT, ADAPTIVE_SCALED, {**implicit, **LARGE, **faster}))
    if world == SILENT:
        unstable = {**implicit, **_fixed(0.5), "discretisation": "literal"}
        found.append(Variant(LITERAL, UNSTABLE, unstable))
    return found


def _exponents(world: str, form: str) -> tuple[float, ...]:
    return EXPONENTS[::2] if (world, form) == (NOISY, LITERAL) else EXPONENTS


def literal_limits(values: Mapping[str, float], period_s: float) -> tuple[float, float]:
    """Largest k4 and k1 with which the law as printed is stable far from the goal.

    ``k4 < 2 a2 dt / (2 a1 + a2 dt)`` and ``k1 < 2 a2 / (a1 + a2 dt / 2)``.

    Parameters
    ----------
    values : mapping
        With ``alpha1`` and ``alpha2``.
    period_s : float
        Time dt from command to command, s.

    Returns
    -------
    tuple of float
        Of k4 and of k1.
    """
    a1, a2 = values["alpha1"], values["alpha2"]
    return (
        2.0 * a2 * period_s / (2.0 * a1 + a2 * period_s),
        2.0 * a2 / (a1 + 0.5 * a2 * period_s),
    )


@dataclass(frozen=True)
class Results:
    """The runs of one variant in one world, a number a case.

    Parameters
    ----------
    settling_s : mapping of str to sequence of float
        Settling times by the bound's name, s; infinite for never.
    jitter_rad_s, final_rms_m, peak_rad_s, limited_share : sequence of float
        As in :class:`~fvs_ros.apps.experiments.trials.Outcome`.
    pace : sequence of float
        Settling time to 5 mm over the time that the way takes at the run's own top joint speed.
    path_ratio : sequence of float
        Length of the ball's path to 5 mm over the straight line.
    """

    settling_s: Mapping[str, Sequence[float]]
    jitter_rad_s: Sequence[float]
    final_rms_m: Sequence[float] = field(default_factory=list)
    peak_rad_s: Sequence[float] = field(default_factory=list)
    limited_share: Sequence[float] = field(default_factory=list)
    pace: Sequence[float] = field(default_factory=list)
    path_ratio: Sequence[float] = field(default_factory=list)


def _results(outcomes: Sequence[Outcome]) -> Results:
    return Results(
        settling_s={name: [seconds(one.settling_s[name]) for one in outcomes] for name in BOUNDS_M},
        jitter_rad_s=[one.jitter_rad_s for one in outcomes],
        final_rms_m=[one.final_rms_m for one in outcomes],
        peak_rad_s=[one.peak_joint_speed_rad_s for one in outcomes],
        limited_share=[one.limited_share for one in outcomes],
        pace=[_pace(one) for one in outcomes],
        path_ratio=[one.path_ratio for one in outcomes],
    )


def _pace(outcome: Outcome) -> float:
    """Settling time over the longest joint travel at the top joint speed of the run."""
    if not np.isfinite(outcome.settled_s):
        return float("inf")
    moving = outcome.series["time_s"] <= outcome.settled_s
    speeds = np.abs(outcome.series["command_rad_s"][moving])
    travel_rad = float(speeds.sum(axis=0).max()) * _PERIOD_S
    return outcome.settled_s * float(speeds.max()) / travel_rad


Key = tuple[str, str, str]


def verdicts(results: Mapping[Key, Results]) -> list[Verdict]:
    """What the numbers say to the paper's claims.

    Parameters
    ----------
    results : mapping
        Results by world, form and exponent.
    """
    return [
        _printed_law(results),
        _faster(results),
        _faster_at_its_speed(results),
        _chatter(results),
        _adaptive(results),
        _worth_having(results),
    ]


def _printed_law(results: Mapping[Key, Results]) -> Verdict:
    tuned = _settled_share(results[SILENT, LITERAL, UNSTABLE])
    slow = _settled_share(results[SILENT, LITERAL, "0.5"])
    k4_limit, k1_limit = literal_limits(SURFACE, _PERIOD_S)
    reaching, literal = REACHING, LITERAL_REACHING
    return Verdict(
        "The law as printed can be run at 125 Hz with reaching gains that suit the implicit form.",
        f"At 125 Hz it needs k4 below {k4_limit:.4f} and k1 below {k1_limit:.2f}. With k1 = "
        f"{reaching['k1']:g}, k4 = {reaching['k4']:g} {100 * tuned:.0f} % of the runs reached "
        f"5 mm (exponent 0.5, no noise); with k1 = {literal['k1']:g}, k2 = {literal['k2']:g}, "
        f"k4 = {literal['k4']:g} {100 * slow:.0f} % did. The implicit form has no such condition.",
        tuned >= 0.95,
    )


def _faster(results: Mapping[Key, Results]) -> Verdict:
    chosen = [results[SILENT, IMPLICIT, f"{one:g}"] for one in EXPONENTS]
    times = [median(one.settling_s["5 mm"]).value for one in chosen]
    return Verdict(
        "The smaller the exponent, the sooner the ball is within 5 mm (errors below 1 m).",
        f"Median settling, s, implicit without noise: {_list(EXPONENTS, times)}.",
        _rising(times),
    )


def _faster_at_its_speed(results: Mapping[Key, Results]) -> Verdict:
    chosen = [results[SILENT, IMPLICIT, f"{one:g}"] for one in EXPONENTS]
    paces = [median(one.pace).value for one in chosen]
    paths = [median(one.path_ratio).value for one in chosen]
    best = EXPONENTS[int(np.argmin(paces))]
    return Verdict(
        "The smaller the exponent, the better a given top speed is used.",
        "A small exponent also drives faster from the start. Settling time over the time that the "
        f"way takes at the run's own top speed: {_list(EXPONENTS, paces)}; best at {best:g}. Where "
        "the exponent is near 0 each axis goes at nearly the same speed, however far it has to go, "
        f"and the ball's way bends: {paths[0]:.2f} times the straight line at {EXPONENTS[0]:g}, "
        f"{paths[EXPONENTS.index(0.5)]:.2f} at 0.5.",
        _rising(paces),
    )


def _chatter(results: Mapping[Key, Results]) -> Verdict:
    def jitter(world: str, form: str, exponent: str) -> float:
        return 1e3 * median(results[world, form, exponent].jitter_rad_s).value

    ratio = ratio_of_medians(
        results[SILENT, LITERAL, "0.1"].jitter_rad_s, results[SILENT, LITERAL, "0.5"].jitter_rad_s
    )
    return Verdict(
        "Small exponents chatter at the goal.",
        "As printed and without noise the command of exponent 0.1 jumps by "
        f"{jitter(SILENT, LITERAL, '0.1'):.1f} mrad/s from tick to tick at rest, that of 0.5 by "
        f"{jitter(SILENT, LITERAL, '0.5'):.1f}: {ratio.text(0)} times. Solved implicitly it is "
        f"{jitter(SILENT, IMPLICIT, '0.1'):.1f} against {jitter(SILENT, IMPLICIT, '0.5'):.1f}, and "
        f"with 1 mm noise {jitter(NOISY, IMPLICIT, '0.1'):.1f} against "
        f"{jitter(NOISY, IMPLICIT, '0.5'):.1f}.",
        ratio.above(2.0),
    )


def _adaptive(results: Mapping[Key, Results]) -> Verdict:
    time = ratio_of_medians(
        results[SILENT, IMPLICIT, ADAPTIVE].settling_s["5 mm"],
        results[SILENT, IMPLICIT, "0.1"].settling_s["5 mm"],
    )
    printed, noisy = (
        ratio_of_medians(
            results[world, form, ADAPTIVE].jitter_rad_s, results[world, form, "0.5"].jitter_rad_s
        )
        for world, form in ((SILENT, LITERAL), (NOISY, IMPLICIT))
    )
    parts = (time.below(1.2), printed.below(2.0), noisy.below(2.0))
    return Verdict(
        "The adaptive exponent 0.1 → 0.5 is as fast as 0.1 (within a fifth) and as calm as 0.5 "
        "(within a factor of two).",
        f"Settling time {time.text()} times that of 0.1 (implicit, no noise); jitter "
        f"{printed.text()} times that of 0.5 as printed without noise, {noisy.text()} times "
        "implicit with 1 mm noise.",
        all_hold(parts),
    )


def _worth_having(results: Mapping[Key, Results]) -> Verdict:
    ours, paper = results[NOISY, IMPLICIT, ADAPTIVE_SCALED], results[NOISY, IMPLICIT, ADAPTIVE]
    jitter = ratio_of_medians(paper.jitter_rad_s, ours.jitter_rad_s)
    time, close = (
        ratio_of_medians(ours.settling_s[name], paper.settling_s[name]) for name in ("5 mm", "2 mm")
    )
    peak = ratio_of_medians(ours.peak_rad_s, paper.peak_rad_s)
    return Verdict(
        "With 1 mm noise an exponent that ends near 1 (0.375 → 0.9, α2 and α3 raised to about the "
        "same top speed) is at least twice as calm as the paper's 0.1 → 0.5, and no more than a "
        "fifth slower to 5 mm.",
        f"The paper's exponents jitter {jitter.text(1)} times as much. Settling time of 0.375 → "
        f"0.9 over that of 0.1 → 0.5: {time.text()} to 5 mm, {close.text()} to 2 mm, at "
        f"{peak.value:.2f} times the top speed.",
        all_hold((jitter.above(2.0), time.below(1.2))),
    )


def _settled_share(results: Results) -> float:
    return float(np.mean(np.isfinite(results.settling_s["5 mm"])))


def _rising(values: Sequence[float]) -> bool:
    """Whether no value is below the one before; never after never counts as rising."""
    return all(after >= before for before, after in pairwise(values))


def _list(names: Sequence[float], values: Sequence[float]) -> str:
    pairs = zip(names, values, strict=True)
    return ", ".join(f"{value} at {name:g}" for name, value in ((n, _number(v)) for n, v in pairs))


def _number(value: float, digits: int = 2) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "never"


def run(context: Context) -> Report:
    """Run the experiment."""
    folder = context.folder("exponents")
    duration_s = QUICK_DURATION_S if context.quick else DURATION_S
    cases = make_cases("e", context.count(6, 1), SEED)
    worlds = {
        SILENT: Conditions(rendered=False, position_noise_m=0.0),
        NOISY: context.conditions(position_noise_m=0.001),
    }
    variants = {world: variants_of(world) for world in worlds}
    keys = [(world, one.form, one.exponent) for world in worlds for one in variants[world]]
    trials = [
        Trial(
            case,
            "rbf",
            "ftsm",
            controller_values=one.values,
            conditions=conditions,
            duration_s=duration_s,
            record=True,
        )
        for world, conditions in worlds.items()
        for one in variants[world]
        for case in cases
    ]
    outcomes = context.map(run_trial, trials, "exponents")
    runs = {
        key: outcomes[number * len(cases) : (number + 1) * len(cases)]
        for number, key in enumerate(keys)
    }
    results = {key: _results(found) for key, found in runs.items()}
    first = {key: found[0] for key, found in runs.items()}
    return Report(
        name="exponents",
        title="The exponent: fast or calm",
        question="The control law moves the ball at a speed that grows with the distance to the "
        "power of an exponent. A small exponent keeps the ball fast up to the goal, and then has "
        "to stop at once. How much faster is that, when does it chatter, and does an exponent "
        "that grows near the goal have the best of both?",
        setup=_setup(len(cases), duration_s),
        figures=(
            _draw_exponents(first, folder),
            _draw_adaptive(first, folder),
            _draw_summary(results, duration_s, folder),
        ),
        tables=[_table(results, variants[world], world, duration_s) for world in worlds],
        verdicts=verdicts(results),
        data={
            "seed": SEED,
            "cases": cases,
            "duration_s": duration_s,
            "worlds": worlds,
            "rows": [
                {
                    "world": world,
                    "form": one.form,
                    "exponent": one.exponent,
                    "controller_values": one.values,
                    "runs": [run.summary() for run in runs[world, one.form, one.exponent]],
                    "pace": results[world, one.form, one.exponent].pace,
                }
                for world in worlds
                for one in variants[world]
            ],
        },
    )


def _setup(count: int, duration_s: float) -> list[str]:
    k4_limit, k1_limit = literal_limits(SURFACE, _PERIOD_S)
    return [
        f"{count} pairs of start and goal 0.2 to 0.5 m apart, the same for all rows, each run for "
        f"{duration_s:g} s with the trained networks and their online update. Limits are out of "
        "the way (3.14 rad/s, 40 rad/s²), as in the paper; gains α1 = 1, α2 = 0.3, α3 = 0.45. "
        "“No noise” takes the ball's true position; “1 mm noise” adds 1 mm to each coordinate of "
        "the camera's measurement.",
        "The law comes in two forms. As printed (16), it evaluates its right side with the last "
        f"command. At 125 Hz this is stable only for k4 < {k4_limit:.4f} and k1 < {k1_limit:.2f}, "
        "so it gets its own reaching gains k1 = {k1:g}, k2 = {k2:g}, k4 = {k4:g}. ".format(
            **LITERAL_REACHING
        )
        + "Solved implicitly, the form that the controller uses, it is stable with any gains: "
        "k1 = {k1:g}, k2 = {k2:g}, k4 = {k4:g}.".format(**REACHING),
        "Jitter is the change of the joint command from tick to tick in the last second, rms, "
        "worst joint: what one hears and feels when the arm should stand still. “Own pace” is the "
        "settling time over the time the way would take at the run's own top speed; it compares "
        "runs that drive at different speeds. “Path” is the ball's path to 5 mm over the straight "
        "line.",
    ]


def _table(
    results: Mapping[Key, Results], variants: Sequence[Variant], world: str, duration_s: float
) -> Table:
    rows = []
    for one in variants:
        found = results[world, one.form, one.exponent]
        rows.append(
            [
                one.form,
                one.exponent,
                *(median(found.settling_s[name]).text() for name in BOUNDS_M),
                _number(1e3 * median(found.final_rms_m).value),
                Interval(*(1e3 * one for one in _ends(median(found.jitter_rad_s)))).text(1),
                _number(median(found.peak_rad_s).value),
                _number(median(found.pace).value),
                _number(median(found.path_ratio).value),
                f"{100 * float(np.median(found.limited_share)):.0f} %",
            ]
        )
    header = [
        "law",
        "exponent",
        *(f"to {name}, s" for name in BOUNDS_M),
        "final error, mm rms",
        "jitter, mrad/s",
        "top speed, rad/s",
        "own pace",
        "path",
        "limited",
    ]
    count = len(next(iter(results.values())).jitter_rad_s)
    return Table(
        f"{world[0].upper()}{world[1:]}: medians of {count} runs (95 % intervals). “Never” is not "
        f"within the {duration_s:g} s of a run. “Limited” is the share of the way on which a limit "
        "shaped the command.",
        header,
        rows,
    )


def _ends(interval: Interval) -> tuple[float, float, float]:
    return interval.value, interval.low, interval.high


def _draw_exponents(runs: Mapping[Key, Outcome], folder: Path) -> Figure:
    """Errors over time for all fixed exponents: the paper's figure 2."""
    plt = pyplot()
    figure, axes = plt.subplots(
        2, 2, figsize=(11, 7), sharex=True, sharey=True, layout="constrained"
    )
    colours = plt.get_cmap("viridis")(np.linspace(0.0, 0.92, len(EXPONENTS)))
    for row, world in zip(axes, (SILENT, NOISY), strict=True):
        for axis, form in zip(row, (LITERAL, IMPLICIT), strict=True):
            for exponent, colour in zip(EXPONENTS, colours, strict=True):
                if exponent not in _exponents(world, form):
                    continue
                series = runs[world, form, f"{exponent:g}"].series
                axis.plot(
                    series["time_s"],
                    1e3 * np.maximum(series["error_m"], 1e-6),
                    color=colour,
                    linewidth=1.3,
                    label=f"{exponent:g}",
                )
            axis.axhline(5.0, color="black", linewidth=0.8, linestyle=":")
            axis.text(0.02, 5.5, "5 mm")
            axis.set_yscale("log")
            axis.set_ylim(0.05, 600.0)
            axis.set_title(f"{form}, {world}")
        row[0].set_ylabel("distance to the goal, mm")
    for axis in axes[1]:
        axis.set_xlabel("time, s")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, title="exponent", loc="outside right center")
    save(figure, folder / "exponents.png")
    return Figure(
        "exponents.png",
        "One run with seven fixed exponents (the paper's figure 2). As printed, small exponents "
        "arrive first and then never come to rest; solved implicitly they do. Noise brings the "
        "unrest back (with fewer exponents as printed, to save time). Large exponents are calm and "
        "slow.",
    )


def _draw_adaptive(runs: Mapping[Key, Outcome], folder: Path) -> Figure:
    """Adaptive against fixed exponents, with their profile: the paper's figure 3."""
    plt = pyplot()
    panels = ((SILENT, LITERAL), (SILENT, IMPLICIT), (NOISY, IMPLICIT))
    shown = (
        ("0.1", "#D55E00", "fixed 0.1"),
        ("0.5", "#009E73", "fixed 0.5"),
        (ADAPTIVE, "#0072B2", f"adaptive {ADAPTIVE}"),
    )
    figure, axes = plt.subplots(
        3, 3, figsize=(12, 8), sharex=True, sharey="row", layout="constrained"
    )
    for column, (world, form) in zip(axes.T, panels, strict=True):
        error, command, profile = column
        error.set_title(f"{form}, {world}")
        for exponent, colour, label in shown:
            series = runs[world, form, exponent].series
            times = series["time_s"]
            error.plot(times, 1e3 * np.maximum(series["error_m"], 1e-6), color=colour, label=label)
            joint = int(np.abs(series["command_rad_s"]).max(axis=0).argmax())
            command.plot(times, series["command_rad_s"][:, joint], color=colour, linewidth=1.0)
        error.set_yscale("log")
        error.set_ylim(0.05, 600.0)
        error.axhline(5.0, color="black", linewidth=0.8, linestyle=":")
        series = runs[world, form, ADAPTIVE].series
        for axis, colour in enumerate(("#0072B2", "#56B4E9", "#CC79A7")):
            profile.plot(
                series["time_s"], series["exponent"][:, axis], color=colour, label="xyz"[axis]
            )
        profile.set_ylim(0.0, 0.6)
        profile.set_xlabel("time, s")
        profile.set_xlim(0.0, 2.5)
    axes[0, 0].set_ylabel("distance to the goal, mm")
    axes[1, 0].set_ylabel("command of the fastest joint,\nrad/s")
    axes[2, 0].set_ylabel("adaptive exponent γ\nof each axis")
    axes[0, 2].legend(loc="upper right")
    axes[2, 2].legend(loc="lower right", title="axis", ncol=3)
    save(figure, folder / "adaptive.png")
    return Figure(
        "adaptive.png",
        "One run with the adaptive exponent against the two fixed ones between which it switches "
        "(the paper's figure 3). Top: error. Middle: the command, where chatter shows. Bottom: the "
        "adaptive exponent of each axis; it switches from 0.1 to 0.5 when that axis comes within "
        "6.9 mm.",
    )


def _draw_summary(results: Mapping[Key, Results], duration_s: float, folder: Path) -> Figure:
    """Settling and jitter over the exponent."""
    plt = pyplot()
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.4), layout="constrained")
    lines = (
        (LITERAL, SILENT, "#D55E00", ":", "v"),
        (LITERAL, NOISY, "#D55E00", "-", "v"),
        (IMPLICIT, SILENT, "#0072B2", ":", "o"),
        (IMPLICIT, NOISY, "#0072B2", "-", "o"),
    )
    for form, world, colour, style, mark in lines:
        exponents = _exponents(world, form)
        chosen = [results[world, form, f"{one:g}"] for one in exponents]
        times = np.array([median(one.settling_s["5 mm"]).value for one in chosen])
        shown = np.where(np.isfinite(times), times, duration_s + 0.15)
        jitter = [max(1e3 * median(one.jitter_rad_s).value, 0.01) for one in chosen]
        look = {"color": colour, "linestyle": style, "marker": mark}
        left.plot(exponents, shown, label=f"{form}, {world}", **look)
        right.plot(exponents, jitter, label=f"{form}, {world}", **look)
    for exponent, place, text, colour in (
        (ADAPTIVE, 0.5, "0.1 → 0.5", "black"),
        (ADAPTIVE_SCALED, 0.9, "0.375 → 0.9,\nfaster", "#CC79A7"),
    ):
        found = results[NOISY, IMPLICIT, exponent]
        for axis, value in (
            (left, median(found.settling_s["5 mm"]).value),
            (right, 1e3 * median(found.jitter_rad_s).value),
        ):
            if np.isfinite(value):
                axis.plot(place, value, "*", color=colour, markersize=13)
                axis.annotate(
                    text,
                    (place, value),
                    textcoords="offset points",
                    xytext=(-8, -4),
                    ha="right",
                    va="top",
                    color=colour,
                )
    left.axhline(duration_s, color="black", linewidth=0.8)
    left.text(0.1, duration_s - 0.05, "never within the run", va="top")
    left.set_ylim(0.0, duration_s + 0.4)
    left.set_ylabel("settling to 5 mm, s")
    right.set_yscale("log")
    right.set_ylabel("jitter at rest, mrad/s (0.01: none)")
    for axis in (left, right):
        axis.set_xlabel("exponent γ (for stars: near the goal)")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncol=4)
    save(figure, folder / "summary.png")
    return Figure(
        "summary.png",
        "Medians over all runs. A small exponent buys time (left) with unrest (right). Stars: "
        "adaptive exponents, implicit with 1 mm noise; they have the time of a small exponent at "
        "the unrest of a large one.",
    )
