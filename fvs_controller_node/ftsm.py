"""The paper's law: fast terminal sliding mode with an adaptive exponent, eqs. (16), (29)-(32).

With ``v = J rdot`` put in on both sides, (16) says ``k4 s' = -k1 s - k2 |s|^(2 sigma - 1)
sgn s``: it prescribes how the sliding variable decays. *Implicit* (the default) solves that
equation and the surface for the end of the tick, so that no step can overshoot, whatever the
gains and the rate. *Literal* evaluates the right side of (16) with the last velocity, as
printed; it is stable only for k4 < 2 a2 dt / (2 a1 + a2 dt) and k1 < 2 a2 / (a1 + a2 dt / 2),
and chatters where the exponent switches. It is here for the paper's figures.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import copysign, inf
from typing import Any, ClassVar

import numpy as np

from fvs_controller_node.allocation import Inverse, make_inverse
from fvs_controller_node.base import N_AXES, ControlInput, ControlLaw, ControlOutput
from fvs_controller_node.pseudo_inverse import DampedInverse
from fvs_controller_node.reaching import ReachingLaw
from fvs_controller_node.settling import settling_times
from fvs_controller_node.surface import SlidingSurface
from fvs_ros.params import Parameter
from fvs_ros.vectors import length

IMPLICIT, LITERAL = "implicit", "literal"
EACH_AXIS, STRAIGHT = "each_axis", "straight"
ADAPTIVE, FIXED = "adaptive", "fixed"

_NEWTON_ITERATIONS = 12
_MAX_ITERATIONS = 80
_TOLERANCE = 1e-14
_TINY_M = 1e-12

#: The literal law divides by the error where the exponent is below 1; it never gets smaller.
_LITERAL_ERROR_FLOOR_M = 1e-9


def next_sliding_value(s: float, law: ReachingLaw, dt_s: float) -> float:
    """Solve (k4/dt + k1) p + k2 p^m = (k4/dt) |s| for p = |s+|, a tick later.

    Newton's method on a concave, rising function: from a point left of the root every step
    stays left of it and comes closer, so that it converges whatever the gains.
    """
    linear = law.k4 / dt_s + law.k1
    right = law.k4 / dt_s * abs(s)
    if right == 0.0:
        return 0.0
    if law.k2 == 0.0:
        return copysign(right / linear, s)
    m = 2.0 * law.sigma - 1.0
    # Where each term is at most half the right side, the sum has not passed it.
    half = 0.5 * right
    p = min(half / linear, _power(half / law.k2, 1.0 / m))
    for _ in range(_MAX_ITERATIONS):
        if p <= 0.0:
            return 0.0
        power = p**m
        step = (right - linear * p - law.k2 * power) / (linear + law.k2 * m * power / p)
        p += step
        if abs(step) <= _TOLERANCE * p:
            break
    return copysign(p, s)


def next_error(right: float, guess: float, surface: SlidingSurface, dt_s: float) -> float:
    """Solve (a1/dt + a2) z + a3 psi(z) = right for the error z a tick later.

    Newton's method inside a bracket, bisecting where Newton leaves it and after a dozen
    steps, so that it converges for every monotone surface, through the switch and the infinite
    slope at 0.

    Parameters
    ----------
    right : float
        Right side, s+ + (a1/dt) y.
    guess : float
        Where to begin, the present error y, m.
    surface : SlidingSurface
        The surface.
    dt_s : float
        Tick, s.
    """
    if right == 0.0:
        return 0.0
    linear = surface.alpha1 / dt_s + surface.alpha2
    alpha3 = surface.alpha3
    target = abs(right)
    low, high = 0.0, target / linear
    if alpha3 == 0.0:
        return copysign(high, right)
    z = abs(guess) if guess * right > 0.0 else high
    if not low < z < high:
        z = 0.5 * high
    for iteration in range(_MAX_ITERATIONS):
        psi, slope = surface.psi_and_slope(z)
        residual = linear * z + alpha3 * psi - target
        if residual > 0.0:
            high = z
        else:
            low = z
        before = z
        z -= residual / (linear + alpha3 * slope)
        if iteration >= _NEWTON_ITERATIONS or not low < z < high:
            z = 0.5 * (low + high)
        if abs(z - before) <= _TOLERANCE * z + _TINY_M:
            break
    return copysign(z, right)


def _toward(error_m: np.ndarray) -> tuple[float, np.ndarray]:
    """The error's length, m, and direction, shape (3,), which is zero where there is no error."""
    distance_m = length(error_m)
    return distance_m, error_m / max(distance_m, _TINY_M)


