"""The paper's law: fast terminal sliding mode with an adaptive exponent, eqs. (16), (29)-(32).

With ``v = J rdot`` put in on both sides, (16) says ``k4 s' = -k1 s - k2 |s|^(2 sigma - 1)
sgn s``: it prescribes how the sliding variable decays. *Implicit* (the default) solves that
equation and the surface for the end of the tick, so that no step can overshoot, whatever the
gains and the rate. *Literal* evaluates the right side of (16) with the last velocity, as
printed; it is stable only for k4 < 2 a2 dt / (2 a1 + a2 dt) and k1 < 2 a2 / (a1 + a2 dt / 2),
and chatters where the exponent switches. It is here for the paper's figures.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import copysign, sqrt

import numpy as np

from fvs_controller_node.base import ControlInput, ControlLaw, ControlOutput
from fvs_controller_node.surface import ReachingLaw, SlidingSurface
from fvs_ros.params import Parameters, live_parameter
from fvs_ros.vectors import length

IMPLICIT, LITERAL = "implicit", "literal"
EACH_AXIS, STRAIGHT = "each_axis", "straight"

_NEWTON_ITERATIONS, _MAX_ITERATIONS = 12, 80
#: A last step of Newton's method whose error, its square, is that of a double.
_LAST_STEP, _TINY_M = 1e-8, 1e-12


def next_sliding_value(s: float, law: ReachingLaw, dt_s: float) -> float:
    """Solve (k4/dt + k1) p + k2 p^m = (k4/dt) |s| for p = |s+|, a tick later."""
    m, right, linear = 2.0 * law.sigma - 1.0, law.k4 / dt_s * s, law.k4 / dt_s + law.k1

    def terminal(p: float) -> tuple[float, float]:
        power = p**m
        return power, m * power / p

    # The solution for sigma = 3/4, a root of a quadratic equation in sqrt(p).
    half = sqrt(law.k2 * law.k2 + 4.0 * linear * abs(right)) + law.k2 + 1e-300
    guess = copysign((2.0 * right / half) ** 2, s)
    return _root(right, linear, law.k2, terminal, guess)


def next_error(right: float, guess: float, surface: SlidingSurface, dt_s: float) -> float:
    """Solve (a1/dt + a2) z + a3 psi(z) = right for the error z a tick later.

    ``right`` is s+ + (a1/dt) y, and ``guess`` the present error y, m.
    """
    linear = surface.alpha1 / dt_s + surface.alpha2
    return _root(right, linear, surface.alpha3, surface.psi_and_slope, guess)


def _root(
    right: float,
    linear: float,
    weight: float,
    function: Callable[[float], tuple[float, float]],
    guess: float,
) -> float:
    """Solve ``linear z + weight f(z) = right`` for a rising, odd function f, given with its slope.

    Newton's method inside a bracket, bisecting where Newton leaves it and after a dozen steps, so
    that it converges through the switch of the exponent and the infinite slope at 0.
    """
    target = abs(right)
    low, high = 0.0, target / linear
    if weight == 0.0 or high == 0.0:
        return copysign(high, right)
    z = min(abs(guess), high) if guess * right > 0.0 else high
    for iteration in range(_MAX_ITERATIONS):
        value, slope = function(z)
        residual = linear * z + weight * value - target
        if residual > 0.0:
            high = z
        else:
            low = z
        before = z
        z -= residual / (linear + weight * slope)
        if iteration < _NEWTON_ITERATIONS and low <= z <= high:
            if abs(z - before) <= _LAST_STEP * z:
                break
        else:
            z = 0.5 * (low + high)
            if high - low <= _TINY_M:
                break
    return copysign(z, right)


@dataclass(frozen=True)
class FtsmGains(Parameters):
    """Gains and form of the law."""

    surface: SlidingSurface = field(default_factory=SlidingSurface)
    reaching: ReachingLaw = field(default_factory=ReachingLaw)
    ftsm_path: str = live_parameter(
        EACH_AXIS,
        "each_axis (one surface per error component, as in the paper) or straight (one surface "
        "for the distance, a straight path to the target).",
        choices=(EACH_AXIS, STRAIGHT),
    )
    discretisation: str = live_parameter(
        IMPLICIT,
        "implicit (stable at any gain and rate) or literal (eq. (16) as printed; chatters).",
        choices=(IMPLICIT, LITERAL),
    )


class FtsmLaw(ControlLaw):
    """Adaptive fast terminal sliding mode control, implicit or literal."""

    Gains = FtsmGains
    gains: FtsmGains
    _last_velocity: list[float] | None = None

    def reset(self) -> None:
        """Forget the last velocity (only the literal form remembers one)."""
        self._last_velocity = None

    def command(self, state: ControlInput) -> ControlOutput:
        """Return the joint velocities for this tick, before any limit."""
        gains = self.gains
        velocity_m_s = state.jacobian.dot(state.applied_rad_s)
        solve = self._implicit if gains.discretisation == IMPLICIT else self._literal
        if gains.ftsm_path == STRAIGHT:
            distance_m = length(state.error_m)
            axis = state.error_m / max(distance_m, _TINY_M)
            (along,), (s,) = solve([distance_m], [float(axis @ velocity_m_s)], state.dt_s)
            wanted, sliding = along * axis, s * axis
            exponent = np.full(axis.size, gains.surface.exponent(distance_m))
        else:
            errors = state.error_m.tolist()
            wanted, sliding = map(np.array, solve(errors, velocity_m_s.tolist(), state.dt_s))
            exponent = np.array([gains.surface.exponent(y) for y in errors])
        joints_rad, home_rad = state.joints_rad, state.home_rad
        velocity = self.inverse.joint_velocity(state.jacobian, wanted, joints_rad, home_rad)
        return ControlOutput(velocity, sliding, exponent)

    def _implicit(
        self, errors: list[float], velocities: list[float], dt_s: float
    ) -> tuple[list[float], list[float]]:
        surface, reaching = self.gains.surface, self.gains.reaching
        wanted, sliding = [], []
        for y, v in zip(errors, velocities, strict=True):
            s = surface.value(y, v)
            s_next = next_sliding_value(s, reaching, dt_s)
            z = next_error(s_next + surface.alpha1 * y / dt_s, y, surface, dt_s)
            wanted.append((z - y) / dt_s)
            sliding.append(s)
        return wanted, sliding

    def _literal(
        self, errors: list[float], velocities: list[float], dt_s: float
    ) -> tuple[list[float], list[float]]:
        surface, reaching = self.gains.surface, self.gains.reaching
        m = 2.0 * reaching.sigma - 1.0
        before = self._last_velocity or velocities
        wanted, sliding = [], []
        for y, v, v_before in zip(errors, velocities, before, strict=True):
            s = surface.value(y, v)
            # It divides by the error where the exponent is below 1.
            floored = copysign(max(abs(y), _TINY_M), y)
            s_dot = surface.derivative(floored, v, (v - v_before) / dt_s)
            pull = reaching.k1 * s + reaching.k2 * copysign(abs(s) ** m, s) + reaching.k4 * s_dot
            wanted.append(v - pull / surface.alpha2)
            sliding.append(s)
        self._last_velocity = velocities
        return wanted, sliding
