"""Base of every node: checked parameters, bounded inputs, diagnostics, clean shutdown."""

from __future__ import annotations

import contextlib
import math
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.parameter import parameter_dict_from_yaml_file
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.service import Service
from rclpy.subscription import Subscription
from sensor_msgs.msg import Image

from fvs_ros import topics
from fvs_ros.clock import LoopClock
from fvs_ros.kinds import Kind
from fvs_ros.params import Parameter, ParameterError, ParameterSet
from fvs_ros.ros.inputs import MOST_ITEMS, ArrivalMonitor, check_request, unpacked
from fvs_ros.ros.messages import (
    OK,
    WARN,
    MessageError,
    from_feature,
    from_stamp,
    plain,
    to_stamp,
    to_status,
)
from fvs_ros.ros.qos import PROFILES, QOS_LATCHED
from fvs_ros.topics import Topic, message_class

#: Of every node's ``~/status``, s.
STATUS_PERIOD_S = 0.1
_DIAGNOSTICS_PERIOD_S = 1.0
#: What comes again and again is logged once in this time, or it would fill the log, s.
REPEAT_S = 5.0
BUILT_IN_PARAMETERS = ("use_sim_time", "start_type_description_service", "qos_overrides.")


def _descriptor(parameter: Parameter) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=parameter.description,
        additional_constraints=parameter.expected(),
        read_only=not parameter.live,
        dynamic_typing=parameter.live and parameter.default == [],  # of which rclpy sees no type
    )
    if (parameter.minimum, parameter.maximum) == (None, None):
        return descriptor
    # The end of an open range.
    largest = math.inf if parameter.kind is float else 2**62
    low = parameter.kind(-largest if parameter.minimum is None else parameter.minimum)
    high = parameter.kind(largest if parameter.maximum is None else parameter.maximum)
    if parameter.kind is float:
        descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    else:
        descriptor.integer_range = [IntegerRange(from_value=low, to_value=high)]
    return descriptor


def names_from_options() -> set[str]:
    """Parameters that the command line gives to all nodes of the process, by ``-p name:=value``."""
    names = {
        word.partition(":=")[0] for flag, word in pairwise(sys.argv) if flag in ("-p", "--param")
    }
    return {n for n in names if ":" not in n and not n.startswith(BUILT_IN_PARAMETERS)}


def _names_of_all_nodes(namespace: str) -> set[str]:
    """Parameters that files give to all nodes, or to all of a namespace."""
    names = set[str]()
    for flag, word in pairwise(sys.argv):
        for key in ("/**", f"{namespace}/**") if flag == "--params-file" else ():
            with contextlib.suppress(RuntimeError):  # it has no such section
                names |= parameter_dict_from_yaml_file(word, target_nodes=[key]).keys()
    return names


