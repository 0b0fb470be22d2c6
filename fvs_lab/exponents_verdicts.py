"""What the numbers say to the paper's claims about the exponent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from fvs_lab.exponents_variants import (
    ADAPTIVE,
    ADAPTIVE_SCALED,
    EXPONENTS,
    IMPLICIT,
    LITERAL,
    LITERAL_REACHING,
    NOISY,
    REACHING,
    SILENT,
    UNSTABLE,
    Key,
    Results,
    literal_limits,
)
from fvs_lab.report import Verdict
from fvs_lab.statistics import all_hold, median, ratio_of_medians


def verdicts(results: Mapping[Key, Results]) -> list[Verdict]:
    """What the numbers say to the paper's claims.

    Parameters
    ----------
    results : mapping
        Results by world, form and exponent.
    """
    return [
        _printed_law(results),
        _faster(results),
        _faster_at_its_speed(results),
        _chatter(results),
        _adaptive(results),
        _worth_having(results),
    ]


def _printed_law(results: Mapping[Key, Results]) -> Verdict:
    tuned = _settled_share(results[SILENT, LITERAL, UNSTABLE])
    slow = _settled_share(results[SILENT, LITERAL, "0.5"])
    k4_limit, k1_limit = literal_limits()
    reaching, literal = REACHING, LITERAL_REACHING
    return Verdict(
        "The law as printed can be run at 125 Hz with reaching gains that suit the implicit form.",
        f"At 125 Hz it needs k4 below {k4_limit:.4f} and k1 below {k1_limit:.2f}. With k1 = "
        f"{reaching['k1']:g}, k4 = {reaching['k4']:g} {100 * tuned:.0f} % of the runs reached "
        f"5 mm (exponent 0.5, no noise); with k1 = {literal['k1']:g}, k2 = {literal['k2']:g}, "
        f"k4 = {literal['k4']:g} {100 * slow:.0f} % did. The implicit form has no such condition.",
        tuned >= 0.95,
    )


def _faster(results: Mapping[Key, Results]) -> Verdict:
    chosen = [results[SILENT, IMPLICIT, f"{one:g}"] for one in EXPONENTS]
    times = [median(one.settling_s["5 mm"]).value for one in chosen]
    return Verdict(
        "The smaller the exponent, the sooner the ball is within 5 mm (errors below 1 m).",
        f"Median settling, s, implicit without noise: {_list(EXPONENTS, times)}.",
        _rising(times),
    )


def _faster_at_its_speed(results: Mapping[Key, Results]) -> Verdict:
    chosen = [results[SILENT, IMPLICIT, f"{one:g}"] for one in EXPONENTS]
    paces = [median(one.pace).value for one in chosen]
    paths = [median(one.path_ratio).value for one in chosen]
    best = EXPONENTS[int(np.argmin(paces))]
    return Verdict(
        "The smaller the exponent, the better a given top speed is used.",
        "A small exponent also drives faster from the start. Settling time over the time that the "
        f"way takes at the run's own top speed: {_list(EXPONENTS, paces)}; best at {best:g}. Where "
        "the exponent is near 0 each axis goes at nearly the same speed, however far it has to go, "
        f"and the ball's way bends: {paths[0]:.2f} times the straight line at {EXPONENTS[0]:g}, "
        f"{paths[EXPONENTS.index(0.5)]:.2f} at 0.5.",
        _rising(paces),
    )


def _chatter(results: Mapping[Key, Results]) -> Verdict:
    def jitter(world: str, form: str, exponent: str) -> float:
        return 1e3 * median(results[world, form, exponent].jitter_rad_s).value

    ratio = ratio_of_medians(
        results[SILENT, LITERAL, "0.1"].jitter_rad_s, results[SILENT, LITERAL, "0.5"].jitter_rad_s
    )
    return Verdict(
        "Small exponents chatter at the goal.",
        "As printed and without noise the command of exponent 0.1 jumps by "
        f"{jitter(SILENT, LITERAL, '0.1'):.1f} mrad/s from tick to tick at rest, that of 0.5 by "
        f"{jitter(SILENT, LITERAL, '0.5'):.1f}: {ratio.text(0)} times. Solved implicitly it is "
        f"{jitter(SILENT, IMPLICIT, '0.1'):.1f} against {jitter(SILENT, IMPLICIT, '0.5'):.1f}, and "
        f"with 1 mm noise {jitter(NOISY, IMPLICIT, '0.1'):.1f} against "
        f"{jitter(NOISY, IMPLICIT, '0.5'):.1f}.",
        ratio.above(2.0),
    )


def _adaptive(results: Mapping[Key, Results]) -> Verdict:
    time = ratio_of_medians(
        results[SILENT, IMPLICIT, ADAPTIVE].settling_s["5 mm"],
        results[SILENT, IMPLICIT, "0.1"].settling_s["5 mm"],
    )
    printed, noisy = (
        ratio_of_medians(
            results[world, form, ADAPTIVE].jitter_rad_s, results[world, form, "0.5"].jitter_rad_s
        )
        for world, form in ((SILENT, LITERAL), (NOISY, IMPLICIT))
    )
    parts = (time.below(1.2), printed.below(2.0), noisy.below(2.0))
    return Verdict(
        "The adaptive exponent 0.1 → 0.5 is as fast as 0.1 (within a fifth) and as calm as 0.5 "
        "(within a factor of two).",
        f"Settling time {time.text()} times that of 0.1 (implicit, no noise); jitter "
        f"{printed.text()} times that of 0.5 as printed without noise, {noisy.text()} times "
        "implicit with 1 mm noise.",
        all_hold(parts),
    )


def _worth_having(results: Mapping[Key, Results]) -> Verdict:
    ours, paper = results[NOISY, IMPLICIT, ADAPTIVE_SCALED], results[NOISY, IMPLICIT, ADAPTIVE]
    jitter = ratio_of_medians(paper.jitter_rad_s, ours.jitter_rad_s)
    time, close = (
        ratio_of_medians(ours.settling_s[name], paper.settling_s[name]) for name in ("5 mm", "2 mm")
    )
    peak = ratio_of_medians(ours.peak_rad_s, paper.peak_rad_s)
    return Verdict(
        "With 1 mm noise an exponent that ends near 1 (0.375 → 0.9, α2 and α3 raised to about the "
        "same top speed) is at least twice as calm as the paper's 0.1 → 0.5, and no more than a "
        "fifth slower to 5 mm.",
        f"The paper's exponents jitter {jitter.text(1)} times as much. Settling time of 0.375 → "
        f"0.9 over that of 0.1 → 0.5: {time.text()} to 5 mm, {close.text()} to 2 mm, at "
        f"{peak.value:.2f} times the top speed.",
        all_hold((jitter.above(2.0), time.below(1.2))),
    )


def _settled_share(results: Results) -> float:
    return float(np.mean(np.isfinite(results.settling_s["5 mm"])))


def _rising(values: Sequence[float]) -> bool:
    """Whether no value is below the one before; never after never counts as rising."""
    return all(after >= before for before, after in pairwise(values))


def _list(names: Sequence[float], values: Sequence[float]) -> str:
    pairs = zip(names, values, strict=True)
    return ", ".join(f"{text_of(value)} at {name:g}" for name, value in pairs)


def text_of(value: float) -> str:
    """Two digits, or "never"."""
    return f"{value:.2f}" if np.isfinite(value) else "never"
