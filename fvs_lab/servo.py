"""Figures 8, 9 and 10: four schemes drive the ball to its target, tuned alike."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np

from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab.contestants import CLIPPED, FREE
from fvs_lab.results import Results
from fvs_lab.search import Search, Terms, search_all
from fvs_lab.trials import Case, Conditions, crossed, make_cases, photo, simulation_of
from fvs_tools.schemes import SCHEMES, Scheme

#: Where the limits are those of a real arm, it is the yardstick.
ORACLE = Scheme("oracle, sliding mode", "oracle", "ftsm", "")
#: The regime of the figures, as in the paper; and all.
PEAK = Terms("Equal peak speed, no limit", FREE, 6.0, ("peak_joint_speed_rad_s", 0.8))
REGIMES = (
    Terms("Equal joint-speed limit", CLIPPED, 4.0),
    PEAK,
    Terms("Equal command jitter", CLIPPED, 5.0, ("jitter_rad_s", 0.001), 2.0),
)


def scoring_cases(count: int) -> list[Case]:
    """Starts and targets on which the tuned schemes are compared."""
    return make_cases("EXP", count, 901)


def measure(context: lab.Context) -> Results:
    """Tune and score; a quick run in the regime of the figures only."""
    tuning = make_cases("TUNE", 1 if context.quick else 4, 900)
    cases = scoring_cases(context.count(60))
    trials = []
    for terms in [PEAK] if context.quick else REGIMES:
        schemes = (*SCHEMES.values(), ORACLE) if terms is REGIMES[0] else SCHEMES.values()
        searches = [Search(scheme, terms) for scheme in schemes]
        for variant in search_all(context, searches, tuning, seed=7):
            trials += [
                trial.changed({"regime": terms.title}, record=number < 4)
                for number, trial in enumerate(crossed([variant], cases))
            ]
    return context.run(trials, "servoing")


def claims(runs: Results) -> Iterator[lab.Claim]:
    """The proposed scheme against the others in each regime, and against the true Jacobian."""
    for title, group in runs.groups("regime").items():
        ratios = {
            name: group.where(scheme="proposed").over(others, "to_5mm_s")
            for name, others in group.groups("scheme").items()
        }
        parts = [
            lab.below(f"settling time over that of {name}", ratios[name], 1.0)
            for name in SCHEMES
            if name != "proposed"
        ]
        yield lab.papers("fastest", *parts, title=title)
        if ORACLE.name in ratios:
            label = "settling time over that with the true Jacobian"
            yield lab.ours("oracle", lab.below(label, ratios[ORACLE.name], 1.1), title=title)


TABLES = (
    lab.Table(
        "regimes",
        ("scheme",),
        ("to_5mm_s",),
        across="regime",
    ),
)

# ---- figures --------------------------------------------------------------------------------


def figures(runs: Results) -> Iterator[lab.Drawn]:
    """Figures 8 to 10 of the paper, of its four experiments."""
    shown = runs.where(regime=PEAK.title, search=0).those(lambda row: bool(row["series"]))
    yield "errors", _errors(shown), {}
    yield "views", _views(shown), {}
    yield "paths", _paths(shown), {}


def _look(row: Mapping[str, Any]) -> dict[str, Any]:
    return {"label": row["scheme"], "color": draw.colour_of(row["scheme"])}


def _errors(runs: Results):
    """Error and coordinates against time, a column per case; figure 8."""
    cases = runs.groups("case")
    heights = {"height_ratios": [1.7, 1, 1, 1]}
    looks = {name: {"color": draw.colour_of(name)} for name in SCHEMES}
    figure, axes = draw.grid(4, len(cases), (14, 10), sharex=True, gridspec_kw=heights)
    for (top, *lower), (case, group) in zip(axes.T, cases.items(), strict=True):
        draw.errors_over_time(top, group, "scheme", looks)
        top.set(title=case, xlim=(0.0, 4.0))
        for number, axis in enumerate(lower):
            coordinate = partial(lambda n, row: 1e3 * row["series"]["feature_m"][:, n], number)
            draw.over_time(axis, group, coordinate, "scheme", looks)
            axis.axhline(1e3 * group.rows[0]["target_m"][number], color="0.3", linestyle="--")
            axis.set(xlabel="time, s", ylabel=f"ball {'xyz'[number]}, mm")
            axis.label_outer()
    axes[0, 0].set_ylabel("error, mm")
    draw.legend(figure)
    return figure


def _views(runs: Results):
    """The ball's way into the camera's view of its end, a circle every 0.1 s; figure 9."""
    cases = runs.groups("case")
    figure, axes = draw.grid(len(cases), len(SCHEMES), (13, 2.55 * len(cases)))
    simulation = simulation_of(Conditions())
    for row, case, group in zip(axes, scoring_cases(len(cases)), cases.values(), strict=True):
        simulation.reset(case.goal_rad)
        image = photo(simulation)
        trails = [
            simulation.views[0].lens.project(run["series"]["feature_m"][:: round(0.1 / 0.008)])
            for run in group
        ]
        points = np.concatenate(trails)
        u, v = 0.5 * (points.min(axis=0) + points.max(axis=0))
        for axis, run, trail in zip(row, group, trails, strict=True):
            axis.imshow(image)
            axis.plot(*trail.T, "o-", color="white", markersize=5.5, linewidth=2.6)
            axis.plot(*trail.T, "o-", markersize=4, linewidth=1.2, **_look(run))
            target = simulation.views[0].lens.project(np.array(run["target_m"]))
            axis.plot(*target, "+", color="white", markersize=13, markeredgewidth=2)
            axis.set(xlim=(u - 160, u + 160), ylim=(v + 120, v - 120), xticks=[], yticks=[])
            axis.set(title=run["scheme"], ylabel=case.name)
            axis.label_outer()
            axis.grid(visible=False)
    return figure


def _paths(runs: Results):
    """The ball's ways in space; figure 10."""
    cases = runs.groups("case")
    figure, (axes,) = draw.grid(1, len(cases), (13, 3.5), subplot_kw={"projection": "3d"})
    for axis, (case, group) in zip(axes, cases.items(), strict=True):
        for run in group:
            x, y, z = run["series"]["feature_m"].T
            axis.plot(x, z, -y, **_look(run))
        axis.plot([x[0]], [z[0]], [-y[0]], "o", color="0.3", markersize=6)
        x, y, z = run["target_m"]
        axis.plot([x], [z], [-y], "+", color="k", markersize=12, markeredgewidth=2)
        axis.set(title=case, xlabel="x, right, m", ylabel="z, away, m", zlabel="-y, up, m")
        axis.locator_params(nbins=4)
        axis.tick_params(labelsize=7)
        axis.set_box_aspect(None, zoom=0.8)  # or the labels are cut off
        axis.set_aspect("equal", adjustable="datalim")  # or a straight way looks wild
    draw.legend(figure)
    return figure


EXPERIMENT = lab.Experiment("servo", measure, claims, TABLES, globals(), figures)
