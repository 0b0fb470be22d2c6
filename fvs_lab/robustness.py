"""Hundreds of random worlds: the usual kind, and one in which everything goes wrong at once."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab.outcome import NOT_STAYED, Outcome
from fvs_lab.results import Interval, Results, number_text, wilson
from fvs_lab.search import ORACLE, ORACLES
from fvs_lab.trials import Trial, Variant
from fvs_lab.worlds import DISTANCE_M, KINDS, QUANTITIES, Kind, Quantity, World, draw_world
from fvs_ros.arguments import unknown
from fvs_ros.kinds import kind_of
from fvs_tools.schemes import BEYOND, SCHEMES, Scheme
from fvs_tools.score import FINAL_S

#: Length of a trial after the target is given, s; the last second must be within 5 mm.
DURATION_S = 6.0
#: Share of the trials in which a robust scheme must settle.
WANTED = 0.99

#: The contestants, with the defaults of the nodes. A new one is one line.
COMPARED = (*SCHEMES.values(), ORACLES[ORACLE], *BEYOND.values())
_QUICK = ("proposed", ORACLE)
#: Those whose settling and jitter are shown by cause.
_BY_CAUSE = ("proposed", "best")


def contestants_called(names: Sequence[str]) -> list[Scheme]:
    """The contestants of these names, or all without any; a ``ValueError`` lists those known."""
    known = {one.name: one for one in COMPARED}
    for name in names:
        if name not in known:
            raise ValueError(unknown("scheme", name, map(repr, known)))
    return [one for one in COMPARED if not names or one.name in names]


def trial_in(world: World, scheme: Scheme, rendered: bool, record: bool = False) -> Trial:
    """A scheme's trial in a world, with rendered images or exact positions."""
    conditions = replace(world.conditions, rendered=rendered)
    return Variant.of(scheme).trial(
        world.case, conditions, duration_s=DURATION_S, record=record, bump=world.bump
    )


def judged(outcome: Outcome) -> Outcome:
    """Also count as failure a ball that settled only within the last second."""
    if outcome.failure or outcome.settled_s <= DURATION_S - FINAL_S:
        return outcome
    return replace(
        outcome, failure=NOT_STAYED, settling_s={name: None for name in outcome.settling_s}
    )


def measure(kind: Kind, context: lab.Context) -> lab.Found:
    """Draw worlds of a kind, and run every scheme in all of them."""
    contestants = contestants_called(context.schemes or (_QUICK if context.quick else ()))
    count = context.count(500, 4)
    worlds = context.map(partial(draw_world, kind), range(1, count + 1), "worlds")
    pairs = [(world, one) for world in worlds for one in contestants]
    trials = [trial_in(world, one, context.rendered) for world, one in pairs]
    outcomes = context.outcomes(trials, kind.name)
    runs = Results(
        judged(outcome).row(scheme=one.name, **world.row())
        for (world, one), outcome in zip(pairs, outcomes, strict=True)
    )
    facts = {
        "kind": kind,
        "count": count,
        "rendered": context.rendered,
        "distance_m": DISTANCE_M,
        "contestants": [one.name for one in contestants],
    }
    data = {"seed": kind.seed, "ranges": kind.ranges, "worlds": worlds, "duration_s": DURATION_S}
    return lab.Found(runs, facts, data)


def rerun(context: lab.Context, kind: Kind, number: int) -> None:
    """Run one trial again, print a line for every contestant, and draw its error over time."""
    contestants = contestants_called(context.schemes)
    world = draw_world(kind, number)
    print(f"   trial {number}: {world.text()}", flush=True)
    trials = [trial_in(world, one, context.rendered, record=True) for one in contestants]
    figure, ((axis,),) = draw.grid(1, 1, (9.0, 5.0))
    outcomes = map(judged, context.outcomes(trials, kind.name))
    rows, looks = [], {}
    for outcome, one in zip(outcomes, contestants, strict=True):
        name = one.name
        text = f"settled after {outcome.settled_s:.2f} s"
        text = f"failed ({outcome.failure})" if outcome.failure else text
        print(f"   {name}: {text}, {1e3 * outcome.final_rms_m:.1f} mm rms in the last second"
              f"{outcome.said and f'; status: {outcome.said}'}", flush=True)  # fmt: skip
        rows.append(outcome.row(scheme=name))
        looks[name] = {"color": draw.colour_of(name), "label": f"{name}: {text}"}
    draw.errors_over_time(axis, Results(rows), "scheme", looks)
    if world.bump is not None:
        draw.bound_line(axis, world.bump.time_s, upright=True)
    axis.set(xlabel="time since the target was given, s", ylabel="error, mm",
             title=f"Trial {number}")  # fmt: skip
    axis.legend()
    path = context.folder(kind.name) / f"trial_{number}.png"
    draw.save(figure, path)
    print(f"picture: {path}", flush=True)


# ---- claims ---------------------------------------------------------------------------------


