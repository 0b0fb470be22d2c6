"""The numbers beyond the paper, in tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from fvs_lab.beyond_camera import MOMENTS, UNDISTURBED
from fvs_lab.beyond_results import KEPT, Results
from fvs_lab.beyond_terms import (
    CLAIRVOYANT,
    FOLLOWERS,
    SIGMA_M,
    WORLDS,
    times_s,
)
from fvs_lab.beyond_tracking import CIRCLE, LINE
from fvs_lab.report import Table
from fvs_lab.spot_check_words import spot_check_table
from fvs_lab.statistics import median
from fvs_lab.trials import BOUNDS_M


def tables(results: Results) -> list[Table]:
    """All tables, in the order of the page."""
    return [
        _minutes(results),
        _told(results),
        _races(results),
        _rendered(results),
        _camera(results),
        _worlds(results),
        *(_tracking(results, kind) for kind in (LINE, CIRCLE)),
        *spot_check_table(results.checks, "the defaults of the nodes"),
    ]


def _minutes(results: Results) -> Table:
    rows = [
        [
            str(one.seed),
            f"{one.images}",
            f"{one.fit_s:.1f}",
            *(
                f"{100 * error:.{digits}f}"
                for error, digits in (
                    (one.chain_box, 3),
                    (one.chain_workspace, 3),
                    (one.taught_box, 2),
                    (one.paper_box, 2),
                    (one.paper_workspace, 0),
                )
            ),
            f"{1e3 * one.late_s:.1f}",
            f"{1e3 * one.found_late_s:.1f}",
        ]
        for one in results.minutes
    ]
    return Table(
        "A minute of data. Errors of the Jacobian against the true one, medians over joints, %: in "
        "box M, where the data are, and over the whole workspace that the camera sees.",
        [
            "seed",
            "images",
            "fit and teaching, s of one core",
            "chain, box M, %",
            "chain, workspace, %",
            "networks it taught, box M, %",
            "the paper's training, box M, %",
            "workspace, %",
            "images late by, ms",
            "found, ms",
        ],
        rows,
    )


def _told(results: Results) -> Table:
    rows = []
    for plant in dict.fromkeys(one.plant for one in results.told):
        ones = [one for one in results.told if one.plant == plant]
        ratios = [one.told / one.seen for one in ones]
        errors = ([getattr(one, name) for one in ones] for name in ("told", "seen", "metric"))
        rows.append(
            [
                plant,
                *(f"{100 * float(np.median(values)):.3f}" for values in errors),
                f"{min(ratios):.2f} to {max(ratios):.2f}",
            ]
        )
    return Table(
        "A minute of data of a plant that errs: what the fit says of its chain's Jacobian in box "
        "M, and how far off that is, medians. A wrong scale of the camera changes all that it "
        "sees alike: no motion tells it, and the camera's own frame needs none.",
        [
            "what errs",
            "the fit says, %",
            "off from what the camera sees, %",
            "off in metres, %",
            "the fit says, over what it is off (each recording)",
        ],
        rows,
    )


def _races(results: Results) -> Table:
    rows = [[CLAIRVOYANT, *_race(results, results.played_s), "", "", ""]]
    for name, outcomes in results.races.items():
        searched = results.searched(name)
        rows.append(
            [
                name,
                *_race(results, partial(times_s, outcomes)),
                f"{min(searched):.2f} to {max(searched):.2f}" if len(searched) > 1 else "",
                _middle([1e3 * one.jitter_rad_s for one in outcomes]),
                _middle([one.peak_joint_speed_rad_s for one in outcomes]),
            ]
        )
    floors = [
        f"{median([one.least_s[bound] for one in results.floors]).text()} s to {bound}"
        for bound in BOUNDS_M
    ]
    return Table(
        f"The race: {len(results.floors)} cases with the same limits and the exact camera; the "
        f"floor is {', '.join(floors)}. Settling times are over the floor of each case, or over "
        "the clairvoyant's time. Tuned and calm: with all additions and searched gains; the "
        "medians of the searches are in a column of their own.",
        [
            "scheme",
            "settled",
            "to 5 mm over floor",
            "over clairvoyant",
            "slowest 10 %, from",
            "worst case",
            "to 2 mm over floor",
            "to 1 mm over floor",
            "to 5 mm, searches",
            "jitter, mrad/s",
            "peak joint speed, rad/s",
        ],
        rows,
    )


def _race(results: Results, times_s_to: Callable[[str], list[float]]) -> list[str]:
    """Cells of a contestant, whose settling times to a bound are given, s."""
    repeats = len(times_s_to("5 mm")) // len(results.floors)
    over = {bound: np.array(results.in_floors(times_s_to(bound), bound)) for bound in BOUNDS_M}
    late = np.array(times_s_to("5 mm")) / np.tile(results.played_s(), repeats)
    middle = {bound: median(ones.tolist(), repeats).text() for bound, ones in over.items()}
    return [
        f"{int(np.isfinite(over['5 mm']).sum())} of {over['5 mm'].size}",
        middle["5 mm"],
        _middle(late.tolist()),
        # A run itself: nothing lies between a time and never.
        *(_number(float(np.quantile(over["5 mm"], part, method="higher"))) for part in (0.9, 1.0)),
        middle["2 mm"],
        middle["1 mm"],
    ]


def _rendered(results: Results) -> Table:
    rows = []
    for name, outcomes in results.rendered.items():
        shift = [f"{value:+.0f}" for value in results.shift_ms(name)]
        rows.append(
            [
                name,
                f"{sum(not one.failure for one in outcomes)} of {len(outcomes)}",
                median(times_s(outcomes)).text(),
                *shift,
                median([one.final_rms_m / SIGMA_M for one in outcomes]).text(),
                _middle([1e3 * one.jitter_rad_s for one in outcomes]),
            ]
        )
    return Table(
        "The first of these cases with rendered images, and with a model fitted to a minute of "
        "motion: settling, and how much later than in the race (exact camera, shipped model); rest "
        f"error over σ, the sensor's white noise of {1e3 * SIGMA_M:g} mm on each coordinate.",
        [
            "scheme",
            "settled",
            "to 5 mm, s",
            "later by (median), ms",
            "largest difference, ms",
            "final rms, σ",
            "jitter, mrad/s",
        ],
        rows,
    )


def _camera(results: Results) -> Table:
    rows = []
    for name in results.shaken:
        cells = [name]
        for moment in MOMENTS:
            arrivals = results.arrivals[moment, name]
            cells.append(_middle([one.settled_s for one in arrivals]))
        for moment in MOMENTS[1:]:
            hits, count = results.kept(moment, name)
            cells += [median(results.slowdown(moment, name)).text(), f"{hits} of {count}"]
        rows.append(cells)
    return Table(
        "The camera is turned by 45° and moved by 10 cm: settling to 5 mm from the second target "
        "on, medians in s, and ratios to the undisturbed run of the same case from the last target "
        "on: that is the second target, but in mid-motion it is the same target given anew, "
        "compared with what was then left of the undisturbed run.",
        [
            "scheme",
            f"{UNDISTURBED}, s",
            *(f"moved {moment}, s" for moment in MOMENTS[1:]),
            *(
                words
                for moment in MOMENTS[1:]
                for words in (f"ratio, {moment}", f"at most {KEPT:g}")
            ),
        ],
        rows,
    )


def _worlds(results: Results) -> Table:
    rows = []
    for number in results.world_numbers:
        world = WORLDS[number]
        cells = [world.kind, world.label]
        for name in FOLLOWERS:
            outcomes = results.worlds[number, name]
            failed = sum(bool(one.failure) for one in outcomes)
            cells += [
                _middle(times_s(outcomes)) + (f", {failed} never" if failed else ""),
                _middle([1e3 * one.final_rms_m for one in outcomes]),
                _middle([1e3 * one.jitter_rad_s for one in outcomes]),
            ]
        rows.append(cells)
    return Table(
        "Other worlds with one set of gains; medians.",
        [
            "what",
            "how much",
            *(
                f"{name}: {words}"
                for name in FOLLOWERS
                for words in ("to 5 mm, s", "rms, mm", "jitter, mrad/s")
            ),
        ],
        rows,
    )


def _tracking(results: Results, kind: str) -> Table:
    rows = [
        [
            f"{speed_m_s:g}",
            *(
                _middle(
                    [1e3 * one for one in results.tracking_m(kind, speed_m_s, name, feed_forward)]
                )
                for name in FOLLOWERS
                for feed_forward in (True, False)
            ),
        ]
        for speed_m_s in results.speeds_m_s()
    ]
    return Table(
        f"Targets on a {kind}: distance of the ball from the target after the start, rms, mm; "
        "medians of the paths. “Alone” is without feed-forward.",
        ["speed, m/s", *(f"{name}{alone}" for name in FOLLOWERS for alone in ("", ", alone"))],
        rows,
    )


def _middle(values: Sequence[float]) -> str:
    return _number(float(np.median(values)))


def _number(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else "never"
