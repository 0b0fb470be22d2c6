"""Model free adaptive control, eq. (48): an increment of the joints per control interval.

``dr = (lambda E + J'J)^-1 J' e`` with ``e = x_d - x``, the minimiser of
``|e - J dr|^2 + lambda |dr|^2``. Since ``(lambda E + J'J)^-1 J' = J' (J J' + lambda E)^-1``, it is
the proportional law with gain 1/T and damping lambda: along a direction of singular value w the
error decays at ``w^2 / (w^2 + lambda) / T``. What is adaptive is the Jacobian, not the law.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fvs_controller_node.base import ControlInput, ControlLaw, ControlOutput
from fvs_controller_node.pseudo_inverse import damped_solution
from fvs_ros.params import Parameters, parameter


@dataclass(frozen=True)
class IncrementGains(Parameters):
    """What the laws have in common that give an increment of the joints."""

    control_interval_s: float = parameter(
        0.04,
        "Control interval that the increment is spread over, s; less is faster.",
        1e-3,
        10.0,
        live=True,
    )


@dataclass(frozen=True)
class MfacGains(IncrementGains):
    """Gains of the law; a positive lambda gives a singular Jacobian a finite command."""

    mfac_lambda: float = parameter(
        0.15,
        "Weight lambda of the joint increment, m^2/rad^2; more is slower, most where the feature "
        "moves little.",
        1e-4,
        100.0,
        live=True,
    )


class MfacLaw(ControlLaw):
    """The law (48), its increment spread over a control interval T.

    The tick may be shorter than the interval: the velocity dr / T is that of a step of T seconds,
    computed anew at every tick.

    Parameters
    ----------
    gains : MfacGains, optional
        lambda and T.
    """

    PARAMETERS = MfacGains.declared()

    def __init__(self, gains: MfacGains | None = None) -> None:
        self.gains = gains or MfacGains()

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> MfacLaw:
        """Build the law with the gains in ``values``."""
        return cls(MfacGains.from_values(values))

    def command(self, control_input: ControlInput) -> ControlOutput:
        """Return the joint velocities for this tick, before any limit."""
        error_m = control_input.error_m
        velocity = damped_solution(
            control_input.jacobian, -error_m / self.gains.control_interval_s, self.gains.mfac_lambda
        )
        return ControlOutput(velocity, np.zeros(error_m.size), np.ones(error_m.size))
