"""How the sliding variable decays: the reaching law, eq. (16) with the velocity put in."""

from __future__ import annotations

from dataclasses import dataclass

from fvs_ros.params import Parameters, live_parameter


@dataclass(frozen=True)
class ReachingLaw(Parameters):
    """k4 s' = -k1 s - k2 |s|^(2 sigma - 1) sgn s; the terminal term ends it in finite time."""

    k1: float = live_parameter(3.0, "Linear gain of the reaching law.", 1e-3, 1e4)
    k2: float = live_parameter(0.05, "Terminal gain of the reaching law.", 0.0, 1e4)
    k4: float = live_parameter(0.05, "s decays with k4 / k1 seconds; 0: at once.", 0.0, 100.0)
    # At 0.5 the command would grow without bound at s = 0.
    sigma: float = live_parameter(0.75, "2 sigma - 1 is the reaching exponent.", 0.51, 0.99)
