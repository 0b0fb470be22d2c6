"""Hundreds of random worlds, to see which scheme brings the ball home whatever goes wrong."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from fvs_lab import robustness_figures
from fvs_lab.context import Context
from fvs_lab.report import Figure, Report, Table
from fvs_lab.robustness_runs import (
    DURATION_S,
    Contestant,
    Job,
    run_job,
    settled_by,
    success_rate,
)
from fvs_lab.robustness_verdicts import rate_text, verdicts
from fvs_lab.robustness_worlds import (
    DISTANCE_M,
    HARSH,
    QUANTITIES,
    Kind,
    draw_world,
)
from fvs_lab.trials import REST_S, Outcome
from fvs_ros.arguments import unknown
from fvs_tools.schemes import BEYOND, SCHEMES


class UnknownSchemeError(ValueError):
    """A scheme that nobody has; the text lists those known."""


#: Who competes, with the defaults of the nodes but for what is named here. A new one is a line.
CONTESTANTS: tuple[Contestant, ...] = (
    *(Contestant(one.name, one.method, one.law, of_paper=True) for one in SCHEMES.values()),
    Contestant("oracle, proportional", "oracle", "proportional"),
    *(
        Contestant(one.name, one.method, one.law, one.estimator_values, one.controller_values)
        for one in BEYOND.values()
    ),
)
#: A quick run has these.
_QUICK = ("proposed", "oracle, proportional")

#: So many trials of a kind are named in the table of failures.
_NAMED = 8


def run(context: Context) -> Report:
    """Send everybody through worlds in which everything that may go wrong does so at once."""
    return run_in(
        context,
        HARSH,
        "Robustness",
        "Random worlds, in which everything that may go wrong does so at once: which scheme brings "
        "the ball to its target in nearly all of them?",
    )


def run_in(context: Context, kind: Kind, title: str, question: str) -> Report:
    """Draw worlds of a kind, send everybody through all of them, and judge.

    Parameters
    ----------
    context : Context
        Settings.
    kind : Kind
        Of the worlds.
    title, question : str
        Of the report.
    """
    contestants = contestants_called(context.schemes or (_QUICK if context.quick else ()))
    count = context.trials or context.count(500, 4)
    worlds = context.map(partial(draw_world, kind), range(1, count + 1), "worlds")
    jobs = [Job(world, one, context.rendered) for world in worlds for one in contestants]
    outcomes = context.map(run_job, jobs, kind.name)
    results = {
        one.name: outcomes[place :: len(contestants)] for place, one in enumerate(contestants)
    }
    folder = context.folder(kind.name)
    return Report(
        name=kind.name,
        title=title,
        question=question,
        setup=_setup(kind, count, context.rendered, contestants),
        figures=[
            Figure(
                robustness_figures.success(folder, worlds, results),
                "Share of the trials that settle against each disturbance, with 95 % intervals; "
                "in brackets the number of worlds. Everything else is as random as always.",
            ),
            Figure(
                robustness_figures.settling(folder, worlds, results),
                "Settling time to 5 mm against each disturbance: the dot is the median, the bar "
                f"goes up to 90 %. At {DURATION_S:g} s stands what never settles.",
            ),
            Figure(
                robustness_figures.jitter(folder, worlds, results),
                "Jitter at rest of the runs that settled: median, and the range of 80 % of them.",
            ),
        ],
        tables=[_table(results), _failures_table(results)],
        verdicts=verdicts(contestants, results),
        data={
            "seed": kind.seed,
            "distance_m": DISTANCE_M,
            "duration_s": DURATION_S,
            "ranges": kind.ranges,
            "contestants": contestants,
            "worlds": worlds,
            "runs": {
                name: [
                    {"trial": world.number, **_kept(one)}
                    for world, one in zip(worlds, ones, strict=True)
                ]
                for name, ones in results.items()
            },
        },
    )


def contestants_called(names: Sequence[str]) -> list[Contestant]:
    """The contestants of these names, or all without any.

    Raises
    ------
    UnknownSchemeError
        If there is none of a name.
    """
    known = {one.name: one for one in CONTESTANTS}
    for name in names:
        if name not in known:
            raise UnknownSchemeError(unknown("scheme", name, map(repr, known)))
    return [one for one in CONTESTANTS if not names or one.name in names]


def rerun(context: Context, kind: Kind, number: int) -> None:
    """Run one trial again, print a line for every contestant, and draw its error over time.

    Parameters
    ----------
    context : Context
        Settings.
    kind : Kind
        Of the worlds.
    number : int
        Of the trial, from 1.

    Raises
    ------
    UnknownSchemeError
        If there is no scheme of a wanted name.
    """
    contestants = contestants_called(context.schemes)
    world = draw_world(kind, number)
    print(f"   trial {number}: {world.words()}", flush=True)
    jobs = [Job(world, one, context.rendered, record=True) for one in contestants]
    results = {
        one.name: outcome
        for one, outcome in zip(contestants, context.map(run_job, jobs, kind.name), strict=True)
    }
    for name, outcome in results.items():
        print(f"   {name}: {_line(outcome)}", flush=True)
    path = context.folder(kind.name) / f"trial_{number}.png"
    robustness_figures.one_trial(path, world, results)
    print(f"picture: {path}", flush=True)


def _line(outcome: Outcome) -> str:
    error = f"{1e3 * outcome.final_rms_m:.1f} mm rms in the last second"
    if not outcome.failure:
        return f"settled after {outcome.settled_s:.2f} s, {error}"
    return f"failed ({outcome.failure}), {error}; the controller said: {outcome.said}"


def _kept(outcome: Outcome) -> dict[str, Any]:
    return {
        "settled_s": outcome.settled_s,
        "failure": outcome.failure,
        "said": outcome.said,
        "final_rms_m": outcome.final_rms_m,
        "jitter_rad_s": outcome.jitter_rad_s,
        "path_ratio": outcome.path_ratio,
        "jacobian_error": outcome.jacobian_error,
    }


def _setup(kind: Kind, count: int, rendered: bool, contestants: Sequence[Contestant]) -> list[str]:
    def span(name: str, factor: float = 1.0) -> str:
        low, high = kind.ranges[name]
        return f"{factor * low:g}" if low == high else f"{factor * low:g} to {factor * high:g}"

    heavy = (
        f" In {100 * kind.heavy_share:.0f} % of them the noise is alpha-stable: most errors are as "
        "small as white noise's, and some are centimetres; in the others it is white, exponent 2."
    )
    bumped = (
        f" In {100 * kind.bumped_share:.0f} % the camera is hit {span('bump_time_s')} s "
        f"after the target was given: it turns by {span('bump_turn_deg')}° and moves by "
        f"{span('bump_shift_m', 1e3)} mm, and the target is given anew in the new view."
    )
    drawn = ", ".join(
        f"{one.label} {span(one.name, one.scale)}{one.unit}"
        for one in QUANTITIES
        if kind.heavy_share or one.name != "noise_exponent"
    )
    camera = (
        "rendered images"
        if rendered
        else "an exact camera, with the noise and errors above; it sees through the arm"
    )
    told = (
        " The oracle is told the true Jacobian, at once after a bump too: what it cannot do is not "
        "the estimator's fault."
    )
    return [
        f"{count} worlds, each a pure function of its number. Start and target are "
        f"{DISTANCE_M[0]:g} to {DISTANCE_M[1]:g} m apart. Evenly drawn are: how far the camera has "
        "been carried round the scene since the networks were trained "
        f"({span('camera_turn_deg')}°, in any direction), "
        f"{drawn}."
        f"{heavy if kind.heavy_share else ''}{bumped if kind.bumped_share else ''} The ball "
        "can be seen at start and target, before and after.",
        f"Who ran: {'; '.join(one.name for one in contestants)}. All meet the same worlds, noise "
        "included, with the defaults of the "
        f"nodes; nothing is tuned here. Ball positions come from {camera}. The target is given as "
        "this camera sees it: a target in metres would be missed by the camera's error. A trial "
        f"lasts {DURATION_S:g} s. It is a success if the true ball stays within 5 mm of the target "
        f"for at least the last {REST_S:g} s; a run that does not counts as infinitely slow. Times "
        "count from the target on, a bump included. "
        "Intervals of shares are Wilson's, 95 %."
        f"{told if any(one.knows_truth for one in contestants) else ''}",
        f"Any trial can be seen alone: fvs_experiments {kind.name} --trial NUMBER, and --scheme "
        "NAME for one scheme of it. It prints the world and what came of it, and draws the error "
        "over time.",
    ]


def _table(results: Mapping[str, Sequence[Outcome]]) -> Table:
    rows = []
    for name, ones in results.items():
        good = [one for one in ones if not one.failure]
        rows.append(
            [
                name,
                rate_text(success_rate(ones)),
                _seconds(settled_by(ones, 0.5)),
                _seconds(settled_by(ones, 0.9)),
                _middle([1e3 * one.final_rms_m for one in ones]),
                _middle([1e3 * one.jitter_rad_s for one in good]),
                _middle([one.path_ratio for one in good]),
            ]
        )
    return Table(
        f"{len(next(iter(results.values())))} worlds, the same for all; medians. Jitter and "
        "path are of the runs that settled, as an arm that is held neither shakes nor moves.",
        [
            "scheme",
            "settled",
            "half by, s",
            "90 % by, s",
            "final rms, mm",
            "jitter, mrad/s",
            "path / distance",
        ],
        rows,
    )


def _failures_table(results: Mapping[str, Sequence[Outcome]]) -> Table:
    rows = []
    for name, ones in results.items():
        trials = defaultdict(list)
        for number, one in enumerate(ones, start=1):
            if one.failure:
                trials[one.failure].append(str(number))
        for cause, numbers in sorted(trials.items(), key=lambda item: -len(item[1])):
            more = ", ..." if len(numbers) > _NAMED else ""
            rows.append([name, cause, str(len(numbers)), ", ".join(numbers[:_NAMED]) + more])
    return Table(
        "Failures by cause, with the numbers of trials to look at (--trial); all of them, and what "
        "the controller said, are in results.json.",
        ["scheme", "cause", "runs", "trials"],
        rows or [["all", "none", "0", "every run settled"]],
    )


def _seconds(seconds: float) -> str:
    return f"{seconds:.2f}" if np.isfinite(seconds) else "never"


def _middle(values: Sequence[float]) -> str:
    return f"{np.median(values):.2f}" if values else "-"
