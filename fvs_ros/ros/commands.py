"""What the nodes that command an arm share: ticks, joint commands, and the joints' limits."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from std_msgs.msg import String

from fvs_ros import topics
from fvs_ros.clock import Pace
from fvs_ros.interface import VELOCITY, PositionPath
from fvs_ros.limits import URDF_LIMITS, JointLimits, with_urdf_limits
from fvs_ros.ros.messages import ERROR, OK, WARN, send_last_zeros, to_command
from fvs_ros.ros.node import FvsNode
from fvs_ros.urdf import UrdfJoint, read_joints

#: A ramp to rest before the process ends takes no longer, s: who ends it waits for some seconds.
_LONGEST_STOP_S = 2.0


class CommandPublisher:
    """Publishes what the robot's driver takes, on ``topic``."""

    def __init__(self, node: FvsNode) -> None:
        self._path = None if node.values["command_interface"] == VELOCITY else PositionPath()
        self.topic = topics.COMMANDS if self._path is None else topics.POSITION_COMMANDS
        self._publisher = node.publisher(self.topic)
        self._lock_step = node.get_parameter("use_sim_time").value
        self._last = np.zeros(0)  # velocity

    def send(
        self,
        velocity_rad_s: np.ndarray,
        joints_rad: np.ndarray | None,
        dt_s: float,
        limits: JointLimits,
        active: bool,
    ) -> tuple[float, ...]:
        """Send joint velocities, (n,); returns what was sent, empty if nothing.

        Simulated time waits for an answer to each joint state: without a position to send, it is
        where the joints are.
        """
        values, last, self._last = velocity_rad_s, self._last, velocity_rad_s
        if not dt_s and not self._lock_step and values.any() and np.array_equal(values, last):
            return ()  # a tick that counts for nothing: the driver holds this command already
        if self._path is not None:
            position = self._path.follow(velocity_rad_s, joints_rad, dt_s, limits, active)
            if position is None and self._lock_step:
                position = joints_rad
            if position is None:
                return ()
            values = position
        message = to_command(values)
        self._publisher.publish(message)
        return tuple(message.data)

    def end(self, joints: int) -> None:
        """Send the last commands: zeros to a velocity controller, which holds the last one."""
        if self._path is None:
            send_last_zeros(self._publisher, joints)


class Ticker:
    """Calls ``tick`` at every joint state and, while none come, at their period.

    It gets the loop's time, s, and what the tick counts for, s, and returns the joint velocities
    that it sent, (n,).
    """

    def __init__(
        self, node: FvsNode, tick: Callable[[float, float], np.ndarray], rate_hz: float = 0.0
    ) -> None:
        self._node, self._tick, self._pace = node, tick, Pace(rate_hz)
        self._ticked_s, self._patience_s = node.now_s(), self._pace.missing_s
        self.late = 0  #: ticks without a joint state
        self._timer = node.create_timer(self._patience_s, self.on_missing, clock=node.steady_clock)

    def on_joint_state(self, now_s: float, stamp_s: float) -> None:
        """Tick at a joint state that has arrived, with its stamp, s."""
        dt_s = self._pace.joint_state(stamp_s)
        if dt_s > 0.0:  # stamps that stand still put no watchdog off
            self._ticked_s = now_s
            self._wait(self._pace.missing_s)
            self._timer.reset()
        self._tick(now_s, dt_s)

    def on_missing(self) -> None:
        """Tick without a joint state, unless simulated time is only slow."""
        now_s = self._node.now_s()
        if now_s - self._ticked_s >= 0.9 * self._patience_s:
            self.late += 1
            self._ticked_s = now_s
            self._wait(self._pace.period_s or self._patience_s)
            self._tick(now_s, self._pace.missing())

    def _wait(self, patience_s: float) -> None:
        """Change the watchdog's period; a learned one varies a little all the time."""
        if abs(patience_s - self._patience_s) > 0.1 * self._patience_s:
            self._patience_s = patience_s
            self._timer.timer_period_ns = round(1e9 * patience_s)
            self._timer.reset()

    def end(self, velocity_rad_s: np.ndarray, commands: CommandPublisher) -> None:
        """Tick until the arm rests, from its last joint velocities, (n,); then end the commands."""
        period_s, due_s = self._pace.period_s, time.monotonic()
        end_s = due_s + _LONGEST_STOP_S
        try:
            while velocity_rad_s.any() and due_s < end_s:
                due_s = max(due_s + period_s, time.monotonic())
                time.sleep(max(0.0, due_s - time.monotonic()))
                velocity_rad_s = self._tick(self._node.now_s(), self._pace.missing())
        finally:
            commands.end(len(velocity_rad_s))


class LimitsReader:
    """Takes the joints' limits that no parameter gives from ``robot_description``.

    Whenever it comes, ``use`` gets all values with them; or ``refuse`` gets what is wrong with the
    arm's own joints. A description that cannot be read, or is another robot's, is left out.
    """

    def __init__(
        self,
        node: FvsNode,
        use: Callable[[dict[str, Any]], None],
        refuse: Callable[[str], None],
    ) -> None:
        self._node, self._use, self._refuse = node, use, refuse
        self._joints: Mapping[str, UrdfJoint] = {}
        preset = [name for name in URDF_LIMITS if node.values[name]]
        if preset:
            node.tell(OK, f"{', '.join(preset)} are those of the parameters")
        node.subscribe(topics.ROBOT_DESCRIPTION, self._on_description)

    def fill(self, values: dict[str, Any]) -> dict[str, Any]:
        """Values with the limits of ``robot_description``, once it came."""
        return with_urdf_limits(values, self._joints)

    def _on_description(self, message: String) -> None:
        node = self._node
        try:
            joints = read_joints(message.data)
        except ValueError as error:
            node.tell(WARN, f"robot_description is left out: {error}")
            return
        problems = [joint.problem for joint in joints.values() if joint.problem]
        if problems:
            node.tell(WARN, f"robot_description: {'; '.join(problems)}")
        taken = [name for name in URDF_LIMITS if not node.values[name]]
        try:
            values = with_urdf_limits(node.values, joints)
            if taken and values == node.values:
                node.tell(WARN, "robot_description is left out: it has none of the arm's joints")
                return
            self._use(values)
        except ValueError as error:
            node.tell(ERROR, f"robot_description is not usable: {error}")
            self._refuse(str(error))
            return
        self._joints = joints
        if taken:
            node.tell(OK, f"{', '.join(taken)} are those of robot_description")
