"""How long it takes: reaching the sliding surface, and sliding to the goal; eqs. (36)-(39).

The paper's (36)-(39) have a wrong denominator (they give negative times for a2 < a3). With a
constant exponent g, ``a1 y' + a2 y + a3 y^g = 0`` takes from y0 down to yf

    t = a1 / (a2 (1 - g)) ln[(a2 y0^(1-g) + a3) / (a2 yf^(1-g) + a3)].

Nothing here knows of speed limits: a limited arm takes at least distance / speed longer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import expm1, log, log1p

import numpy as np

from fvs_controller_node.surface import ReachingLaw, SlidingSurface


def constant_exponent_time_s(
    y_from: float, y_to: float, gamma: float, surface: SlidingSurface
) -> float:
    """Time to slide from one error, m, to a smaller one with a constant exponent in (0, 1], s.

    0 <= y_to <= y_from, and y_to > 0 if gamma = 1 or alpha3 = 0.
    """
    a1, a2, a3 = surface.alpha1, surface.alpha2, surface.alpha3
    if y_from <= y_to:
        return 0.0
    if gamma == 1.0 or a3 == 0.0:
        rate = (a2 + a3 if gamma == 1.0 else a2) / a1
        return float("inf") if y_to == 0.0 else log(y_from / y_to) / rate
    p = 1.0 - gamma
    return a1 / (a2 * p) * log((a2 * y_from**p + a3) / (a2 * y_to**p + a3))


def sliding_time_bounds_s(
    y0: float, surface: SlidingSurface, pieces: int = 64
) -> tuple[float, float]:
    """Lower and upper bound of the time to slide from ``y0`` to zero, s.

    The exponent falls with the error, and below 1 m a larger exponent is slower, so on each piece
    its two end values enclose the time.
    """
    y0 = abs(y0)
    if not y0 < 1.0:
        raise ValueError(f"the paper's surface is made for errors below 1 m, got {y0} m")
    edges = [0.0, *np.geomspace(1e-3 * surface.switch_error_m, 1.0, pieces).tolist()]
    edges = [edge for edge in edges if edge < y0] + [y0]
    lower = upper = 0.0
    for near, far in pairwise(edges):
        lower += constant_exponent_time_s(far, near, surface.exponent(far), surface)
        upper += constant_exponent_time_s(far, near, surface.exponent(near), surface)
    return lower, upper


def reaching_time_s(s0: float, law: ReachingLaw) -> float:
    """Time in which k4 s' = -k1 s - k2 |s|^(2 sigma - 1) sgn s brings s0 to zero, s.

    t = k4 / (k1 (2 - 2 sigma)) ln(1 + k1 |s0|^(2 - 2 sigma) / k2); infinite if k2 = 0.
    """
    if s0 == 0.0 or law.k4 == 0.0:
        return 0.0
    if law.k2 == 0.0:
        return float("inf")
    p = 2.0 - 2.0 * law.sigma
    return law.k4 / (law.k1 * p) * log1p(law.k1 * abs(s0) ** p / law.k2)


def sliding_value_after(s0: float, t_s: float, law: ReachingLaw) -> float:
    """Return the sliding variable after ``t_s`` seconds of the reaching law."""
    if t_s >= reaching_time_s(s0, law):
        return 0.0
    p = 2.0 - 2.0 * law.sigma
    rate = law.k1 * p / law.k4
    # u = |s|^p is linear: u' = -p (k1 u + k2) / k4.
    u0 = abs(s0) ** p
    u = u0 + (u0 + law.k2 / law.k1) * expm1(-rate * t_s)
    return float(np.sign(s0)) * max(0.0, u) ** (1.0 / p)


@dataclass(frozen=True)
class SettlingTime:
    """Bounds of the settling time of one axis."""

    reaching_s: float  #: to the sliding surface
    sliding_s: float  #: from there to zero, upper bound

    @property
    def total_s(self) -> float:
        """Upper bound of both, s."""
        return self.reaching_s + self.sliding_s


def settling_times(
    error_m: Sequence[float],
    velocity_m_s: Sequence[float],
    surface: SlidingSurface,
    law: ReachingLaw,
) -> list[SettlingTime]:
    """Bounds of the settling time, axis by axis, without speed limits.

    While the surface is reached, |y| grows by at most the integral of |s| / a1, since
    ``a1 y' = s - a2 y - a3 psi(y)``; not at all when the axis starts from rest, where s keeps
    the sign of y and y' that of -y.
    """
    times = []
    for y, v in zip(error_m, velocity_m_s, strict=True):
        s = surface.value(y, v)
        reaching = reaching_time_s(s, law)
        worst = abs(y)
        if v != 0.0 and abs(s) > 0.0:
            worst += abs(s) * min(reaching, law.k4 / law.k1) / surface.alpha1
        times.append(SettlingTime(reaching, sliding_time_bounds_s(worst, surface)[1]))
    return times
