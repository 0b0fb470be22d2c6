"""Pictures of success and settling time against each disturbance, and of a single trial."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fvs_lab.noise import WHITE
from fvs_lab.robustness_runs import DURATION_S, settled_by, success_rate
from fvs_lab.robustness_worlds import QUANTITIES, Quantity, World
from fvs_lab.style import COLOURS, pyplot, save
from fvs_lab.trials import BOUNDS_M, Outcome

#: For contestants that have no colour of their own in the laboratory.
_SPARE = ("#56B4E9", "#8C564B", "#999999")


@dataclass(frozen=True)
class Disturbance:
    """Something that differs from world to world, in bins.

    Parameters
    ----------
    label : str
        Of the axis.
    value : callable
        How much of it there is in a world.
    edges : tuple of float
        Of the bins; the lower one belongs to the bin, the last one too.
    names : tuple of str
        Of the bins; by default their ends.
    """

    label: str
    value: Callable[[World], float]
    edges: tuple[float, ...]
    names: tuple[str, ...] = ()

    @property
    def bins(self) -> tuple[str, ...]:
        """Names of the bins."""
        ends = zip(self.edges[:-1], self.edges[1:], strict=True)
        return self.names or tuple(f"{low:g}-{high:g}" for low, high in ends)

    def bin_of(self, world: World) -> int:
        """The bin that a world belongs to."""
        place = int(np.searchsorted(self.edges, self.value(world), side="right")) - 1
        return min(max(place, 0), len(self.edges) - 2)


#: Ends of the bins of what is drawn, in the units of their labels.
_EDGES: dict[str, tuple[float, ...]] = {
    "position_noise_m": (0.2, 0.8, 1.4, 2.0),
    "noise_exponent": (1.5, 1.65, 1.8, WHITE),
    "image_rate_hz": (8, 15, 30, 60),
    "latency_s": (0, 25, 50, 75, 100),
    "dropout": (0, 5, 10, 15, 20),
    "focal_error": (-2, -1, 0, 1, 2),
    "depth_error": (-2, -1, 0, 1, 2),
    "encoder_noise_rad": (0, 0.1, 0.2, 0.35, 0.5),
    "joint_lag_s": (0, 25, 50, 75, 100),
    "dead_time_s": (8, 20, 40, 60),
    "drive_gain": (0.8, 0.87, 0.94, 1.0),
}


def _value_of(quantity: Quantity) -> Callable[[World], float]:
    return lambda world: quantity.scale * getattr(world.conditions, quantity.name)


DISTURBANCES = (
    Disturbance("distance, m", lambda world: world.distance_m, (0.1, 0.2, 0.3, 0.4, 0.5)),
    Disturbance("camera carried round, °", lambda world: world.turn_deg, (0.0, 10.0, 20.0, 30.0)),
    Disturbance(
        "camera bumped in mid-run, °",
        lambda world: -1.0 if world.bump is None else world.bump_deg,
        (-1.0, 0.0, 5.0, 10.0),
        ("not", "0-5", "5-10"),
    ),
    *(Disturbance(one.axis, _value_of(one), _EDGES[one.name]) for one in QUANTITIES),
)

Results = Mapping[str, Sequence[Outcome]]


def varied(worlds: Sequence[World]) -> tuple[Disturbance, ...]:
    """The disturbances that differ from world to world; the first one if none does."""
    return (
        tuple(one for one in DISTURBANCES if len({one.value(world) for world in worlds}) > 1)
        or DISTURBANCES[:1]
    )


def success(folder: Path, worlds: Sequence[World], results: Results) -> str:
    """Draw success rates against each disturbance; returns the file's name."""

    def rate(outcomes: Sequence[Outcome]) -> tuple[float, float, float]:
        share = success_rate(outcomes)
        return 100 * share.value, 100 * share.low, 100 * share.high

    return _panels(folder / "success.png", worlds, results, rate, "settled, %")


def settling(folder: Path, worlds: Sequence[World], results: Results) -> str:
    """Draw settling times against each disturbance; returns the file's name."""

    def times(outcomes: Sequence[Outcome]) -> tuple[float, float, float]:
        middle, late = (min(settled_by(outcomes, share), DURATION_S) for share in (0.5, 0.9))
        return middle, middle, late

    return _panels(folder / "settling.png", worlds, results, times, "to 5 mm, s")


