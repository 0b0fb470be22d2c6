"""Tables and figures of what is beyond the paper."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from fvs_lab.beyond_camera import KEPT, MOMENTS
from fvs_lab.experiment import Found, Named
from fvs_lab.figures import bound_line, colour_of, dots, legend, panels, plain_ticks, ranges
from fvs_lab.results import METRICS, Metric, Results, number_text, searches, settled, span, table
from fvs_lab.spot_check import rows as spot_check_rows

_SHOWN = METRICS | {
    "over_5mm": Metric("to 5 mm over floor"),
    "over_2mm": Metric("to 2 mm over floor"),
    "over_1mm": Metric("to 1 mm over floor"),
    "over_clairvoyant": Metric("over clairvoyant"),
    "later_s": Metric("later by, ms", 1e3, 0),
    "rms_sigma": Metric("final rms, σ"),
    "slowdown": Metric("over undisturbed"),
    "stated": Metric("the fit says, %", 100, 3),
    "seen": Metric("off from what the camera sees, %", 100, 3),
    "metric": Metric("off in metres, %", 100, 3),
    "rms_m": Metric("rms, mm", 1e3),
}
#: Columns of a recording: header, column, factor and digits.
_MINUTE = (
    ("images", "images", 1, 0),
    ("fit and distillation, s of one core", "fit_s", 1, 1),
    ("chain, box M, %", "chain_box", 100, 3),
    ("chain, workspace, %", "chain_workspace", 100, 3),
    ("networks distilled from it, box M, %", "distilled_box", 100, 2),
    ("the paper's training, box M, %", "paper_box", 100, 2),
    ("workspace, %", "paper_workspace", 100, 0),
    ("images late by, ms", "late_s", 1e3, 1),
    ("found, ms", "found_late_s", 1e3, 1),
)
#: What is slower than this, or never settles, stands here.
_SLOWEST_FLOORS, _SLOWEST_RATIO = 8.0, 4.0


def tables(found: Found) -> Iterator[Named]:
    """All tables, in the order of the page."""
    parts = found.runs.groups("part")
    yield (
        "minutes",
        [
            {"seed": str(row["seed"])}
            | {name: f"{factor * row[key]:.{digits}f}" for name, key, factor, digits in _MINUTE}
            for row in parts["minute"]
        ],
    )
    honesty = {"the fit says, over what it is off": lambda runs: span(runs.values("honesty"))}
    errors = ("stated", "seen", "metric")
    yield "assessments", table(parts["assessment"], {"plant": "what errs"}, errors, honesty, _SHOWN)
    scheme = {"scheme": "scheme"}
    metrics = ["over_5mm", "over_clairvoyant", "over_2mm", "over_1mm", "jitter_rad_s",
               "peak_joint_speed_rad_s"]  # fmt: skip
    cells = {
        "settled": settled,
        "slowest 10 %, from": lambda runs: _quantile(runs, 0.9),
        "worst case": lambda runs: _quantile(runs, 1.0),
        "to 5 mm, searches": searches("over_5mm"),
    }
    yield "races", table(parts["race"], scheme, metrics, cells, _SHOWN)
    metrics = ["to_5mm_s", "later_s", "rms_sigma", "jitter_rad_s"]
    furthest = {"largest difference, ms": lambda runs: (
        f"{1e3 * max(runs.values('later_s'), key=abs):+.0f}"
    )}  # fmt: skip
    yield (
        "rendered",
        table(parts["rendered"], scheme, metrics, {"settled": settled, **furthest}, _SHOWN),
    )
    kept = {f"at most {KEPT:g}": lambda runs: f"{sum(runs.values('kept'))} of {len(runs)}"}
    by = {"scheme": "scheme", "moment": "camera moved"}
    yield "camera", table(parts["camera"], by, ("to_5mm_s", "slowdown"), kept, _SHOWN)
    by = {"kind": "what", "label": "how much", "scheme": "scheme"}
    metrics = ["to_5mm_s", "final_rms_m", "jitter_rad_s"]
    yield "worlds", table(parts["world"], by, metrics, {"settled": settled})
    by = {"path": "path", "speed_m_s": "speed, m/s", "feed_forward": "feed-forward"}
    yield "tracking", table(parts["tracking"], {**by, "scheme": "scheme"}, ("rms_m",), known=_SHOWN)
    if found.extra["checks"]:
        yield "spot_check", spot_check_rows(found.extra["checks"])


def _quantile(runs: Results, part: float) -> str:
    """A run itself: nothing lies between a time and never."""
    return number_text(float(np.quantile(runs.values("over_5mm"), part, method="higher")), 2)


def figures(found: Found) -> Iterator[Named]:
    """All figures, in the order of the page."""
    parts = found.runs.groups("part")
    yield "minute", _minute(parts["minute"])
    yield "races", _races(parts["race"])
    yield "camera", _camera(parts["camera"])
    yield "worlds", _worlds(parts["world"])
    yield "tracking", _tracking(parts["tracking"])


def _minute(runs: Results):
    figure, ((axis,),) = panels(1, 1, (8.6, 3.6))
    names = {
        "chain": "best, fitted chain",
        "distilled": "extended, networks distilled from it",
        "paper": "proposed, the paper's training",
    }
    rows = {
        f"{name}, {place}": [100 * value for value in runs.values(f"{key}_{place}")]
        for key, name in names.items()
        for place in ("box", "workspace")
    }
    dots(axis, rows)
    axis.set(xscale="log", xlabel="error of the Jacobian, median over joints, %")
    return figure


def _by_scheme(runs: Results, column: str, factor: float = 1.0) -> dict[str, list[float]]:
    return {
        name: [factor * row[column] for row in ones if column in row]
        for name, ones in runs.groups("scheme").items()
    }


def _races(runs: Results):
    figure, (axes,) = panels(1, 3, (14.0, 6.0), sharey=True)
    for axis, column in zip(axes, ("over_5mm", "over_2mm"), strict=False):
        dots(axis, _by_scheme(runs, column), _SLOWEST_FLOORS, named=axis is axes[0])
        axis.axvline(1.0, color="black", linewidth=0.8)
        plain_ticks(axis, (1, 1.5, 2, 3, 5, 8))
        axis.set_xlabel(_SHOWN[column].label)
    dots(axes[2], _by_scheme(runs, "jitter_rad_s", 1e3), named=False)
    plain_ticks(axes[2], (0.1, 0.2, 0.5, 1, 2, 5, 10))
    axes[2].set_xlabel(METRICS["jitter_rad_s"].label)
    return figure


def _camera(runs: Results):
    figure, (axes,) = panels(1, len(MOMENTS) - 1, (13.5, 3.8), sharey=True)
    for axis, moment in zip(axes, MOMENTS[1:], strict=True):
        rows = _by_scheme(runs.where(moment=moment), "slowdown")
        dots(axis, rows, _SLOWEST_RATIO, named=axis is axes[0])
        bound_line(axis, KEPT, upright=True)
        axis.set(title=moment, xlabel=_SHOWN["slowdown"].label)
        axis.set_xlim(right=_SLOWEST_RATIO + 0.1)
    return figure


def _worlds(runs: Results):
    figure, axes = panels(2, 1, (12.5, 5.4), sharex=True)
    for axis, metric, most in zip(
        axes.flat, ("to_5mm_s", "final_rms_m"), (4.0, np.inf), strict=True
    ):
        one = METRICS[metric]
        bar = _bar(metric, one.factor, most)
        for number, (name, ones) in enumerate(runs.groups("scheme").items()):
            bars = [bar(some) for some in ones.groups("kind", "label").values()]
            places = np.arange(len(bars)) + 0.22 * (number - 1)
            ranges(axis, places, bars, color=colour_of(name), linestyle="", label=name)
        axis.set_ylabel(one.label)
    axes[1, 0].set_yscale("log")
    names = ["\n".join(key) for key in runs.groups("kind", "label")]
    axes[1, 0].set_xticks(range(len(names)), names)
    legend(figure, axes[0, 0], 3)
    return figure


def _bar(metric: str, factor: float, most: float) -> Callable:
    def bar(runs: Results) -> tuple[float, float, float]:
        values = np.minimum(factor * np.array(runs.values(metric)), most)
        low, middle, high = np.quantile(values, (0.1, 0.5, 0.9))
        return middle, low, high

    return bar


def _tracking(runs: Results):
    paths = runs.groups("path")
    figure, (axes,) = panels(1, len(paths), (10.5, 4.0), sharey=True)
    for axis, (kind, some) in zip(axes, paths.items(), strict=True):
        for (name, feed_forward), ones in some.groups("scheme", "feed_forward").items():
            speeds = ones.groups("speed_m_s")
            rms_mm = [1e3 * float(np.median(one.values("rms_m"))) for one in speeds.values()]
            style, end = ("o-", "") if feed_forward else ("x:", ", alone")
            axis.plot(list(speeds), rms_mm, style, color=colour_of(name), label=name + end)
        axis.set(yscale="log", title=kind, xlabel="speed of the target, m/s")
    axes[0].set_ylabel("distance from the target, rms, mm")
    legend(figure, axes[0], 6)
    return figure