def wins(ones: Results, others: Results) -> Interval:
    """Share of the first one's wins among the worlds in which exactly one of two settles.

    Without such a world the two cannot be compared.
    """
    pairs = zip(ones.values("settled"), others.values("settled"), strict=True)
    won = [one for one, other in pairs if one != other]
    return wilson(sum(won), len(won)) if won else Interval(0.5, 0.0, 1.0, 0)


def best_of(runs: Results) -> str:
    """The competitor that settles in most worlds; of equals, the one with the shorter median."""
    groups = {name: ones for name, ones in runs.groups("scheme").items() if name != ORACLE}
    return min(
        groups,
        key=lambda name: (
            -groups[name].share().value,
            np.quantile(groups[name].values("to_5mm_s"), 0.5, method="lower"),
        ),
    )


def claims(found: lab.Found) -> Iterator[lab.Claim]:
    """Judge every scheme, and the lead of the best one over the paper's."""
    schemes = found.runs.groups("scheme")
    for name in sorted(schemes, key=lambda name: name == ORACLE):
        part = lab.share_above("trials that settle", schemes[name].share(), WANTED)
        yield lab.ours("enough", part, scheme=name)
    if set(schemes) == {ORACLE}:
        return
    best = best_of(found.runs)
    parts = [
        lab.share_above(
            f"of the worlds in which only one of it and {name} settles",
            wins(schemes[best], schemes[name]),
            0.5,
        )
        for name in SCHEMES
        if name in schemes and name != best
    ]
    yield lab.ours("lead", *parts, scheme=best)


# ---- tables and figures ---------------------------------------------------------------------


def _varied(runs: Results) -> list[tuple[Quantity, np.ndarray, np.ndarray]]:
    """Quantities that differ from run to run: the edges of their thirds, and each run's, 0 to 2."""
    found = []
    for one in QUANTITIES if runs else ():
        values = one.scale * np.array(runs.values(one.name))
        edges = np.linspace(values.min(), values.max(), 4)
        if edges[0] < edges[-1]:
            found.append((one, edges, np.clip(np.searchsorted(edges, values) - 1, 0, 2)))
    return found


def by_cause(runs: Results) -> Results:
    """The runs of two schemes in the lowest and in the highest third of each quantity."""
    runs = runs.those(lambda row: row["scheme"] in _BY_CAUSE)
    rows = []
    for one, edges, thirds in _varied(runs):
        for third in (0, 2):
            low, high = (number_text(edge, 2) for edge in edges[third : third + 2])
            cause = f"{one.label} {low} to {high}{one.unit}"
            rows += [
                {**row, "cause": cause}
                for row, its in zip(runs, thirds, strict=True)
                if its == third
            ]
    return Results(rows)


TABLES = (
    lab.TableOf(
        "schemes",
        ("scheme",),
        ("settled:share", "to_5mm_s:half", "to_5mm_s:90 %", "final_rms_m", "failure:causes"),
    ),
    lab.TableOf("settled", ("scheme",), ("jitter_rad_s", "path_ratio"), {"settled": True}),
    lab.TableOf(
        "causes",
        ("cause", "scheme"),
        ("settled:share", "to_5mm_s:half", "to_5mm_s:90 %", "jitter_rad_s"),
        rows=by_cause,
    ),
    lab.TableOf(
        "failures", ("scheme", "failure"), ("world:count", "world:list"), {"settled": False}
    ),
)


def figures(found: lab.Found) -> Iterator[lab.Drawn]:
    """A panel per quantity: success in each third of its range, for each scheme."""
    runs = found.runs
    varied = _varied(runs)
    if not varied:
        return
    columns = min(len(varied), 4)
    rows = math.ceil(len(varied) / columns)
    figure, axes = draw.grid(rows, columns, (3.25 * columns, 3.3 * rows), sharey=True)
    for axis in axes.flat[len(varied) :]:
        axis.set_visible(False)
    names = list(runs.groups("scheme"))
    for axis, (one, edges, thirds) in zip(axes.flat, varied, strict=False):
        places = 0.5 * (edges[1:] + edges[:-1])[thirds]
        binned = Results({**row, "at": float(at)} for row, at in zip(runs, places, strict=True))
        apart = (edges[1] - edges[0]) * min(0.12, 0.8 / len(names))
        for number, name in enumerate(names):
            shift = apart * (number - 0.5 * (len(names) - 1))
            bins = dict(sorted(binned.where(scheme=name).groups("at").items()))
            draw.shares(axis, bins, shift, color=draw.colour_of(name), label=name)
        axis.set_xlabel(", ".join(filter(None, [one.label, one.unit.strip()])))
    for axis in axes[:, 0]:
        axis.set_ylabel("settled, %")
    draw.legend(figure, 2 * columns)
    yield "success", figure, {}


EXPERIMENTS = {
    name: lab.Experiment(
        name,
        partial(measure, kind),
        claims,
        TABLES,
        figures,
        globals(),
        model=kind_of(kind.feature).model,
        template="robustness",
    )
    for name, kind in KINDS.items()
}
