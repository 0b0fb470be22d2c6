"""Effect of the additions to the paper: least time, moved cameras, targets that move."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab.contestants import CLIPPED, CONTESTANTS, EXACT, ORACLE, floor_s, variant
from fvs_lab.results import Results
from fvs_lab.search import Search, Terms, search_all
from fvs_lab.trials import (
    HOME_RAD,
    Bump,
    Case,
    Trial,
    along,
    crossed,
    make_cases,
    sees_all,
    simulation_of,
)
from fvs_tools.schemes import SCHEMES, Scheme

# ---- the race against the floor -------------------------------------------------------------

#: The paper's laws that have the filter there, with the networks.
ON_NETWORKS = [Scheme(f"rbf+{law}", "rbf", law, "") for law in ("mfac", "mpc")]
#: Who is searched on which terms: for speed alone, and for speed with about the jitter of extended
#: with its defaults, 0.2 mrad/s.
SEARCHED = (
    (
        Terms("tuned", CLIPPED, 4.0),
        (CONTESTANTS["extended"], *SCHEMES.values(), *ON_NETWORKS, CONTESTANTS[ORACLE]),
    ),
    (
        Terms("calm", CLIPPED, 5.0, ("jitter_rad_s", 0.0002), 3.0),
        (CONTESTANTS["extended"], SCHEMES["rbf+pid"], *ON_NETWORKS),
    ),
)


def equipped(scheme: Scheme, terms: Terms) -> Search:
    """The search for the gains of a scheme with all additions that its parts can take.

    Least joint speeds are for laws that command a ball velocity, the camera's rotation is for the
    networks; a straight path is a matter of the sliding mode law.
    """
    resolves = scheme.law in ("ftsm", "proportional")
    redundancy = {"redundancy_resolution": "least_speed"} if resolves else {}
    better = replace(
        scheme,
        name=f"{scheme.name}, {terms.title}",
        method={"rbf": "rbf_left"}.get(scheme.method, scheme.method),
        controller_values={**scheme.controller_values, **redundancy},
    )
    return Search(better, terms)


def race(context: lab.Context, cases: Sequence[Case]) -> Results:
    """All schemes, with their defaults and searched, over the floor of each case."""
    searches = [equipped(scheme, terms) for terms, schemes in SEARCHED for scheme in schemes]
    if context.quick:  # the sliding mode law and another
        searches = searches[:3:2]
    tuning = make_cases("T", 1 if context.quick else 4, 402)
    racers = [*map(variant, CONTESTANTS), *search_all(context, searches, tuning, seed=8)]
    names = [case.name for case in cases]
    floors_s = dict(zip(names, context.map(floor_s, cases, "the floor"), strict=True))
    labelled = [racer.changed({"part": "race"}) for racer in racers]
    runs = context.run(crossed(labelled, cases), "against the floor")
    return runs.adding(
        lambda row: {
            "floor_s": floors_s[row["case"]],
            "over_5mm": row["to_5mm_s"] / floors_s[row["case"]],
        }
    )


# ---- moved cameras --------------------------------------------------------------------------

#: Time from the target to the blow, s, by the moment of the blow; infinite for none.
MOMENTS = {"undisturbed": math.inf, "1 s before the target": -1.0, "in mid-motion": 0.3}


def bumped(count: int) -> Iterator[Trial]:
    """Each moment and some contestants in drawn cases, with the same blow to the camera.

    Cases and blows are drawn so that the ball is still seen after the blow.
    """
    rng = np.random.default_rng(505)
    drawn = 0
    while drawn < count:
        cases = make_cases(f"C{drawn + 1}-", 1, int(rng.integers(2**31)))
        ends = np.array([cases[0].start_rad, cases[0].goal_rad])
        # About the optical axis, except for a tenth.
        axis = np.append(0.1 * rng.normal(size=2), rng.choice([-1.0, 1.0]))
        bump = Bump(0.0, along(axis, 45.0), along(rng.normal(size=3), 0.1))
        if not sees_all(EXACT, (*ends, ends.mean(axis=0)), bump):
            continue
        drawn += 1
        for (moment, time_s), name in product(MOMENTS.items(), ("best", "extended")):
            blow = None if time_s == math.inf else replace(bump, time_s=time_s)
            still = variant(name, part="camera", moment=moment)
            yield from crossed([still.changed(duration_s=3.5, bump=blow)], cases)


def with_slowdown(runs: Results) -> Results:
    """Rows with ``over_undisturbed``: settling time over that of the undisturbed run of the case.

    After a blow in motion both count from the blow. Infinite if no time remained, or if the
    undisturbed run never settled.
    """
    calm = runs.where(moment="undisturbed").groups("scheme", "case")

    def slowdown(row: Mapping[str, Any]) -> dict[str, Any]:
        time_s = MOMENTS[row["moment"]]
        before_s = time_s if 0.0 < time_s < math.inf else 0.0
        left_s = calm[row["scheme"], row["case"]].rows[0]["to_5mm_s"] - before_s
        comparable = 0.0 < left_s < math.inf
        ratio = (row["to_5mm_s"] - before_s) / left_s if comparable else math.inf
        return {"over_undisturbed": ratio, "kept": ratio <= 1.2}

    return runs.adding(slowdown)


# ---- moving targets -------------------------------------------------------------------------

RADIUS_M = 0.08


def on_circle(start_m: np.ndarray, plane: np.ndarray, speed_m_s: float, time_s: float):
    """The target at a time, m; it begins along the second unit vector of the plane."""
    angle = speed_m_s * time_s / RADIUS_M
    return start_m + RADIUS_M * ((np.cos(angle) - 1.0) * plane[0] + np.sin(angle) * plane[1])


def pursuits(count: int, speeds_m_s: Sequence[float], names: Sequence[str]) -> Iterator[Trial]:
    """Targets on circles in any plane, with feed-forward of their motion or without."""
    rng = np.random.default_rng(405)
    simulation = simulation_of(EXACT)
    simulation.reset(HOME_RAD)
    start_m, home = simulation.true_pose().position_m, tuple(HOME_RAD.tolist())
    for number in range(count):
        plane = np.linalg.qr(rng.normal(size=(3, 2)))[0].T
        case = Case(f"circle {number + 1}", home, home, 405_001 + number)
        for speed_m_s, forward, name in product(speeds_m_s, (True, False), names):
            moving = variant(
                name, part="tracking", speed_m_s=speed_m_s, feed_forward=forward
            ).changed(
                controller={"target_feed_forward": forward},
                record=True,
                path=partial(on_circle, start_m, plane, speed_m_s),
            )
            yield from crossed([moving], [case])


def tracking_error(row: Mapping[str, Any]) -> dict[str, float]:
    """Of a pursuit's row: ``rms_m``, the ball's distance from the target after the start, m.

    It is infinite for an arm that the supervisor held.
    """
    time_s, error_m = row["series"]["time_s"], row["series"]["error_m"]
    rms_m = float(np.sqrt(np.mean(error_m[time_s > 0.375 * time_s[-1]] ** 2)))
    return {"rms_m": math.inf if row["jitter_rad_s"] == math.inf else rms_m}


# ---- the experiment -------------------------------------------------------------------------


def measure(context: lab.Context) -> Results:
    """Measure all parts; each row names its ``part``."""
    count = context.count(60)
    cases = make_cases("B", count, 410)
    shaken = context.run(bumped(count), "moved cameras")
    speeds_m_s = (0.1,) if context.quick else (0.02, 0.1, 0.3)
    trials = pursuits(max(1, count // 20), speeds_m_s, ("proposed", "extended", "best"))
    followed = context.run(trials, "moving targets").adding(tracking_error)
    return Results([*race(context, cases), *with_slowdown(shaken), *followed])


def claims(runs: Results) -> Iterator[lab.Claim]:
    """All claims, in the order of the page; those without numbers in a quick run have no parts."""
    parts = runs.groups("part")
    races = parts["race"].groups("scheme")
    over = races["best"].median("over_5mm")
    yield lab.ours("best", lab.below("settling to 5 mm over the floor", over, 1.15))

    def faster(scheme: str, rival: str) -> lab.Part:
        ratio = races[scheme].over(races[rival], "over_5mm")
        return lab.below(f"settling time of {scheme} over that of {rival}", ratio, 1.0)

    yield lab.ours("extended", *(faster("extended", name) for name in SCHEMES))
    for terms, schemes in SEARCHED:
        rivals = [
            name
            for scheme in schemes
            if scheme.law != "ftsm" and scheme.method != "oracle"
            if (name := f"{scheme.name}, {terms.title}") in races
        ]
        if rivals:
            best = min(rivals, key=lambda name: races[name].median("over_5mm").value)
            yield lab.papers("law", faster(f"extended, {terms.title}", best), how=terms.title)
    for moment, shaken in parts["camera"].groups("moment").items():
        shaken_by = shaken.groups("scheme")
        kept = [
            lab.kept(f"cases of {name}", shaken_by[name].values("kept"), 0.95)
            for name in ("best", "extended")
        ]
        if moment != "undisturbed":
            yield lab.ours("camera", *kept, moment=moment)
    followed = parts["tracking"].where(speed_m_s=0.1).groups("scheme", "feed_forward")
    errors = [
        lab.below(name, followed[name, True].over(followed[name, False], "rms_m"), 1.0 / 3.0)
        for name in ("proposed", "extended", "best")
    ]
    yield lab.ours("tracking", *errors)


TABLES = (
    lab.Table(
        "races",
        ("scheme",),
        ("over_5mm", "jitter_rad_s:half", "settled:of"),
        {"part": "race"},
    ),
    lab.Table(
        "camera",
        ("moment",),
        ("over_undisturbed:half", "kept:of"),
        {"part": "camera"},
        across="scheme",
    ),
    lab.Table(
        "tracking",
        ("speed_m_s", "feed_forward"),
        ("rms_m:half",),
        {"part": "tracking"},
        across="scheme",
    ),
)


def figures(runs: Results) -> Iterator[lab.Drawn]:
    """Settling times over the floor, and jitter at rest."""
    race_runs = runs.where(part="race")
    figure, ((time_axis, jitter_axis),) = draw.grid(1, 2, (12.0, 6.0), sharey=True)
    draw.dots_of(jitter_axis, race_runs, "scheme", "jitter_rad_s")
    draw.plain_ticks(jitter_axis, (0.1, 0.2, 0.5, 1, 2, 5, 10))
    draw.dots_of(time_axis, race_runs, "scheme", "over_5mm", most=8.0)
    draw.plain_ticks(time_axis, (1, 1.5, 2, 3, 5, 8))
    yield "races", figure, {}


EXPERIMENT = lab.Experiment("beyond", measure, claims, TABLES, globals(), figures)
