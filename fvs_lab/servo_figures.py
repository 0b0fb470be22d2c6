"""The pictures of the servoing experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fvs_lab.statistics import median
from fvs_lab.style import COLOURS, pyplot, save
from fvs_lab.trials import BOUNDS_M, Case, Conditions, Outcome, simulation_of
from fvs_tools.schemes import SCHEMES

if TYPE_CHECKING:
    from fvs_lab.search import Found
    from fvs_lab.servo_terms import Regime

#: Every so many ticks a point is drawn.
_EVERY = 3
_CIRCLE_S = 0.1
_VIEW_PX = (320, 240)
#: Rows of the tables that are drawn, and how.
_DRAWN = (*SCHEMES, "oracle, sliding mode")
_AXES = "xyz"


def drawn(outcome: Outcome) -> dict[str, np.ndarray]:
    """The part of a run's time series that the figures show."""
    names = ("time_s", "ball_m", "error_m")
    return {name: outcome.series[name][::_EVERY] for name in names if name in outcome.series}


def _colour(row: str) -> str:
    if row in COLOURS:
        return COLOURS[row]
    return COLOURS["frozen"] if row.startswith("frozen") else COLOURS["oracle"]


def _line(row: str) -> dict[str, Any]:
    dashed = row.startswith("oracle")
    return {
        "color": _colour(row),
        "linewidth": 1.2 if dashed else 1.7,
        "linestyle": ":" if dashed else "-",
        "label": row,
    }


def summary(
    folder: Path,
    regimes: Sequence[Regime],
    outcomes: Mapping[str, Mapping[str, Sequence[Outcome]]],
) -> str:
    """Draw all settling times, a panel a regime; returns the file's name."""
    plt = pyplot()
    figure, panels = plt.subplots(1, len(regimes), figsize=(15, 3.6), layout="constrained")
    rng = np.random.default_rng(0)
    for panel, regime in zip(panels, regimes, strict=True):
        rows = outcomes[regime.name]
        top_s = regime.duration_s
        for place, (row, ones) in enumerate(reversed(list(rows.items()))):
            times = np.array([one.settled_s for one in ones])
            heights = place + rng.uniform(-0.18, 0.18, times.size)
            panel.plot(
                np.minimum(times, top_s), heights, "o", color=_colour(row), alpha=0.45, markersize=4
            )
            middle = min(median(times.tolist()).value, top_s)
            panel.plot([middle, middle], [place - 0.36, place + 0.36], color=_colour(row), lw=3)
        slowest_s = max(min(one.settled_s, top_s) for ones in rows.values() for one in ones)
        panel.set(
            title=regime.title, xlabel="settling time to 5 mm (s)", xlim=(0.0, 1.04 * slowest_s)
        )
        panel.set_yticks(range(len(rows)), list(reversed(list(rows))))
    save(figure, folder / "summary.png")
    return "summary.png"


def errors(
    folder: Path, regime: Regime, rows: Mapping[str, Sequence[Outcome]], cases: Sequence[Case]
) -> str:
    """Draw error and coordinates against time, a column an experiment; the file's name."""
    plt = pyplot()
    figure, grid = plt.subplots(
        4,
        len(cases),
        figsize=(14, 10),
        layout="constrained",
        sharex=True,
        squeeze=False,
        gridspec_kw={"height_ratios": [1.7, 1, 1, 1]},
    )
    end_s = _interesting_s(rows, len(cases), regime.duration_s)
    for column, case in enumerate(cases):
        top = grid[0, column]
        for row in _DRAWN:
            series = drawn(rows[row][column])
            top.semilogy(series["time_s"], 1e3 * series["error_m"], **_line(row))
            for axis in range(3):
                grid[1 + axis, column].plot(
                    series["time_s"], 1e3 * series["ball_m"][:, axis], **_line(row)
                )
        top.axhline(1e3 * BOUNDS_M["5 mm"], color="0.5", linewidth=1)
        top.set(title=case.name, xlim=(0.0, end_s), ylim=(0.1, 600.0))
        for axis in range(3):
            target = rows[_DRAWN[0]][column].target_m[axis]
            grid[1 + axis, column].axhline(1e3 * target, color="0.3", linestyle="--", linewidth=1)
        grid[3, column].set_xlabel("time (s)")
    grid[0, 0].set_ylabel("error (mm)")
    for axis in range(3):
        grid[1 + axis, 0].set_ylabel(f"ball {_AXES[axis]} (mm)")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    name = f"errors_{regime.name}.png"
    save(figure, folder / name)
    return name


def _interesting_s(rows: Mapping[str, Sequence[Outcome]], count: int, duration_s: float) -> float:
    """End of the time axis: all that is drawn has settled, and some rest."""
    last = max(min(rows[row][i].settled_s, duration_s) for row in _DRAWN for i in range(count))
    return min(duration_s, 1.25 * last + 0.3)


