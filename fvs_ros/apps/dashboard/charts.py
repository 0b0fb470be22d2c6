"""The curves of the page."""

from __future__ import annotations

from math import isfinite, nan

import numpy as np
import viser
from viser import uplot

from fvs_ros.apps.dashboard import markup
from fvs_ros.apps.dashboard.view import Curves

#: Four of them fit a window of 768 pixels.
_HEIGHT_PX = 118
_JOINTS = ("pan", "lift", "elbow", "wrist 1", "wrist 2", "wrist 3")
_JOINT_COLOURS = (
    markup.SKY,
    markup.ORANGE,
    markup.GREEN,
    markup.YELLOW,
    markup.PINK,
    markup.VERMILLION,
)
_AXIS_COLOURS = (markup.SKY, markup.ORANGE, markup.PINK)
_WHITE = "#F2F4F7"
_NUDGE_S = 1e-6
#: Samples that are further apart are not joined by a line, s: viser's charts know no gaps.
_GAP_S = 1.5
_TICKS = {"show": False}
_AXES = (
    uplot.Axis(size=36, gap=4, space=60.0, font="11px sans-serif", ticks=_TICKS),
    uplot.Axis(size=46, gap=6, space=24.0, font="11px sans-serif", ticks=_TICKS),
)


def _series(label: str, colour: str, width: float = 1.5, dashed: bool = False) -> uplot.Series:
    one = uplot.Series(label=label, stroke=colour, width=width, points={"show": False})
    if dashed:
        one["dash"] = (6.0, 4.0)
    return one


class Charts:
    """Error, joint speeds, prediction error and exponents over the last seconds.

    Parameters
    ----------
    gui : viser.GuiApi
        Where they are put, in the present container.
    history_s : float
        Length of the curves, s.
    """

    def __init__(self, gui: viser.GuiApi, history_s: float) -> None:
        self._gui = gui
        self._history_s = history_s
        self._limit_rad_s = nan
        self._nudge_s = 0.0
        self._error = self._add(
            "Distance to the target, mm",
            # What is unknown has no logarithm either: it is not to be drawn as zero.
            {"distr": 3, "log": 10, "range": (0.01, 1000.0), "clamp": "unknown"},
            *(_series(f"|{a}|", c, 1.0) for a, c in zip("xyz", _AXIS_COLOURS, strict=True)),
            _series("distance", _WHITE, 2.25),
        )
        self._speed = self._add(
            "Joint speeds and their limit, rad/s",
            {"range": (0.0, 1.2)},
            *(_series(n, c) for n, c in zip(_JOINTS, _JOINT_COLOURS, strict=True)),
            _series("limit", markup.GREY, 1.0, dashed=True),
        )
        self._ratio = self._add(
            "One-step prediction error (1: as bad as predicting rest)",
            {"distr": 3, "log": 10, "range": (0.001, 10.0), "clamp": "unknown"},
            _series("error ratio", markup.SKY, 2.0),
            _series("as bad as none", markup.GREY, 1.0, dashed=True),
        )
        self._exponent = self._add(
            "Exponents of the sliding mode law",
            {"range": (0.0, 2.0)},
            *(_series(f"γ{a}", c, 2.0) for a, c in zip("xyz", _AXIS_COLOURS, strict=True)),
        )

    def _add(self, title: str, scale: dict, *series: uplot.Series) -> viser.GuiUplotHandle:
        nothing = np.full(2, np.nan)
        return self._gui.add_uplot(
            (np.array([-self._history_s, 0.0]), *(nothing,) * len(series)),
            (uplot.Series(label="s"), *series),
            title=title,
            scales={"x": {"time": False}, "y": scale},
            axes=_AXES,
            legend={"show": True, "live": False},
            cursor={"drag": {"x": False, "y": False}},
            height=_HEIGHT_PX,
            padding=(8, 10, 0, 0),
        )

    def update(self, curves: Curves, limit_rad_s: float) -> None:
        """Draw the newest curves."""
        self._nudge_s = _NUDGE_S - self._nudge_s
        time_s, norm, *parts = curves.error_mm.T
        self._draw(self._error, time_s, *parts, norm)
        if isfinite(limit_rad_s) and limit_rad_s != self._limit_rad_s:
            self._limit_rad_s = limit_rad_s  # the chart is made anew: not oftener than need be
            scale = {"range": (0.0, 1.2 * limit_rad_s)}
            self._speed.scales = {**self._speed.scales, "y": scale}
        self._draw(self._speed, *curves.speed_rad_s.T, level=limit_rad_s)
        self._draw(self._ratio, *curves.ratio.T, level=1.0)
        self._draw(self._exponent, *curves.exponent.T)

    def _draw(
        self,
        chart: viser.GuiUplotHandle,
        time_s: np.ndarray,
        *columns: np.ndarray,
        level: float | None = None,
    ) -> None:
        """Draw over the whole length; where nothing is known, nothing is drawn.

        The page keeps a zoom relative to the length, which therefore stays as it is; and it draws
        the axes anew only where a range changes, which it therefore does, by less than one sees.
        """
        from_s = self._nudge_s - self._history_s
        lines = [np.pad(since_gap(time_s, one), 1, constant_values=nan) for one in columns]
        times = np.concatenate(([from_s], time_s, [0.0]))
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
        At these times; NaN where unknown.

    Returns
    -------
    ndarray, shape (n,)
        The same, and NaN before the last time that nothing was known for long.
    """
    known = np.flatnonzero(np.isfinite(values))
    gaps = np.flatnonzero(np.diff(time_s[known]) > _GAP_S)
    if not len(gaps):
        return values
    since = values.copy()
    since[: known[gaps[-1]] + 1] = nan
    return since
