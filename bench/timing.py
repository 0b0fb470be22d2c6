"""How times are printed."""

from __future__ import annotations

import numpy as np


def spread(values, unit, percent=99.0):
    """Median, and what this percentage stays below (100: the largest)."""
    median, most = np.percentile(values, (50.0, percent))
    name = "at most" if percent == 100.0 else f"at {percent:g} %"
    return f"{median:7.2f} {unit} median {most:8.2f} {unit} {name}   ({len(values)})"
