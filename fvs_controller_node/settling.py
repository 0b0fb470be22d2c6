"""Settling time: reaching the sliding surface, and sliding to the goal; eqs. (36)-(39).

The paper's (36)-(39) have a wrong denominator (they give negative times for a2 < a3). With a
constant exponent g, ``a1 y' + a2 y + a3 y^g = 0`` takes from y0 down to yf

    t = a1 / (a2 (1 - g)) ln[(a2 y0^(1-g) + a3) / (a2 yf^(1-g) + a3)].

Speed limits are ignored: a limited arm takes longer.
"""

from __future__ import annotations

from itertools import pairwise
from math import inf, log1p

import numpy as np

from fvs_controller_node.surface import ReachingLaw, SlidingSurface

_NODES, _WEIGHTS = (rule.tolist() for rule in np.polynomial.legendre.leggauss(16))
#: Ends of the pieces of the quadrature, in switching errors.
_PIECES = (0.0, 0.7, 1.0, 1.2, 1.6)


def sliding_time_s(y0: float, surface: SlidingSurface) -> float:
    """Time to slide from an error, m, to zero, s; infinite where it only gets closer.

    By Gauss-Legendre quadrature of dt = a1 dy / (a2 y + a3 y^g(y)) over z = y^(1 - g(0)), which is
    regular at 0, in pieces: near the switch the exponent changes.
    """
    y0 = abs(y0)
    if not y0 < 1.0:
        raise ValueError(f"the paper's surface is made for errors below 1 m, got {y0} m")
    near = surface.exponent(0.0)
    p = 1.0 - near
    if y0 == 0.0 or p <= 0.0 or surface.alpha3 == 0.0:
        return 0.0 if y0 == 0.0 else inf

    def pace(z: float) -> float:
        y = z ** (1.0 / p)
        attractor = surface.alpha3 * y ** (surface.exponent(y) - near)
        return surface.alpha1 / (p * (surface.alpha2 * z + attractor))

    ends = [min(share * surface.switch_error_m, y0) ** p for share in _PIECES] + [y0**p]
    pieces = [(0.5 * (low + high), 0.5 * (high - low)) for low, high in pairwise(ends)]
    return sum(
        half * weight * pace(middle + half * node)
        for middle, half in pieces
        for node, weight in zip(_NODES, _WEIGHTS, strict=True)
    )


def reaching_time_s(s0: float, law: ReachingLaw) -> float:
    """Time in which k4 s' = -k1 s - k2 |s|^(2 sigma - 1) sgn s brings s0 to zero, s.

    t = k4 / (k1 (2 - 2 sigma)) ln(1 + k1 |s0|^(2 - 2 sigma) / k2); infinite if k2 = 0.
    """
    if s0 == 0.0 or law.k4 == 0.0:
        return 0.0
    if law.k2 == 0.0:
        return inf
    p = 2.0 - 2.0 * law.sigma
    return law.k4 / (law.k1 * p) * log1p(law.k1 * abs(s0) ** p / law.k2)


def settling_time_s(y0: float, surface: SlidingSurface, law: ReachingLaw) -> float:
    """Bound of an axis' time from rest at an error, m, to zero without speed limits, s.

    Until the surface is reached the error does not grow: from rest s keeps the sign of y, and y'
    that of -y.
    """
    return reaching_time_s(surface.value(y0, 0.0), law) + sliding_time_s(y0, surface)
