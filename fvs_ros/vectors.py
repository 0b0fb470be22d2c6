"""A few numbers of a short vector, in plain floats: of three or six, far quicker than by numpy."""

from __future__ import annotations

from math import isfinite, sqrt

import numpy as np


def length(vector: np.ndarray) -> float:
    """Euclidean norm of a vector, shape (n,)."""
    return sqrt(float(vector.dot(vector)))


def largest(values: np.ndarray) -> float:
    """Greatest magnitude of some finite numbers, shape (n,)."""
    return max(map(abs, values.tolist()))


def all_finite(values: np.ndarray) -> bool:
    """Whether none of some numbers, shape (n,), is infinite or NaN."""
    return all(map(isfinite, values.tolist()))
