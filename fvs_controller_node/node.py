"""``fvs_controller_node``: joints, ball, Jacobian and target in, joint velocities out."""

from __future__ import annotations

from fvs_ros import stop

stop.listen()

import sys
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray
from std_srvs.srv import Trigger

from fvs_controller_node.config import PARAMETERS
from fvs_controller_node.inbox import JACOBIAN, JOINT_STATES, OBJECT, ROBOT_DESCRIPTION
from fvs_controller_node.loop import ServoLoop
from fvs_controller_node.reasons import Reason, State
from fvs_controller_node.references import References
from fvs_controller_node.relation import OBJECT_FRAME
from fvs_controller_node.supervisor import Command
from fvs_ros import ros, topics
from fvs_ros.joints import ForeignJointsError, JointMap, JointStateError
from fvs_ros.status import ESTIMATOR_FAULT, ESTIMATOR_WAITING

_NEVER_RAN = "no robot_program_running yet: start the robot program if the arm does not move"
_NO_RANGES = (
    "the joints' ranges are unknown: set joint_min_rad and joint_max_rad, or publish "
    "robot_description"
)
_LATE = (Reason.STALE, Reason.RETURNING)
#: A latched target reaches both subscriptions within this time, s.
_TARGET_ECHO_S = 0.5
#: What keeps it waiting for less is not logged, s.
_PASSING_S = 2.0
_LEVELS = {
    State.SERVOING: ros.OK,
    State.READY: ros.OK,
    State.WAITING: ros.WARN,
    State.HOLDING: ros.WARN,
    State.FAULT: ros.ERROR,
}


