"""Effect of the additions to the paper: a minute of data, least time, moved cameras."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from fvs_lab import beyond_runs as moved
from fvs_lab import contestants as who
from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab.floor import SPARE_M, Floor, Limits, floor_of
from fvs_lab.outcome import BOUNDS_M
from fvs_lab.results import DECISIVE, Results, median, wilson
from fvs_lab.search import REGIMES, SEEDS, Search, Tuned, search_all
from fvs_lab.spot_check import claims as spot_check_claims
from fvs_lab.spot_check import spot_checks
from fvs_lab.trials import Case, Conditions, make_cases
from fvs_tools.schemes import SCHEMES

_NAME = "beyond"
#: Races and other worlds use exact ball positions with the camera's noise, without rendering.
_EXACT = {"rendered": False}
#: Searched gains are for speed alone, within the limits that all have.
_REGIME = REGIMES[0]
#: Contestants that are judged by moved cameras, the first ones.
_JUDGED = 2
_LIMITS = Limits(who.SPEED_RAD_S, who.ACCELERATION_RAD_S2)
#: Worlds of the spot check, by the label after the scheme's name.
CHECKED = {
    "": Conditions(),
    ", 200 ms of latency": Conditions(latency_s=0.2),
    ", camera turned by 45°": Conditions(camera_turn_deg=(0.0, 0.0, 45.0)),
}


def measure(context: lab.Context) -> lab.Found:
    """Measure all parts; each row names its ``part``."""
    count = context.count(60, 1)
    if not context.quick:  # 140 minutes on one core of a desktop computer
        print(f"   about {140 * count / 60 / context.jobs:.0f} minutes", flush=True)
    cases = make_cases("B", count, 410)
    found = _searched(context)
    minutes = _minutes(context, count)
    floors = context.map(partial(floor_of, limits=_LIMITS), cases, "the floor")
    races = _over_floors(_races(context, found, cases), cases, floors)
    rendered = _rendered(context, cases[: max(1, 4 * count // 15)], races)
    camera = _journeys(context, count)
    followed = _pursuits(context, max(1, count // 20))
    runs = Results([*minutes, *races, *rendered, *camera, *_worlds(context, cases), *followed])
    # The nodes have a rendered camera, whatever the laboratory uses.
    checked = {
        name + words: who.variant(name).trial(cases[0], conditions)
        for words, conditions in CHECKED.items()
        for name in (who.BEST, who.EXTENDED)
    }
    data = {
        "conditions": context.conditions(),
        "contestants": who.CONTESTANTS,
        "cases": cases,
        "worlds_visited": who.WORLDS,
        "searches": {name: [one.summary() for one in ones] for name, ones in found.items()},
        "floors": floors,
        "spot_check": spot_checks(context, checked, cases[:4], _NAME),
    }
    return lab.Found(runs, _facts(context, runs, floors), data)


def _facts(context: lab.Context, runs: Results, floors: Sequence[Floor]) -> dict[str, Any]:
    later = runs.where(part="rendered").groups("scheme")
    later_ms = [1e3 * ones.median("later_s").value for ones in later.values()]
    return {
        "rendered": context.rendered,
        "moved": moved,
        "seeds": SEEDS,
        "spare_m": SPARE_M,
        "later_ms": (min(later_ms), max(later_ms)),
        "count": len(floors),
        "pictured": len(later[who.BEST]),
        "minutes": len(runs.where(part="minute", plant=moved.USUAL)),
        "floors": {
            bound: median([one.least_s[bound] for one in floors]).text() for bound in BOUNDS_M
        },
    }


# ---- runs -----------------------------------------------------------------------------------


def _minutes(context: lab.Context, count: int) -> list[dict[str, Any]]:
    """Recordings of the nominal plant, and fewer of each plant with an error."""
    duration_s = moved.MINUTE_S / 6 if context.quick else moved.MINUTE_S
    recordings = [
        (plant, 401 + number, duration_s, context.conditions(**changes))
        for plant, changes in moved.ERRING.items()
        for number in range(max(1, count // (3 if plant == moved.USUAL else 10)))
    ]
    places = moved.draw_places(400, 20 if context.quick else 200)
    return context.map(partial(moved.learn, places=places), recordings, "minutes of data")


def _searched(context: lab.Context) -> dict[str, list[Tuned]]:
    """The gains of all schemes with all additions, from several searches."""
    cases = make_cases("T", 1 if context.quick else 4, 402)
    searches = {name: Search.of(one, _REGIME) for name, one in who.TUNED.items()}
    searches |= {name: Search.of(one, who.CALM_REGIME) for name, one in who.CALM.items()}
    if context.quick:
        searches = {name: searches[name] for name in (who.SLIDING, who.OTHERS[0])}
    return search_all(context, searches, cases, seed=8)


def _races(
    context: lab.Context, found: Mapping[str, Sequence[Tuned]], cases: Sequence[Case]
) -> Results:
    exact = context.conditions(**_EXACT)
    racers: list[tuple[dict[str, Any], Any]] = [
        ({"scheme": name}, who.variant(name).trial) for name in who.RACERS
    ]
    for name, ones in found.items():
        for search, one in enumerate(ones):
            tuned = partial(one.trial, duration_s=_REGIME.duration_s)
            racers.append(({"scheme": name, "search": search}, tuned))
    turned = Search.of(who.CALM["rbf+pid, calm"], who.CALM_REGIME)
    for gain_1_s in () if context.quick else who.TURNED_1_S:
        calm = partial(turned.trial, {"proportional_gain_1_s": gain_1_s})
        racers.append(({"scheme": f"rbf+pid, {gain_1_s:g}/s"}, calm))
    runs = [
        ({"part": "race", **label, "case": case.name}, trial(case, conditions=exact))
        for label, trial in racers
        for case in cases
    ]
    return context.score(runs, "against the floor")


def _over_floors(races: Results, cases: Sequence[Case], floors: Sequence[Floor]) -> Results:
    """The races, the clairvoyant first, with settling times over the least times."""
    by_case = {case.name: floor for case, floor in zip(cases, floors, strict=True)}
    columns = {bound: bound.replace(" ", "") for bound in BOUNDS_M}
    played = [
        {
            "part": "race",
            "scheme": who.CLAIRVOYANT,
            "case": name,
            "settled": bool(np.isfinite(floor.clairvoyant_s["5 mm"])),
            **{f"to_{column}_s": floor.clairvoyant_s[bound] for bound, column in columns.items()},
        }
        for name, floor in by_case.items()
    ]

    def over(row: Mapping[str, Any]) -> dict[str, float]:
        floor = by_case[row["case"]]
        found = {
            f"over_{column}": row[f"to_{column}_s"] / floor.least_s[bound]
            for bound, column in columns.items()
        }
        return found | {"over_clairvoyant": row["to_5mm_s"] / floor.clairvoyant_s["5 mm"]}

    return Results([*played, *races]).adding(over)


def _rendered(context: lab.Context, cases: Sequence[Case], races: Results) -> Results:
    """Runs with rendered images: delay against the race, and rest error over the noise."""
    raced = races.groups("scheme", "case")

    def compared(row: Mapping[str, Any]) -> dict[str, Any]:
        before_s = raced[row["scheme"], row["case"]].rows[0]["to_5mm_s"]
        # Two runs that never settle have no delay (inf - inf is NaN).
        later_s = 0.0 if row["to_5mm_s"] == before_s else row["to_5mm_s"] - before_s
        sigma = row["final_rms_m"] / who.SIGMA_M
        return {"part": "rendered", "later_s": later_s, "rms_sigma": sigma}

    return context.run(product(map(who.variant, who.SEEN), cases), "with images").adding(compared)


def _journeys(context: lab.Context, count: int) -> Results:
    """Enough journeys to decide against a share of 95 %; fewer for the other schemes."""
    parts = {who.SHAKEN[:_JUDGED]: 37 * count // 30, who.SHAKEN[_JUDGED:]: count // 6}
    if context.quick:
        parts = {who.SHAKEN[:_JUDGED]: 1}
    runs = [
        run for names, share in parts.items() for run in moved.journeys(max(1, share), 505, names)
    ]
    return moved.with_slowdown(_scored(context, runs, "moved cameras"))


def _worlds(context: lab.Context, cases: Sequence[Case]) -> Results:
    variants = [
        replace(
            who.variant(name),
            labels={"part": "world", "kind": world.kind, "label": world.label, "scheme": name},
            conditions={**_EXACT, **world.changes},
        )
        for world in who.WORLDS[: 1 if context.quick else None]
        for name in who.FOLLOWERS
    ]
    return context.run(product(variants, cases), "other worlds")


def _pursuits(context: lab.Context, count: int) -> Results:
    speeds_m_s = moved.SPEEDS_M_S[2:3] if context.quick else moved.SPEEDS_M_S
    runs = moved.pursuits(count, 405, speeds_m_s, who.FOLLOWERS)
    return _scored(context, runs, "moving targets").adding(moved.tracking_error)


def _scored(context: lab.Context, runs: Iterable[moved.Run], label: str) -> Results:
    """Run trials under the call's conditions."""
    conditions = context.conditions()
    return context.score([(name, replace(one, conditions=conditions)) for name, one in runs], label)