class FvsNode(Node):
    """A node with declared parameters, watched inputs and diagnostics.

    A parameter given at start with a wrong value, or to this node without being its own, is a
    ``ParameterError``. What a file gives to all nodes and this one has not is ignored with a
    warning, unless its name is a slip of one of this node's.
    """

    #: Set to end the process with this exit code.
    exit_code: int | None = None

    #: Whether subscriptions and timers, once created, stay to the end. Such a node runs on the
    #: events executor, in half the CPU time; that one crashes when a subscription is destroyed
    #: (ros2/rclpy#1644) and does not support callback groups.
    keeps_subscriptions = False

    def __init__(self, name: str, parameters: Iterable[Parameter], namespace: str = "") -> None:
        super().__init__(
            name,
            namespace=namespace,
            automatically_declare_parameters_from_overrides=True,
        )
        self._declared_name = name  # also where the user gives it another one
        self.parameter_set = ParameterSet(parameters)
        self.values = self._declare()
        self.add_on_set_parameters_callback(self._on_set)
        simulated = self.get_parameter("use_sim_time").value
        #: Ages on it never jump; stamps (``get_clock``) serve pairing and latency only.
        self._loop_clock = LoopClock(self.ros_s if simulated else None)
        self.steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._monitors: dict[str, ArrivalMonitor] = {}
        self._status = self.publisher(topics.STATUS)
        self._diagnostics = self.create_publisher(DiagnosticArray, topics.DIAGNOSTICS.name, 10)
        self.create_timer(_DIAGNOSTICS_PERIOD_S, self._publish_diagnostics, clock=self.steady_clock)
        self._health: tuple[bytes, str] = (OK, "starting")

    def _declare(self) -> dict[str, Any]:
        overrides = {
            name: self.get_parameter(name).value
            for name in self.get_parameters_by_prefix("")
            if not name.startswith(BUILT_IN_PARAMETERS)
        }
        own = self.parameter_set
        elsewhere = names_from_options()  # in this process, which checks them
        others = [n for n in overrides if n not in own and n not in elsewhere]
        shared = _names_of_all_nodes(self.get_namespace()) if others else ()
        for name in others:
            if name not in shared or own.is_slip(name):
                own[name]  # raises
        values = own.values({n: v for n, v in overrides.items() if n in own})
        if others:
            self.tell(WARN, f"given to all nodes, no parameters of this one: {', '.join(others)}")
        for name in overrides:
            self.undeclare_parameter(name)
        for parameter in self.parameter_set:
            self.declare_parameter(
                parameter.name, values[parameter.name], _descriptor(parameter), ignore_override=True
            )
        return values

    # rclpy refuses wrong names, types and ranges before any callback, with texts that name neither
    # the parameter nor what was expected. So these check first.

    def set_parameters(self, parameter_list: list[rclpy.Parameter]) -> list[SetParametersResult]:
        """Set parameters one by one; refusals say what was expected, and 1 is taken for 1.0."""
        return [self.set_parameters_atomically([parameter]) for parameter in parameter_list]

    def set_parameters_atomically(
        self, parameter_list: list[rclpy.Parameter]
    ) -> SetParametersResult:
        """Set all parameters or none; refusals say what was expected."""
        try:
            return super().set_parameters_atomically([self._settable(p) for p in parameter_list])
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))

    def _settable(self, requested: rclpy.Parameter) -> rclpy.Parameter:
        if requested.name.startswith(BUILT_IN_PARAMETERS):
            return requested
        declared = self.parameter_set[requested.name]
        if not declared.live:
            raise ParameterError(
                f"parameter {requested.name} can be set at start only; restart the node"
            )
        return rclpy.Parameter(requested.name, value=declared.check(requested.value))

    def _on_set(self, changes: list[rclpy.Parameter]) -> SetParametersResult:
        changed = {
            change.name: change.value for change in changes if change.name in self.parameter_set
        }
        candidate = {**self.values, **changed}
        try:
            self.on_parameters(candidate, set(changed))
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self.values = candidate
        return SetParametersResult(successful=True)

    def on_parameters(self, values: dict[str, Any], changed: set[str]) -> None:
        """Take changed live parameters into use; a ``ValueError`` refuses them all."""

    # --- time ---

    def steady_s(self) -> float:
        """Seconds on the steady clock."""
        return time.monotonic()

    def now_s(self) -> float:
        """Seconds of the loop, for ages and time-outs: simulated ones in simulated time."""
        return self._loop_clock.now_s()

    def ros_s(self) -> float:
        """Seconds on the node's ROS clock: for stamps."""
        return self.get_clock().now().nanoseconds * 1e-9

    # --- inputs and diagnostics ---

    def create_subscription(
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[[Any], None],
        qos_profile: QoSProfile | int,
        *,
        raw: bool = False,
        **options: Any,
    ) -> Subscription:
        """Subscribe; what is too large, malformed or refused by a ``MessageError`` is dropped."""

        def on_data(data: Any) -> None:
            try:
                callback(unpacked(msg_type, data))
            except MessageError as error:
                self.log_refusal(f"{topic}: a message was dropped: {error}")

        return super().create_subscription(
            msg_type,
            topic,
            callback if raw else on_data,
            qos_profile,
            # An image from raw bytes takes four times as long to deserialize.
            raw=raw or msg_type is not Image,
            **options,
        )

    def create_service(
        self, srv_type: Any, srv_name: str, callback: Callable[[Any, Any], Any], **options: Any
    ) -> Service:
        """Offer a service; a request that is too large or malformed is refused."""

        def on_request(request: Any, response: Any) -> Any:
            try:
                check_request(request)
            except ValueError as error:
                refusal = SetParametersResult(successful=False, reason=str(error))
                if isinstance(response, SetParameters.Response):
                    response.results = [refusal] * len(request.parameters[:MOST_ITEMS])
                elif isinstance(response, SetParametersAtomically.Response):
                    response.result = refusal
                self.log_refusal(f"{srv_name}: a request was refused: {error}")
                return response
            return callback(request, response)

        return super().create_service(srv_type, srv_name, on_request, **options)

    def subscribe(
        self, topic: Topic, callback: Callable[[Any], None], qos: QoSProfile | None = None
    ) -> None:
        """Watch a topic with the type and, unless given, the quality of service declared for it."""
        for profile in [qos] if qos else [PROFILES[asked] for asked in topic.asks]:
            self.watch(message_class(topic.type), topic.name, callback, profile)

    def subscribe_feature(
        self,
        topic: Topic,
        kind: Kind,
        take: Callable[[float, float, np.ndarray], None],
        refuse: Callable[[str], None],
    ) -> None:
        """Watch what is measured in the frame ``feature_frame``.

        ``take`` its arrival and its exposure, s, and z, (m,); ``refuse`` says why it is none.
        """

        def on_feature(message: Any) -> None:
            now_s = self.now_s()
            try:
                z = from_feature(message, kind, self.values["feature_frame"], topic.name)
            except MessageError as error:
                refuse(str(error))
            else:
                take(now_s, from_stamp(message.header.stamp), z)

        self.subscribe(topic, on_feature)

    def publisher(self, topic: Topic) -> Publisher:
        """Make a publisher with the type and the quality of service that are declared for it."""
        own = f"{self._declared_name}/"
        name = topic.name.replace(own, "~/") if topic.name.startswith(own) else topic.name
        return self.create_publisher(message_class(topic.type), name, PROFILES[topic.offers])

    def watch(
        self, message_type: type, topic: str, callback: Callable[[Any], None], qos: QoSProfile
    ) -> Subscription:
        """Subscribe, and report the input's age, rate and jitter on ``/diagnostics``."""
        monitor = self._monitors.setdefault(topic, ArrivalMonitor())

        def on_message(message: Any) -> None:
            monitor.arrived(self.now_s())
            callback(message)

        # A latched subscription has a volatile one beside it: no warning about publishers.
        events = SubscriptionEventCallbacks(use_default_callbacks=qos is not QOS_LATCHED)
        return self.create_subscription(
            message_type, topic, on_message, qos, event_callbacks=events
        )

    def monitor(self, topic: str) -> ArrivalMonitor:
        """Arrival statistics of a watched input."""
        return self._monitors[topic]

    def other_publishers(self, topic: str) -> list[str]:
        """Full names of other nodes that publish on a topic, sorted.

        For a topic on which this node has one publisher. A second node with its name is listed as
        ``another`` and the name; a node whose name DDS does not know yet as words without a slash.
        A killed node stays in the graph for about twenty seconds.
        """
        own = self.get_fully_qualified_name()
        publishers = [
            "a node whose name is not known yet"
            if "_NODE_NAME_UNKNOWN_" in info.node_name
            else f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in self.get_publishers_info_by_topic(self.resolve_topic_name(topic))
        ]
        others = set(publishers) - {own}
        return sorted(others | {f"another {own}"} if publishers.count(own) > 1 else others)

    @property
    def status_heard(self) -> bool:
        """Whether anybody listens to ``~/status``."""
        return self._status.get_subscription_count() > 0

    def publish_status(
        self, level: bytes, state: str, reason: str, values: Mapping[str, Any]
    ) -> None:
        """Publish ``~/status`` to those who listen: state, reason in words, key numbers."""
        self._health = (level, f"{state}: {reason}")
        if self.status_heard:
            name = self.get_fully_qualified_name()
            self._status.publish(to_status(level, name, reason, {"state": state, **values}))

    def tell(self, level: bytes, text: str) -> None:
        """Log with the severity of a diagnostic level."""
        text = plain(text)
        # One line each: rclpy allows a call site one severity.
        if level == OK:
            self.get_logger().info(text)
        elif level == WARN:
            self.get_logger().warning(text)
        else:
            self.get_logger().error(text)

    def log_refusal(self, text: str) -> None:
        """Log why a message or a request cannot be used, not too often."""
        self.get_logger().warning(plain(text), throttle_duration_sec=REPEAT_S)

    def _publish_diagnostics(self) -> None:
        if not self._diagnostics.get_subscription_count():
            return
        now_s, (level, text) = self.now_s(), self._health
        values = {
            f"{topic} {key}": value
            for topic, monitor in self._monitors.items()
            for key, value in monitor.report(now_s).items()
        }
        message = DiagnosticArray(
            status=[to_status(level, self.get_fully_qualified_name(), text, values)]
        )
        message.header.stamp = to_stamp(self.ros_s())
        self._diagnostics.publish(message)

    # --- life cycle ---

    def finish(self) -> None:
        """Send the last messages before the process ends, whatever the cause."""
