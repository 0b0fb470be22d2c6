"""What every node stands on: checked parameters, bounded inputs, diagnostics, an orderly end."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.service import Service
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import String

from fvs_ros import console, stop, topics
from fvs_ros.arguments import node_help
from fvs_ros.clock import LoopClock
from fvs_ros.params import Parameter, ParameterError, ParameterSet
from fvs_ros.paths import find_file
from fvs_ros.ros.messages import MOST_TEXT, OK, WARN, MessageError, plain, to_stamp, to_status
from fvs_ros.ros.monitor import ArrivalMonitor
from fvs_ros.ros.qos import QOS_LATCHED, QOS_NEWEST, QOS_RELIABLE
from fvs_ros.stop import EXIT_BAD_INPUT, EXIT_OK

try:
    from rclpy.experimental import EventsExecutor
except ImportError:  # before rclpy 7.1.4
    EventsExecutor = None  # type: ignore[assignment]

_SPIN_PERIOD_S = 0.05
_DIAGNOSTICS_PERIOD_S = 1.0
#: The same complaint is logged once in this time.
_REPEAT_S = 5.0
#: Messages and requests of others are at most so large, bytes; a robot's description (URDF) may be
#: larger. A request names at most so many things.
_MOST_BYTES, _MOST_BYTES_OF, _MOST_ITEMS = 2**14, {String: 2**22}, 250
#: Images are as large as their pixels, which their decoding bounds; their texts are bounded here.
_IMAGES = (Image, CompressedImage)
_BUILT_IN_PARAMETERS = ("use_sim_time", "start_type_description_service", "qos_overrides.")


# --- what comes from others ---


def _unpacked(message_type: type, data: Any) -> Any:
    """The message in what a topic brought, bytes or an image; a ``MessageError`` if it is none."""
    if message_type in _IMAGES:
        size, most, what = len(data.header.frame_id), MOST_TEXT, "its frame_id"
    else:
        size, most, what = len(data), _MOST_BYTES_OF.get(message_type, _MOST_BYTES), "it"
    if size > most:
        raise MessageError(f"{what} has {size} bytes, expected at most {most}")
    try:
        return data if message_type in _IMAGES else deserialize_message(data, message_type)
    except RuntimeError as error:
        raise MessageError(str(error)) from error


def _check_request(request: Any) -> None:
    """A ``ValueError`` if a service's request is too large or malformed."""
    size = len(serialize_message(request))
    fields = [getattr(request, name) for name in request.get_fields_and_field_types()]
    items = max([len(field) for field in fields if isinstance(field, list)], default=0)
    if size > _MOST_BYTES or items > _MOST_ITEMS:
        raise MessageError(
            f"a request of {items} items and {size} bytes is too large, "
            f"expected at most {_MOST_ITEMS} and {_MOST_BYTES}"
        )
    for parameter in getattr(request, "parameters", ()):
        rclpy.Parameter.from_parameter_msg(parameter)  # raises if its type is unknown


# --- parameters ---


def _descriptor(parameter: Parameter) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=parameter.description,
        additional_constraints=parameter.expected(),
        read_only=not parameter.live,
    )
    bounds = (parameter.minimum, parameter.maximum)
    if bounds != (None, None):
        low, high = (-math.inf if bounds[0] is None else bounds[0]), bounds[1]
        if parameter.kind is float:
            high = math.inf if high is None else high
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(low), to_value=float(high))
            ]
        elif parameter.kind is int:
            descriptor.integer_range = [
                IntegerRange(
                    from_value=int(max(low, -(2**62))),
                    to_value=int(2**62 if high is None else high),
                )
            ]
    return descriptor


class NeverReady(CallbackGroup):
    """Subscriptions that the executor leaves alone: their messages are fetched."""

    def can_execute(self, entity: Any) -> bool:
        """Never."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Never."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Nothing has begun."""


class Sampled:
    """A topic that is looked at when it suits: its messages wake nobody.

    Hundreds of messages a second cost a process a good part of a core even if it only wants to
    know, now and then, what the newest one says.

    Parameters
    ----------
    node : Node
        Who looks.
    message_type : type
        Of the topic.
    topic : str
        Its name.
    callback : callable
        Takes a message.
    """

    def __init__(
        self, node: Node, message_type: type, topic: str, callback: Callable[[Any], None]
    ) -> None:
        self._node = node
        self._subscription = node.create_subscription(
            message_type, topic, callback, QOS_NEWEST, callback_group=NeverReady()
        )

    def look(self) -> None:
        """Take the newest message, if one has come since the last look."""
        subscription = self._subscription
        with subscription.handle:
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        if taken is not None:
            subscription.callback(taken[0])

    def close(self) -> None:
        """Hear no more."""
        self._node.destroy_subscription(self._subscription)