# ---- claims ---------------------------------------------------------------------------------

#: Requirements on a minute of data: claim, column, largest value, factor and unit.
_MINUTE = {
    "chain": (("chain_box", 0.005, 100, " %"), ("chain_workspace", 0.015, 100, " %")),
    "late": (("late_error_s", 0.003, 1e3, " ms"),),
    "fit": (("fit_s", 5.0, 1, " s"),),
    "distilled": (("distilled_box", 0.02, 100, " %"),),
}
#: The error stated by the fit may be wrong by this factor, either way.
HONEST = 2.0
#: Share of the cases that must settle in each of the other worlds, and of honest fits.
MOST = 0.9


def claims(found: lab.Found) -> Iterator[lab.Claim]:
    """All claims, in the order of the page; those without numbers in a quick run have no parts."""
    parts = found.runs.groups("part")
    races, worlds = parts["race"].groups("scheme"), parts["world"]
    for claim, columns in _MINUTE.items():
        usual = parts["minute"].where(plant=moved.USUAL)
        yield lab.ours(claim, *(_largest(usual, *column) for column in columns))
    honesty = parts["minute"].values("honesty")
    honest = sum(1.0 / HONEST <= ratio <= HONEST for ratio in honesty)
    label = f"recordings within a factor of {HONEST:g}"
    yield lab.ours("honest", lab.share_above(label, wilson(honest, len(honesty)), MOST))
    over = races[who.BEST].median("over_5mm")
    yield lab.ours("best", lab.below("settling to 5 mm over the floor", over, 1.15))
    yield lab.ours("extended", *(_faster(races, who.EXTENDED, name) for name in SCHEMES))
    for sliding, terms in (
        (who.SLIDING, "for speed alone"),
        (who.SLIDING_CALM, f"for at most {1e3 * who.CALM_RAD_S:g} mrad/s of jitter"),
    ):
        yield lab.papers("law", *_law(races, sliding), terms=terms)
    tuned = [(f"{name}, tuned", name) for name in SCHEMES]
    means = [_faster(races, one, name) for one, name in tuned if one in races]
    yield lab.ours("means", *means)
    for moment in moved.MOMENTS[1:]:
        for name in (who.BEST, who.EXTENDED):
            share = parts["camera"].where(moment=moment, scheme=name).share("kept")
            part = lab.share_above("cases that keep the pace", share, 0.95)
            yield lab.ours("camera", part, scheme=name, moment=moment)
    pictured = parts["rendered"].groups("scheme")
    rest = [
        lab.below(f"{name}: rms over σ", pictured[name].median("rms_sigma"), 0.4)
        for name in (who.EXTENDED, who.BEST)
    ]
    yield lab.ours("rest", *rest)
    yield from _world_claims(worlds)
    yield lab.ours("tracking", *_tracking(parts["tracking"]))
    yield from spot_check_claims(found.data["spot_check"])


