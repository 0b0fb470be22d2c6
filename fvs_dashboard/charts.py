"""The curves of the page."""

from __future__ import annotations

from math import isfinite, nan

import numpy as np
import viser
from viser import uplot

from fvs_dashboard import markup
from fvs_dashboard.board import HISTORY_S, Board

#: Three of them and the inputs fit a window of 768 pixels.
_HEIGHT_PX = 118
_JOINTS = {
    "pan": markup.SKY,
    "lift": markup.ORANGE,
    "elbow": markup.GREEN,
    "wrist 1": markup.YELLOW,
    "wrist 2": markup.PINK,
    "wrist 3": markup.VERMILLION,
}
_AXES = {"|x|": markup.SKY, "|y|": markup.ORANGE, "|z|": markup.PINK}
_WHITE = "#F2F4F7"
_NUDGE_S = 1e-6
#: Samples that are further apart are not joined by a line, s: viser's charts know no gaps.
_GAP_S = 1.5
_SCALES = tuple(
    uplot.Axis(size=size, gap=gap, space=space, font="11px sans-serif", ticks={"show": False})
    for size, gap, space in ((36, 4, 60.0), (46, 6, 24.0))
)


def _series(label: str, colour: str, width: float = 1.5, dashed: bool = False) -> uplot.Series:
    one = uplot.Series(label=label, stroke=colour, width=width, points={"show": False})
    if dashed:
        one["dash"] = (6.0, 4.0)
    return one


class Charts:
    """Error, joint speeds and prediction error over the last seconds.

    Parameters
    ----------
    gui : viser.GuiApi
        Where they are put, in the present container.
    """

    def __init__(self, gui: viser.GuiApi) -> None:
        self._gui = gui
        self._limit_rad_s = nan
        self._nudge_s = 0.0
        self._error = self._add(
            "Distance to the target, mm",
            # What is unknown has no logarithm either: it is not to be drawn as zero.
            {"distr": 3, "log": 10, "range": (0.01, 1000.0), "clamp": "unknown"},
            _series("distance", _WHITE, 2.25),
            *(_series(name, colour, 1.0) for name, colour in _AXES.items()),
        )
        self._speed = self._add(
            "Joint speeds and their limit, rad/s",
            {"range": (0.0, 1.2)},
            *(_series(name, colour) for name, colour in _JOINTS.items()),
            _series("limit", markup.GREY, 1.0, dashed=True),
        )
        self._ratio = self._add(
            "One-step prediction error (1: as bad as predicting rest)",
            {"distr": 3, "log": 10, "range": (0.001, 10.0), "clamp": "unknown"},
            _series("error ratio", markup.SKY, 2.0),
            _series("as bad as none", markup.GREY, 1.0, dashed=True),
        )

    def _add(self, title: str, scale: dict, *series: uplot.Series) -> viser.GuiUplotHandle:
        nothing = np.full(2, np.nan)
        return self._gui.add_uplot(
            (np.array([-HISTORY_S, 0.0]), *(nothing,) * len(series)),
            (uplot.Series(label="s"), *series),
            title=title,
            scales={"x": {"time": False}, "y": scale},
            axes=_SCALES,
            legend={"show": True, "live": False},
            cursor={"drag": {"x": False, "y": False}},
            height=_HEIGHT_PX,
            padding=(8, 10, 0, 0),
        )

    def update(self, board: Board, now_s: float) -> None:
        """Draw the newest curves."""
        self._nudge_s = _NUDGE_S - self._nudge_s
        limit_rad_s = board.limit("max_joint_velocity_rad_s")
        if isfinite(limit_rad_s) and limit_rad_s != self._limit_rad_s:
            self._limit_rad_s = limit_rad_s  # the chart is made anew: not oftener than need be
            scale = {"range": (0.0, 1.2 * limit_rad_s)}
            self._speed.scales = {**self._speed.scales, "y": scale}
        self._draw(self._error, board.error_mm.window(now_s))
        self._draw(self._speed, board.speed_rad_s.window(now_s), level=limit_rad_s)
        self._draw(self._ratio, board.ratio.window(now_s), level=1.0)

    def _draw(
        self, chart: viser.GuiUplotHandle, window: np.ndarray, level: float | None = None
    ) -> None:
        """Draw over the whole length; where nothing is known, nothing is drawn.

        The page keeps a zoom relative to the length, which therefore stays as it is; and it draws
        the axes anew only where a range changes, which it therefore does, by less than one sees.
        """
        time_s, *columns = window.T
        times = np.concatenate(([self._nudge_s - HISTORY_S], time_s, [0.0]))
        lines = [np.pad(since_gap(time_s, one), 1, constant_values=nan) for one in columns]
        if level is not None:
            lines.append(np.full(len(times), level))
        chart.data = (times, *lines)


def since_gap(time_s: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Leave out what was before the last gap: the page would draw a line across it.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Times, rising, s.
    values : ndarray, shape (n,)
        At these times.

    Returns
    -------
    ndarray, shape (n,)
        The same, and NaN before the last time that nothing was known for long.
    """
    gaps = np.flatnonzero(np.diff(time_s) > _GAP_S)
    since = np.array(values)
    since[: gaps[-1] + 1 if len(gaps) else 0] = nan
    return since