class FvsNode(Node):
    """A node with declared parameters, watched inputs and diagnostics.

    Parameters
    ----------
    name : str
        Node name.
    parameters : iterable of Parameter
        Its parameters; overrides that are unknown or wrong are refused.

    Raises
    ------
    ParameterError
        If a parameter given at start is unknown or has a wrong value.
    """

    def __init__(self, name: str, parameters: Iterable[Parameter]) -> None:
        super().__init__(name, automatically_declare_parameters_from_overrides=True)
        self.parameter_set = ParameterSet(parameters)
        self.values = self._declare()
        self.add_on_set_parameters_callback(self._on_set)
        simulated = self.get_parameter("use_sim_time").value
        #: Ages on it never jump; stamps (``get_clock``) serve pairing and latency only.
        self._loop_clock = LoopClock(self.ros_s if simulated else None)
        self.steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._monitors: dict[str, ArrivalMonitor] = {}
        self._status = self.create_publisher(DiagnosticStatus, topics.STATUS.name, QOS_RELIABLE)
        self._diagnostics = self.create_publisher(DiagnosticArray, topics.DIAGNOSTICS.name, 10)
        self.create_timer(_DIAGNOSTICS_PERIOD_S, self._publish_diagnostics, clock=self.steady_clock)
        self._health: tuple[bytes, str] = (OK, "starting")

    def _declare(self) -> dict[str, Any]:
        given = {
            name: self.get_parameter(name).value
            for name in self.get_parameters_by_prefix("")
            if not name.startswith(_BUILT_IN_PARAMETERS)
        }
        values = self.parameter_set.values(given)
        for name in given:
            self.undeclare_parameter(name)
        for parameter in self.parameter_set:
            self.declare_parameter(
                parameter.name,
                values[parameter.name],
                _descriptor(parameter),
                ignore_override=True,
            )
        return values

    # rclpy refuses wrong names, types and ranges before any callback, in words of its own that
    # name neither the parameter nor what was expected. So these look first.

    def set_parameters(self, parameter_list: list[rclpy.Parameter]) -> list[SetParametersResult]:
        """Set parameters one by one; refusals say what was expected, and 1 is taken for 1.0."""
        return [self.set_parameters_atomically([given]) for given in parameter_list]

    def set_parameters_atomically(
        self, parameter_list: list[rclpy.Parameter]
    ) -> SetParametersResult:
        """Set all parameters or none; refusals say what was expected."""
        try:
            return super().set_parameters_atomically([self._settable(p) for p in parameter_list])
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))

    def _settable(self, given: rclpy.Parameter) -> rclpy.Parameter:
        if given.name.startswith(_BUILT_IN_PARAMETERS):
            return given
        parameter = self.parameter_set[given.name]
        if not parameter.live:
            raise ParameterError(
                f"parameter {given.name} can be set at start only; restart the node"
            )
        return rclpy.Parameter(given.name, value=parameter.check(given.value))

    def _on_set(self, changes: list[rclpy.Parameter]) -> SetParametersResult:
        accepted: dict[str, Any] = {}
        try:
            for change in changes:
                if change.name.startswith(_BUILT_IN_PARAMETERS):
                    continue
                accepted[change.name] = self.parameter_set[change.name].check(change.value)
            candidate = {**self.values, **accepted}
            self.on_parameters(candidate, set(accepted))
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
                callback(_unpacked(msg_type, data))
            except MessageError as error:
                text = plain(f"{topic}: a message was dropped: {error}")
                self.get_logger().warning(text, throttle_duration_sec=_REPEAT_S)

        return super().create_subscription(
            msg_type,
            topic,
            callback if raw else on_data,
            qos_profile,
            # From its bytes an image takes four times as long to unpack.
            raw=raw or msg_type not in _IMAGES,
            **options,
        )

    def create_service(
        self, srv_type: Any, srv_name: str, callback: Callable[[Any, Any], Any], **options: Any
    ) -> Service:
        """Offer a service; a request that is too large or malformed is refused."""

        def on_request(request: Any, response: Any) -> Any:
            try:
                _check_request(request)
            except ValueError as error:
                refusal = SetParametersResult(successful=False, reason=str(error))
                if isinstance(response, SetParameters.Response):
                    response.results = [refusal] * len(request.parameters[:_MOST_ITEMS])
                elif isinstance(response, SetParametersAtomically.Response):
                    response.result = refusal
                text = f"{srv_name}: a request was refused: {error}"
                self.get_logger().warning(text, throttle_duration_sec=_REPEAT_S)
                return response
            return callback(request, response)

        return super().create_service(srv_type, srv_name, on_request, **options)

    def watch(
        self, message_type: type, topic: str, callback: Callable[[Any], None], qos: QoSProfile
    ) -> Any:
        """Subscribe, and report the input's age, rate and jitter on ``/diagnostics``."""
        monitor = self._monitors.setdefault(topic, ArrivalMonitor())

        def on_message(message: Any) -> None:
            monitor.arrived(self.now_s())
            callback(message)

        # What is watched latched is watched volatile, too: no publisher is to be warned of.
        events = SubscriptionEventCallbacks(use_default_callbacks=qos is not QOS_LATCHED)
        return self.create_subscription(
            message_type, topic, on_message, qos, event_callbacks=events
        )

    def monitor(self, topic: str) -> ArrivalMonitor:
        """Arrival statistics of a watched input."""
        return self._monitors[topic]

    def other_publishers(self, topic: str) -> list[str]:
        """Full names of other nodes that publish on a topic, sorted.

        A second node of this one's name is called ``another`` and the name; of a node that is
        not fully known yet, words stand in place of the name, without a slash. For a topic that
        this node has one publisher of. A node that was killed stays in the graph for some twenty
        seconds.
        """
        own = self.get_fully_qualified_name()
        found = [
            "a node whose name is not known yet"
            if "_NODE_NAME_UNKNOWN_" in info.node_name
            else f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in self.get_publishers_info_by_topic(self.resolve_topic_name(topic))
        ]
        others = set(found) - {own}
        return sorted(others | {f"another {own}"} if found.count(own) > 1 else others)

    def publish_status(
        self, level: bytes, state: str, reason: str, values: Mapping[str, Any]
    ) -> None:
        """Publish ``~/status``: state, reason in words, key numbers."""
        self._health = (level, f"{state}: {reason}")
        name = self.get_fully_qualified_name()
        self._status.publish(to_status(level, name, reason, {"state": state, **values}))

    def tell(self, level: bytes, text: str) -> None:
        """Log with the severity of a diagnostic level."""
        text = plain(text)
        # One line each: rclpy holds a call site to its first severity.
        if level == OK:
            self.get_logger().info(text)
        elif level == WARN:
            self.get_logger().warning(text)
        else:
            self.get_logger().error(text)

    def diagnostic_values(self) -> dict[str, Any]:
        """More key numbers for ``/diagnostics``."""
        return {}

    def _publish_diagnostics(self) -> None:
        now_s = self.now_s()
        values: dict[str, Any] = {}
        for topic, monitor in self._monitors.items():
            for key, value in monitor.report(now_s).items():
                values[f"{topic} {key}"] = value
        values.update(self.diagnostic_values())
        level, text = self._health
        message = DiagnosticArray(
            status=[to_status(level, self.get_fully_qualified_name(), text, values)]
        )
        message.header.stamp = to_stamp(self.ros_s())
        self._diagnostics.publish(message)

    # --- life cycle ---

    #: Set to end the process with this exit code.
    exit_code: int | None = None

    #: Whether subscriptions, timers and the like, once created, stay to the end. Such a node does
    #: without wait sets, which take half of its time; the executor that does crashes where a
    #: subscription is destroyed (ros2/rclpy#1644), and knows no callback groups.
    keeps_subscriptions = False

    def finish(self) -> None:
        """Last words on the wire before the process ends, whatever ended it."""