def _largest(runs: Results, column: str, bound: float, factor: float, unit: str) -> lab.Part:
    """The largest value of all recordings must be small enough."""
    largest = max(runs.values(column))
    enough = True if len(runs) >= DECISIVE else None
    text = (
        f"at most {factor * largest:.2g}{unit} in {len(runs)} recordings, "
        f"asked: {factor * bound:g}{unit}"
    )
    label = column.removesuffix("_s").replace("_", " ")
    return lab.Part(label, text, enough if largest <= bound else False, largest / bound)


def _faster(races: Mapping[str, Results], one: str, other: str) -> lab.Part:
    ratio = races[one].over(races[other], "over_5mm")
    return lab.below(f"settling time of {one} over that of {other}", ratio, 1.0)


def _law(races: Mapping[str, Results], sliding: str) -> list[lab.Part]:
    """The sliding mode law among equals; none in a quick run that has too few of them."""
    how = sliding.rpartition(", ")[2]
    others = [name for name in who.OTHERS if name in races and name.endswith(how)]
    if sliding not in races or not others:
        return []
    best = min(others, key=lambda name: races[name].median("over_5mm").value)
    return [_faster(races, sliding, best)]


def _world_claims(worlds: Results) -> Iterator[lab.Claim]:
    visited = worlds.groups("scheme", "kind", "label")
    without, *latencies = (world.label for world in who.WORLDS if world.kind == "latency")
    for name in (who.EXTENDED, who.BEST):
        parts = [
            lab.below(
                f"settling time at {label} over that without",
                visited[name, "latency", label].over(visited[name, "latency", without], "to_5mm_s"),
                1.1,
            )
            for label in latencies
            if (name, "latency", label) in visited
        ]
        yield lab.ours("latency", *parts, scheme=name)
    shares = [
        lab.share_above(f"{scheme}, {kind} {label}: runs that settle", runs.share(), MOST)
        for (kind, label, scheme), runs in worlds.groups("kind", "label", "scheme").items()
    ]
    yield lab.ours("worlds", *shares)
    shaken = visited.get((who.BEST, "encoders", "0.2 mrad"))
    if shaken:
        usual = visited[who.BEST, who.USUAL.kind, who.USUAL.label]
        parts = [
            lab.below("jitter", shaken.median("jitter_rad_s"), 0.002, 1e3, " mrad/s"),
            lab.below("settling time over that without", shaken.over(usual, "to_5mm_s"), 1.05),
        ]
        yield lab.ours("encoders", *parts)


