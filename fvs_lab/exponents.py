"""The exponent of the sliding surface: how fast, how calm; figures 2 and 3 of the paper.

The surface ``s = a1 y' + a2 y + a3 |y|^g sgn y`` (14) makes an axis move at about
``a2 |y| + a3 |y|^g``: the smaller g, the longer the speed holds up near the goal, and the more
suddenly it must turn round there. Everything runs without a speed limit that would hide this.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fvs_lab import exponents_figures
from fvs_lab.context import Context
from fvs_lab.exponents_variants import (
    LITERAL_REACHING,
    NOISY,
    REACHING,
    SILENT,
    Key,
    Results,
    Variant,
    literal_limits,
    results_of,
    variants_of,
)
from fvs_lab.exponents_verdicts import text_of, verdicts
from fvs_lab.report import Figure, Report, Table
from fvs_lab.statistics import median
from fvs_lab.trials import (
    BOUNDS_M,
    Conditions,
    Outcome,
    Trial,
    make_cases,
    run_trial,
)

NAME = "exponents"
SEED = 301
DURATION_S, QUICK_DURATION_S = 4.0, 1.6


def run(context: Context) -> Report:
    """Run the experiment."""
    folder = context.folder(NAME)
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
    outcomes = context.map(run_trial, trials, NAME)
    runs = {
        key: outcomes[number * len(cases) : (number + 1) * len(cases)]
        for number, key in enumerate(keys)
    }
    results = {key: results_of(found) for key, found in runs.items()}
    first = {key: found[0] for key, found in runs.items()}
    return Report(
        name=NAME,
        title="The exponent: fast or calm",
        question="The control law moves the ball at a speed that grows with the distance to the "
        "power of an exponent. A small exponent keeps the ball fast up to the goal, and then has "
        "to stop at once. How much faster is that, when does it chatter, and does an exponent "
        "that grows near the goal have the best of both?",
        setup=_setup(len(cases), duration_s),
        figures=_figures(first, results, duration_s, folder),
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
                    "first_run": {
                        name: values
                        for name, values in runs[world, one.form, one.exponent][0].series.items()
                        if name != "ball_m"
                    },
                }
                for world in worlds
                for one in variants[world]
            ],
        },
    )


def _setup(count: int, duration_s: float) -> list[str]:
    k4_limit, k1_limit = literal_limits()
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


def _figures(
    first: Mapping[Key, Outcome],
    results: Mapping[Key, Results],
    duration_s: float,
    folder: Path,
) -> list[Figure]:
    return [
        Figure(
            exponents_figures.errors(first, folder),
            "One run with seven fixed exponents (the paper's figure 2). As printed, small "
            "exponents arrive first and then never come to rest; solved implicitly they do. Noise "
            "brings the unrest back (with fewer exponents as printed, to save time). Large "
            "exponents are calm and slow.",
        ),
        Figure(
            exponents_figures.adaptive(first, folder),
            "One run with the adaptive exponent against the two fixed ones between which it "
            "switches (the paper's figure 3). Top: error. Middle: the command, where chatter "
            "shows. Bottom: the adaptive exponent of each axis; it switches from 0.1 to 0.5 when "
            "that axis comes within 6.9 mm.",
        ),
        Figure(
            exponents_figures.summary(results, duration_s, folder),
            "Medians over all runs. A small exponent buys time (left) with unrest (right). Stars: "
            "adaptive exponents, implicit with 1 mm noise; they have the time of a small exponent "
            "at the unrest of a large one.",
        ),
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
                text_of(1e3 * median(found.final_rms_m).value),
                median([1e3 * value for value in found.jitter_rad_s]).text(1),
                text_of(median(found.peak_rad_s).value),
                text_of(median(found.pace).value),
                text_of(median(found.path_ratio).value),
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
