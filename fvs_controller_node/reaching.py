"""How the sliding variable decays: the reaching law, eq. (16) with the velocity put in."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf


@dataclass(frozen=True)
class ReachingLaw:
    """k4 s' = -k1 s - k2 |s|^(2 sigma - 1) sgn s.

    Parameters
    ----------
    k1 : float
        Linear gain.
    k2 : float
        Gain of the terminal term, which ends the approach in finite time.
    k4 : float
        Time scale: the sliding variable decays with k4 / k1 seconds. 0 is the surface at once.
    sigma : float
        In (1/2, 1); the exponent is 2 sigma - 1.
    """

    k1: float = 3.0
    k2: float = 0.05
    k4: float = 0.05
    sigma: float = 0.75

    def __post_init__(self) -> None:
        if not 0.0 < self.k1 < inf:
            raise ValueError(f"k1 must be positive, got {self.k1}")
        if not 0.0 <= self.k2 < inf:
            raise ValueError(f"k2 must not be negative, got {self.k2}")
        if not 0.0 <= self.k4 < inf:
            raise ValueError(f"k4 must not be negative, got {self.k4}")
        if not 0.5 < self.sigma < 1.0:
            raise ValueError(
                "sigma must be between 0.5 and 1 (the command would grow without bound "
                f"at s = 0 otherwise), got {self.sigma}"
            )
