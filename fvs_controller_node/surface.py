"""The fast terminal sliding surface with the adaptive exponent, and how s decays to it.

One axis at a time, ``s = a1 y' + a2 y + a3 psi(y)`` with ``psi(y) = |y|^g(y) sgn y``, eq. (31), and
``g(y) = l1 - l2 tanh(l3 (y^2 - Delta))``, eq. (29): small far from the goal (fast), large
near it (calm); it switches at ``|y| = sqrt(Delta)``. Errors are in metres and below 1 m: the
exponent makes the surface depend on the unit.

Plain floats on purpose: for three axes numpy costs more than the arithmetic.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf, log, tanh

from fvs_ros.params import ParameterError, Parameters, live_parameter


@dataclass(frozen=True)
class SlidingSurface(Parameters):
    """Parameters of the sliding surface, and its functions.

    ``psi`` rises strictly for |y| < 1 m: psi' = |y|^g (g/|y| + g' ln|y| sgn y), where both
    terms are positive because g > 0, g' sgn y <= 0 and ln|y| < 0. Beyond 1 m the second term
    is negative but dies like exp(-2 l3 y^2), far below the first while
    ``switch_error_m`` <= 0.3 m (which is required), so that the surface is monotone everywhere.
    """

    alpha1: float = live_parameter(1.0, "Weight of the error's velocity in s.", 1e-3, 100.0)
    alpha2: float = live_parameter(3.0, "Weight of the error in s.", 1e-3, 100.0)
    alpha3: float = live_parameter(2.0, "Weight of the terminal attractor in s.", 0.0, 100.0)
    lambda1: float = live_parameter(0.6375, "Middle of the adaptive exponent, eq. (29).", 0.01, 1.0)
    lambda2: float = live_parameter(
        0.2625,
        "Half span of the exponent: lambda1 - lambda2 far from the goal, lambda1 + lambda2 near "
        "it; 0 fixes it, eq. (14).",
        0.0,
        0.5,
    )
    switch_error_m: float = live_parameter(
        0.005,
        "Error at which the exponent switches (the paper's sqrt(Delta)), m; three to five times "
        "the measurement noise.",
        1e-5,
        0.3,
    )
    #: Steepness of the exponent's switch, 1/m^2: with 3 / Delta the exponent at zero error is
    #: within 0.5 % of lambda1 + lambda2.
    lambda3: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = self.lambda1 - self.lambda2, self.lambda1 + self.lambda2
        if not (low > 0.0 and high <= 1.0):
            raise ParameterError(
                "the exponent must stay above 0 and at most 1: lambda1 - lambda2 is "
                f"{low:g}, lambda1 + lambda2 is {high:g}"
            )
        object.__setattr__(self, "lambda3", 3.0 / self.switch_error_m**2)

    def exponent(self, y: float) -> float:
        """Return the exponent g(y), eq. (29)."""
        return self.lambda1 - self.lambda2 * tanh(
            self.lambda3 * (y * y - self.switch_error_m * self.switch_error_m)
        )

    def psi(self, y: float) -> float:
        """Return the terminal attractor |y|^g(y) sgn y."""
        return self.psi_and_slope(y)[0]

    def psi_and_slope(self, y: float) -> tuple[float, float]:
        """psi(y) and dpsi/dy, eq. (32) with its missing terms; infinite slope at 0 if g < 1."""
        if y == 0.0:
            return 0.0, (1.0 if self.exponent(0.0) >= 1.0 else inf)
        a = abs(y)
        # exponent() and its slope in one, for the root finding of the implicit law.
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


@dataclass(frozen=True)
class ReachingLaw(Parameters):
    """k4 s' = -k1 s - k2 |s|^(2 sigma - 1) sgn s; the terminal term ends it in finite time."""

    k1: float = live_parameter(3.0, "Linear gain of the reaching law.", 1e-3, 1e4)
    k2: float = live_parameter(0.05, "Terminal gain of the reaching law.", 0.0, 1e4)
    k4: float = live_parameter(
        0.05, "k4 / k1 is the time constant of s, s; 0: immediate.", 0.0, 100.0
    )
    # At 0.5 the command would grow without bound at s = 0.
    sigma: float = live_parameter(0.75, "2 sigma - 1 is the reaching exponent.", 0.51, 0.99)
