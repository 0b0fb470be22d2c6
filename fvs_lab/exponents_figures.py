"""The pictures of the comparison of exponents."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fvs_lab.exponents_variants import (
    ADAPTIVE,
    ADAPTIVE_SCALED,
    EXPONENTS,
    IMPLICIT,
    LITERAL,
    NOISY,
    SILENT,
    Key,
    Results,
    exponents_of,
)
from fvs_lab.statistics import median
from fvs_lab.style import pyplot, save
from fvs_lab.trials import Outcome


def errors(runs: Mapping[Key, Outcome], folder: Path) -> str:
    """Draw errors over time for all fixed exponents; returns the file's name."""
    plt = pyplot()
    figure, axes = plt.subplots(
        2, 2, figsize=(11, 7), sharex=True, sharey=True, layout="constrained"
    )
    colours = plt.get_cmap("viridis")(np.linspace(0.0, 0.92, len(EXPONENTS)))
    for row, world in zip(axes, (SILENT, NOISY), strict=True):
        for axis, form in zip(row, (LITERAL, IMPLICIT), strict=True):
            for exponent, colour in zip(EXPONENTS, colours, strict=True):
                if exponent not in exponents_of(world, form):
                    continue
                series = runs[world, form, f"{exponent:g}"].series
                axis.plot(
                    series["time_s"],
                    1e3 * np.maximum(series["error_m"], 1e-6),
                    color=colour,
                    linewidth=1.3,
                    label=f"{exponent:g}",
                )
            axis.axhline(5.0, color="black", linewidth=0.8, linestyle=":")
            # outside, where no curve is
            axis.text(1.01, 5.0, "5 mm", transform=axis.get_yaxis_transform(), va="center")
            axis.set_yscale("log")
            axis.set_ylim(0.05, 600.0)
            axis.set_title(f"{form}, {world}")
        row[0].set_ylabel("distance to the goal, mm")
    for axis in axes[1]:
        axis.set_xlabel("time, s")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, title="exponent", loc="outside right center")
    save(figure, folder / "exponents.png")
    return "exponents.png"


def adaptive(runs: Mapping[Key, Outcome], folder: Path) -> str:
    """Draw adaptive against fixed exponents, with their profile; the file's name."""
    plt = pyplot()
    panels = ((SILENT, LITERAL), (SILENT, IMPLICIT), (NOISY, IMPLICIT))
    shown = (
        ("0.1", "#D55E00", "fixed 0.1"),
        ("0.5", "#009E73", "fixed 0.5"),
        (ADAPTIVE, "#0072B2", f"adaptive {ADAPTIVE}"),
    )
    figure, axes = plt.subplots(
        3, 3, figsize=(12, 8), sharex=True, sharey="row", layout="constrained"
    )
    for column, (world, form) in zip(axes.T, panels, strict=True):
        error, command, profile = column
        error.set_title(f"{form}, {world}")
        for exponent, colour, label in shown:
            series = runs[world, form, exponent].series
            times = series["time_s"]
            error.plot(times, 1e3 * np.maximum(series["error_m"], 1e-6), color=colour, label=label)
            joint = int(np.abs(series["command_rad_s"]).max(axis=0).argmax())
            command.plot(times, series["command_rad_s"][:, joint], color=colour, linewidth=1.0)
        error.set_yscale("log")
        error.set_ylim(0.05, 600.0)
        error.axhline(5.0, color="black", linewidth=0.8, linestyle=":")
        series = runs[world, form, ADAPTIVE].series
        for axis, colour in enumerate(("#0072B2", "#56B4E9", "#CC79A7")):
            profile.plot(
                series["time_s"], series["exponent"][:, axis], color=colour, label="xyz"[axis]
            )
        profile.set_ylim(0.0, 0.6)
        profile.set_xlabel("time, s")
        profile.set_xlim(0.0, 2.5)
    axes[0, 0].set_ylabel("distance to the goal, mm")
    axes[1, 0].set_ylabel("command of the fastest joint,\nrad/s")
    axes[2, 0].set_ylabel("adaptive exponent γ\nof each axis")
    axes[0, 2].legend(loc="upper right")
    axes[2, 2].legend(loc="lower right", title="axis", ncol=3)
    save(figure, folder / "adaptive.png")
    return "adaptive.png"


def summary(results: Mapping[Key, Results], duration_s: float, folder: Path) -> str:
    """Draw settling and jitter over the exponent; the file's name."""
    plt = pyplot()
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.4), layout="constrained")
    lines = (
        (LITERAL, SILENT, "#D55E00", ":", "v"),
        (LITERAL, NOISY, "#D55E00", "-", "v"),
        (IMPLICIT, SILENT, "#0072B2", ":", "o"),
        (IMPLICIT, NOISY, "#0072B2", "-", "o"),
    )
    for form, world, colour, style, mark in lines:
        exponents = exponents_of(world, form)
        chosen = [results[world, form, f"{one:g}"] for one in exponents]
        times = np.array([median(one.settling_s["5 mm"]).value for one in chosen])
        shown = np.where(np.isfinite(times), times, duration_s + 0.15)
        jitter = [max(1e3 * median(one.jitter_rad_s).value, 0.01) for one in chosen]
        look = {"color": colour, "linestyle": style, "marker": mark}
        left.plot(exponents, shown, label=f"{form}, {world}", **look)
        right.plot(exponents, jitter, label=f"{form}, {world}", **look)
    for exponent, place, text, colour in (
        (ADAPTIVE, 0.5, "0.1 → 0.5", "black"),
        (ADAPTIVE_SCALED, 0.9, "0.375 → 0.9,\nfaster", "#CC79A7"),
    ):
        found = results[NOISY, IMPLICIT, exponent]
        for axis, value in (
            (left, median(found.settling_s["5 mm"]).value),
            (right, 1e3 * median(found.jitter_rad_s).value),
        ):
            if np.isfinite(value):
                axis.plot(place, value, "*", color=colour, markersize=13)
                axis.annotate(
                    text,
                    (place, value),
                    textcoords="offset points",
                    xytext=(-8, -4),
                    ha="right",
                    va="top",
                    color=colour,
                )
    left.axhline(duration_s, color="black", linewidth=0.8)
    left.set_ylim(0.0, duration_s + 0.4)
    left.text(0.5, duration_s + 0.4, "never within the run", ha="center", va="top")
    left.set_ylabel("settling to 5 mm, s")
    right.set_yscale("log")
    right.set_ylabel("jitter at rest, mrad/s (0.01: none)")
    for axis in (left, right):
        axis.set_xlabel("exponent γ (for stars: near the goal)")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncol=4)
    save(figure, folder / "summary.png")
    return "summary.png"
