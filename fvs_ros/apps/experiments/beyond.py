"""What the additions to the paper are worth: a minute of data, least time, moved cameras."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from fvs_ros.apps.experiments import beyond_figures
from fvs_ros.apps.experiments.beyond_calm import DURATION_S, calm
from fvs_ros.apps.experiments.beyond_camera import (
    CARRIED_S,
    REST_S,
    STRUCK_AFTER_S,
    Arrival,
    draw_journeys,
    run_journey,
)
from fvs_ros.apps.experiments.beyond_minute import (
    ERRING,
    MINUTE_S,
    MOST_LATE_S,
    PAPERS_METHOD,
    Minute,
    Told,
    draw_places,
    learn,
    tell,
)
from fvs_ros.apps.experiments.beyond_results import Results
from fvs_ros.apps.experiments.beyond_tables import tables
from fvs_ros.apps.experiments.beyond_terms import (
    ACCELERATION_RAD_S2,
    BEST,
    CLAIRVOYANT,
    CONTESTANTS,
    EXTENDED,
    FOLLOWERS,
    RACERS,
    SHAKEN,
    SPEED_RAD_S,
    WORLDS,
    trial_of,
)
from fvs_ros.apps.experiments.beyond_tracking import (
    RADIUS_M,
    RATE_HZ,
    SPEEDS_M_S,
    Pursuit,
    Tracked,
    draw_paths,
    run_pursuit,
)
from fvs_ros.apps.experiments.beyond_verdicts import verdicts
from fvs_ros.apps.experiments.context import Context
from fvs_ros.apps.experiments.floor import SPARE_M, Limits, floor_of
from fvs_ros.apps.experiments.report import Figure, Report
from fvs_ros.apps.experiments.search import Found
from fvs_ros.apps.experiments.spot_check import SpotCheck, spot_check
from fvs_ros.apps.experiments.trials import Case, Conditions, Outcome, make_cases, run_trial

NAME = "beyond"
_PLACES_SEED, _MINUTES_SEED, _TUNING_SEED, _SCORING_SEED = 400, 401, 402, 403
_JOURNEYS_SEED, _PATHS_SEED = 505, 405
_LIMITS = Limits(SPEED_RAD_S, ACCELERATION_RAD_S2)
#: Targets of the spot check, and contestants that are judged by moved cameras, the first ones.
_TARGETS, _JUDGED = 4, 2
#: Worlds of the spot check, in words behind the scheme's name.
CHECKED = {
    Conditions(): "",
    Conditions(latency_s=0.2): ", 200 ms of latency",
    Conditions(camera_turn_deg=(0.0, 0.0, 45.0)): ", camera turned by 45°",
}


def run(context: Context) -> Report:
    """Measure all parts, draw and judge."""
    count = context.count(16, 1)
    cases = make_cases("B", count, _SCORING_SEED)
    found = calm(context, make_cases("T", 1 if context.quick else 3, _TUNING_SEED))
    results = Results(
        minutes=context.map(learn, _minutes(context, max(1, 5 * count // 4)), "minutes of data"),
        told=_told(context, max(1, 3 * count // 8)),
        floors=context.map(partial(floor_of, limits=_LIMITS), cases, "the floor"),
        races=_races(context, cases),
        calmed=_calmed(context, found, cases),
        arrivals=_arrivals(context, count),
        worlds=_worlds(context, cases[: max(1, count // 2)]),
        pursuits=_pursuits(context, max(1, 3 * count // 16)),
        calm_limit_rad_s=_limit(found),
        checks=_checks(context, cases),
    )
    return Report(
        name=NAME,
        title="Beyond the paper",
        question="A forward model fitted to a minute of motion, least joint travel at the limits, "
        "images fused by how noisy they are, the drives' lag and the target's motion anticipated: "
        "what is all that worth?",
        setup=_setup(context, results),
        figures=_figures(context, results),
        tables=tables(results),
        verdicts=verdicts(results),
        data={
            "conditions": context.conditions(),
            "contestants": CONTESTANTS,
            "cases": cases,
            "worlds_visited": WORLDS,
            "calm": [
                {"name": one.search.name, "limit": one.search.limit, "best": one.best}
                for one in found.values()
            ],
            "minutes": results.minutes,
            "told": results.told,
            "floors": results.floors,
            "races": {
                name: [one.summary() for one in ones] for name, ones in results.races.items()
            },
            "calmed": {
                name: [one.summary() for one in ones] for name, ones in results.calmed.items()
            },
            "arrivals": {
                f"{name}, {moment}": ones for (moment, name), ones in results.arrivals.items()
            },
            "worlds": {
                f"{name}, world {number}": [one.summary() for one in ones]
                for (number, name), ones in results.worlds.items()
            },
            "pursuits": [
                {
                    "name": pursuit.name,
                    "path": pursuit.path.kind,
                    "seed": pursuit.path.seed,
                    "speed_m_s": pursuit.speed_m_s,
                    "feed_forward": pursuit.feed_forward,
                    "rms_m": tracked.rms_m,
                }
                for pursuit, tracked in results.pursuits
            ],
            "spot_check": results.checks,
        },
    )


# ---- runs -----------------------------------------------------------------------------------


def _minutes(context: Context, count: int, **changes: Any) -> list[Minute]:
    duration_s = MINUTE_S / 6 if context.quick else MINUTE_S
    places = draw_places(_PLACES_SEED, 20 if context.quick else 200)
    return [
        Minute(
            _MINUTES_SEED + number,
            duration_s,
            context.conditions(**changes),
            places,
            _papers_method(context),
        )
        for number in range(count)
    ]


def _papers_method(context: Context) -> str:
    return "ridge" if context.quick else PAPERS_METHOD


def _told(context: Context, count: int) -> list[Told]:
    tasks = [
        (plant, minute)
        for plant, changes in ERRING.items()
        for minute in _minutes(context, count, **changes)
    ]
    return context.map(tell, tasks, "minutes of plants that err")


def _races(context: Context, cases: Sequence[Case]) -> dict[str, list[Outcome]]:
    trials = [trial_of(name, case, context.conditions()) for case in cases for name in RACERS]
    outcomes = context.map(run_trial, trials, "against the floor")
    return {name: outcomes[place :: len(RACERS)] for place, name in enumerate(RACERS)}


def _calmed(
    context: Context, found: Mapping[str, Found], cases: Sequence[Case]
) -> dict[str, list[Outcome]]:
    trials = [
        one.trial(case, context.conditions(), DURATION_S)
        for one in found.values()
        for case in cases
    ]
    outcomes = iter(context.map(run_trial, trials, "as calm"))
    return {key: [next(outcomes) for _ in cases] for key in found}


def _arrivals(context: Context, count: int) -> dict[tuple[str, str], list[Arrival]]:
    """So many journeys that their share can be told from 95 %; fewer for those beside it."""
    parts = {SHAKEN[:_JUDGED]: 37 * count // 8, SHAKEN[_JUDGED:]: 5 * count // 8}
    if context.quick:
        parts = {SHAKEN[:_JUDGED]: 1}
    journeys = [
        journey
        for names, share in parts.items()
        for journey in draw_journeys(max(1, share), _JOURNEYS_SEED, names, context.conditions())
    ]
    arrivals: dict[tuple[str, str], list[Arrival]] = {}
    for journey, one in zip(
        journeys, context.map(run_journey, journeys, "moved cameras"), strict=True
    ):
        arrivals.setdefault((journey.moment, journey.name), []).append(one)
    return arrivals


def _worlds(context: Context, cases: Sequence[Case]) -> dict[tuple[int, str], list[Outcome]]:
    numbers = range(1 if context.quick else len(WORLDS))
    keys = [(number, name) for number in numbers for name in FOLLOWERS]
    trials = [
        trial_of(name, case, context.conditions(**WORLDS[number].changes))
        for number, name in keys
        for case in cases
    ]
    outcomes = iter(context.map(run_trial, trials, "other worlds"))
    return {key: [next(outcomes) for _ in cases] for key in keys}


def _pursuits(context: Context, count: int) -> list[tuple[Pursuit, Tracked]]:
    pursuits = [
        Pursuit(name, path, speed_m_s, feed_forward, context.conditions())
        for path in draw_paths(count, _PATHS_SEED)[: 1 if context.quick else None]
        for speed_m_s in (SPEEDS_M_S[2:3] if context.quick else SPEEDS_M_S)
        for feed_forward in (True, False)
        for name in FOLLOWERS
    ]
    tracked = context.map(run_pursuit, pursuits, "moving targets")
    return list(zip(pursuits, tracked, strict=True))


def _checks(context: Context, cases: Sequence[Case]) -> list[SpotCheck]:
    if not context.nodes:
        return []
    # The nodes have a rendered camera, whatever the laboratory uses.
    asked = [(name, conditions) for conditions in CHECKED for name in (BEST, EXTENDED)]
    return [
        spot_check(
            context,
            name + CHECKED[conditions],
            trial_of(name, cases[0], conditions),
            cases[:_TARGETS],
            domain=1 + (os.getpid() + number) % 100,
            seeds=2 if context.quick else 6,
            experiment=NAME,
        )
        for number, (name, conditions) in enumerate(asked[:1] if context.quick else asked)
    ]


def _limit(found: Mapping[str, Found]) -> float:
    """The jitter that all searches allowed, rad/s."""
    (bound,) = {one.search.limit.bound for one in found.values() if one.search.limit}
    return bound


# ---- words ----------------------------------------------------------------------------------


def _setup(context: Context, results: Results) -> list[str]:
    camera = "rendered images" if context.rendered else "the simulator's true positions"
    return [
        f"Everything runs in lock step, with ball positions from {camera} and 1 mm of white noise, "
        "40 ms of latency, and drives with dead time and lag, unless it says otherwise. All "
        f"schemes have the same starts, targets, noise and limits ({SPEED_RAD_S:g} rad/s and "
        f"{ACCELERATION_RAD_S2:g} rad/s² for each joint), the defaults of the nodes, and begin "
        "with the same trained model. extended has the paper's networks and law with all additions "
        "that need no forward model; best has the fitted chain and a law that arrives at the "
        "limits.",
        f"A minute: {len(results.minutes)} recordings of the collector's motion in box M, whose "
        f"images are stamped late by a random 0 to {1e3 * MOST_LATE_S:.0f} ms. A chain of six "
        "revolute joints is fitted and teaches six networks; beside it, the paper's networks are "
        f"trained on the same recording (by the method {_papers_method(context)}). "
        "The workspace is every joint position, over the whole range, whose ball the camera sees.",
        "The physical floor of a case: the least time after which the ball is within 5 mm (2 mm, "
        "1 mm) of the target and can be kept there while the joints brake, from rest and within "
        "the joints' limits, by sequential quadratic programming on the true kinematics. It knows "
        f"nothing of latency and lag. {CLAIRVOYANT.capitalize()}: such a motion, planned for "
        f"{1e3 * SPARE_M:g} mm less, played blindly as commands to the simulated drives, which "
        "have dead time and lag; it knows arm and target exactly. As calm: the paper's "
        "other schemes with gains searched anew (CMA-ES, on other cases) for least settling time "
        "at no more jitter than extended has on those; once with the usual image filter, and "
        "once with the share of an image that the filter believes searched, too.",
        "Moved camera: from a first target, where the arm rests, to a second. The camera is turned "
        "by 45°, mostly about its optical axis so that the ball stays in view, and moved by 10 cm; "
        "the target is given anew at once where it is in the new view, and nothing else is told. "
        f"Between two targets: {REST_S:g} s before the second target. Carried: evenly for "
        f"{CARRIED_S:g} s while the arm is stopped; it is started {REST_S:g} s before the second "
        f"target. In mid-motion: {STRUCK_AFTER_S:g} s after it. The oracle is told the true "
        "Jacobian at once, but has no forward model.",
        f"Moving targets are told at {RATE_HZ:g} Hz: straight lines of about half a metre, and "
        f"circles of {100 * RADIUS_M:g} cm radius in any plane. Numbers are medians with their "
        "95 % bootstrap intervals; a run that never settles counts as infinitely slow.",
    ]


def _figures(context: Context, results: Results) -> list[Figure]:
    folder = context.folder(NAME)
    return [
        Figure(
            beyond_figures.minute(results, folder),
            "What a minute of data teaches: a dot a recording. The networks know nothing beyond "
            "their data; the chain does.",
        ),
        Figure(
            beyond_figures.races(results, folder),
            "Settling times over the physical floors, and jitter at rest: a dot a case, the bar is "
            "the median. At 8 stands what is slower or never settles.",
        ),
        Figure(
            beyond_figures.camera(results, folder),
            "A camera turned by 45° and moved by 10 cm: settling over that of the undisturbed run. "
            "The dashed line is 1.2; at 4 stands what is slower.",
        ),
        Figure(
            beyond_figures.worlds(results, folder),
            "Other worlds with one set of gains: medians, and the range of 80 % of the cases.",
        ),
        Figure(
            beyond_figures.tracking(results, folder),
            "Following moving targets, with feed-forward (solid) and without (dotted).",
        ),
    ]
