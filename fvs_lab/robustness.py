"""Hundreds of random worlds, to see which scheme settles whatever goes wrong."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from fvs_lab.context import Context
from fvs_lab.experiment import OURS, Claim, Experiment, Found, Named, share_above
from fvs_lab.figures import bound_line, colours_of, error_curve, keys, panels, ranges
from fvs_lab.outcome import BOUNDS_M, NOT_STAYED, REST_S, Outcome
from fvs_lab.results import METRICS, Results, number_text
from fvs_lab.statistics import Interval, wilson
from fvs_lab.style import save
from fvs_lab.trials import Trial, Variant, run_trial
from fvs_lab.worlds import DISTANCE_M, HARSH, QUANTITIES, Kind, World, draw_world
from fvs_ros.arguments import unknown
from fvs_tools.schemes import BEYOND, SCHEMES, Scheme

#: Length of a trial from the target on, s; of this the last second must be within 5 mm.
DURATION_S = 6.0
#: Share of the trials that a robust scheme must master.
WANTED = 0.99
#: Trials named in the table of failures, for each cause.
_NAMED = 8

_ORACLE = Scheme("oracle, proportional", "oracle", "proportional", "")
#: Who competes, with the defaults of the nodes. A new one is a line.
CONTESTANTS = (*SCHEMES.values(), _ORACLE, *BEYOND.values())
_QUICK = ("proposed", _ORACLE.name)


class UnknownSchemeError(ValueError):
    """A scheme that does not exist; the text lists those known."""


def contestants_called(names: Sequence[str]) -> list[Scheme]:
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


def trial_in(world: World, scheme: Scheme, rendered: bool, record: bool = False) -> Trial:
    """A scheme's trial in a world, with rendered images or exact positions."""
    conditions = replace(world.conditions, rendered=rendered)
    return Variant.of(scheme).trial(
        world.case, conditions, duration_s=DURATION_S, record=record, bump=world.bump
    )


def judged(outcome: Outcome) -> Outcome:
    """Call it a failure, too, if the ball came to stay only within the last second."""
    if outcome.failure or outcome.settled_s <= DURATION_S - REST_S:
        return outcome
    return replace(
        outcome, failure=NOT_STAYED, settling_s={name: None for name in outcome.settling_s}
    )


def experiment_in(kind: Kind) -> Experiment:
    """The experiment in worlds of a kind."""
    return Experiment(
        kind.name, partial(measure, kind), claims, tables, figures, template="robustness"
    )


def measure(kind: Kind, context: Context) -> Found:
    """Draw worlds of a kind, and run every scheme in all of them."""
    contestants = contestants_called(context.schemes or (_QUICK if context.quick else ()))
    count = context.trials or context.count(500, 4)
    worlds = context.map(partial(draw_world, kind), range(1, count + 1), "worlds")
    pairs = [(world, one) for world in worlds for one in contestants]
    trials = [trial_in(world, one, context.rendered) for world, one in pairs]
    outcomes = context.map(run_trial, trials, kind.name)
    runs = Results(
        judged(outcome).row(scheme=one.name, **world.row())
        for (world, one), outcome in zip(pairs, outcomes, strict=True)
    )
    facts = {
        "kind": kind,
        "count": count,
        "rendered": context.rendered,
        "contestants": [one.name for one in contestants],
        "distance_m": DISTANCE_M,
        "duration_s": DURATION_S,
        "rest_s": REST_S,
        "wanted": WANTED,
    }
    data = {"seed": kind.seed, "ranges": kind.ranges, "worlds": worlds, "duration_s": DURATION_S}
    return Found(runs, facts, data)


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
    print(f"   trial {number}: {world.text()}", flush=True)
    trials = [trial_in(world, one, context.rendered, record=True) for one in contestants]
    figure, ((axis,),) = panels(1, 1, (9.0, 5.0))
    names = [one.name for one in contestants]
    outcomes = map(judged, context.map(run_trial, trials, kind.name))
    for outcome, (name, colour) in zip(outcomes, colours_of(names).items(), strict=True):
        text = (
            f"failed ({outcome.failure})"
            if outcome.failure
            else (f"settled after {outcome.settled_s:.2f} s")
        )
        print(f"   {name}: {text}, {1e3 * outcome.final_rms_m:.1f} mm rms in the last second"
              f"{outcome.said and f'; status: {outcome.said}'}", flush=True)  # fmt: skip
        error_curve(axis, outcome.series, color=colour, label=f"{name}: {text}")
    bound_line(axis, 1e3 * BOUNDS_M["5 mm"])
    if world.bump is not None:
        bound_line(axis, world.bump.time_s, upright=True)
    axis.set(xlabel="time since the target was given, s", ylabel="error, mm",
             title=f"Trial {number}")  # fmt: skip
    axis.legend()
    path = context.folder(kind.name) / f"trial_{number}.png"
    save(figure, path)
    print(f"picture: {path}", flush=True)


# ---- claims ---------------------------------------------------------------------------------


def settled_by(runs: Results, share: float) -> float:
    """Time by which this share of the runs had settled, s; infinite if fewer ever do."""
    times = np.sort(runs.values("to_5mm_s"))
    return float(times[math.ceil(share * times.size) - 1])


def wins(ones: Results, others: Results) -> Interval | None:
    """Of the worlds in which just one of two settles, the share that the first one does.

    Returns
    -------
    Interval or None
        None where there is no such world.
    """
    pairs = zip(ones.values("settled"), others.values("settled"), strict=True)
    won = [one for one, other in pairs if one != other]
    return wilson(sum(won), len(won)) if won else None


