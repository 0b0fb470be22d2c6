"""Hundreds of random worlds: the usual kind, and one in which everything goes wrong at once."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab.outcome import NOT_STAYED
from fvs_lab.search import ORACLE, ORACLES
from fvs_lab.trials import Trial, Variant
from fvs_lab.worlds import DISTANCE_M, KINDS, Kind, World, draw_world
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


def contestants_called(names: Sequence[str]) -> list[Scheme]:
    """The contestants of these names, or all without any; a ``ValueError`` lists those known."""
    known = {one.name: one for one in COMPARED}
    for name in names:
        if name not in known:
            raise ValueError(unknown("scheme", name, map(repr, known)))
    return [one for one in COMPARED if not names or one.name in names]


def trial_in(world: World, scheme: Scheme, record: bool = False) -> Trial:
    """A scheme's trial in a world."""
    variant = Variant.of(scheme).labelled(world=world.number)
    return variant.trial(
        world.case, world.conditions, duration_s=DURATION_S, record=record, bump=world.bump
    )


def judged(row: Mapping[str, Any]) -> dict[str, Any]:
    """Columns that also count as failure a ball that settled only within the last second."""
    if row["failure"] or row["to_5mm_s"] <= DURATION_S - FINAL_S:
        return {}
    return {"failure": NOT_STAYED, "settled": False, "to_5mm_s": math.inf, "to_2mm_s": math.inf}


def measure(kind: Kind, context: lab.Context) -> lab.Found:
    """Draw worlds of a kind, and run every scheme in all of them."""
    contestants = contestants_called(context.schemes or (_QUICK if context.quick else ()))
    count = context.count(500)
    worlds = context.map(partial(draw_world, kind), range(1, count + 1), "worlds")
    trials = [trial_in(world, one) for world in worlds for one in contestants]
    runs = context.run(trials, kind.name).adding(judged)
    facts = {"kind": kind, "count": count, "distance_m": DISTANCE_M}
    data = {"seed": kind.seed, "ranges": kind.ranges, "worlds": worlds, "duration_s": DURATION_S}
    return lab.Found(runs, facts, data)


def rerun(context: lab.Context, kind: Kind, number: int) -> None:
    """Run one trial again, print a line for every contestant, and draw its error over time."""
    contestants = contestants_called(context.schemes)
    world = draw_world(kind, number)
    print(f"   trial {number}: {world.text()}", flush=True)
    trials = [trial_in(world, one, record=True) for one in contestants]
    figure, ((axis,),) = draw.grid(1, 1, (9.0, 5.0))
    runs, looks = context.run(trials, kind.name).adding(judged), {}
    for row in runs:
        name, failure, said = row["scheme"], row["failure"], row["said"]
        text = f"failed ({failure})" if failure else f"settled after {row['to_5mm_s']:.2f} s"
        print(f"   {name}: {text}, {1e3 * row['final_rms_m']:.1f} mm rms in the last second"
              f"{said and f'; status: {said}'}", flush=True)  # fmt: skip
        looks[name] = {"color": draw.colour_of(name), "label": f"{name}: {text}"}
    draw.errors_over_time(axis, runs, "scheme", looks)
    if world.bump is not None:
        draw.bound_line(axis, world.bump.time_s, upright=True)
    axis.set(xlabel="time since the target was given, s", ylabel="error, mm",
             title=f"Trial {number}")  # fmt: skip
    axis.legend()
    path = context.folder(kind.name) / f"trial_{number}.png"
    draw.save(figure, path)
    print(f"picture: {path}", flush=True)


def claims(found: lab.Found) -> Iterator[lab.Claim]:
    """Judge the schemes worth using."""
    for name, runs in found.runs.groups("scheme").items():
        if name in ("proposed", *BEYOND):
            part = lab.share_above("trials that settle", runs.share(), WANTED)
            yield lab.ours("enough", part, scheme=name)


TABLES = (
    lab.TableOf(
        "schemes",
        ("scheme",),
        (
            "settled:of",
            "to_5mm_s:half",
            "to_5mm_s:90 %",
            "final_rms_m:half",
            "failure:causes",
        ),
    ),
)


EXPERIMENTS = {
    name: lab.Experiment(
        name,
        partial(measure, kind),
        claims,
        TABLES,
        lambda _: (),
        globals(),
        model=kind_of(kind.feature).model,
        template="robustness",
    )
    for name, kind in KINDS.items()
}
