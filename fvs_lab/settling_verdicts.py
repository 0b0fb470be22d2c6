"""What the runs say to the bounds on the settling time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from fvs_lab.report import Verdict
from fvs_lab.settling_bounds import BANDS
from fvs_lab.settling_runs import (
    EVERYDAY,
    FREE_GAINS,
    IDEAL,
    Run,
)

#: What the bounds leave out and the arm has: a tick until the first command leaves, the drives'
#: dead time and their lag, s.
ALLOWANCE_S = 0.008 + 0.008 + 0.012

#: So many runs must keep a promise for it to be kept.
ENOUGH = 0.95


def verdicts(runs: Sequence[Run]) -> list[Verdict]:
    """What the runs say to the bounds."""
    free = [run for run in runs if run.gains in FREE_GAINS and not run.excluded]
    counted = [run for run in free if run.world != IDEAL]
    ideal = [run for run in free if run.world == IDEAL]
    found = [_bound(counted), _band(counted), _motion(counted, ideal), *_printed(counted)]
    limited = [run for run in runs if run.gains == EVERYDAY]
    return [*found, _limited(limited)] if limited else found


def _decided(part: float, runs: Sequence[Run]) -> bool | None:
    return part >= ENOUGH if runs else None


def _bound(runs: Sequence[Run]) -> Verdict:
    part = share(runs, within)
    slack = [run.bound_s / run.measured_s["5 mm"] for run in runs]
    return Verdict(
        "The corrected bound holds: at least 95 % of the runs settle within it.",
        f"{100 * part:.1f} % of {len(runs)} runs were within 5 mm and 2 mm in the bound's time, "
        "raw, with nothing allowed for the loop's delay. The bound is to zero error: its median is "
        f"{middle(slack):.1f} times the measured time to 5 mm.",
        _decided(part, runs),
    )


def _band(runs: Sequence[Run]) -> Verdict:
    raw = share(runs, within_band)
    allowed = share(runs, lambda run: within_band(run, ALLOWANCE_S))
    slack = [run.band_bound_s["5 mm"] / run.measured_s["5 mm"] for run in runs]
    return Verdict(
        "The sharper bound, on the time to the same 5 mm and 2 mm, holds as well, raw.",
        f"{100 * raw:.1f} % of {len(runs)} runs; {100 * allowed:.1f} % with "
        f"{1e3 * ALLOWANCE_S:.0f} ms allowed for tick, dead time and lag. Median "
        f"{middle(slack):.2f} times the measured time to 5 mm.",
        _decided(raw, runs),
    )


def _motion(runs: Sequence[Run], ideal: Sequence[Run]) -> Verdict:
    def near(run: Run) -> bool:
        predicted = run.predicted_s["5 mm"]
        return abs(run.measured_s["5 mm"] - predicted) <= 0.1 * predicted + ALLOWANCE_S

    def late_ms(some: Sequence[Run], band: str) -> list[float]:
        return [1e3 * (run.measured_s[band] - run.predicted_s[band]) for run in some]

    def late(some: Sequence[Run], band: str) -> str:
        low, median, high = (_quantile(late_ms(some, band), part) for part in (0.025, 0.5, 0.975))
        return f"{median:+.0f} ms (95 % of the runs {low:+.0f} to {high:+.0f})"

    part = share(runs, near)
    without = f"; with ideal drives {late(ideal, '5 mm')} and {late(ideal, '2 mm')}"
    sooner = bool(ideal) and middle(late_ms(runs, "5 mm")) < middle(late_ms(ideal, "5 mm"))
    coasting = (
        " The drives' delay makes the ball arrive sooner, not later: it coasts through the last "
        "millimetres, where the theory slows down."
    )
    return Verdict(
        "The theory predicts the motion itself: time to 5 mm within 10 % and 28 ms.",
        f"True of {100 * part:.1f} % of {len(runs)} runs. Measured minus predicted: to 5 mm "
        f"{late(runs, '5 mm')}, to 2 mm {late(runs, '2 mm')}{without if ideal else ''}."
        f"{coasting if sooner else ''}",
        _decided(part, runs),
    )


def _printed(runs: Sequence[Run]) -> Iterator[Verdict]:
    negative = share(runs, lambda run: run.printed_sliding_s < 0.0)
    kept = share(
        runs, lambda run: run.printed_sliding_s > 0.0 and run.measured_s["5 mm"] <= run.printed_s
    )
    positive = [run for run in runs if run.printed_sliding_s > 0.0]
    factor = [run.printed_sliding_s / run.sliding_s for run in positive]
    long = f" Where it is positive, it is {middle(factor):.1f} times the corrected one."
    yield Verdict(
        "The paper's own formula (36)-(39), as printed, bounds the settling time.",
        f"Its sliding time is negative in {100 * negative:.0f} % of {len(runs)} runs, those with "
        f"α2 < α3; {100 * kept:.0f} % have a positive one and kept it.{long if positive else ''}",
        _decided(kept, runs),
    )


def _limited(runs: Sequence[Run]) -> Verdict:
    part = share(runs, within_band)
    late = [run.measured_s["5 mm"] / run.band_bound_s["5 mm"] for run in runs]
    return Verdict(
        "With the everyday limit of 1 rad/s the bound to 5 mm and 2 mm still holds.",
        f"{100 * part:.1f} % of {len(runs)} runs with the controller's default gains and limits; "
        f"time to 5 mm {middle(late):.2f} times the bound. The bound knows no limits, and the "
        "controller's status calls it so.",
        _decided(part, runs),
    )


# ---- promises kept --------------------------------------------------------------------------


def share(runs: Sequence[Run], kept: Callable[[Run], bool]) -> float:
    """Share of runs that keep a promise; 0 of none.

    Parameters
    ----------
    runs : sequence of Run
        The runs.
    kept : callable
        Of a run: whether it does.
    """
    return float(np.mean([kept(run) for run in runs])) if runs else 0.0


def within(run: Run) -> bool:
    """Whether all bands were reached within the bound to zero."""
    return all(run.measured_s[band] <= run.bound_s for band in BANDS)


def within_band(run: Run, allowance_s: float = 0.0) -> bool:
    """Whether each band was reached within the bound to that band, and an allowance, s."""
    return all(run.measured_s[band] <= run.band_bound_s[band] + allowance_s for band in BANDS)


def middle(values: Sequence[float]) -> float:
    """The median, as a quantile."""
    return _quantile(values, 0.5)


def _quantile(values: Sequence[float], part: float) -> float:
    """A quantile that is one of the values; not a number of none."""
    if not values:
        return float("nan")
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, round(part * (len(ordered) - 1)))]