def run(
    make_node: Callable[[], FvsNode],
    doc: str,
    parameters: Iterable[Parameter],
    argv: list[str] | None = None,
) -> int:
    """Run one node in this process until a signal, its own wish, or an error.

    Signals end the spin loop, not the ROS context, so that ``finish`` can still send. A blocked
    terminal does not hold the node: what it cannot take is dropped.

    Parameters
    ----------
    make_node : callable
        Builds the node after ``rclpy.init``.
    doc : str
        Docstring of its module, for ``--help``: name, and what it is for.
    parameters : iterable of Parameter
        Its parameters, for ``--help``.
    argv : list of str, optional
        Arguments with ``--ros-args``; default those of the process.

    Returns
    -------
    int
        0 after a signal or a finished task, 1 after an error, 2 after a wrong parameter or file.
    """
    stop.listen()
    # A first announcement that is lost costs a moment, not three seconds; read by Fast DDS alone.
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(find_file("quick_discovery.xml")))
    with console.never_blocking():
        if {"-h", "--help"} & set(sys.argv if argv is None else argv):
            print(node_help(doc, parameters))
            return EXIT_OK
        return _run(make_node, argv)


def _run(make_node: Callable[[], FvsNode], argv: list[str] | None) -> int:
    try:
        unknown = remove_ros_args(sys.argv if argv is None else argv)[1:]
        if unknown:  # rclpy would pass over them, and the node run with other values than wanted
            _say(
                f"cannot start: unknown argument {unknown[0]!r}; parameters and remaps stand "
                "behind --ros-args, as in --ros-args -p name:=value; --help lists them"
            )
            return EXIT_BAD_INPUT
        rclpy.init(args=argv, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # rcl's own: arguments or a parameter file it cannot read
        _say(f"cannot start: {error}")
        return EXIT_BAD_INPUT
    node = None
    try:
        try:
            node = make_node()
        except (ValueError, OSError, ParameterException) as error:
            _say(f"cannot start: {error}")
            return EXIT_BAD_INPUT
        executor = _make_executor(node.keeps_subscriptions)
        executor.add_node(node)
        try:
            while not stop.RECEIVED and node.exit_code is None and rclpy.ok():
                executor.spin_once(timeout_sec=_SPIN_PERIOD_S)
        except ExternalShutdownException:
            return EXIT_OK
        finally:
            node.finish()
            executor.shutdown(timeout_sec=0.0)  # left to the garbage collector, it complains
        return EXIT_OK if node.exit_code is None else node.exit_code
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()


def _make_executor(events: bool) -> Executor:
    events_too = events and EventsExecutor is not None
    return EventsExecutor() if events_too else SingleThreadedExecutor()


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