def jitter(folder: Path, worlds: Sequence[World], results: Results) -> str:
    """Draw jitter at rest against each disturbance; returns the file's name."""

    def jitters(outcomes: Sequence[Outcome]) -> tuple[float, float, float]:
        found = [1e3 * one.jitter_rad_s for one in outcomes if not one.failure] or [np.nan]
        low, middle, high = np.percentile(found, (10, 50, 90), method="nearest")
        return middle, low, high

    return _panels(folder / "jitter.png", worlds, results, jitters, "jitter, mrad/s")


def _panels(
    path: Path,
    worlds: Sequence[World],
    results: Results,
    measure: Callable[[Sequence[Outcome]], tuple[float, float, float]],
    label: str,
) -> str:
    """Draw a panel a disturbance: a value and the ends of its bar for each bin and contestant."""
    plt = pyplot()
    panels = varied(worlds)
    columns = min(len(panels), 4)
    rows = math.ceil(len(panels) / columns)
    figure, axes = plt.subplots(
        rows,
        columns,
        figsize=(3.25 * columns, 3.3 * rows),
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    for axis in axes.flat[len(panels) :]:
        axis.set_visible(False)
    colours = colours_of(list(results))
    for axis, disturbance in zip(axes.flat, panels, strict=False):
        bins = [disturbance.bin_of(world) for world in worlds]
        for place, (name, outcomes) in enumerate(results.items()):
            shift = min(0.12, 0.8 / len(results)) * (place - 0.5 * (len(results) - 1))
            parts = [
                (number, measure(chosen))
                for number in range(len(disturbance.bins))
                if (
                    chosen := [
                        one for one, bin_ in zip(outcomes, bins, strict=True) if bin_ == number
                    ]
                )
            ]
            x = np.array([number + shift for number, _ in parts])
            value, low, high = np.array([numbers for _, numbers in parts]).T
            axis.errorbar(
                x,
                value,
                (value - low, high - value),
                color=colours[name],
                marker="o",
                markersize=4,
                linewidth=1.4,
                elinewidth=0.8,
            )
        counts = [bins.count(number) for number in range(len(disturbance.bins))]
        labels = [f"{one}\n({n})" for one, n in zip(disturbance.bins, counts, strict=True)]
        axis.set_xticks(range(len(labels)), labels)
        axis.set_xlabel(disturbance.label)
        axis.grid(visible=False, axis="x")
    for axis in axes[:, 0]:
        axis.set_ylabel(label)
    handles = [
        plt.Line2D([], [], color=colour, marker="o", label=name) for name, colour in colours.items()
    ]
    figure.legend(handles=handles, loc="outside lower center", ncol=2 * columns)
    save(figure, path)
    return path.name


def one_trial(path: Path, world: World, results: Mapping[str, Outcome]) -> None:
    """Draw the error over time of every contestant in one world; the runs must be recorded."""
    plt = pyplot()
    figure, axis = plt.subplots(figsize=(9.0, 5.0), layout="constrained")
    for (name, one), colour in zip(
        results.items(), colours_of(list(results)).values(), strict=True
    ):
        axis.semilogy(
            one.series["time_s"],
            1e3 * one.series["error_m"],
            color=colour,
            label=f"{name}: {one.failure or f'settled after {one.settled_s:.2f} s'}",
        )
    axis.axhline(1e3 * BOUNDS_M["5 mm"], color="black", linewidth=0.8, linestyle=":")
    if world.bump is not None:
        axis.axvline(world.bump.time_s, color="#c0392b", linewidth=0.8)
        axis.annotate(
            " camera bumped", (world.bump.time_s, axis.get_ylim()[1]), color="#c0392b", va="top"
        )
    axis.set_xlabel("time since the target was given, s")
    axis.set_ylabel("error, mm")
    axis.set_title(f"Trial {world.number}")
    axis.legend()
    save(figure, path)


def colours_of(names: Sequence[str]) -> dict[str, str]:
    """A colour for every contestant, the laboratory's where there is one."""
    colours: dict[str, str] = {}
    spare = iter(_SPARE * len(names))
    for name in names:
        # "oracle, proportional" has the oracle's.
        own = COLOURS.get(name.split(",")[0])
        colours[name] = own if own and own not in colours.values() else next(spare)
    return colours
