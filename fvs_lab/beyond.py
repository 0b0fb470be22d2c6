"""Effect of the additions to the paper: a minute of data, least time, moved cameras."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import islice, product
from typing import Any

import numpy as np

from fvs_estimator_node.chain_fit import fit_chain
from fvs_estimator_node.collecting import CollectorConfig
from fvs_estimator_node.training import TrainingOptions, train
from fvs_lab import contestants as who
from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab import trials
from fvs_lab.arms import collect
from fvs_lab.floor import ur5
from fvs_lab.results import Results, label_of, median, wilson
from fvs_lab.search import CLIPPED, ORACLE, ORACLES, REGIMES, Regime, Search, search_all
from fvs_tools.closed_loop import ClosedLoop
from fvs_tools.schemes import BEYOND, SCHEMES, Scheme

#: Exact ball positions with the camera's noise, without rendering.
EXACT = trials.Conditions(rendered=False)

# ---- a minute of motion ---------------------------------------------------------------------

MINUTE_S = 60.0
#: Largest stamp delay of a recording's images, drawn uniformly by its seed, s.
MOST_LATE_S = 0.1
#: Errors of the plant as conditions: the calibration error of an off-the-shelf depth camera.
USUAL = "nothing"
PLANTS: Mapping[str, Mapping[str, Any]] = {
    USUAL: {},
    "focal length stated 1 % too long": {"focal_error": 0.01},
    "focal length stated 1 % too short": {"focal_error": -0.01},
    "depths stated 0.5 % too large": {"depth_error": 0.005},
}
#: Largest values that are asked of every recording.
MINUTE = {
    "chain_box": 0.005,
    "chain_workspace": 0.015,
    "distilled_box": 0.02,
    "late_error_s": 0.003,
    "fit_s": 5.0,
}
#: The error stated by the fit may be wrong by this factor, either way, in this share of the fits.
HONEST, MOST = 2.0, 0.9


def draw_places(count: int) -> dict[str, np.ndarray]:
    """Draw joints of ``box`` M, and of the whole ``workspace`` that the camera sees, rad."""
    rng = np.random.default_rng(400)
    box = trials.HOME_RAD + rng.uniform(-1.0, 1.0, (count, trials.HOME_RAD.size)) * trials.BOX_RAD
    seen: list[np.ndarray] = []
    while len(seen) < count:
        joints = rng.uniform(-np.pi, np.pi, trials.HOME_RAD.size)
        if trials.sees_all(trials.Conditions(), [joints]):
            seen.append(joints)
    return {"box": box, "workspace": np.array(seen)}


def learn(
    task: tuple[str, int, float, trials.Conditions], places: Mapping[str, np.ndarray]
) -> dict[str, Any]:
    """Record a plant (its name, seed, duration, s, and conditions), fit, distil and compare.

    Returns a row: relative errors of the Jacobians of the chain and of the distilled networks,
    medians over the places of :func:`draw_places`; ``fit_s`` on one core; error of the estimated
    stamp delay. For box M also the error ``stated`` by the fit, and the error against the Jacobian
    of the position that the camera reports (``seen``); ``chain_box`` is against the true one.
    """
    plant, seed, duration_s, conditions = task
    late_s = float(np.random.default_rng([seed, 1]).uniform(0.0, MOST_LATE_S))
    simulation = trials.simulation_of(conditions)
    box_rad = tuple(trials.BOX_RAD.tolist())
    config = CollectorConfig(duration_s=duration_s, seed=seed, joint_range_rad=box_rad)
    data = collect(simulation, config, late_s)
    began_s = time.process_time()
    distilled = train(data, TrainingOptions("poe", seed=seed))
    fit_s = time.process_time() - began_s
    assert distilled.chain is not None

    def off(model: Any, where: str, camera: np.ndarray) -> float:
        true = np.array([camera @ simulation.true_jacobian(one) for one in places[where]])
        return float(np.median(trials.relative_errors(model.jacobian(places[where]), true)))

    exact = np.eye(3)
    # the camera's systematic error is linear
    erring = np.stack([simulation.as_seen(one) for one in exact], axis=1)
    stated = float(np.median(fit_chain(data).jacobian_deviation(places["box"])))
    seen = off(distilled.chain, "box", erring)
    return {
        "part": "minute",
        "plant": plant,
        "seed": seed,
        "fit_s": fit_s,
        "late_error_s": abs(distilled.errors["time_offset_s"] - late_s),
        "chain_box": off(distilled.chain, "box", exact),
        "chain_workspace": off(distilled.chain, "workspace", exact),
        "distilled_box": off(distilled.model, "box", exact),
        "stated": stated,
        "seen": seen,
        "honesty": stated / seen,
    }


def _minutes(context: lab.Context, count: int) -> list[dict[str, Any]]:
    """Recordings of the nominal plant, and fewer of each plant with an error."""
    recordings = [
        (plant, 401 + n, 10.0 if context.quick else MINUTE_S, context.conditions(**changes))
        for plant, changes in ([*PLANTS.items()][: 1 if context.quick else None])
        for n in range(max(1, count // (3 if plant == USUAL else 10)))
    ]
    places = draw_places(5 if context.quick else 200)
    return context.map(partial(learn, places=places), recordings, "minutes of data")


# ---- the race against the floor -------------------------------------------------------------

#: The paper's laws that have the filter there, with the networks.
_ON_NETWORKS = [Scheme(f"rbf+{law}", "rbf", law, "") for law in ("mfac", "mpc")]
CALM_RAD_S = 0.0002
#: Terms of the search, and who is searched: for speed alone, and for speed with a jitter limit of
#: about extended's jitter with its defaults. Jitter is measured in the second after two seconds
#: within 5 mm.
SEARCHED = {
    "tuned": (
        REGIMES[0],
        (BEYOND[who.EXTENDED], *SCHEMES.values(), *_ON_NETWORKS, ORACLES[ORACLE]),
    ),
    "calm": (
        Regime("calm", "", CLIPPED, 5.0, ("jitter_rad_s", CALM_RAD_S), 3.0),
        (BEYOND[who.EXTENDED], SCHEMES["rbf+pid"], *_ON_NETWORKS),
    ),
}


def equipped(scheme: Scheme, how: str) -> Scheme:
    """A scheme with all additions that its parts can take, for a search of its gains.

    Least joint speeds are for laws that command a ball velocity, the camera's rotation is for the
    networks; a straight path is a matter of the sliding mode law.
    """
    resolves = scheme.law in ("ftsm", "proportional")
    redundancy = {"redundancy_resolution": "least_speed"} if resolves else {}
    return replace(
        scheme,
        name=f"{scheme.name}, {how}",
        method={"rbf": "rbf_left"}.get(scheme.method, scheme.method),
        controller_values={**scheme.controller_values, **redundancy},
    )


def _race(context: lab.Context, cases: list[trials.Case]) -> tuple[Results, dict[str, Any]]:
    """All schemes over the floor of each case; also the searches and floors."""
    schemes = [
        (equipped(one, how), regime) for how, (regime, ones) in SEARCHED.items() for one in ones
    ]
    searches = {one.name: Search(one, regime) for one, regime in schemes}
    if context.quick:  # the sliding mode law and another
        searches = {name: searches[name] for name in [*searches][:3:2]}
    tuning = trials.make_cases("T", 1 if context.quick else 4, 402)
    found = search_all(context, searches, tuning, seed=8)
    floors_s = context.map(who.floor_s, cases, "the floor")
    racers = [
        who.variant(name) for name in (who.BEST, who.BEST_ORACLE, who.EXTENDED, *who.PUBLISHED)
    ]
    for ones in found.values():
        racers += [one.variant.labelled(search=search) for search, one in enumerate(ones)]
    runs = context.run(
        [one.labelled(part="race").trial(case, EXACT) for one in racers for case in cases],
        "against the floor",
    )
    by_case = dict(zip([case.name for case in cases], floors_s, strict=True))
    summaries = [one.summary() for ones in found.values() for one in ones]
    over = runs.adding(lambda row: {"over_5mm": row["to_5mm_s"] / by_case[row["case"]]})
    return over, {"floors_s": by_case, "searches": summaries}


# ---- moved cameras --------------------------------------------------------------------------

#: Time from the target to the blow in motion, s.
STRUCK_AFTER_S = 0.3
#: How long the camera is carried, and how long the arm rests at the first target after a blow, s.
CARRIED_S, REST_S = 2.0, 1.0
#: When the camera moves.
UNDISTURBED, AT_REST, IN_MOTION = "undisturbed", "between two targets", "in mid-motion"
CARRIED = f"within {CARRIED_S:g} s while the arm is stopped"
MOMENTS = (UNDISTURBED, AT_REST, CARRIED, IN_MOTION)
SHAKEN = (who.BEST, who.EXTENDED, who.BEST_ORACLE, "proposed", who.FROZEN)
#: A run keeps its pace if it takes at most this much longer; asked of this share.
SLOWER, KEPT = 1.2, 0.95


def journeys(count: int, names: tuple[str, ...]) -> Iterator[trials.Trial]:
    """From the goal of a case to its start, a rest, and back, with a blow to the camera.

    Cases and blows are drawn so that the ball is still seen after the blow; each has all moments
    and all contestants. Settling times count from the second target on.
    """
    rng = np.random.default_rng(505)
    drawn = 0
    while drawn < count:
        case = trials.make_cases(f"C{drawn + 1}-", 1, int(rng.integers(2**31)))[0]
        # About the optical axis, except for a tenth.
        axis = np.append(0.1 * rng.normal(size=2), rng.choice([-1.0, 1.0]))
        shift = rng.normal(size=3)
        bump = trials.Bump(STRUCK_AFTER_S, trials.along(axis, 45.0), trials.along(shift, 0.1))
        ends = np.array([case.start_rad, case.goal_rad])
        if not trials.sees_all(EXACT, (*ends, ends.mean(axis=0)), bump):
            continue
        drawn += 1
        first_m = ur5().position(ends[0])
        for moment, name in product(MOMENTS, names):
            yield trials.Trial(
                who.variant(name).labelled(part="camera", moment=moment),
                replace(case, start_rad=case.goal_rad),
                EXACT,
                duration_s=3.5,
                bump=bump if moment == IN_MOTION else None,
                before=partial(_visit, first_m, bump, moment),
            )


def _visit(first_m: np.ndarray, bump: trials.Bump, moment: str, one: ClosedLoop) -> None:
    """Go to a first target, world frame, m, and rest there; the camera moves at its moment."""
    trials.give_target(one, first_m)
    one.run(1.6)
    if moment == AT_REST:
        bump.strike(one.simulation)
        trials.give_target(one, first_m)
    elif moment == CARRIED:
        one.loop.supervisor.stop()
        one.run(0.5)
        ticks = round(CARRIED_S / one.period_s)
        for _ in range(ticks):
            bump.strike(one.simulation, ticks)
            one.tick()
        one.run(0.5)
        trials.give_target(one, first_m)
        one.loop.supervisor.start(one.simulation.time_s)
    one.run(REST_S)


def with_slowdown(arrivals: Results) -> Results:
    """Rows with ``over_undisturbed``: settling time over that of the undisturbed run of the case.

    After a blow in motion both count from the blow, when the target is given again. Infinite if
    no time remained, or if the undisturbed run never settled.
    """
    calm = arrivals.where(moment=UNDISTURBED).groups("scheme", "case")

    def slowdown(row: Mapping[str, Any]) -> dict[str, Any]:
        before_s = STRUCK_AFTER_S if row["moment"] == IN_MOTION else 0.0
        left_s = calm[row["scheme"], row["case"]].rows[0]["to_5mm_s"] - before_s
        comparable = 0.0 < left_s < math.inf
        ratio = (row["to_5mm_s"] - before_s) / left_s if comparable else math.inf
        return {"over_undisturbed": ratio, "kept": ratio <= SLOWER}

    return arrivals.adding(slowdown)


# ---- other worlds, moving targets -----------------------------------------------------------

FOLLOWERS = ("proposed", who.EXTENDED, who.BEST)
#: Worlds as conditions that differ.
WORLDS: Mapping[str, Mapping[str, Any]] = {
    "as usual": {},
    "rendered images": {"rendered": True},
    "200 ms of latency": {"latency_s": 0.2},
    "drives 100 ms slower, 60 ms dead time": {"joint_lag_s": 0.1, "dead_time_s": 0.06},
    "1 mrad of encoder noise": {"encoder_noise_rad": 0.001},
    "8 images per second": {"image_rate_hz": 8.0},
    "4 mm of noise": {"position_noise_m": 0.004},
}
RADIUS_M, ROUND_S = 0.08, 4.0
SPEEDS_M_S = (0.02, 0.1, 0.3)
#: Largest error with feed-forward over that without, at the middle speed.
FOLLOWED = 1.0 / 3.0


def on_circle(start_m: np.ndarray, plane: np.ndarray, speed_m_s: float, time_s: float):
    """The target at a time, m; it begins along the second unit vector of the plane."""
    angle = speed_m_s * time_s / RADIUS_M
    return start_m + RADIUS_M * ((np.cos(angle) - 1.0) * plane[0] + np.sin(angle) * plane[1])


def pursuits(
    count: int, speeds_m_s: tuple[float, ...], names: tuple[str, ...]
) -> Iterator[trials.Trial]:
    """Targets on circles in any plane, with feed-forward of their motion or without."""
    rng = np.random.default_rng(405)
    simulation = trials.simulation_of(EXACT)
    simulation.reset(trials.HOME_RAD)
    start_m, home = simulation.true_ball_position(), tuple(trials.HOME_RAD.tolist())
    for number in range(count):
        plane = np.linalg.qr(rng.normal(size=(3, 2)))[0].T
        case = trials.Case(f"circle {number + 1}", home, home, 405_001 + number)
        for speed_m_s, feed_forward, name in product(speeds_m_s, (True, False), names):
            one = who.variant(name, target_feed_forward=feed_forward)
            labels = {"speed_m_s": speed_m_s, "feed_forward": feed_forward}
            path = partial(on_circle, start_m, plane, speed_m_s)
            yield one.labelled(part="tracking", **labels).trial(
                case, EXACT, duration_s=ROUND_S, record=True, path=path
            )


def tracking_error(row: Mapping[str, Any]) -> dict[str, float]:
    """Of a pursuit's row: ``rms_m``, the ball's distance from the target after the start, m.

    It is infinite for an arm that the supervisor held.
    """
    time_s, error_m = row["series"]["time_s"], row["series"]["error_m"]
    rms_m = float(np.sqrt(np.mean(error_m[time_s > 0.375 * time_s[-1]] ** 2)))
    return {"rms_m": math.inf if row["jitter_rad_s"] == math.inf else rms_m}


# ---- the experiment -------------------------------------------------------------------------


def measure(context: lab.Context) -> lab.Found:
    """Measure all parts; each row names its ``part``."""
    count = context.count(60)
    cases = trials.make_cases("B", count, 410)
    minutes = _minutes(context, count)
    race, data = _race(context, cases)
    moved = islice(journeys(count, SHAKEN), 2 if context.quick else None)
    shaken = context.run(moved, "moved cameras")
    visited = [
        replace(who.variant(name), conditions=changes)
        .labelled(part="world", world=world)
        .trial(case, EXACT)
        for world, changes in ([*WORLDS.items()][: 1 if context.quick else None])
        for name in FOLLOWERS
        for case in cases
    ]
    worlds = context.run(visited, "other worlds")
    speeds_m_s = SPEEDS_M_S[1:2] if context.quick else SPEEDS_M_S
    followed = context.run(pursuits(max(1, count // 20), speeds_m_s, FOLLOWERS), "moving targets")
    facts = {
        "count": count,
        "minutes": sum(row["plant"] == USUAL for row in minutes),
        "floor_s": median([*data["floors_s"].values()]).text(),
    }
    runs = [*minutes, *race, *with_slowdown(shaken), *worlds, *followed.adding(tracking_error)]
    return lab.Found(Results(runs), facts, {"cases": cases, **data})


def claims(found: lab.Found) -> Iterator[lab.Claim]:
    """All claims, in the order of the page; those without numbers in a quick run have no parts."""
    parts = found.runs.groups("part")
    usual, races = parts["minute"].where(plant=USUAL), parts["race"].groups("scheme")
    small = [
        lab.kept(label_of(name), [one <= bound for one in usual.values(name)], 1.0)
        for name, bound in MINUTE.items()
    ]
    yield lab.ours("minute", *small)
    honesty = parts["minute"].values("honesty")
    honest = wilson(sum(1.0 / HONEST <= ratio <= HONEST for ratio in honesty), len(honesty))
    yield lab.ours("honest", lab.share_above("recordings", honest, MOST))
    over = races[who.BEST].median("over_5mm")
    yield lab.ours("best", lab.below("settling to 5 mm over the floor", over, 1.15))

    def faster(one: str, other: str) -> lab.Part:
        ratio = races[one].over(races[other], "over_5mm")
        return lab.below(f"settling time of {one} over that of {other}", ratio, 1.0)

    yield lab.ours("extended", *(faster(who.EXTENDED, name) for name in SCHEMES))
    for how, (_, schemes) in SEARCHED.items():
        rivals = [one for one in schemes if one.law != "ftsm" and one.method != "oracle"]
        others = [name for one in rivals if (name := f"{one.name}, {how}") in races]
        if others:
            best = min(others, key=lambda name: races[name].median("over_5mm").value)
            yield lab.papers("law", faster(f"{who.EXTENDED}, {how}", best), how=how)
    for moment in MOMENTS[1:]:
        shaken = parts["camera"].where(moment=moment).groups("scheme")
        kept = [
            lab.kept(f"cases of {name}", shaken[name].values("kept"), KEPT)
            for name in (who.BEST, who.EXTENDED)
            if name in shaken
        ]
        yield lab.ours("camera", *kept, moment=moment)
    shares = [
        lab.share_above(f"{scheme}, {world}", runs.share(), MOST)
        for (world, scheme), runs in parts["world"].groups("world", "scheme").items()
    ]
    yield lab.ours("worlds", *shares)
    followed = parts["tracking"].where(speed_m_s=SPEEDS_M_S[1]).groups("scheme", "feed_forward")
    errors = [
        lab.below(name, followed[name, True].over(followed[name, False], "rms_m"), FOLLOWED)
        for name in FOLLOWERS
    ]
    yield lab.ours("tracking", *errors)


TABLES = (
    lab.TableOf("minutes", ("plant",), tuple(f"{one}:most" for one in MINUTE), {"plant": USUAL}),
    lab.TableOf(
        "plants",
        ("plant",),
        ("stated:half", "seen:half", "chain_box:half", "honesty:least", "honesty:most"),
        {"part": "minute"},
    ),
    lab.TableOf(
        "races",
        ("scheme",),
        ("over_5mm", "over_5mm:90 %", "jitter_rad_s:half", "settled:of"),
        {"part": "race"},
    ),
    lab.TableOf(
        "camera",
        ("moment",),
        ("over_undisturbed:half", "kept:of"),
        {"part": "camera"},
        across="scheme",
    ),
    lab.TableOf(
        "worlds",
        ("world",),
        ("to_5mm_s:half", "jitter_rad_s:half"),
        {"part": "world"},
        across="scheme",
    ),
    lab.TableOf(
        "tracking",
        ("speed_m_s", "feed_forward"),
        ("rms_m:half",),
        {"part": "tracking"},
        across="scheme",
    ),
)


def figures(found: lab.Found) -> Iterator[lab.Drawn]:
    """Settling times over the floor, and jitter at rest."""
    runs = found.runs.where(part="race")
    figure, ((time_axis, jitter_axis),) = draw.grid(1, 2, (12.0, 6.0), sharey=True)
    draw.dots_of(jitter_axis, runs, "scheme", "jitter_rad_s")
    draw.plain_ticks(jitter_axis, (0.1, 0.2, 0.5, 1, 2, 5, 10))
    draw.dots_of(time_axis, runs, "scheme", "over_5mm", most=8.0)
    draw.plain_ticks(time_axis, (1, 1.5, 2, 3, 5, 8))
    yield "races", figure, {}


EXPERIMENT = lab.Experiment("beyond", measure, claims, TABLES, figures, globals())
