"""The pictures of the servoing experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fvs_lab.figures import bound_line, colour_of, dots, error_curve, legend, panels, plain_ticks
from fvs_lab.outcome import BOUNDS_M
from fvs_lab.regimes import REGIMES, Regime
from fvs_lab.results import METRICS, Results
from fvs_lab.search import Tuned
from fvs_lab.style import pyplot
from fvs_lab.trials import Case, Conditions, simulation_of
from fvs_tools.schemes import SCHEMES

_CIRCLE_S = 0.1
_VIEW_PX = (320, 240)
#: Rows of the tables that are drawn.
_DRAWN = (*SCHEMES, "oracle, sliding mode")
_AXES = "xyz"


def _look(scheme: str) -> dict[str, Any]:
    style = ":" if scheme.startswith("oracle") else "-"
    return {"color": colour_of(scheme), "linestyle": style, "label": scheme}


def _run(runs: Results, scheme: str, case: Case) -> Mapping[str, Any]:
    return runs.where(scheme=scheme, case=case.name).rows[0]


def summary(runs: Results):
    """Draw all settling times, a panel per regime."""
    figure, (axes,) = panels(1, len(REGIMES), (15, 3.6), sharey=True)
    for axis, regime in zip(axes, REGIMES, strict=True):
        schemes = runs.where(regime=regime.name).groups("scheme")
        times = {name: ones.values("to_5mm_s") for name, ones in schemes.items()}
        dots(axis, times, regime.duration_s, named=axis is axes[0])
        axis.set(title=regime.title, xlabel=METRICS["to_5mm_s"].label, xlim=(0.0, None))
    return figure


def errors(runs: Results, regime: Regime, cases: Sequence[Case]):
    """Draw error and coordinates against time, a column per experiment."""
    heights = {"height_ratios": [1.7, *(1 for _ in _AXES)]}
    size = (14, 10)
    figure, grid = panels(1 + len(_AXES), len(cases), size, sharex=True, gridspec_kw=heights)
    last_s = 0.0
    for (top, *lower), case in zip(grid.T, cases, strict=True):
        for scheme in _DRAWN:
            run = _run(runs, scheme, case)
            error_curve(top, run["series"], **_look(scheme))
            last_s = max(last_s, min(run["to_5mm_s"], regime.duration_s))
            for number, axis in enumerate(lower):
                times_s, ball_m = run["series"]["time_s"], run["series"]["ball_m"]
                axis.plot(times_s, 1e3 * ball_m[:, number], **_look(scheme))
        bound_line(top, 1e3 * BOUNDS_M["5 mm"])
        top.set(title=case.name, ylim=(0.1, 600.0))
        for axis, target_m in zip(lower, run["target_m"], strict=True):
            axis.axhline(1e3 * target_m, color="0.3", linestyle="--", linewidth=1)
        lower[-1].set_xlabel("time, s")
    # All that is drawn has settled, and some rest.
    grid[0, 0].set(xlim=(0.0, min(regime.duration_s, 1.25 * last_s + 0.3)), ylabel="error, mm")
    for axis, name in zip(grid[1:, 0], _AXES, strict=True):
        axis.set_ylabel(f"ball {name}, mm")
    legend(figure, grid[0, 0], len(_DRAWN))
    return figure


def views(runs: Results, cases: Sequence[Case]):
    """Draw the ball's way into the camera's view of its end."""
    names = list(SCHEMES)
    figure, grid = panels(len(cases), len(names), (13, 2.55 * len(cases)))
    simulation = simulation_of(Conditions())
    camera = simulation.intrinsics
    for row, case in zip(grid, cases, strict=True):
        simulation.reset(case.goal_rad)
        simulation.full_frames = True
        frame = simulation.look().frame
        simulation.full_frames = False
        assert frame is not None
        shown = [_run(runs, name, case) for name in names]
        trails = [camera.project(_circles(run["series"])) for run in shown]
        u0, v0 = _corner(np.concatenate(trails), camera.width, camera.height)
        for axis, name, run, trail in zip(row, names, shown, trails, strict=True):
            axis.imshow(frame.rgb)
            axis.plot(*trail.T, "o-", color="white", markersize=5.5, linewidth=2.6)
            axis.plot(*trail.T, "o-", color=colour_of(name), markersize=4, linewidth=1.2)
            target = camera.project(np.array(run["target_m"]))
            axis.plot(*target, "+", color="white", markersize=13, markeredgewidth=2)
            axis.set(xlim=(u0, u0 + _VIEW_PX[0]), ylim=(v0 + _VIEW_PX[1], v0), xticks=[], yticks=[])
            axis.grid(visible=False)
        row[0].set_ylabel(case.name)
    for axis, name in zip(grid[0], names, strict=True):
        axis.set_title(name)
    return figure


def _circles(series: Mapping[str, np.ndarray]) -> np.ndarray:
    """Ball positions a circle apart in time."""
    step = max(1, round(_CIRCLE_S / float(np.diff(series["time_s"][:2])[0])))
    return series["ball_m"][::step]


def _corner(points: np.ndarray, width: int, height: int) -> np.ndarray:
    """Upper left corner of a view with the points in its middle, within the image."""
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    view = np.array(_VIEW_PX)
    return np.clip(middle - 0.5 * view, 0.0, np.array([width, height]) - view)


def paths(runs: Results, cases: Sequence[Case]):
    """Draw the ball's ways in space."""
    figure, (axes,) = panels(1, len(cases), (13, 3.5), subplot_kw={"projection": "3d"})
    for axis, case in zip(axes, cases, strict=True):
        for scheme in _DRAWN:
            run = _run(runs, scheme, case)
            x, y, z = run["series"]["ball_m"].T
            axis.plot(x, z, -y, **_look(scheme))
        axis.plot([x[0]], [z[0]], [-y[0]], "o", color="0.3", markersize=6)
        x, y, z = run["target_m"]
        axis.plot([x], [z], [-y], "+", color="k", markersize=12, markeredgewidth=2)
        axis.set_title(case.name)
        axis.set(xlabel="x, right, m", ylabel="z, away, m", zlabel="-y, up, m")
        axis.locator_params(nbins=4)
        axis.tick_params(labelsize=7)
        axis.set_box_aspect(None, zoom=0.8)  # or the labels are cut off
        axis.set_aspect("equal", adjustable="datalim")  # or a straight way looks wild
    legend(figure, axes[0], len(_DRAWN))
    return figure


