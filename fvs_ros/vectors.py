"""Norms of short vectors in plain floats, quicker than by numpy; arrays checked by declaration."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite, sqrt
from typing import Any

import numpy as np

#: No joint position, rad, no coordinate of a position, m, and no entry of a Jacobian, m/rad, that a
#: message may hold is larger: it would be a mistake of whoever sent it.
LARGEST = 100.0


def length(vector: np.ndarray) -> float:
    """Euclidean norm of a vector, shape (n,)."""
    return sqrt(float(vector.dot(vector)))


def largest(values: np.ndarray) -> float:
    """Greatest magnitude of some finite numbers, shape (n,)."""
    return max(map(abs, values.tolist()))


def all_finite(values: np.ndarray) -> bool:
    """Whether no number of an array is infinite or NaN."""
    return all(map(isfinite, values.ravel().tolist()))


def plausible(values: np.ndarray) -> bool:
    """Whether no number of an array is NaN or larger than ``LARGEST``."""
    return all(-LARGEST <= value <= LARGEST for value in values.ravel().tolist())


def check_arrays(
    owner: Any, shapes: Mapping[str, tuple[int | str, ...]], **sizes: int
) -> dict[str, int]:
    """Make fields of a frozen dataclass read-only arrays of finite floats.

    A letter in ``shapes`` is a length that is the same in all, such as those of ``sizes``; returns
    the lengths by letter. A ``ValueError`` says which field is not as declared.
    """
    for name, shape in shapes.items():
        try:
            value = np.array(getattr(owner, name), dtype=float)
        except (TypeError, ValueError):
            raise ValueError(f"{name} holds something that is not a number") from None
        if value.ndim != len(shape) or not all(
            size == (sizes.setdefault(side, size) if isinstance(side, str) else side)
            for side, size in zip(shape, value.shape, strict=True)
        ):
            expected = ", ".join(str(sizes.get(side, side)) for side in shape)  # type: ignore[arg-type]
            raise ValueError(f"{name} has shape {value.shape}, expected ({expected})")
        if not np.all(np.isfinite(value)):
            raise ValueError(f"{name} holds a number that is not finite")
        value.setflags(write=False)
        object.__setattr__(owner, name, value)
    return sizes
