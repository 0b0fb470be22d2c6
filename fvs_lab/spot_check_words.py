"""What the spot checks through the nodes say, as a table and as a verdict."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fvs_lab.report import Table, Verdict
from fvs_lab.spot_check import SpotCheck
from fvs_lab.trials import seconds

#: The nodes agree if no settling time is later or earlier than in lock step by more than this: an
#: image period and a few ticks, s.
AGREE_S = 0.05


def spot_check_table(checks: Sequence[SpotCheck], gains: str) -> list[Table]:
    """A row a scheme; no table without a check.

    Parameters
    ----------
    checks : sequence of SpotCheck
        What was found.
    gains : str
        Whose gains were used, in words.
    """
    if not checks:
        return []
    rows = [
        [
            one.name,
            ", ".join(f"{_words(low)} to {_words(high)}" for low, high in one.ranges_s()),
            one.problem or ", ".join(_words(seconds(time)) for time in one.nodes_s),
            *(["", ""] if one.problem else [f"{one.shift_s():+.2f}", f"{one.worst_s():+.2f}"]),
        ]
        for one in checks
    ]
    return [
        Table(
            "Spot check: the same task in lock step, with several seeds of the noise, and through "
            f"the real nodes over DDS in real time ({gains}; settling to 5 mm, one target after "
            "another)",
            ["scheme", "lock step, range, s", "nodes, s", "shift (median), s", "worst target, s"],
            rows,
        )
    ]


def spot_check_verdict(checks: Sequence[SpotCheck], claim: str) -> list[Verdict]:
    """Judge whether lock step tells what the nodes do; no verdict without a check."""
    if not checks:
        return []
    problems = [f"{one.name}: {one.problem}" for one in checks if one.problem]
    if problems:
        return [Verdict(claim, "; ".join(problems), None)]
    words = ", ".join(
        f"{one.name} {one.shift_s():+.2f} s (worst target {one.worst_s():+.2f} s)" for one in checks
    )
    return [
        Verdict(
            claim,
            "Settling time through the nodes minus the median of the lock-step runs, median of "
            f"{len(checks[0].nodes_s)} targets: {words} (they agree up to {AGREE_S} s).",
            max(abs(one.worst_s()) for one in checks) <= AGREE_S,
        )
    ]


def _words(time_s: float) -> str:
    return f"{time_s:.2f}" if np.isfinite(time_s) else "never"
