"""Figures 8, 9 and 10: four schemes drive the ball to its target, tuned alike."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from fvs_lab import servo_figures
from fvs_lab.context import Context
from fvs_lab.experiment import OURS, PAPER, Claim, Experiment, Found, Named, below
from fvs_lab.regimes import (
    BASELINES,
    FROZEN,
    JITTER_RAD_S,
    ORACLE_SLIDING,
    PEAK_RAD_S,
    PROPOSED,
    REGIMES,
    ROWS,
    SAME_WORLD,
    SEARCHED,
    search_of,
)
from fvs_lab.results import METRICS, Results, searches, settled, span, table
from fvs_lab.search import SEEDS, Tuned, search_all
from fvs_lab.spot_check import SpotCheck, spot_checks
from fvs_lab.spot_check import claims as spot_check_claims
from fvs_lab.spot_check import rows as spot_check_rows
from fvs_lab.trials import Case, Conditions, make_cases, run_trial

_TUNING_SEED, _SCORING_SEED, _SEARCH_SEED = 900, 901, 7
#: Cases that the figures show, as in the paper.
_SHOWN = 4

#: Searches by regime and scheme.
_Searches = Mapping[tuple[str, str], Sequence[Tuned]]


def measure(context: Context) -> Found:
    """Tune and score."""
    # Rendered images change no settling time, at two to three times the cost: see page beyond.
    conditions = Conditions(rendered=False)
    tuning = make_cases("TUNE", 1 if context.quick else 4, _TUNING_SEED)
    scoring = make_cases("EXP", context.count(60, 2), _SCORING_SEED)
    found = search_all(
        context,
        {
            (regime.name, name): search_of(scheme, regime)
            for regime in REGIMES
            for name, scheme in SEARCHED.items()
        },
        tuning,
        _SEARCH_SEED,
    )
    for (regime, name), ones in found.items():
        for other in SAME_WORLD.get(regime, ()):
            for one, more in zip(ones, found[other, name], strict=True):
                one.others.extend(more.tried)
    checks = _checks(context, found, scoring)
    facts = {
        "noise_mm": 1e3 * conditions.position_noise_m,
        "latency_ms": 1e3 * conditions.latency_s,
        "tuning": len(tuning),
        "scoring": len(scoring),
        "seeds": SEEDS,
        "peak_rad_s": PEAK_RAD_S,
        "jitter_mrad_s": 1e3 * JITTER_RAD_S,
    }
    data = {
        "conditions": conditions,
        "tuning_cases": tuning,
        "scoring_cases": scoring,
        "searches": [
            {"name": one.search.name, "knobs": one.search.knobs, "limit": one.search.limit,
             "fixed": one.search.variant.controller_values, "best": one.best, "tried": one.tried}
            for ones in found.values() for one in ones
        ],
        "spot_check": checks,
    }  # fmt: skip
    extra = {"searches": found, "checks": checks, "cases": scoring[:_SHOWN]}
    return Found(_score(context, found, scoring, conditions), facts, data, extra)


def _score(
    context: Context, found: _Searches, cases: Sequence[Case], conditions: Conditions
) -> Results:
    """Run every row of every regime on all cases, search by search."""
    labels, trials = [], []
    for regime in REGIMES:
        for row in ROWS:
            changes = {"method": "frozen"} if row == FROZEN else {}
            for search, tuned in enumerate(found[regime.name, PROPOSED if changes else row]):
                for number, case in enumerate(cases):
                    labels.append(
                        {"regime": regime.name, "scheme": row, "search": search, "case": case.name}
                    )
                    record = search == 0 and number < _SHOWN
                    trials.append(
                        tuned.trial(case, conditions, regime.duration_s, record=record, **changes)
                    )
    outcomes = context.map(run_trial, trials, "servoing")
    return Results(one.row(**label) for one, label in zip(outcomes, labels, strict=True))


def _checks(context: Context, found: _Searches, scoring: Sequence[Case]) -> list[SpotCheck]:
    regime = REGIMES[-1]
    trials = {
        # The nodes have a rendered camera, whatever the laboratory uses.
        name: found[regime.name, name][0].trial(scoring[0], Conditions(), regime.duration_s)
        for name in (PROPOSED, "ukf+mpc")
    }
    return spot_checks(context, trials, scoring[:_SHOWN], "servo")


def claims(found: Found) -> Iterator[Claim]:
    """The proposed scheme against the others in each regime, and against the true Jacobian."""
    for regime in REGIMES:
        schemes = found.runs.where(regime=regime.name).groups("scheme")
        parts = [
            below(
                f"settling time over that of {name}",
                schemes[PROPOSED].over(schemes[name], "to_5mm_s"),
                1.0,
            )
            for name in BASELINES
        ]
        yield Claim("fastest", PAPER, parts, given={"title": regime.title})
    schemes = found.runs.where(regime=REGIMES[0].name).groups("scheme")
    ratio = schemes[PROPOSED].over(schemes[ORACLE_SLIDING], "to_5mm_s")
    label = "settling time over that with the true Jacobian"
    yield Claim("oracle", OURS, [below(label, ratio, 1.1)], given={"title": REGIMES[0].title})
    yield from spot_check_claims(found.extra["checks"])


def tables(found: Found) -> Iterator[Named]:
    """Medians per regime, the gains that were found, failures, spot checks."""
    metrics = ("to_5mm_s", "to_2mm_s", "final_rms_m", "jitter_rad_s", "peak_joint_speed_rad_s",
               "jacobian_error")  # fmt: skip
    cells = {
        "to 5 mm, searches, s": searches("to_5mm_s"),
        "settled": settled,
        "largest joint speed, rad/s": lambda runs: (
            f"{max(runs.values('peak_joint_speed_rad_s')):.2f}"
        ),
    }
    for regime in REGIMES:
        runs = found.runs.where(regime=regime.name)
        rows = table(runs, {"scheme": "scheme"}, metrics, cells, METRICS)
        yield "regime", rows, {"title": regime.title}
    yield "gains", _gains(found.extra["searches"])
    yield "failures", _failures(found.runs)
    if found.extra["checks"]:
        yield "spot_check", spot_check_rows(found.extra["checks"])


def _gains(found: _Searches) -> list[dict[str, str]]:
    rows = []
    for (regime, name), ones in found.items():
        best = [one.best.gains for one in ones]
        gains = (f"{key} {span([one[key] for one in best], digits=4)}" for key in best[0])
        edges = (edge for one in ones for edge in one.search.at_an_edge(one.best.gains))
        rows.append(
            {
                "regime": regime,
                "scheme": name,
                "candidates": " + ".join(str(len(one.tried) + len(one.others)) for one in ones),
                "gains": ", ".join(gains),
                "at an end of their range": ", ".join(dict.fromkeys(edges)) or "-",
            }
        )
    return rows


def _failures(runs: Results) -> list[dict[str, str]]:
    failed = runs.where(settled=False)
    rows: list[dict[str, Any]] = [
        {"regime": regime, "scheme": scheme, "runs": str(count), "cause": cause}
        for (regime, scheme), ones in failed.groups("regime", "scheme").items()
        for cause, count in Counter(ones.values("failure")).most_common()
    ]
    return rows or [{"regime": "all", "scheme": "all", "runs": "0", "cause": "none failed"}]


def figures(found: Found) -> Iterator[Named]:
    """Figures 8 to 10 of the paper, all settling times, and what the searches tried."""
    cases = found.extra["cases"]
    yield "summary", servo_figures.summary(found.runs)
    for regime in REGIMES[:2]:
        first = found.runs.where(regime=regime.name, search=0)
        yield "errors", servo_figures.errors(first, regime, cases), {"regime": regime.name}
    first = found.runs.where(regime=REGIMES[1].name, search=0)
    yield "views", servo_figures.views(first, cases)
    yield "paths", servo_figures.paths(first, cases)
    yield "trade", servo_figures.trade(found.extra["searches"], JITTER_RAD_S)


EXPERIMENT = Experiment("servo", measure, claims, tables, figures)
