"""The curves of the page."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from math import isfinite, nan

import numpy as np
import viser
from viser import uplot

from fvs_dashboard import markup
from fvs_dashboard.board import HISTORY_S, Board

#: Three of them and the inputs fit a window of 768 pixels.
_HEIGHT_PX = 118
_AXES = {"|x|": markup.SKY, "|y|": markup.ORANGE, "|z|": markup.PINK}
_WHITE = "#F2F4F7"
_NUDGE_S = 1e-6
#: Samples that are further apart are not joined by a line, s: viser's charts know no gaps.
_GAP_S = 1.5
_SCALES = tuple(
    uplot.Axis(size=size, gap=gap, space=space, font="11px sans-serif", ticks={"show": False})
    for size, gap, space in ((36, 4, 60.0), (46, 6, 24.0))
)


def _series(label: str, colour: str, width: float = 1.5) -> uplot.Series:
    return uplot.Series(label=label, stroke=colour, width=width, points={"show": False})


def _level(label: str) -> uplot.Series:
    return uplot.Series(**_series(label, markup.GREY, 1.0), dash=(6.0, 4.0))


def _logarithmic(least: float, most: float) -> dict:
    # What is unknown has no logarithm: it is not to be drawn as zero.
    return {"distr": 3, "log": 10, "range": (least, most), "clamp": "unknown"}


class Charts:
    """Error, joint speeds and prediction error over the last seconds.

    Parameters
    ----------
    gui : viser.GuiApi
        Where they are put, in the present container.
    joint_names : sequence of str
        Kinematic order.
    """

    def __init__(self, gui: viser.GuiApi, joint_names: Sequence[str]) -> None:
        self._gui = gui
        self._limit_rad_s = nan
        self._nudge_s = 0.0
        labels = (
            name.removesuffix("_joint").removeprefix("shoulder_").replace("_", " ")
            for name in joint_names
        )
        self._error = self._add(
            "Distance to the target, mm",
            _logarithmic(0.01, 1000.0),
            _series("distance", _WHITE, 2.25),
            *(_series(name, colour, 1.0) for name, colour in _AXES.items()),
        )
        self._speed = self._add(
            "Joint speeds and their limit, rad/s",
            {"range": (0.0, 1.2)},
            *(_series(*both) for both in zip(labels, cycle(markup.COLOURS[:-1]), strict=False)),
            _level("limit"),
        )
        self._ratio = self._add(
            "One-step prediction error (1: as bad as predicting rest)",
            _logarithmic(0.001, 10.0),
            _series("error ratio", markup.SKY, 2.0),
            _level("as bad as none"),
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
            self._limit_rad_s = limit_rad_s  # a new scale rebuilds the chart
            scale = {"range": (0.0, 1.2 * limit_rad_s)}
            self._speed.scales = {**self._speed.scales, "y": scale}
        self._draw(self._error, board.error_mm.window(now_s))
        self._draw(self._speed, board.speed_rad_s.window(now_s), limit_rad_s)
        self._draw(self._ratio, board.ratio.window(now_s), 1.0)

    def _draw(self, chart: viser.GuiUplotHandle, window: np.ndarray, *levels: float) -> None:
        """Draw over the whole length; where nothing is known, nothing is drawn.

        The browser keeps a zoom relative to the length, so that this is constant; it redraws the
        axes only where a range changes, so that it changes by less than one sees.
        """
        time_s, *columns = window.T
        times = np.concatenate(([self._nudge_s - HISTORY_S], time_s, [0.0]))
        lines = [np.pad(since_gap(time_s, one), 1, constant_values=nan) for one in columns]
        chart.data = (times, *lines, *(np.full(len(times), level) for level in levels))


def since_gap(time_s: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Leave out what was before the last gap: the page would draw a line across it.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
        Times, rising, s, and values at them.

    Returns
    -------
    ndarray, shape (n,)
        The values, NaN before the last gap.
    """
    gaps = np.flatnonzero(np.diff(time_s) > _GAP_S)
    since = np.array(values)
    since[: gaps[-1] + 1 if len(gaps) else 0] = nan
    return since
