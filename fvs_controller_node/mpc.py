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
from math import inf, log
from typing import Any, ClassVar, NamedTuple

import numpy as np

from fvs_controller_node.base import N_AXES, ControlInput, ControlLaw, ControlOutput
from fvs_controller_node.pseudo_inverse import DampedInverse
from fvs_ros.params import Parameter

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)
#: Beyond so many time constants nothing is left of the weight, in double precision.
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


class MpcLaw(ControlLaw):
    """The law (49) as corrected, with Q = q E, its increment spread over a control interval.

    The velocity is u / T, computed anew at every tick. The posture parameters do not act on this
    law.

    Parameters
    ----------
    horizon : float
        H, control intervals.
    alpha : float
        alpha*, weight of the future, in (0, 1].
    rho : float
        Decay of the wanted error, 1/interval; beta = exp(-rho).
    q : float
        What a squared radian of increment costs, m^2/rad^2; positive, so that a singular Jacobian
        gives a finite command.
    interval_s : float
        T, the control interval, s.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter(
            "mpc_horizon",
            10.7,
            "Prediction horizon H, control intervals.",
            0.1,
            1000.0,
            live=True,
        ),
        Parameter(
            "mpc_alpha",
            0.64,
            "Weight alpha of an interval over that of the one before; 1 weighs all alike.",
            0.01,
            1.0,
            live=True,
        ),
        Parameter(
            "mpc_rho",
            1.26,
            "Decay of the wanted error, 1/interval; more is faster.",
            1e-3,
            100.0,
            live=True,
        ),
        Parameter(
            "mpc_q",
            0.07,
            "Weight q of the joint increment, m^2/rad^2; more is slower, most where the ball moves "
            "little.",
            1e-4,
            100.0,
            live=True,
        ),
        Parameter(
            "mpc_interval_s",
            0.04,
            "Control interval that the increment is spread over, s; less is faster.",
            1e-3,
            10.0,
            live=True,
        ),
    )

    def __init__(
        self,
        horizon: float = 10.7,
        alpha: float = 0.64,
        rho: float = 1.26,
        q: float = 0.07,
        interval_s: float = 0.04,
    ) -> None:
        for name, value in (
            ("mpc_horizon", horizon),
            ("mpc_rho", rho),
            ("mpc_q", q),
            ("mpc_interval_s", interval_s),
        ):
            if not 0.0 < value < inf:
                raise ValueError(f"{name} must be positive, got {value}")
        if not 0.0 < alpha <= 1.0:
            raise ValueError(f"mpc_alpha must be above 0 and at most 1, got {alpha}")
        self.interval_s = interval_s
        self.coefficients = mpc_coefficients(horizon, alpha, rho)
        a, b, c = self.coefficients
        self._gain_1_s = (b - c) / (a * interval_s)
        self._inverse = DampedInverse(q / a)

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> MpcLaw:
        """Build the law with the gains in ``values``."""
        return cls(
            values["mpc_horizon"],
            values["mpc_alpha"],
            values["mpc_rho"],
            values["mpc_q"],
            values["mpc_interval_s"],
        )

    def command(self, control_input: ControlInput) -> ControlOutput:
        """Return the joint velocities for this tick, before any limit."""
        return ControlOutput(
            velocity_rad_s=self._inverse.joint_velocity(
                control_input.jacobian, -self._gain_1_s * control_input.error_m
            ),
            sliding_variable=np.zeros(N_AXES),
            exponent=np.ones(N_AXES),
        )
