"""What the additions to the paper are worth: a minute of data, least time, moved cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from fvs_estimator_node.distilling import train_structured
from fvs_estimator_node.model_file import save_model
from fvs_lab import beyond_camera, beyond_tracking
from fvs_lab import beyond_contestants as who
from fvs_lab.beyond_camera import draw_journeys, run_journey, with_slowdown
from fvs_lab.beyond_claims import claims
from fvs_lab.beyond_minute import (
    ERRING,
    MINUTE_S,
    MOST_LATE_S,
    PAPERS_METHOD,
    Minute,
    assess,
    draw_places,
    learn,
    record,
)
from fvs_lab.beyond_shown import figures, tables
from fvs_lab.beyond_tracking import SPEEDS_M_S, Pursuit, draw_paths, run_pursuit
from fvs_lab.context import Context
from fvs_lab.experiment import Experiment, Found
from fvs_lab.floor import SPARE_M, Floor, Limits, floor_of
from fvs_lab.outcome import BOUNDS_M
from fvs_lab.regimes import REGIMES, search_of
from fvs_lab.results import Results
from fvs_lab.search import SEEDS, Tuned, search_all
from fvs_lab.spot_check import SpotCheck, spot_checks
from fvs_lab.statistics import median
from fvs_lab.trials import Case, Conditions, Trial, make_cases, run_trial

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
    assessments = _assessments(context, max(1, count // 10))
    floors = context.map(partial(floor_of, limits=_LIMITS), cases, "the floor")
    races = _over_floors(_races(context, found, cases), cases, floors)
    rendered = _rendered(context, cases[: max(1, 4 * count // 15)], races)
    camera = with_slowdown(_journeys(context, count))
    runs = Results(
        [*minutes, *assessments, *races, *rendered, *camera, *_worlds(context, cases),
         *_pursuits(context, max(1, count // 20))]
    )  # fmt: skip
    checks = _checks(context, cases)
    data = {
        "conditions": context.conditions(),
        "contestants": who.CONTESTANTS,
        "cases": cases,
        "worlds_visited": who.WORLDS,
        "searches": {
            name: [
                {"best": one.best, "at_an_end": one.search.at_an_edge(one.best.gains)}
                for one in ones
            ]
            for name, ones in found.items()
        },
        "floors": floors,
        "spot_check": checks,
    }
    return Found(runs, _facts(context, runs, floors), data, {"checks": checks})


def _facts(context: Context, runs: Results, floors: Sequence[Floor]) -> dict[str, Any]:
    later = runs.where(part="rendered").groups("scheme")
    later_ms = {name: ones.median("later_s").value * 1e3 for name, ones in later.items()}
    own, fitted = (
        [value for name, value in later_ms.items() if name.endswith(who.MINUTES) is minutes]
        for minutes in (False, True)
    )
    return {
        "who": who,
        "moved": beyond_camera,
        "tracking": beyond_tracking,
        "rendered": context.rendered,
        "seeds": SEEDS,
        "later_ms": (min(own), max(own)),
        "minutes_ms": (min(fitted), max(fitted)),
        "count": len(floors),
        "pictured": len(later[who.BEST]),
        "minutes": len(runs.where(part="minute")),
        "most_late_ms": 1e3 * MOST_LATE_S,
        "papers_method": _papers_method(context),
        "spare_mm": 1e3 * SPARE_M,
        "floors": {
            bound: median([one.least_s[bound] for one in floors]).text() for bound in BOUNDS_M
        },
    }


# ---- runs -----------------------------------------------------------------------------------


def _minutes(context: Context, count: int, **changes: Any) -> list[Minute]:
    duration_s = MINUTE_S / 6 if context.quick else MINUTE_S
    places = draw_places(_PLACES_SEED, 20 if context.quick else 200)
    conditions = context.conditions(**changes)
    return [
        Minute(_MINUTES_SEED + number, duration_s, conditions, places, _papers_method(context))
        for number in range(count)
    ]


def _papers_method(context: Context) -> str:
    return "ridge" if context.quick else PAPERS_METHOD


def _assessments(context: Context, count: int) -> list[dict[str, Any]]:
    tasks = [
        (plant, minute)
        for plant, changes in ERRING.items()
        for minute in _minutes(context, count, **changes)
    ]
    return context.map(assess, tasks, "minutes of plants that err")


def _searched(context: Context) -> dict[str, list[Tuned]]:
    """The gains of all schemes with all additions, from several searches."""
    cases = make_cases("T", 1 if context.quick else 4, _TUNING_SEED)
    searches = {name: search_of(one, _REGIME) for name, one in who.TUNED.items()}
    searches |= {name: search_of(one, who.CALM_REGIME) for name, one in who.CALM.items()}
    if context.quick:
        searches = {name: searches[name] for name in (who.SLIDING, who.OTHERS[0])}
    return search_all(context, searches, cases, _SEARCH_SEED)


def _races(
    context: Context, found: Mapping[str, Sequence[Tuned]], cases: Sequence[Case]
) -> Results:
    exact = context.conditions(**_EXACT)
    labels: list[dict[str, Any]] = []
    trials: list[Trial] = []
    for name in who.RACERS:
        labels += [{"scheme": name}] * len(cases)
        trials += [who.variant(name).trial(case, exact) for case in cases]
    for name, ones in found.items():
        for search, one in enumerate(ones):
            labels += [{"scheme": name, "search": search}] * len(cases)
            trials += [one.trial(case, exact, _REGIME.duration_s) for case in cases]
    turned = search_of(who.CALM["rbf+pid, calm"], who.CALM_REGIME)
    for gain_1_s in () if context.quick else who.TURNED_1_S:
        gains = {"proportional_gain_1_s": gain_1_s}
        labels += [{"scheme": f"rbf+pid, {gain_1_s:g}/s"}] * len(cases)
        trials += [turned.trial(gains, case, exact) for case in cases]
    outcomes = context.map(run_trial, trials, "against the floor")
    return Results(
        outcome.row(part="race", case=trial.case.name, **label)
        for outcome, trial, label in zip(outcomes, trials, labels, strict=True)
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
    variants = []
    for world in who.WORLDS[: 1 if context.quick else None]:
        for name in who.FOLLOWERS:
            labels = {"part": "world", "kind": world.kind, "label": world.label, "scheme": name}
            conditions = {**_EXACT, **world.changes}
            variants.append(replace(who.variant(name), labels=labels, conditions=conditions))
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


def _checks(context: Context, cases: Sequence[Case]) -> list[SpotCheck]:
    trials = {
        # The nodes have a rendered camera, whatever the laboratory uses.
        name + words: who.variant(name).trial(cases[0], conditions)
        for words, conditions in CHECKED.items()
        for name in (who.BEST, who.EXTENDED)
    }
    return spot_checks(context, trials, cases[:_TARGETS], _NAME)


EXPERIMENT = Experiment(_NAME, measure, claims, tables, figures)
