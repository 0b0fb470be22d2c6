"""Model predictive control, eq. (49) as corrected: the best constant joint rate over a horizon.

With t in control intervals and u the joint increment of one, the joints are taken to go on at u
and the error to be wanted at ``beta^t e``, ``e = x_d - x``. The cost

    int_0^H alpha^t |(1 - beta^t) e - t J u|^2 dt + q |u|^2,    beta = exp(-rho)

is least where ``(a J'J + q E) u = (b - c) J' e`` with

    a = int_0^H alpha^t t^2 dt,  b = int_0^H alpha^t t dt,  c = int_0^H (alpha beta)^t t dt.

Hence ``u = (b - c)/a  J' (J J' + q/a E)^-1 e``: like :mod:`fvs_controller_node.mfac` a
proportional law, with gain (b - c) / (a T) and damping q / a.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import log
from typing import Any, NamedTuple

import numpy as np

from fvs_controller_node.base import ControlInput, ControlLaw, ControlOutput
from fvs_controller_node.mfac import IncrementGains
from fvs_controller_node.pseudo_inverse import damped_solution
from fvs_ros.params import live_parameter

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)
#: Beyond this count of time constants nothing is left of the weight, in double precision.
_TIME_CONSTANTS = 60.0


class MpcCoefficients(NamedTuple):
    """The integrals a, b and c of (49)."""

    a: float
    b: float
    c: float


def mpc_coefficients(horizon: float, alpha: float, rho: float) -> MpcCoefficients:
    """Integrals of (49), by quadrature.

    The closed forms divide differences that vanish by powers of ln(alpha): at alpha = 1 they are
    0/0, and short of it by 1e-7 not even the sign of a is right.

    Parameters
    ----------
    horizon : float
        H, control intervals.
    alpha : float
        Forgetting of the future, in (0, 1].
    rho : float
        -ln(beta), how fast the wanted error decays, 1/interval.

    Examples
    --------
    >>> a, b, _ = mpc_coefficients(3.0, 1.0, 1.0)
    >>> round(a, 12), round(b, 12)  # H^3/3, H^2/2
    (9.0, 4.5)
    """
    rate = -log(alpha)
    return MpcCoefficients(
        a=_moment(2, rate, horizon),
        b=_moment(1, rate, horizon),
        c=_moment(1, rate + rho, horizon),
    )


def _moment(power: int, rate: float, horizon: float) -> float:
    """Integral of exp(-rate t) t^power from 0 to the horizon, by Gauss-Legendre quadrature."""
    end = horizon if rate * horizon <= _TIME_CONSTANTS else _TIME_CONSTANTS / rate
    t = 0.5 * end * (_NODES + 1.0)
    return 0.5 * end * float(_WEIGHTS @ (np.exp(-rate * t) * t**power))


@dataclass(frozen=True)
class MpcGains(IncrementGains):
    """Gains of the law; a positive q gives a singular Jacobian a finite command."""

    mpc_horizon: float = live_parameter(
        10.7, "Prediction horizon H, control intervals.", 0.1, 1000.0
    )
    mpc_alpha: float = live_parameter(
        0.64, "Weight alpha of an interval over the one before; 1 weighs all alike.", 0.01, 1.0
    )
    mpc_rho: float = live_parameter(
        1.26, "Decay of the wanted error, 1/interval; more is faster.", 1e-3, 100.0
    )
    mpc_q: float = live_parameter(
        0.07,
        "Weight q of the joint increment, m^2/rad^2; more is slower, most where the feature moves "
        "little.",
        1e-4,
        100.0,
    )


class MpcLaw(ControlLaw):
    """The law (49) as corrected, with Q = q E; the velocity u / T is computed anew at every tick.

    Parameters
    ----------
    gains : MpcGains, optional
        H, alpha, rho, q and T.
    """

    PARAMETERS = MpcGains.declared()

    def __init__(self, gains: MpcGains | None = None) -> None:
        self.gains = one = gains or MpcGains()
        self.coefficients = mpc_coefficients(one.mpc_horizon, one.mpc_alpha, one.mpc_rho)
        a, b, c = self.coefficients
        self._gain_1_s, self._damping = (b - c) / (a * one.control_interval_s), one.mpc_q / a

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> MpcLaw:
        """Build the law with the gains in ``values``."""
        return cls(MpcGains.from_values(values))

    def command(self, control_input: ControlInput) -> ControlOutput:
        """Return the joint velocities for this tick, before any limit."""
        error_m = control_input.error_m
        velocity = damped_solution(control_input.jacobian, -self._gain_1_s * error_m, self._damping)
        return ControlOutput(velocity, np.zeros(error_m.size), np.ones(error_m.size))
