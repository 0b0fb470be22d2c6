"""Times of calls, and how they are printed."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np


def cpu_s(call: Callable[[], object], repeats: int = 1) -> list[float]:
    """CPU time of each of several calls, s."""
    spent = []
    for _ in range(repeats):
        begin_s = time.process_time()
        call()
        spent.append(time.process_time() - begin_s)
    return spent


def spread(values: Sequence[float] | np.ndarray, unit: str, percent: float = 99.0) -> str:
    """Median, and what this percentage stays below (100: the largest)."""
    median, most = np.percentile(values, (50.0, percent))
    name = "at most" if percent == 100.0 else f"at {percent:g} %"
    return f"{median:7.2f} {unit} median {most:8.2f} {unit} {name}   ({len(values)})"
