"""Noise with heavy tails: most errors as small as a camera's, some of them centimetres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Exponent of noise without heavy tails.
WHITE = 2.0
#: No error of a coordinate is larger than this, m: the detection knows the size of the ball.
_LARGEST_ERROR_M = 0.1


@dataclass(frozen=True)
class StableNoise:
    """Symmetric alpha-stable errors of a ball position, by Chambers, Mallows and Stuck.

    Parameters
    ----------
    scale_m : float
        Standard deviation at exponent 2, m; with less, the bulk is as wide and the tails heavy.
    exponent : float
        Above 1, up to 2 (white, normally distributed).
    """

    scale_m: float
    exponent: float

    def __call__(self, rng: np.random.Generator) -> np.ndarray:
        """Draw the errors of the three coordinates, cut off where no camera errs so far, m."""
        alpha = self.exponent
        angle = rng.uniform(-0.5 * np.pi, 0.5 * np.pi, 3)
        waiting = rng.exponential(size=3)
        spread = (np.cos((1.0 - alpha) * angle) / waiting) ** ((1.0 - alpha) / alpha)
        draw = np.sin(alpha * angle) / np.cos(angle) ** (1.0 / alpha) * spread
        error_m = self.scale_m / np.sqrt(2.0) * draw
        return np.clip(error_m, -_LARGEST_ERROR_M, _LARGEST_ERROR_M)
