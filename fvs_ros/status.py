"""Parses the key numbers of a status, which are text in the message."""

from __future__ import annotations

from collections.abc import Mapping
from math import nan

import numpy as np

#: A status older than this counts as none, s.
SILENT_S = 1.0
#: State of a controller that publishes no status.
SILENT = "SILENT"
#: States in which an estimator may publish no Jacobian; if it does not, the reason says why.
ESTIMATOR_WAITING, ESTIMATOR_FAULT = "WAITING", "FAULT"


def number(values: Mapping[str, str], key: str) -> float:
    """A number of a status; NaN where it is missing or unknown."""
    try:
        return float(values.get(key, "nan"))
    except ValueError:  # "unknown", or empty
        return nan


def vector(values: Mapping[str, str], pattern: str) -> np.ndarray | None:
    """A vector of a status, shape (3,), by ``pattern`` with x, y, z in it; None if unknown."""
    xyz = np.array([number(values, pattern.format(axis)) for axis in "xyz"])
    return xyz if np.isfinite(xyz).all() else None