class ControllerNode(ros.FvsNode):
    """Ticks at every joint state, and while none come, so that zeros keep flowing."""

    keeps_subscriptions = True

    def __init__(self, namespace: str = "") -> None:
        super().__init__("fvs_controller_node", PARAMETERS, namespace)
        v = self.values
        self._frame = v["feature_frame"]
        self._joint_map = JointMap(v["joint_names"], v["tf_prefix"])
        self._loop = ServoLoop(v)
        self._kind = self._loop.kind
        self._stamp_s: float | None = None
        #: Of each camera, the last samples of targets, of all publishers together, and when.
        self._heard_targets = [deque[tuple]([()], maxlen=16) for _ in self._kind.parts]
        self._heard_target_s = [-np.inf for _ in self._kind.parts]
        self._targets = 0  # how many have come, refused ones included
        self._refusal = ""
        self._conflicting = ""
        self._silence = ""  # of a driver that has never said whether the robot program runs
        self._crowded = ""  # what has more than one publisher, in words
        self._hears_others = False
        self._sent: deque[tuple[float, ...]] = deque(maxlen=64)  # own commands
        self._command: Command | None = None
        self._since_s = -np.inf  # when the present reason began
        self._logged: Reason | None = None
        self._logged_s: dict[Reason, float] = {}

        self._commands = ros.CommandPublisher(self)
        self._sliding = self.publisher(self._kind.topics.sliding)
        self.subscribe(topics.JOINT_STATES, self._on_joint_states)
        parts, inputs = self._kind.parts, self._loop.supervisor.inputs
        for camera, (part, name) in enumerate(zip(parts, inputs.features, strict=True)):
            add_image = partial(self._loop.add_image, camera=camera)
            self.subscribe_feature(part.feature, part, add_image, inputs[name].bad)
            # A latched target is heard twice.
            self.subscribe(part.topics.target, partial(self._on_target, camera=camera))
        if not self._kind.on_arm and len(parts) == 1:
            seen, add_object = self._kind.topics.object, self._loop.add_object
            self.subscribe_feature(seen, self._kind, add_object, inputs[OBJECT].bad)
        take_jacobian = partial(self._on_arm, ros.from_jacobian, self._loop.add_jacobian)
        self.subscribe(topics.JACOBIAN, take_jacobian)
        take_chain = partial(self._on_arm, ros.from_chain, self._loop.add_chain)
        self.subscribe(topics.KINEMATIC_CHAIN, take_chain)
        self.subscribe(topics.ESTIMATOR_STATUS, self._on_estimator_status)
        self.subscribe(topics.SPEED_SCALING, self._on_speed_scaling)
        self.subscribe(topics.ROBOT_PROGRAM_RUNNING, self._on_program_running)
        self._limits = ros.LimitsReader(self, self._take_limits, inputs[ROBOT_DESCRIPTION].bad)
        self.create_service(Trigger, "~/start", self._as_service(self._start))
        self.create_service(Trigger, "~/stop", self._as_service(self._loop.supervisor.stop))
        self.create_service(
            Trigger, "~/set_current_as_target", self._as_service(self._take_current_as_target)
        )
        self.create_service(Trigger, "~/teach", self._as_service(self._teach))
        self.create_service(Trigger, "~/go_to_reference", self._as_service(self._go_to_reference))
        self._ticker = ros.Ticker(self, self._tick, v["joint_state_rate_hz"])
        self.create_timer(ros.STATUS_PERIOD_S, self._publish_status, clock=self.steady_clock)
        self.create_timer(0.5, self._look_around, clock=self.steady_clock)

    # --- inputs ---

    def _on_joint_states(self, message: JointState) -> None:
        now_s, stamp_s = self.now_s(), ros.from_stamp(message.header.stamp)
        supervisor = self._loop.supervisor
        try:
            joints = self._joint_map.positions(message.name, message.position, stamp_s)
        except ForeignJointsError as error:
            # Joint states of another device are an error only while ours have never arrived.
            if self._stamp_s is None:
                supervisor.inputs[JOINT_STATES].bad(str(error))
            return
        except JointStateError as error:
            self._loop.bad_joints(str(error))
        else:
            self._stamp_s = stamp_s
            self._loop.add_joints(now_s, stamp_s, joints)
        self._ticker.on_joint_state(now_s, stamp_s)

    def _on_arm(
        self, read: Callable[..., Any], add: Callable[..., None], message: Float64MultiArray
    ) -> None:
        """Take the Jacobian, or the chain."""
        now_s, joints = self.now_s(), len(self._joint_map.names)
        try:
            add(now_s, read(message, joints, self._kind))
        except ros.MessageError as error:
            self._loop.supervisor.inputs[JACOBIAN].bad(str(error))

    def _on_estimator_status(self, message: DiagnosticStatus) -> None:
        values, now_s = ros.from_status(message), self.now_s()
        supervisor = self._loop.supervisor
        idle = values.get("state") in (ESTIMATOR_WAITING, ESTIMATOR_FAULT)
        supervisor.inputs[JACOBIAN].set_source_status(now_s, message.message if idle else "")

    def _on_target(self, message: Any, camera: int = 0) -> None:
        kind, now_s, frame = self._kind.parts[camera], self.now_s(), message.header.frame_id
        try:  # in its own frame: the goal refuses another one
            target = ros.from_feature(message, kind, frame, kind.topics.target.name)
        except ros.MessageError as error:
            self._targets, self._refusal = self._targets + 1, f"target refused: {error}"
            self.tell(ros.WARN, self._refusal)
            return
        stamp_s = ros.from_stamp(message.header.stamp)
        heard = (*target.tolist(), stamp_s, frame)
        # Latched samples arrive twice, and again whenever the publisher is rediscovered: they must
        # not undo a newer target. Without a stamp (`ros2 topic pub`) only an immediate echo counts.
        soon = now_s - self._heard_target_s[camera] < _TARGET_ECHO_S
        targets = self._heard_targets[camera]
        again = heard in targets if stamp_s != 0.0 else soon and heard == targets[-1]
        targets.append(heard)
        self._heard_target_s[camera] = now_s
        if again:
            return
        if kind.any_frame and frame != OBJECT_FRAME:
            frame = self._frame
        accepted, text = self._loop.add_target(target, frame, stamp_s, camera)
        self._targets, self._refusal = self._targets + 1, "" if accepted else text
        if text and not (accepted and soon):  # a moving target would flood the log
            self.tell(ros.OK if accepted else ros.WARN, text)

    def _take_current_as_target(self) -> tuple[bool, str]:
        accepted, text = self._loop.set_current_as_target(self.now_s())
        if accepted:
            self._targets, self._refusal = self._targets + 1, ""
        return accepted, text

    def _references(self) -> References:
        return References(self.values["references_path"], self._kind, self._joint_map.names)

    def _teach(self) -> tuple[bool, str]:
        name, references = self.values["reference"], self._references()
        try:
            taught = self._loop.teach(self.now_s())
            references.keep(name, taught)
        except (ValueError, OSError) as error:
            return False, f"not taught: {error}"
        where, deviation = self._kind.text(taught.z), self._kind.length_text(taught.deviation_m, 2)
        return True, (
            f"taught {name} in the frame {taught.frame}: {where}, +-{deviation}; "
            f"written to {references.path}"
        )

    def _go_to_reference(self) -> tuple[bool, str]:
        name = self.values["reference"]
        try:
            reference = self._references().get(name)
        except (ValueError, OSError) as error:
            return False, f"target refused: {error}"
        accepted, text = self._loop.go_to(reference, name)
        return accepted, f"{name}: {text}"

    def _take_limits(self, values: dict[str, Any]) -> None:
        self._loop.configure(values)
        self._loop.supervisor.inputs[ROBOT_DESCRIPTION].forget()

    def _on_program_running(self, message: Bool) -> None:
        self._loop.supervisor.inputs.add_program_running(message.data)

    def _on_speed_scaling(self, message: Float64) -> None:
        self._loop.supervisor.inputs.add_speed_scaling(self.now_s(), message.data)

    def _start(self) -> tuple[bool, str]:
        started, text = self._loop.supervisor.start(self.now_s())
        return started, f"{text}; {self._silence}" if self._silence else text

    def _as_service(self, action):
        def on_request(_request: Trigger.Request, response: Trigger.Response):
            response.success, response.message = action()
            tell = self.get_logger().info if response.success else self.log_refusal
            tell(response.message)
            return response

        return on_request

    def on_parameters(self, values: dict[str, Any], changed: set[str]) -> None:
        """Take changed gains and limits into use; another law only while the arm is stopped."""
        if changed <= {"reference", "references_path"}:
            return  # read when they are used
        if values["law"] != self.values["law"] and self._loop.supervisor.started:
            raise ValueError("the law changes only while the arm is stopped; call ~/stop first")
        self._loop.configure(self._limits.fill(values))

    # --- the tick: the only place that sends commands ---

    def _tick(self, now_s: float, dt_s: float) -> np.ndarray:
        command, supervisor = self._loop.tick(now_s, dt_s), self._loop.supervisor
        velocity, limits, active = command.velocity_rad_s, supervisor.config, supervisor.started
        sent = self._commands.send(velocity, self._loop.measured_rad, dt_s, limits, active)
        if sent:
            self._sent.append(sent)
        if self._loop.sliding_variable is not None and self._stamp_s is not None:
            sliding_m = self._loop.sliding_variable
            self._sliding.publish(ros.to_sliding(self._stamp_s, self._frame, self._kind, sliding_m))
        previous, self._command = self._command, command
        if previous is None or previous.reason is not command.reason:
            self._since_s = now_s
            self._publish_status()
        self._tell_reason(now_s, command)
        return velocity

    # --- outputs ---

    def _tell_reason(self, now_s: float, command: Command) -> None:
        # What is missing at a start for a moment is no news.
        if command.state is State.WAITING and now_s < self._since_s + _PASSING_S:
            return
        passes = command.state in (State.WAITING, State.HOLDING) or command.reason in _LATE
        passes = passes and not command.reason.needs_start
        again = passes and now_s < self._logged_s.get(command.reason, -np.inf) + ros.REPEAT_S
        if command.reason is self._logged or again:
            return
        self._logged, self._logged_s[command.reason] = command.reason, now_s
        # Before a start, waiting is normal.
        level = ros.OK if command.state is State.WAITING else _LEVELS[command.state]
        self.tell(level, f"{command.state.value}: {command.text}")

    def _publish_status(self) -> None:
        command = self._command
        if command is None:
            return
        silence = "" if command.state is State.SERVOING else self._silence
        ranges = "" if self._loop.supervisor.config.ranges_known else _NO_RANGES
        hidden = self._loop.supervisor.inputs.hidden(self.now_s())
        crowded = "" if command.reason is Reason.CONFLICT else self._crowded  # it says so
        possible = (self._refusal, silence, ranges, hidden, crowded)
        remarks = [remark for remark in possible if remark]
        text = f"{command.text} ({'; '.join(remarks)})" if remarks else command.text
        values = self._loop.status_values(self.now_s()) if self.status_heard else {}
        values.pop("state", None)
        self.publish_status(
            max(_LEVELS[command.state], ros.WARN if self._crowded else ros.OK),
            command.state.value,
            text,
            {
                **values,
                "late_ticks": self._ticker.late,
                "other_commanders": self._conflicting,
                "refused_target": self._refusal,
                "targets": self._targets,
            },
        )

    def _look_around(self) -> None:
        """Subscribe to the commands once another node publishes them (a killed one may be listed).

        A UR driver publishes ``robot_program_running`` on change only, so never before the first
        program ran. Other drivers never publish it although the robot obeys.
        """
        topic = self.resolve_topic_name(topics.ROBOT_PROGRAM_RUNNING.name)
        unheard = not self.monitor(topics.ROBOT_PROGRAM_RUNNING.name).count
        self._silence = _NEVER_RAN if unheard and self.count_publishers(topic) else ""
        inputs, crowded = self._loop.supervisor.inputs, list[str]()
        for name in (inputs[key].name for key in (*inputs.features, OBJECT, JACOBIAN)):
            count = self.count_publishers(self.resolve_topic_name(name))
            if count > 1:
                crowded.append(f"{name} has {count} publishers: stop all but one")
        # One that is not known by name yet may be this very node.
        self._conflicting = ", ".join(
            n for n in self.other_publishers(self._commands.topic.name) if "/" in n
        )
        if self._conflicting:
            crowded.append(f"{self._conflicting} publishes commands as well: stop it")
        before, self._crowded = self._crowded, "; ".join(crowded)
        if self._crowded != before:
            self.tell(ros.WARN, self._crowded or "only one publisher again")
        if self._conflicting and not self._hears_others:
            self._hears_others = True
            self.subscribe(self._commands.topic, self._on_any_command)

    def _on_any_command(self, message: Float64MultiArray) -> None:
        # Own commands are received, too. The same command from another node does no harm.
        if tuple(message.data) not in self._sent:
            name = self._conflicting or "another node"
            self._loop.supervisor.inputs.conflicting_command(self.now_s(), name)

    def finish(self) -> None:
        """Come to rest, send zeros last, and publish the final status."""
        supervisor = self._loop.supervisor
        supervisor.shutdown()
        self._ticker.end(supervisor.velocity_rad_s, self._commands)
        self._command = self._loop.tick(self.now_s(), 0.0)
        self._publish_status()


def main() -> int:
    """Run ``fvs_controller_node``."""
    return ros.run(ControllerNode, __doc__, PARAMETERS)


if __name__ == "__main__":
    sys.exit(main())
