"""What the additions to the paper are worth: a minute of data, least time, moved cameras."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from fvs_estimator_node.distilling import train_structured
from fvs_estimator_node.model_file import save_model
from fvs_lab import beyond_runs
from fvs_lab import contestants as who
from fvs_lab import figures as draw
from fvs_lab.beyond_runs import (
    ERRING,
    KEPT,
    MINUTE_S,
    MOMENTS,
    PAPERS_METHOD,
    SPEEDS_M_S,
    Minute,
    Pursuit,
    assess,
    draw_journeys,
    draw_paths,
    draw_places,
    learn,
    record,
    run_journey,
    run_pursuit,
    with_slowdown,
)
from fvs_lab.experiment import (
    OURS,
    PAPER,
    Claim,
    Context,
    Drawn,
    Experiment,
    Found,
    Part,
    TableOf,
    below,
    share_above,
)
from fvs_lab.floor import SPARE_M, Floor, Limits, floor_of
from fvs_lab.outcome import BOUNDS_M
from fvs_lab.results import DECISIVE, METRICS, Results, label_of, median, wilson
from fvs_lab.search import REGIMES, SEEDS, Search, Tuned, search_all
from fvs_lab.spot_check import claims as spot_check_claims
from fvs_lab.spot_check import spot_checks
from fvs_lab.trials import Case, Conditions, make_cases, run_trial
from fvs_tools.schemes import SCHEMES

_NAME = "beyond"
_PLACES_SEED, _MINUTES_SEED, _TUNING_SEED, _SCORING_SEED = 400, 401, 402, 410
_JOURNEYS_SEED, _PATHS_SEED, _SEARCH_SEED = 505, 405, 8
#: Races and other worlds have no picture: a camera that knows the ball, with the same noise.
_EXACT = {"rendered": False}
#: Searched gains are for speed alone, within the limits that all have.
_REGIME = REGIMES[0]
#: All of it on one core of a desktop computer, minutes.
_ALL_MIN = 140.0
_LIMITS = Limits(who.SPEED_RAD_S, who.ACCELERATION_RAD_S2)
#: Targets of the spot check, and contestants that are judged by moved cameras, the first ones.
_TARGETS, _JUDGED = 4, 2
#: Worlds of the spot check by the words behind the scheme's name.
CHECKED = {
    "": Conditions(),
    ", 200 ms of latency": Conditions(latency_s=0.2),
    ", camera turned by 45°": Conditions(camera_turn_deg=(0.0, 0.0, 45.0)),
}


def measure(context: Context) -> Found:
    """Measure all parts; each row's ``part`` says of which one it is."""
    count = context.count(60, 1)
    if not context.quick:
        print(f"   about {_ALL_MIN * count / 60 / context.jobs:.0f} minutes", flush=True)
    cases = make_cases("B", count, _SCORING_SEED)
    found = _searched(context)
    minutes = context.map(learn, _minutes(context, max(1, count // 3)), "minutes of data")
    plants = [
        (plant, minute)
        for plant, changes in ERRING.items()
        for minute in _minutes(context, max(1, count // 10), **changes)
    ]
    assessments = context.map(assess, plants, "minutes of plants that err")
    floors = context.map(partial(floor_of, limits=_LIMITS), cases, "the floor")
    races = _over_floors(_races(context, found, cases), cases, floors)
    rendered = _rendered(context, cases[: max(1, 4 * count // 15)], races)
    camera = with_slowdown(_journeys(context, count))
    runs = Results(
        [*minutes, *assessments, *races, *rendered, *camera, *_worlds(context, cases),
         *_pursuits(context, max(1, count // 20))]
    )  # fmt: skip
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
        "spot_check": spot_checks(context, checked, cases[:_TARGETS], _NAME),
    }
    return Found(runs, _facts(context, runs, floors), data)


def _facts(context: Context, runs: Results, floors: Sequence[Floor]) -> dict[str, Any]:
    later = runs.where(part="rendered").groups("scheme")
    later_ms = {name: ones.median("later_s").value * 1e3 for name, ones in later.items()}
    own, fitted = (
        [value for name, value in later_ms.items() if name.endswith(who.MINUTES) is minutes]
        for minutes in (False, True)
    )
    return {
        "rendered": context.rendered,
        "moved": beyond_runs,
        "seeds": SEEDS,
        "spare_m": SPARE_M,
        "later_ms": (min(own), max(own)),
        "minutes_ms": (min(fitted), max(fitted)),
        "count": len(floors),
        "pictured": len(later[who.BEST]),
        "minutes": len(runs.where(part="minute")),
        "papers_method": _papers_method(context),
        "floors": {
            bound: median([one.least_s[bound] for one in floors]).text() for bound in BOUNDS_M
        },
    }


# ---- runs -----------------------------------------------------------------------------------


def _papers_method(context: Context) -> str:
    return "ridge" if context.quick else PAPERS_METHOD


def _minutes(context: Context, count: int, **changes: Any) -> list[Minute]:
    duration_s = MINUTE_S / 6 if context.quick else MINUTE_S
    places = draw_places(_PLACES_SEED, 20 if context.quick else 200)
    conditions = context.conditions(**changes)
    return [
        Minute(_MINUTES_SEED + number, duration_s, conditions, places, _papers_method(context))
        for number in range(count)
    ]


def _searched(context: Context) -> dict[str, list[Tuned]]:
    """The gains of all schemes with all additions, from several searches."""
    cases = make_cases("T", 1 if context.quick else 4, _TUNING_SEED)
    searches = {name: Search.of(one, _REGIME) for name, one in who.TUNED.items()}
    searches |= {name: Search.of(one, who.CALM_REGIME) for name, one in who.CALM.items()}
    if context.quick:
        searches = {name: searches[name] for name in (who.SLIDING, who.OTHERS[0])}
    return search_all(context, searches, cases, _SEARCH_SEED)


def _races(
    context: Context, found: Mapping[str, Sequence[Tuned]], cases: Sequence[Case]
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
    labels = [{**label, "case": case.name} for label, _ in racers for case in cases]
    trials = [trial(case, conditions=exact) for _, trial in racers for case in cases]
    outcomes = context.map(run_trial, trials, "against the floor")
    return Results(
        outcome.row(part="race", **label) for outcome, label in zip(outcomes, labels, strict=True)
    )


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
    rows = []
    for row in (*played, *races):
        floor = by_case[row["case"]]
        over = {
            f"over_{column}": row[f"to_{column}_s"] / floor.least_s[bound]
            for bound, column in columns.items()
        }
        late = row["to_5mm_s"] / floor.clairvoyant_s["5 mm"]
        rows.append({**row, **over, "over_clairvoyant": late})
    return Results(rows)


def _rendered(context: Context, cases: Sequence[Case], races: Results) -> Results:
    """With rendered images, and with a model fitted to a minute in place of the shipped one."""
    duration_s = MINUTE_S / 6 if context.quick else MINUTE_S
    minute = Minute(_MINUTES_SEED, duration_s, context.conditions(), draw_places(0, 0))
    path = context.folder(_NAME) / "minute.npz"
    save_model(path, train_structured(record(minute)[0], seed=minute.seed))
    variants = [who.variant(name) for name in who.SEEN]
    own = context.run(variants, cases, "with images")
    fitted = context.run(variants[:_JUDGED], cases, "with a minute's model", model=str(path))
    raced = races.groups("scheme", "case")
    rows = []
    for row, end in (*((row, "") for row in own), *((row, who.MINUTES) for row in fitted)):
        before_s = raced[row["scheme"], row["case"]].rows[0]["to_5mm_s"]
        # Two that never settle are alike.
        later_s = 0.0 if row["to_5mm_s"] == before_s else row["to_5mm_s"] - before_s
        labels = {"part": "rendered", "scheme": row["scheme"] + end, "later_s": later_s}
        rows.append({**row, **labels, "rms_sigma": row["final_rms_m"] / who.SIGMA_M})
    return Results(rows)


def _journeys(context: Context, count: int) -> Results:
    """Enough journeys to tell their share from 95 %; fewer for the schemes beside them."""
    parts = {who.SHAKEN[:_JUDGED]: 37 * count // 30, who.SHAKEN[_JUDGED:]: count // 6}
    if context.quick:
        parts = {who.SHAKEN[:_JUDGED]: 1}
    journeys = [
        journey
        for names, share in parts.items()
        for journey in draw_journeys(max(1, share), _JOURNEYS_SEED, names, context.conditions())
    ]
    return Results(context.map(run_journey, journeys, "moved cameras"))


def _worlds(context: Context, cases: Sequence[Case]) -> Results:
    variants = [
        replace(
            who.variant(name),
            labels={"part": "world", "kind": world.kind, "label": world.label, "scheme": name},
            conditions={**_EXACT, **world.changes},
        )
        for world in who.WORLDS[: 1 if context.quick else None]
        for name in who.FOLLOWERS
    ]
    return context.run(variants, cases, "other worlds")


def _pursuits(context: Context, count: int) -> Results:
    pursuits = [
        Pursuit(name, path, speed_m_s, feed_forward, context.conditions())
        for path in draw_paths(count, _PATHS_SEED)[: 1 if context.quick else None]
        for speed_m_s in (SPEEDS_M_S[2:3] if context.quick else SPEEDS_M_S)
        for feed_forward in (True, False)
        for name in who.FOLLOWERS
    ]
    return Results(context.map(run_pursuit, pursuits, "moving targets"))


# ---- claims ---------------------------------------------------------------------------------

#: What a minute of data must be good for: claim, column, its largest value, factor and unit.
_MINUTE = {
    "chain": (("chain_box", 0.005, 100, " %"), ("chain_workspace", 0.015, 100, " %")),
    "late": (("late_error_s", 0.003, 1e3, " ms"),),
    "fit": (("fit_s", 5.0, 1, " s"),),
    "distilled": (("distilled_box", 0.02, 100, " %"),),
}
#: What the fit says of its error may be larger or smaller by this factor.
HONEST = 2.0
#: Settling time over the physical floor.
OVER_FLOOR = 1.15
#: Share of the cases in which a camera that was moved must not cost the pace.
KEPT_SHARE = 0.95
#: True error at rest over the sensor's noise, and settling time over that without latency.
REST_SIGMA, SLOWED = 0.4, 1.1
#: Noise of a real robot's encoders, the jitter that it may make, rad/s; and the settling time over
#: that without it.
ENCODERS, CALM_ENOUGH_RAD_S, AS_SOON = "0.2 mrad", 0.002, 1.05
#: Share of the cases that must settle in each of the other worlds, and of honest fits.
MOST = 0.9
#: Speed at which tracking is judged, m/s, and what feed-forward must leave of the error.
TRACKING_M_S, LEFT = 0.1, 1.0 / 3.0


def claims(found: Found) -> Iterator[Claim]:
    """All claims, in the order of the page; those without numbers in a quick run have no parts."""
    parts = found.runs.groups("part")
    races, worlds = parts["race"].groups("scheme"), parts["world"]
    for claim, columns in _MINUTE.items():
        yield Claim(claim, OURS, [_largest(parts["minute"], *column) for column in columns])
    honesty = parts["assessment"].values("honesty")
    honest = sum(1.0 / HONEST <= ratio <= HONEST for ratio in honesty)
    label = f"recordings within a factor of {HONEST:g}"
    yield Claim("honest", OURS, [share_above(label, wilson(honest, len(honesty)), MOST)])
    over = races[who.BEST].median("over_5mm")
    yield Claim("best", OURS, [below("settling to 5 mm over the floor", over, OVER_FLOOR)])
    yield Claim("extended", OURS, [_faster(races, who.EXTENDED, name) for name in SCHEMES])
    for sliding, terms in (
        (who.SLIDING, "for speed alone"),
        (who.SLIDING_CALM, f"for at most {1e3 * who.CALM_RAD_S:g} mrad/s of jitter"),
    ):
        yield Claim("law", PAPER, _law(races, sliding), given={"terms": terms})
    tuned = [(f"{name}, tuned", name) for name in SCHEMES]
    means = [_faster(races, one, name) for one, name in tuned if one in races]
    yield Claim("means", OURS, means)
    for moment in MOMENTS[1:]:
        for name in (who.BEST, who.EXTENDED):
            share = parts["camera"].where(moment=moment, scheme=name).share("kept")
            part = share_above("cases that keep the pace", share, KEPT_SHARE)
            yield Claim("camera", OURS, [part], given={"scheme": name, "moment": moment})
    pictured = parts["rendered"].groups("scheme")
    rest = [
        below(f"{name}: rms over σ", pictured[name].median("rms_sigma"), REST_SIGMA)
        for name in (who.EXTENDED, who.BEST)
    ]
    yield Claim("rest", OURS, rest)
    yield from _world_claims(worlds)
    yield Claim("tracking", OURS, _tracking(parts["tracking"]))
    yield from spot_check_claims(found.data["spot_check"])


def _largest(runs: Results, column: str, bound: float, factor: float, unit: str) -> Part:
    """The largest value of all recordings must be small enough."""
    largest = max(runs.values(column))
    enough = True if len(runs) >= DECISIVE else None
    text = (
        f"at most {factor * largest:.2g}{unit} in {len(runs)} recordings, "
        f"asked: {factor * bound:g}{unit}"
    )
    label = column.removesuffix("_s").replace("_", " ")
    return Part(label, text, enough if largest <= bound else False, largest / bound)


def _faster(races: Mapping[str, Results], one: str, other: str) -> Part:
    ratio = races[one].over(races[other], "over_5mm")
    return below(f"settling time of {one} over that of {other}", ratio, 1.0)


def _law(races: Mapping[str, Results], sliding: str) -> list[Part]:
    """The sliding mode law among equals; none in a quick run that has too few of them."""
    how = sliding.rpartition(", ")[2]
    others = [name for name in who.OTHERS if name in races and name.endswith(how)]
    if sliding not in races or not others:
        return []
    best = min(others, key=lambda name: races[name].median("over_5mm").value)
    return [_faster(races, sliding, best)]


def _world_claims(worlds: Results) -> Iterator[Claim]:
    visited = worlds.groups("scheme", "kind", "label")
    without, *latencies = (world.label for world in who.WORLDS if world.kind == "latency")
    for name in (who.EXTENDED, who.BEST):
        parts = [
            below(
                f"settling time at {label} over that without",
                visited[name, "latency", label].over(visited[name, "latency", without], "to_5mm_s"),
                SLOWED,
            )
            for label in latencies
            if (name, "latency", label) in visited
        ]
        yield Claim("latency", OURS, parts, given={"scheme": name})
    shares = [
        share_above(f"{scheme}, {kind} {label}: runs that settle", runs.share(), MOST)
        for (kind, label, scheme), runs in worlds.groups("kind", "label", "scheme").items()
    ]
    yield Claim("worlds", OURS, shares)
    shaken = visited.get((who.BEST, "encoders", ENCODERS))
    if shaken:
        usual = visited[who.BEST, who.USUAL.kind, who.USUAL.label]
        parts = [
            below("jitter", shaken.median("jitter_rad_s"), CALM_ENOUGH_RAD_S, 1e3, " mrad/s"),
            below("settling time over that without", shaken.over(usual, "to_5mm_s"), AS_SOON),
        ]
        yield Claim("encoders", OURS, parts)


def _tracking(runs: Results) -> list[Part]:
    found = []
    for name in who.FOLLOWERS:
        with_it, alone = (
            runs.where(scheme=name, speed_m_s=TRACKING_M_S, feed_forward=feed_forward)
            for feed_forward in (True, False)
        )
        found.append(below(f"{name}: error over that alone", with_it.over(alone, "rms_m"), LEFT))
    return found


# ---- tables and figures ---------------------------------------------------------------------

TABLES = (
    TableOf(
        "minutes",
        ("part",),
        (
            "fit_s:range",
            "chain_box:range",
            "chain_workspace:range",
            "distilled_box:range",
            "paper_box:range",
            "paper_workspace:range",
            "late_error_s:range",
        ),
        {"part": "minute"},
    ),
    TableOf(
        "assessments",
        ("plant",),
        ("stated", "seen", "metric", "honesty:range"),
        {"part": "assessment"},
    ),
    TableOf(
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
    TableOf(
        "rendered",
        ("scheme",),
        ("to_5mm_s", "later_s", "later_s:range", "rms_sigma", "jitter_rad_s", "settled:of"),
        {"part": "rendered"},
    ),
    TableOf(
        "camera", ("scheme", "moment"), ("to_5mm_s", "slowdown", "kept:of"), {"part": "camera"}
    ),
    TableOf(
        "worlds",
        ("kind", "label", "scheme"),
        ("to_5mm_s", "final_rms_m", "jitter_rad_s", "settled:of"),
        {"part": "world"},
    ),
    TableOf(
        "tracking",
        ("path", "speed_m_s", "feed_forward", "scheme"),
        ("rms_m",),
        {"part": "tracking"},
    ),
)
#: What is slower than this, or never settles, stands here.
_SLOWEST_FLOORS, _SLOWEST_RATIO, _SLOWEST_S = 8.0, 4.0, 4.0


def figures(found: Found) -> Iterator[Drawn]:
    """All figures, in the order of the page."""
    parts = found.runs.groups("part")
    yield "minute", _minute_figure(parts["minute"]), {}
    yield "races", _races_figure(parts["race"]), {}
    yield "camera", _camera_figure(parts["camera"]), {}
    yield "worlds", _worlds_figure(parts["world"]), {}
    yield "tracking", _tracking_figure(parts["tracking"]), {}


def _minute_figure(runs: Results):
    figure, ((axis,),) = draw.grid(1, 1, (8.6, 3.6))
    columns = [f"{who}_{where}" for who in ("chain", "distilled", "paper")
               for where in ("box", "workspace")]  # fmt: skip
    draw.dots(axis, {label_of(one): [100 * value for value in runs.values(one)] for one in columns})
    axis.set(xscale="log", xlabel="error of the Jacobian, median over joints, %")
    return figure


def _races_figure(runs: Results):
    figure, (axes,) = draw.grid(1, 3, (14.0, 6.0), sharey=True)
    for axis, column in zip(axes, ("over_5mm", "over_2mm"), strict=False):
        draw.dots_of(axis, runs, "scheme", column, _SLOWEST_FLOORS, named=axis is axes[0])
        axis.axvline(1.0, color="black", linewidth=0.8)
        draw.plain_ticks(axis, (1, 1.5, 2, 3, 5, 8))
    draw.dots_of(axes[2], runs, "scheme", "jitter_rad_s", named=False)
    draw.plain_ticks(axes[2], (0.1, 0.2, 0.5, 1, 2, 5, 10))
    return figure


def _camera_figure(runs: Results):
    figure, (axes,) = draw.grid(1, len(MOMENTS) - 1, (13.5, 3.8), sharey=True)
    for axis, moment in zip(axes, MOMENTS[1:], strict=True):
        some = runs.where(moment=moment)
        draw.dots_of(axis, some, "scheme", "slowdown", _SLOWEST_RATIO, named=axis is axes[0])
        draw.bound_line(axis, KEPT, upright=True)
        axis.set_title(moment)
        axis.set_xlim(right=_SLOWEST_RATIO + 0.1)
    return figure


def _worlds_figure(runs: Results):
    figure, axes = draw.grid(2, 1, (12.5, 5.4), sharex=True)
    drawn = (("to_5mm_s", _SLOWEST_S), ("final_rms_m", np.inf))
    for axis, (metric, most) in zip(axes.flat, drawn, strict=True):
        for number, (name, some) in enumerate(runs.groups("scheme").items()):
            look = {"color": draw.colour_of(name), "linestyle": "", "label": name}
            places, shift = some.groups("kind", "label"), 0.22 * (number - 1)
            draw.bars(axis, places, draw.spread_bar(metric), most, shift, **look)
        axis.set_ylabel(METRICS[metric].label)
    axes[1, 0].set_yscale("log")
    names = ["\n".join(key) for key in runs.groups("kind", "label")]
    axes[1, 0].set_xticks(range(len(names)), names)
    draw.legend(figure, 3)
    return figure


def _tracking_figure(runs: Results):
    looks: dict[str, dict[str, Any]] = {}
    for name in who.FOLLOWERS:
        looks[name] = {"color": draw.colour_of(name)}
        looks[f"{name}, alone"] = {"color": draw.colour_of(name), "linestyle": ":", "marker": "x"}
    lines = Results(
        {**row, "line": row["scheme"] + ("" if row["feed_forward"] else ", alone")} for row in runs
    )
    paths = lines.groups("path")
    figure, (axes,) = draw.grid(1, len(paths), (10.5, 4.0), sharey=True)
    for axis, (kind, some) in zip(axes, paths.items(), strict=True):
        draw.against(axis, some, "speed_m_s", "rms_m", "line", looks)
        axis.set(yscale="log", title=kind)
    draw.legend(figure, 6)
    return figure


EXPERIMENT = Experiment(_NAME, measure, claims, TABLES, figures, globals())