def best_of(runs: Results) -> str:
    """The competitor that settles in most worlds; of equals, the one with the shorter median."""
    groups = {name: ones for name, ones in runs.groups("scheme").items() if name != _ORACLE.name}
    return min(
        groups, key=lambda name: (-groups[name].share().value, settled_by(groups[name], 0.5))
    )


def claims(found: Found) -> Iterator[Claim]:
    """Judge every scheme, and the lead of the best one over the paper's."""
    schemes = found.runs.groups("scheme")
    for name in sorted(schemes, key=lambda name: name == _ORACLE.name):
        part = share_above("trials that settle", schemes[name].share(), WANTED)
        yield Claim("enough", OURS, [part], given={"scheme": name})
    if set(schemes) == {_ORACLE.name}:
        return
    best = best_of(found.runs)
    parts = []
    for name in SCHEMES:
        if name in schemes and name != best:
            share = wins(schemes[best], schemes[name])
            label = f"of the worlds that only one of it and {name} masters"
            # Without such a world nothing tells the two apart.
            parts.append(share_above(label, share or Interval(0.5, 0.0, 1.0, 0), 0.5))
    yield Claim("lead", OURS, parts, given={"scheme": best})


# ---- tables and figures ---------------------------------------------------------------------


def _share_text(runs: Results) -> str:
    share = runs.share()
    return f"{100 * share.value:.1f} % ({100 * share.low:.1f} to {100 * share.high:.1f})"


def _plain(runs: Results, metric: str) -> str:
    one = METRICS[metric]
    values = runs.values(metric)
    return number_text(one.factor * float(np.median(values)), 2) if values else "-"


def tables(found: Found) -> Iterator[Named]:
    """Success and medians, and failures by cause."""
    rows, failed = [], []
    for name, runs in found.runs.groups("scheme").items():
        good = runs.where(settled=True)
        rows.append(
            {
                "scheme": name,
                "settled": _share_text(runs),
                "half by, s": number_text(settled_by(runs, 0.5), 2),
                "90 % by, s": number_text(settled_by(runs, 0.9), 2),
                "final error, mm rms": _plain(runs, "final_rms_m"),
                "jitter, mrad/s": _plain(good, "jitter_rad_s"),
                "path / distance": _plain(good, "path_ratio"),
            }
        )
        causes = runs.where(settled=False).groups("failure")
        for cause, ones in sorted(causes.items(), key=lambda one: -len(one[1])):
            trials = [str(number) for number in ones.values("world")]
            more = ", ..." if len(trials) > _NAMED else ""
            failed.append(
                {
                    "scheme": name,
                    "cause": cause,
                    "runs": str(len(trials)),
                    "trials": ", ".join(trials[:_NAMED]) + more,
                }
            )
    none = {"scheme": "all", "cause": "none", "runs": "0", "trials": "every run settled"}
    yield "schemes", rows
    yield "failures", failed or [none]


#: A point and the ends of its bar.
_Bar = tuple[float, float, float]


def _success(runs: Results) -> _Bar:
    share = runs.share()
    return 100 * share.value, 100 * share.low, 100 * share.high


def _settling(runs: Results) -> _Bar:
    half, most = (min(settled_by(runs, share), DURATION_S) for share in (0.5, 0.9))
    return half, half, most


def _jitter(runs: Results) -> _Bar:
    found = runs.where(settled=True).values("jitter_rad_s") or [np.nan]
    low, half, high = 1e3 * np.percentile(found, (10, 50, 90), method="nearest")
    return half, low, high


def figures(found: Found) -> Iterator[Named]:
    """Success, settling time and jitter against each quantity that differs."""
    yield "success", _against(found.runs, _success, "settled, %")
    yield "settling", _against(found.runs, _settling, METRICS["to_5mm_s"].label)
    yield "jitter", _against(found.runs, _jitter, METRICS["jitter_rad_s"].label)


def _against(runs: Results, bar: Callable[[Results], _Bar], label: str):
    """Draw a panel per quantity: a bar for each bin and scheme."""
    varied = [one for one in QUANTITIES if len(set(runs.values(one.name))) > 1] or QUANTITIES[:1]
    columns = min(len(varied), 4)
    rows = math.ceil(len(varied) / columns)
    figure, axes = panels(rows, columns, (3.25 * columns, 3.3 * rows), sharey=True)
    for axis in axes.flat[len(varied) :]:
        axis.set_visible(False)
    schemes = runs.groups("scheme")
    colours = colours_of(list(schemes))
    for axis, quantity in zip(axes.flat, varied, strict=False):
        counts = dict.fromkeys(range(len(quantity.bins)), 0)
        for number, (name, ones) in enumerate(schemes.items()):
            bins = Results(
                {**row, "bin": quantity.bin_of(row[quantity.name])} for row in ones
            ).groups("bin")
            counts |= {place: len(some) for place, some in bins.items()}
            shift = min(0.12, 0.8 / len(schemes)) * (number - 0.5 * (len(schemes) - 1))
            places = sorted(bins)
            bars = [bar(bins[place]) for place in places]
            ranges(axis, [place + shift for place in places], bars, color=colours[name])
        names = [f"{name}\n({counts[place]})" for place, name in enumerate(quantity.bins)]
        axis.set_xticks(range(len(names)), names)
        axis.set_xlabel(quantity.axis)
        axis.grid(visible=False, axis="x")
    for axis in axes[:, 0]:
        axis.set_ylabel(label)
    looks = {name: {"color": colour, "marker": "o"} for name, colour in colours.items()}
    keys(figure, looks, 2 * columns)
    return figure


EXPERIMENT = experiment_in(HARSH)
