"""The proportional laws: the feature moves straight to the target.

The law (46) is ``rdot = -k J^+ (x - x_d)``. For the estimator's update law its sliding variable is
the error, as (45) is corrected in docs/corrections.md.

Model free adaptive control, (48), and model predictive control, (49) as corrected there, give a
joint increment per control interval T. With ``e = x_d - x`` they are ``J' (J J' + lambda E)^-1 e``
and ``(b - c)/a J' (J J' + q/a E)^-1 e``, where

    a = int_0^H alpha^t t^2 dt,  b = int_0^H alpha^t t dt,  c = int_0^H (alpha beta)^t t dt.

Both are computed anew at every tick, which may be shorter than the interval: proportional laws with
gain 1/T and damping lambda, gain (b - c) / (a T) and damping q / a.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import log
from typing import ClassVar

import numpy as np
from scipy.special import hyp1f1

from fvs_controller_node.base import ControlInput, ControlLaw, ControlOutput
from fvs_controller_node.redundancy import damped_solution
from fvs_ros.params import Parameters, live_parameter


@dataclass(frozen=True)
class ProportionalGains(Parameters):
    """Gain of the law (46)."""

    proportional_gain_1_s: float = live_parameter(
        8.0, "Gain of the proportional law, 1/s.", 0.01, 100.0
    )


class ProportionalLaw(ControlLaw):
    """Straight to the target, at a speed in proportion to the error: the law (46)."""

    Gains = ProportionalGains

    def command(self, state: ControlInput) -> ControlOutput:
        """Return the joint velocities for this tick, before any limit."""
        velocity = -self.gains.proportional_gain_1_s * state.error_m
        joint_velocity = self.inverse.joint_velocity(
            state.jacobian, velocity, state.joints_rad, state.home_rad
        )
        return ControlOutput(joint_velocity, state.error_m.copy(), np.ones(state.error_m.size))


@dataclass(frozen=True)
class IncrementGains(Parameters):
    """The gain that both increment laws have."""

    control_interval_s: float = live_parameter(
        0.04, "Control interval that the increment is spread over, s; less is faster.", 1e-3, 10.0
    )


@dataclass(frozen=True)
class MfacGains(IncrementGains):
    """Gains of the law (48); a positive lambda gives a singular Jacobian a finite command."""

    mfac_lambda: float = live_parameter(
        0.15,
        "Weight lambda of the joint increment, m^2/rad^2; more is slower, most where the feature "
        "moves little.",
        1e-4,
        100.0,
    )

    @property
    def gain_and_damping(self) -> tuple[float, float]:
        """Gain, 1/s, and damping, m^2/rad^2."""
        return 1.0 / self.control_interval_s, self.mfac_lambda


class MfacLaw(ControlLaw):
    """The law (48), with the gains lambda and T: proportional, with a damped inverse of its own."""

    Gains: ClassVar[type[Parameters]] = MfacGains

    def command(self, state: ControlInput) -> ControlOutput:
        """Return the joint velocities for this tick, before any limit."""
        error_m = state.error_m
        gain_1_s, damping = self.gains.gain_and_damping
        velocity = damped_solution(state.jacobian, -gain_1_s * error_m, damping)
        return ControlOutput.plain(velocity, error_m.size)


@dataclass(frozen=True)
class MpcGains(IncrementGains):
    """Gains of the law (49); a positive q gives a singular Jacobian a finite command."""

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

    @cached_property
    def gain_and_damping(self) -> tuple[float, float]:
        """Gain, 1/s, and damping, m^2/rad^2."""
        a, b, c = mpc_coefficients(self.mpc_horizon, self.mpc_alpha, self.mpc_rho)
        return (b - c) / (a * self.control_interval_s), self.mpc_q / a


class MpcLaw(MfacLaw):
    """The law (49) as corrected, with Q = q E, and the gains H, alpha, rho, q and T."""

    Gains = MpcGains


def mpc_coefficients(horizon: float, alpha: float, rho: float) -> tuple[float, float, float]:
    """Integrals a, b and c of (49); rho is -ln(beta).

    They are Kummer's functions. The elementary forms divide differences that vanish by powers of
    ln(alpha): at alpha = 1 they are 0/0, and short of it by 1e-7 not even the sign of a is right.
    """
    power, rate = np.array([3, 2, 2]), -log(alpha) + np.array([0.0, 0.0, rho])
    a, b, c = (hyp1f1(power, power + 1, -rate * horizon) * horizon**power / power).tolist()
    return a, b, c