def views(folder: Path, rows: Mapping[str, Sequence[Outcome]], cases: Sequence[Case]) -> str:
    """Draw the ball's way into the camera's view of its end; the file's name."""
    plt = pyplot()
    names = list(SCHEMES)
    figure, grid = plt.subplots(
        len(cases),
        len(names),
        figsize=(13, 2.55 * len(cases)),
        layout="constrained",
        squeeze=False,
    )
    simulation = simulation_of(Conditions())
    camera = simulation.intrinsics
    for number, case in enumerate(cases):
        simulation.reset(case.goal_rad)
        simulation.full_frames = True
        frame = simulation.look().frame
        simulation.full_frames = False
        assert frame is not None
        trails = [camera.project(_circles(rows[name][number])) for name in names]
        u0, v0 = _corner(np.concatenate(trails), camera.width, camera.height)
        for column, (name, trail) in enumerate(zip(names, trails, strict=True)):
            axes = grid[number, column]
            axes.imshow(frame.rgb)
            axes.plot(trail[:, 0], trail[:, 1], "o-", color="white", markersize=5.5, linewidth=2.6)
            axes.plot(
                trail[:, 0],
                trail[:, 1],
                "o-",
                color=_colour(name),
                markersize=4,
                linewidth=1.2,
            )
            u, v = camera.project(np.array(rows[name][number].target_m))
            axes.plot(u, v, "+", color="white", markersize=13, markeredgewidth=2)
            axes.set(xlim=(u0, u0 + _VIEW_PX[0]), ylim=(v0 + _VIEW_PX[1], v0))
            axes.set_xticks([])
            axes.set_yticks([])
            axes.grid(False)
            if number == 0:
                axes.set_title(name)
            if column == 0:
                axes.set_ylabel(case.name)
    save(figure, folder / "views.png")
    return "views.png"


def _circles(outcome: Outcome) -> np.ndarray:
    """Ball positions a circle apart in time."""
    time_s, ball_m = outcome.series["time_s"], outcome.series["ball_m"]
    step = max(1, round(_CIRCLE_S / float(time_s[1] - time_s[0])))
    return ball_m[::step]


def _corner(points: np.ndarray, width: int, height: int) -> tuple[float, float]:
    """Upper left corner of a view with the points in its middle, within the image."""
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    u0 = float(np.clip(middle[0] - 0.5 * _VIEW_PX[0], 0.0, width - _VIEW_PX[0]))
    v0 = float(np.clip(middle[1] - 0.5 * _VIEW_PX[1], 0.0, height - _VIEW_PX[1]))
    return u0, v0


def paths(folder: Path, rows: Mapping[str, Sequence[Outcome]], cases: Sequence[Case]) -> str:
    """Draw the ball's ways in space; the file's name."""
    plt = pyplot()
    figure = plt.figure(figsize=(13, 3.5), layout="constrained")
    for number, case in enumerate(cases):
        axes = figure.add_subplot(1, len(cases), number + 1, projection="3d")
        for row in _DRAWN:
            ball = drawn(rows[row][number])["ball_m"]
            axes.plot(ball[:, 0], ball[:, 2], -ball[:, 1], **_line(row))
        one = rows[_DRAWN[0]][number]
        start, target = one.series["ball_m"][0], one.target_m
        axes.plot([start[0]], [start[2]], [-start[1]], "o", color="0.3", markersize=6)
        axes.plot(
            [target[0]], [target[2]], [-target[1]], "+", color="k", markersize=12, markeredgewidth=2
        )
        axes.set_title(case.name)
        axes.set_xlabel("x, right (m)", fontsize=8)
        axes.set_ylabel("z, away (m)", fontsize=8)
        axes.set_zlabel("-y, up (m)", fontsize=8)
        axes.tick_params(labelsize=7)
        axes.locator_params(nbins=4)
        axes.set_box_aspect(None, zoom=0.8)  # or the labels are cut off
        axes.set_aspect("equal", adjustable="datalim")  # or a straight way looks wild
        if number == 0:
            handles, labels = axes.get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    save(figure, folder / "paths.png")
    return "paths.png"


def trade(
    folder: Path, found: Mapping[tuple[str, str], Sequence[Found]], jitter_bound_rad_s: float
) -> str:
    """Draw settling time against jitter of all candidates with a speed limit; the file's name."""
    plt = pyplot()
    figure, panel = plt.subplots(figsize=(8, 5), layout="constrained")
    for name in SCHEMES:
        tried = [one for ones in found["jitter", name] for one in ones.tried]
        tried = [one for one in tried if np.isfinite(one.settled_s)]
        jitter = 1e3 * np.array([one.jitter_rad_s for one in tried])
        settled = np.array([one.settled_s for one in tried])
        panel.plot(jitter, settled, "o", color=_colour(name), alpha=0.3, markersize=4)
        front = _front(jitter, settled)
        panel.plot(jitter[front], settled[front], "o-", color=_colour(name), label=name)
    panel.axvline(1e3 * jitter_bound_rad_s, color="0.4", linestyle="--", linewidth=1)
    panel.set(
        xscale="log",
        yscale="log",
        xlabel="jitter of the command at rest (mrad/s rms, from tick to tick)",
        ylabel="settling time to 5 mm (s)",
    )
    panel.set_yticks([0.6, 0.8, 1.0, 1.5, 2.0, 3.0, 4.0], minor=False)
    panel.yaxis.set_major_formatter("{x:g}")
    panel.yaxis.set_minor_formatter("")
    panel.legend()
    save(figure, folder / "trade.png")
    return "trade.png"


def _front(jitter: np.ndarray, settled: np.ndarray) -> np.ndarray:
    """Indices of the points that no other beats in both, by rising jitter."""
    front, best = [], np.inf
    for index in np.lexsort((settled, jitter)):
        if settled[index] < best:
            front.append(index)
            best = settled[index]
    return np.array(front, dtype=int)