def _tracking(runs: Results) -> list[lab.Part]:
    found = []
    for name in who.FOLLOWERS:
        with_it, alone = (
            runs.where(scheme=name, speed_m_s=0.1, feed_forward=feed_forward)
            for feed_forward in (True, False)
        )
        found.append(
            lab.below(f"{name}: error over that alone", with_it.over(alone, "rms_m"), 1.0 / 3.0)
        )
    return found


# ---- tables and figures ---------------------------------------------------------------------

TABLES = (
    lab.TableOf(
        "minutes",
        ("part",),
        (
            "fit_s:range",
            "chain_box:range",
            "chain_workspace:range",
            "distilled_box:range",
            "late_error_s:range",
        ),
        {"part": "minute", "plant": moved.USUAL},
    ),
    lab.TableOf(
        "assessments",
        ("plant",),
        ("stated", "seen", "chain_box", "honesty:range"),
        {"part": "minute"},
    ),
    lab.TableOf(
        "races",
        ("scheme",),
        (
            "settled:of",
            "over_5mm",
            "over_clairvoyant",
            "over_2mm",
            "over_1mm",
            "jitter_rad_s",
            "peak_joint_speed_rad_s",
            "over_5mm:90 %",
            "over_5mm:all",
            "over_5mm:searches",
        ),
        {"part": "race"},
    ),
    lab.TableOf(
        "rendered",
        ("scheme",),
        ("to_5mm_s", "later_s", "later_s:range", "rms_sigma", "jitter_rad_s", "settled:of"),
        {"part": "rendered"},
    ),
    lab.TableOf(
        "camera", ("scheme", "moment"), ("to_5mm_s", "slowdown", "kept:of"), {"part": "camera"}
    ),
    lab.TableOf(
        "worlds",
        ("kind", "label", "scheme"),
        ("to_5mm_s", "final_rms_m", "jitter_rad_s", "settled:of"),
        {"part": "world"},
    ),
    lab.TableOf(
        "tracking",
        ("path", "speed_m_s", "feed_forward", "scheme"),
        ("rms_m",),
        {"part": "tracking"},
    ),
)


def figures(found: lab.Found) -> Iterator[lab.Drawn]:
    """Settling times over the floor, and jitter at rest."""
    runs = found.runs.where(part="race")
    figure, (axes,) = draw.grid(1, 3, (14.0, 6.0), sharey=True)
    for axis, column in zip(axes, ("over_5mm", "over_2mm"), strict=False):
        draw.dots_of(axis, runs, "scheme", column, 8.0, named=axis is axes[0])
        axis.axvline(1.0, color="black", linewidth=0.8)
        draw.plain_ticks(axis, (1, 1.5, 2, 3, 5, 8))
    draw.dots_of(axes[2], runs, "scheme", "jitter_rad_s", named=False)
    draw.plain_ticks(axes[2], (0.1, 0.2, 0.5, 1, 2, 5, 10))
    yield "races", figure, {}


EXPERIMENT = lab.Experiment(_NAME, measure, claims, TABLES, figures, globals())
