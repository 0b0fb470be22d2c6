"""The fast terminal sliding surface with the adaptive exponent, one axis at a time.

``s = a1 y' + a2 y + a3 psi(y)`` with ``psi(y) = |y|^g(y) sgn y``, eq. (31), and
``g(y) = l1 - l2 tanh(l3 (y^2 - Delta))``, eq. (29): small far from the goal (fast), large
near it (calm); it switches at ``|y| = sqrt(Delta)``. Errors are in metres and below 1 m: the
exponent makes the surface depend on the unit.

Plain floats on purpose: for three axes numpy costs more than the arithmetic.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import copysign, inf, log, tanh


@dataclass(frozen=True)
class SlidingSurface:
    """Parameters of the sliding surface, and its functions.

    ``psi`` rises strictly for |y| < 1 m: psi' = |y|^g (g/|y| + g' ln|y| sgn y), where both
    terms are positive because g > 0, g' sgn y <= 0 and ln|y| < 0. Beyond 1 m the second term
    is negative but dies like exp(-2 l3 y^2), far below the first while
    ``switch_error_m`` <= 0.3 m (which is required), so that the surface is monotone everywhere.

    Parameters
    ----------
    alpha1 : float
        Weight of the error's velocity.
    alpha2 : float
        Weight of the error, 1/s where alpha1 = 1.
    alpha3 : float
        Weight of the terminal attractor psi.
    lambda1, lambda2 : float
        Middle and half span of the exponent: lambda1 - lambda2 far from the goal, about
        lambda1 + lambda2 near it. lambda2 = 0 fixes the exponent.
    switch_error_m : float
        sqrt(Delta), the error at which the exponent switches, m.
    lambda3 : float, optional
        Steepness of the switch, 1/m^2. Default 3 / Delta: then the exponent at zero error is
        within 0.5 % of lambda1 + lambda2. A smaller one never gets there.

    Raises
    ------
    ValueError
        If a parameter is out of range; the text says which and why.
    """

    alpha1: float = 1.0
    alpha2: float = 3.0
    alpha3: float = 2.0
    lambda1: float = 0.6375
    lambda2: float = 0.2625
    switch_error_m: float = 0.005
    lambda3: float | None = None

    def __post_init__(self) -> None:
        if not 0.0 < self.alpha1 < inf:
            raise ValueError(f"alpha1 must be positive, got {self.alpha1}")
        if not 0.0 < self.alpha2 < inf:
            raise ValueError(f"alpha2 must be positive, got {self.alpha2}")
        if not 0.0 <= self.alpha3 < inf:
            raise ValueError(f"alpha3 must not be negative, got {self.alpha3}")
        if not 0.0 < self.switch_error_m <= 0.3:
            raise ValueError(
                f"switch_error_m must be above 0 and at most 0.3 m, got {self.switch_error_m}"
            )
        if self.lambda3 is None:
            object.__setattr__(self, "lambda3", 3.0 / self.switch_error_m**2)
        elif not 0.0 < self.lambda3 < inf:
            raise ValueError(f"lambda3 must be positive, got {self.lambda3}")
        if self.lambda2 < 0.0:
            raise ValueError(f"lambda2 must not be negative, got {self.lambda2}")
        low, high = self.lambda1 - self.lambda2, self.lambda1 + self.lambda2
        if not (low > 0.0 and high <= 1.0):
            raise ValueError(
                "the exponent must stay above 0 and at most 1: lambda1 - lambda2 is "
                f"{low:g}, lambda1 + lambda2 is {high:g}"
            )

    @classmethod
    def fixed(
        cls, gamma: float, alpha1: float = 1.0, alpha2: float = 3.0, alpha3: float = 2.0
    ) -> SlidingSurface:
        """Build a surface with one exponent everywhere, eq. (14)."""
        return cls(alpha1, alpha2, alpha3, lambda1=gamma, lambda2=0.0)

    def exponent(self, y: float) -> float:
        """Return the exponent g(y), eq. (29)."""
        assert self.lambda3 is not None
        return self.lambda1 - self.lambda2 * tanh(
            self.lambda3 * (y * y - self.switch_error_m * self.switch_error_m)
        )

    def exponent_slope(self, y: float) -> float:
        """dg/dy = -2 l2 l3 y sech^2(l3 (y^2 - Delta)), 1/m."""
        assert self.lambda3 is not None
        t = tanh(self.lambda3 * (y * y - self.switch_error_m * self.switch_error_m))
        return -2.0 * self.lambda2 * self.lambda3 * y * (1.0 - t * t)

    def psi(self, y: float) -> float:
        """Return the terminal attractor |y|^g(y) sgn y."""
        if y == 0.0:
            return 0.0
        return copysign(float(abs(y) ** self.exponent(y)), y)

    def psi_and_slope(self, y: float) -> tuple[float, float]:
        """psi(y) and dpsi/dy, eq. (32) with its missing terms; infinite slope at 0 if g < 1."""
        if y == 0.0:
            return 0.0, (1.0 if self.exponent(0.0) >= 1.0 else inf)
        a = abs(y)
        # exponent() and exponent_slope() in one, for the root finding of the implicit law.
        assert self.lambda3 is not None
        t = tanh(self.lambda3 * (a * a - self.switch_error_m * self.switch_error_m))
        g = self.lambda1 - self.lambda2 * t
        g_slope = -2.0 * self.lambda2 * self.lambda3 * a * (1.0 - t * t)
        power = a**g
        return (power if y > 0.0 else -power), power * (g / a + g_slope * log(a))

    def value(self, y: float, velocity: float) -> float:
        """Return the sliding variable s of an axis with error ``y`` (m) and its velocity (m/s)."""
        return self.alpha1 * velocity + self.alpha2 * y + self.alpha3 * self.psi(y)

    def derivative(self, y: float, velocity: float, acceleration: float) -> float:
        """ds/dt, eq. (32) as corrected; infinite at y = 0 where g < 1 and the axis moves."""
        _, slope = self.psi_and_slope(y)
        attractor = 0.0 if velocity == 0.0 else self.alpha3 * slope * velocity
        return self.alpha1 * acceleration + self.alpha2 * velocity + attractor
