"""What the random worlds say about the schemes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from fvs_lab.report import Verdict
from fvs_lab.robustness_runs import (
    Contestant,
    settled_by,
    success_rate,
    wins,
)
from fvs_lab.statistics import Interval, all_hold, ratio_of_medians
from fvs_lab.trials import Outcome

#: Share of the trials that a robust scheme must master.
WANTED = 0.99

Results = Mapping[str, Sequence[Outcome]]


def best_of(contestants: Sequence[Contestant], results: Results) -> Contestant:
    """The competitor that settles in most worlds; of equals, the one with the shorter median."""

    def rank(one: Contestant) -> tuple[float, float]:
        outcomes = results[one.name]
        return -success_rate(outcomes).value, settled_by(outcomes, 0.5)

    return min((one for one in contestants if not one.knows_truth), key=rank)


def verdicts(contestants: Sequence[Contestant], results: Results) -> list[Verdict]:
    """Judge everybody, and the lead of the best competitor over the paper's schemes."""
    found = [
        _enough(one.name, results[one.name])
        for one in sorted(contestants, key=lambda one: one.knows_truth)
    ]
    if all(one.knows_truth for one in contestants):
        return found
    best = best_of(contestants, results)
    rivals = [one for one in contestants if one.of_paper and one is not best]
    return [*found, _lead(best, rivals, results)] if rivals else found


def rate_text(rate: Interval) -> str:
    """``98.4 % (96.9 to 99.2)``."""
    return f"{100 * rate.value:.1f} % ({100 * rate.low:.1f} to {100 * rate.high:.1f})"


def _enough(name: str, outcomes: Sequence[Outcome]) -> Verdict:
    rate = success_rate(outcomes)
    failed = sum(bool(one.failure) for one in outcomes)
    return Verdict(
        f"At least {100 * WANTED:g} % of the trials of {name} settle.",
        f"{rate_text(rate)} of {rate.count}; {failed} failed.",
        rate.above(WANTED),
    )


def _lead(best: Contestant, rivals: Sequence[Contestant], results: Results) -> Verdict:
    """Compare world by world: only those in which just one of two settles can tell them apart."""
    parts, words = [], []
    for rival in rivals:
        share = wins(results[best.name], results[rival.name])
        parts.append(None if share is None else share.above(0.5))
        pace = ratio_of_medians(
            [one.settled_s for one in results[best.name]],
            [one.settled_s for one in results[rival.name]],
        )
        alone = (
            "none differs"
            if share is None
            else f"{round(share.value * share.count)} of the {share.count} worlds that just one of "
            "the two masters"
        )
        words.append(
            f"{rival.name} {rate_text(success_rate(results[rival.name]))}, {alone}, settling time "
            f"over its {pace.text()}"
        )
    return Verdict(
        f"{best.name}, the best here, settles in more worlds than every other scheme of the paper.",
        f"{best.name} {rate_text(success_rate(results[best.name]))} against: {'; '.join(words)}.",
        all_hold(parts),
    )
