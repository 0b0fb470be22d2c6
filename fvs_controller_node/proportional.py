"""The simplest law: the feature moves straight to the target, ``rdot = -k J^+ (x - x_d)``, (46).

The paper calls it, with RBF networks that learn by (45), the scheme "RBF+PID"; there is neither an
integral nor a derivative in it. As corrected, (45) is ``rdot_i theta_i (n2 (x - x_d) + n3 e)``: the
update law (17) with the error in the place of the sliding variable, n2 in that of alpha2 and n3 in
that of n1. The law therefore gives the error as its sliding variable.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fvs_controller_node.base import ControlInput, ControlLaw, ControlOutput
from fvs_controller_node.pseudo_inverse import DampedInverse
from fvs_controller_node.redundancy import Inverse, make_inverse
from fvs_ros.params import Parameters, parameter


@dataclass(frozen=True)
class ProportionalGains(Parameters):
    """Gain of the law."""

    proportional_gain_1_s: float = parameter(
        8.0, "Gain of the proportional law, 1/s.", 0.01, 100.0, live=True
    )


class ProportionalLaw(ControlLaw):
    """Proportional control of the feature.

    Parameters
    ----------
    gains : ProportionalGains, optional
        The gain k.
    inverse : Inverse, optional
        From feature velocity to joint velocities.
    """

    PARAMETERS = ProportionalGains.declared()

    def __init__(
        self, gains: ProportionalGains | None = None, inverse: Inverse | None = None
    ) -> None:
        self.gains = gains or ProportionalGains()
        self.inverse: Inverse = inverse or DampedInverse()

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> ProportionalLaw:
        """Build the law with the gain in ``values``."""
        return cls(ProportionalGains.from_values(values), make_inverse(values))

    def command(self, control_input: ControlInput) -> ControlOutput:
        """Return the joint velocities for this tick, before any limit."""
        one = control_input
        velocity = -self.gains.proportional_gain_1_s * one.error_m
        joint_velocity = self.inverse.joint_velocity(
            one.jacobian, velocity, one.joints_rad, one.home_rad
        )
        return ControlOutput(joint_velocity, one.error_m.copy(), np.ones(one.error_m.size))