def trade(found: Mapping[tuple[str, str], Sequence[Tuned]], jitter_bound_rad_s: float):
    """Draw settling time against jitter of all candidates with a speed limit."""
    plt = pyplot()
    figure, axis = plt.subplots(figsize=(8, 5), layout="constrained")
    for name in SCHEMES:
        tried = [one for ones in found["jitter", name] for one in ones.tried]
        points = np.array(
            [(1e3 * one.jitter_rad_s, one.settled_s) for one in tried if np.isfinite(one.settled_s)]
        ).reshape(-1, 2)
        axis.plot(*points.T, "o", color=colour_of(name), alpha=0.3, markersize=4)
        ordered = points[np.lexsort((points[:, 1], points[:, 0]))]
        best = np.minimum.accumulate(ordered[:, 1])
        front = ordered[np.append(True, np.diff(best) < 0.0)[: len(ordered)]]
        axis.plot(*front.T, "o-", color=colour_of(name), label=name)
    bound_line(axis, 1e3 * jitter_bound_rad_s, upright=True)
    axis.set(xscale="log", xlabel="jitter at rest, mrad/s", ylabel=METRICS["to_5mm_s"].label)
    plain_ticks(axis, (0.6, 0.8, 1.0, 1.5, 2.0, 3.0, 4.0), across=False)
    axis.legend()
    return figure
