"""The joint commands on the wire: velocities, or positions that follow them."""

from __future__ import annotations

import numpy as np

from fvs_ros import topics
from fvs_ros.limits import VELOCITY, JointLimits, PositionPath
from fvs_ros.ros.messages import send_last_zeros, to_command
from fvs_ros.ros.node import FvsNode


class CommandPublisher:
    """Publishes what the robot's driver takes, on ``topic``."""

    def __init__(self, node: FvsNode) -> None:
        self._path = None if node.values["command_interface"] == VELOCITY else PositionPath()
        self.topic = topics.COMMANDS if self._path is None else topics.POSITION_COMMANDS
        self._publisher = node.publisher(self.topic)
        self._lock_step = node.get_parameter("use_sim_time").value

    def send(
        self,
        velocity_rad_s: np.ndarray,
        joints_rad: np.ndarray | None,
        dt_s: float,
        limits: JointLimits,
        active: bool,
    ) -> tuple[float, ...]:
        """Send joint velocities, (n,); returns what was sent, empty if nothing.

        Positions need the measured joints, rad, (n,), and are sent in an active session only: a
        position controller holds the last one, and another may take over in between. Simulated time
        waits for an answer to each joint state: then it is where the joints are.
        """
        values = velocity_rad_s
        if self._path is not None:
            active = active or bool(velocity_rad_s.any())
            if not active:
                self._path.end()
            if joints_rad is None or not (active or self._lock_step):
                return ()
            values = self._path.advance(velocity_rad_s, joints_rad, dt_s, limits)
        message = to_command(values)
        self._publisher.publish(message)
        return tuple(message.data)

    def end(self, joints: int) -> None:
        """Send the last commands: zeros to a velocity controller, which holds the last one."""
        if self._path is None:
            send_last_zeros(self._publisher, joints)
