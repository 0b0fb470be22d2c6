"""Hundreds of random worlds of the usual kind, in which what is to be used must not fail."""

from __future__ import annotations

from fvs_lab.context import Context
from fvs_lab.report import Report
from fvs_lab.robustness import run_in
from fvs_lab.robustness_worlds import EVERYDAY


def run(context: Context) -> Report:
    """Send everybody through worlds with a usual sensor and a camera that was moved before."""
    return run_in(
        context,
        EVERYDAY,
        "Everyday",
        "A millimetre of noise, some latency, lost images, and a camera that was moved since the "
        "training: does every single run end at its target?",
    )