def _power(base: float, exponent: float) -> float:
    try:
        return float(base**exponent)
    except OverflowError:
        return inf


def _gain(name: str, default: float, description: str, low: float, high: float) -> Parameter:
    return Parameter(name, default, description, low, high, live=True)


_SURFACE = SlidingSurface()
_REACHING = ReachingLaw()


class FtsmLaw(ControlLaw):
    """Adaptive fast terminal sliding mode control.

    Parameters
    ----------
    surface : SlidingSurface
        The sliding surface.
    reaching : ReachingLaw
        How the sliding variable decays.
    inverse : Inverse, optional
        From ball velocity to joint velocities.
    discretisation : {"implicit", "literal"}
        See the module.
    path : {"each_axis", "straight"}
        Whether each coordinate of the error has a surface of its own, as in the paper, or the
        distance has one: the ball then goes straight to the target.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        _gain("alpha1", _SURFACE.alpha1, "Weight of the error's velocity in s.", 1e-3, 100.0),
        _gain("alpha2", _SURFACE.alpha2, "Weight of the error in s.", 1e-3, 100.0),
        _gain("alpha3", _SURFACE.alpha3, "Weight of the terminal attractor in s.", 0.0, 100.0),
        Parameter(
            "exponent",
            ADAPTIVE,
            "Exponent of the terminal attractor: adaptive, eq. (29), or fixed, eq. (14).",
            choices=(ADAPTIVE, FIXED),
            live=True,
        ),
        _gain("fixed_exponent", 0.75, "The exponent where it is fixed.", 0.01, 1.0),
        _gain("lambda1", _SURFACE.lambda1, "Middle of the adaptive exponent.", 0.01, 1.0),
        _gain(
            "lambda2",
            _SURFACE.lambda2,
            "Half span of the adaptive exponent: lambda1 - lambda2 far from the goal, "
            "lambda1 + lambda2 near it.",
            0.0,
            0.5,
        ),
        _gain(
            "lambda3_1_m2",
            0.0,
            "Steepness of the exponent's switch, 1/m^2; 0 takes 3 / switch_error_m^2.",
            0.0,
            1e9,
        ),
        _gain(
            "switch_error_m",
            _SURFACE.switch_error_m,
            "Error at which the exponent switches (the paper's sqrt(Delta)), m; three to five "
            "times the measurement noise.",
            1e-5,
            0.3,
        ),
        Parameter(
            "ftsm_path",
            EACH_AXIS,
            "Each coordinate of the error with a surface of its own, as in the paper, or one "
            "surface of the distance: straight to the target.",
            choices=(EACH_AXIS, STRAIGHT),
            live=True,
        ),
        _gain("k1", _REACHING.k1, "Linear gain of the reaching law.", 1e-3, 1e4),
        _gain("k2", _REACHING.k2, "Terminal gain of the reaching law.", 0.0, 1e4),
        _gain("k4", _REACHING.k4, "s decays with k4 / k1 seconds.", 0.0, 100.0),
        _gain("sigma", _REACHING.sigma, "2 sigma - 1 is the reaching exponent.", 0.51, 0.99),
        Parameter(
            "discretisation",
            IMPLICIT,
            "implicit (stable at any gain and rate) or literal (eq. (16) as printed; chatters).",
            choices=(IMPLICIT, LITERAL),
            live=True,
        ),
    )

    def __init__(
        self,
        surface: SlidingSurface | None = None,
        reaching: ReachingLaw | None = None,
        inverse: Inverse | None = None,
        discretisation: str = IMPLICIT,
        path: str = EACH_AXIS,
    ) -> None:
        if discretisation not in (IMPLICIT, LITERAL):
            raise ValueError(
                f"unknown discretisation {discretisation!r}; known are {IMPLICIT}, {LITERAL}"
            )
        if path not in (EACH_AXIS, STRAIGHT):
            raise ValueError(f"unknown path {path!r}; known are {EACH_AXIS}, {STRAIGHT}")
        self.surface = surface or SlidingSurface()
        self.reaching = reaching or ReachingLaw()
        self.inverse: Inverse = inverse or DampedInverse()
        self.discretisation = discretisation
        self.path = path
        self._last_velocity: list[float] | None = None

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> FtsmLaw:
        """Build the law with the gains in ``values``."""
        if values["exponent"] == FIXED:
            lambda1, lambda2 = values["fixed_exponent"], 0.0
        else:
            lambda1, lambda2 = values["lambda1"], values["lambda2"]
        surface = SlidingSurface(
            alpha1=values["alpha1"],
            alpha2=values["alpha2"],
            alpha3=values["alpha3"],
            lambda1=lambda1,
            lambda2=lambda2,
            switch_error_m=values["switch_error_m"],
            lambda3=values["lambda3_1_m2"] or None,
        )
        reaching = ReachingLaw(values["k1"], values["k2"], values["k4"], values["sigma"])
        return cls(
            surface,
            reaching,
            make_inverse(values),
            values["discretisation"],
            values["ftsm_path"],
        )

    def reset(self) -> None:
        """Forget the last velocity (only the literal form remembers one)."""
        self._last_velocity = None

    def settling_bound_s(self, error_m: np.ndarray) -> float | None:
        """Eqs. (36)-(39) as corrected: reaching plus sliding time of the slowest axis."""
        errors = [_toward(error_m)[0]] if self.path == STRAIGHT else error_m.tolist()
        if self.discretisation == LITERAL or max(map(abs, errors)) >= 1.0:
            return None
        times = settling_times(errors, [0.0] * len(errors), self.surface, self.reaching)
        return max(one.total_s for one in times)

    def command(self, control_input: ControlInput) -> ControlOutput:
        """Return the joint velocities for this tick, before any limit."""
        error_m, jacobian = control_input.error_m, control_input.jacobian
        velocity_m_s = jacobian @ control_input.applied_rad_s
        solve = self._implicit if self.discretisation == IMPLICIT else self._literal
        if self.path == STRAIGHT:
            distance_m, axis = _toward(error_m)
            (along,), (s,) = solve([distance_m], [float(axis @ velocity_m_s)], control_input.dt_s)
            wanted, sliding = along * axis, s * axis
            exponent = np.full(N_AXES, self.surface.exponent(distance_m))
        else:
            errors = error_m.tolist()
            wanted, sliding = map(
                np.array, solve(errors, velocity_m_s.tolist(), control_input.dt_s)
            )
            exponent = np.array([self.surface.exponent(y) for y in errors])
        return ControlOutput(
            velocity_rad_s=self.inverse.joint_velocity(
                jacobian, wanted, control_input.joints_rad, control_input.home_rad
            ),
            sliding_variable=sliding,
            exponent=exponent,
        )

    def _implicit(
        self, errors: list[float], velocities: list[float], dt_s: float
    ) -> tuple[list[float], list[float]]:
        surface = self.surface
        wanted, sliding = [], []
        for y, v in zip(errors, velocities, strict=True):
            s = surface.value(y, v)
            s_next = next_sliding_value(s, self.reaching, dt_s)
            z = next_error(s_next + surface.alpha1 * y / dt_s, y, surface, dt_s)
            wanted.append((z - y) / dt_s)
            sliding.append(s)
        return wanted, sliding

    def _literal(
        self, errors: list[float], velocities: list[float], dt_s: float
    ) -> tuple[list[float], list[float]]:
        surface, reaching = self.surface, self.reaching
        m = 2.0 * reaching.sigma - 1.0
        before = self._last_velocity or velocities
        wanted, sliding = [], []
        for y, v, v_before in zip(errors, velocities, before, strict=True):
            s = surface.value(y, v)
            floored = copysign(max(abs(y), _LITERAL_ERROR_FLOOR_M), y)
            s_dot = surface.derivative(floored, v, (v - v_before) / dt_s)
            pull = reaching.k1 * s + reaching.k2 * copysign(abs(s) ** m, s) + reaching.k4 * s_dot
            wanted.append(v - pull / surface.alpha2)
            sliding.append(s)
        self._last_velocity = velocities
        return wanted, sliding
