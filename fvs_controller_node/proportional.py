"""The simplest law: the ball moves straight to the target, ``rdot = -k J^+ (x - x_d)``, eq. (46).

The paper calls it, with RBF networks that learn by (45), the scheme "RBF+PID"; there is neither an
integral nor a derivative in it. As corrected, (45) is ``rdot_i theta_i (n2 (x - x_d) + n3 e)``: the
update law (17) with the error in the place of the sliding variable, n2 in that of alpha2 and n3 in
that of n1. The law therefore gives the error as its sliding variable.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from typing import Any, ClassVar

import numpy as np

from fvs_controller_node.allocation import Inverse, make_inverse
from fvs_controller_node.base import N_AXES, ControlInput, ControlLaw, ControlOutput
from fvs_controller_node.pseudo_inverse import DampedInverse
from fvs_ros.params import Parameter


class ProportionalLaw(ControlLaw):
    """Proportional control of the ball position.

    Parameters
    ----------
    gain_1_s : float
        k, 1/s.
    inverse : Inverse, optional
        From ball velocity to joint velocities.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter(
            "proportional_gain_1_s",
            8.0,
            "Gain of the proportional law, 1/s.",
            0.01,
            100.0,
            live=True,
        ),
    )

    def __init__(self, gain_1_s: float = 8.0, inverse: Inverse | None = None) -> None:
        if not 0.0 < gain_1_s < inf:
            raise ValueError(f"proportional_gain_1_s must be positive, got {gain_1_s}")
        self.gain_1_s = gain_1_s
        self.inverse: Inverse = inverse or DampedInverse()

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> ProportionalLaw:
        """Build the law with the gains in ``values``."""
        return cls(values["proportional_gain_1_s"], make_inverse(values))

    def command(self, control_input: ControlInput) -> ControlOutput:
        """Return the joint velocities for this tick, before any limit."""
        return ControlOutput(
            velocity_rad_s=self.inverse.joint_velocity(
                control_input.jacobian,
                -self.gain_1_s * control_input.error_m,
                control_input.joints_rad,
                control_input.home_rad,
            ),
            sliding_variable=control_input.error_m.copy(),
            exponent=np.ones(N_AXES),
        )
