"""Where arm and ball will be when a command takes effect, and how fast one may be there.

A drive does what it is told some 30 ms later. A law that looks at the present brakes too late by
what has been commanded and not been done yet; so it is shown the joints and the error with that
motion made. With the lag out of the way, braking can be planned close to the acceleration limit.
"""

from __future__ import annotations

import numpy as np

from fvs_controller_node.base import ControlInput, ControlOutput
from fvs_ros.vectors import largest

#: Share of the acceleration limit that braking is planned with.
BRAKING_SHARE = 0.9


def braking_speed_within(travel_rad: float, acceleration_rad_s2: float, dt_s: float) -> float:
    """Largest speed from which, from the next tick on, one can brake within a travel, rad/s."""
    step = acceleration_rad_s2 * dt_s
    return float((step * step + 2.0 * acceleration_rad_s2 * travel_rad) ** 0.5 - step)


class Anticipation:
    """Shows a law what will be, and brakes for it.

    Parameters
    ----------
    max_acceleration_rad_s2 : float
        Limit of each joint's command.
    """

    def __init__(self, max_acceleration_rad_s2: float) -> None:
        self._acceleration = BRAKING_SHARE * max_acceleration_rad_s2

    def shift(
        self, present: ControlInput, pending_rad: np.ndarray, target_motion_m: np.ndarray
    ) -> ControlInput:
        """What will be once pending motion of the joints, rad, (n,), and the target has been made.

        ``target_motion_m`` is how far the target goes meanwhile, m, (m,).
        """
        return present._replace(
            error_m=present.error_m + present.jacobian @ pending_rad - target_motion_m,
            joints_rad=present.joints_rad + pending_rad,
        )

    def brake(self, output: ControlOutput, shifted: ControlInput) -> ControlOutput:
        """The output, no faster than it can brake for the target."""
        velocity = output.velocity_rad_s
        fastest = largest(velocity)
        closing = -float(shifted.error_m @ (shifted.jacobian @ velocity))
        if closing <= 0.0:
            return output
        # On this course the error is gone after this time, and the joint has gone that far.
        to_go_s = float(shifted.error_m @ shifted.error_m) / closing
        limit = braking_speed_within(fastest * to_go_s, self._acceleration, shifted.dt_s)
        if limit < fastest:
            velocity = (limit / fastest) * velocity
        return output._replace(velocity_rad_s=velocity)
