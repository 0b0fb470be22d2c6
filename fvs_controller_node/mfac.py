"""Model free adaptive control, eq. (48): an increment of the joints per control interval.

``dr = (lambda E + J'J)^-1 J' e`` with ``e = x_d - x``, the minimiser of
``|e - J dr|^2 + lambda |dr|^2``. Since ``(lambda E + J'J)^-1 J' = J' (J J' + lambda E)^-1``, it is
the proportional law with gain 1/T and damping lambda: along a direction of singular value w the
error decays at ``w^2 / (w^2 + lambda) / T``. What is adaptive is the Jacobian, not the law.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from typing import Any, ClassVar

import numpy as np

from fvs_controller_node.base import N_AXES, ControlInput, ControlLaw, ControlOutput
from fvs_controller_node.pseudo_inverse import DampedInverse
from fvs_ros.params import Parameter


class MfacLaw(ControlLaw):
    """The law (48), its increment spread over a control interval.

    The tick may be shorter than the interval: the velocity dr / T is that of a step of T seconds,
    computed anew at every tick. The posture parameters do not act on this law.

    Parameters
    ----------
    damping : float
        lambda, m^2/rad^2: what a squared radian of increment costs; positive, so that a singular
        Jacobian gives a finite command.
    interval_s : float
        T, the control interval that the paper's increment is meant for, s.
    """

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter(
            "mfac_lambda",
            0.15,
            "Weight lambda of the joint increment, m^2/rad^2; more is slower, most where the ball "
            "moves little.",
            1e-4,
            100.0,
            live=True,
        ),
        Parameter(
            "mfac_interval_s",
            0.04,
            "Control interval that the increment is spread over, s; less is faster.",
            1e-3,
            10.0,
            live=True,
        ),
    )

    def __init__(self, damping: float = 0.15, interval_s: float = 0.04) -> None:
        if not 0.0 < damping < inf:
            raise ValueError(f"mfac_lambda must be positive, got {damping}")
        if not 0.0 < interval_s < inf:
            raise ValueError(f"mfac_interval_s must be positive, got {interval_s}")
        self.interval_s = interval_s
        self._inverse = DampedInverse(damping)

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> MfacLaw:
        """Build the law with the gains in ``values``."""
        return cls(values["mfac_lambda"], values["mfac_interval_s"])

    def command(self, control_input: ControlInput) -> ControlOutput:
        """Return the joint velocities for this tick, before any limit."""
        return ControlOutput(
            velocity_rad_s=self._inverse.joint_velocity(
                control_input.jacobian, -control_input.error_m / self.interval_s
            ),
            sliding_variable=np.zeros(N_AXES),
            exponent=np.ones(N_AXES),
        )
