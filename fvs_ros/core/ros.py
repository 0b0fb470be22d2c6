"""The one shared module that knows ROS: topic names, QoS, messages <-> numpy, node life cycle."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PointStamped, PoseStamped, Vector3Stamped
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.service import Service
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, String

from fvs_ros.core import console, stop, topics
from fvs_ros.core.arguments import node_help
from fvs_ros.core.camera import CameraModel, Intrinsics, camera_model
from fvs_ros.core.chain import SerialChain
from fvs_ros.core.clock import LoopClock
from fvs_ros.core.joints import N_JOINTS
from fvs_ros.core.monitor import ArrivalMonitor
from fvs_ros.core.params import Parameter, ParameterError, ParameterSet
from fvs_ros.core.paths import find_file
from fvs_ros.core.stop import EXIT_BAD_INPUT, EXIT_OK
from fvs_ros.core.vectors import length

try:
    from rclpy.experimental import EventsExecutor
except ImportError:  # before rclpy 7.1.4
    EventsExecutor = None  # type: ignore[assignment]

# Topic names; what they hold stands in topics.py.
JOINT_STATES = topics.JOINT_STATES.name
BALL_POSITION = topics.BALL_POSITION.name
JACOBIAN = topics.JACOBIAN.name
KINEMATIC_CHAIN = topics.KINEMATIC_CHAIN.name
TARGET_POSITION = topics.TARGET_POSITION.name
SLIDING_VARIABLE = topics.SLIDING_VARIABLE.name
COMMANDS = topics.COMMANDS.name
ESTIMATOR_STATUS = topics.ESTIMATOR_STATUS.name
CONTROLLER_STATUS = topics.CONTROLLER_STATUS.name
DETECTOR_STATUS = topics.DETECTOR_STATUS.name
TRUE_BALL_POSITION = topics.TRUE_BALL_POSITION.name
TRUE_JACOBIAN = topics.TRUE_JACOBIAN.name
TRUE_CAMERA_POSE = topics.TRUE_CAMERA_POSE.name
ROBOT_DESCRIPTION = topics.ROBOT_DESCRIPTION.name
STATUS = topics.STATUS.name
DIAGNOSTICS = topics.DIAGNOSTICS.name
COLOR_IMAGE = topics.COLOR_IMAGE.name
DEPTH_IMAGE = topics.DEPTH_IMAGE.name
CAMERA_INFO = topics.CAMERA_INFO.name
ROBOT_PROGRAM_RUNNING = topics.ROBOT_PROGRAM_RUNNING.name
SPEED_SCALING = topics.SPEED_SCALING.name
MARKERS = topics.MARKERS.name
TF_STATIC = topics.TF_STATIC.name


def _qos(reliability: ReliabilityPolicy, durability: DurabilityPolicy) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=1, reliability=reliability, durability=durability
    )


#: Any publisher is compatible with it, and the newest sample wins.
QOS_NEWEST = _qos(ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE)
QOS_RELIABLE = _qos(ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)
QOS_LATCHED = _qos(ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)
#: Heard for certain by whoever is there, and by nobody who comes later.
QOS_EVENT = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    lifespan=Duration(seconds=1.0),
)
#: For a record: nothing is lost while its keeper is busy for a moment, and nothing is old.
QOS_EVERY = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=25, reliability=ReliabilityPolicy.RELIABLE
)
#: For images: one may be still on its way when the next one is there.
QOS_LARGE = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=5, reliability=ReliabilityPolicy.RELIABLE
)

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR

_SPIN_PERIOD_S = 0.05
_LAST_ZEROS, _LAST_ZEROS_PERIOD_S, _LAST_ZEROS_ACK_S = 5, 0.01, 0.5
_DIAGNOSTICS_PERIOD_S = 1.0
#: The same complaint is logged once in this time.
_REPEAT_S = 5.0
_QUATERNION_SLACK = 0.01
#: Messages and requests of others are at most so large, bytes; a robot's description (URDF) may be
#: larger. A request names at most so many things.
_MOST_BYTES, _MOST_BYTES_OF, _MOST_ITEMS = 2**14, {String: 2**22}, 250
#: Images are as large as their pixels, which their decoding bounds; their texts are bounded here.
_IMAGES = (Image, CompressedImage)
#: Longest text that is logged, told or taken for a frame, characters.
_MOST_TEXT = 1000
_BUILT_IN_PARAMETERS = ("use_sim_time", "start_type_description_service", "qos_overrides.")


class MessageError(ValueError):
    """A message that cannot be used; the text says what was wrong and what was expected."""


# --- what comes from others ---


def _unpacked(message_type: type, data: Any) -> Any:
    """The message in what a topic brought, bytes or an image; a ``MessageError`` if it is none."""
    if message_type in _IMAGES:
        size, most, what = len(data.header.frame_id), _MOST_TEXT, "its frame_id"
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


def _plain(text: str) -> str:
    """A text as it may be logged and told: printable, and not too long."""
    return "".join(c if c.isprintable() else " " for c in text[:_MOST_TEXT])


# --- messages <-> numpy. Scalars go through float(): rclpy does not check float fields. ---


def to_stamp(stamp_s: float) -> Time:
    """ROS time of seconds since the clock's epoch, within what a ``Time`` can hold."""
    nanoseconds = min(max(round(stamp_s * 1e9), -(2**31) * 10**9), 2**31 * 10**9 - 1)
    return Time(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)


def from_stamp(stamp: Time) -> float:
    """Seconds since the clock's epoch."""
    return stamp.sec + stamp.nanosec * 1e-9


def to_point(stamp_s: float, frame: str, position_m: np.ndarray) -> PointStamped:
    """``PointStamped`` of a position, m, shape (3,)."""
    message = PointStamped()
    message.header.stamp = to_stamp(stamp_s)
    message.header.frame_id = frame
    x, y, z = position_m
    message.point.x, message.point.y, message.point.z = float(x), float(y), float(z)
    return message


def from_point(message: PointStamped, frame: str, topic: str) -> np.ndarray:
    """Position of a ``PointStamped``.

    Parameters
    ----------
    message : PointStamped
        The message.
    frame : str
        The only frame accepted.
    topic : str
        Name for the error's text.

    Returns
    -------
    ndarray, shape (3,)
        Position, m.

    Raises
    ------
    MessageError
        If it is in another frame or not finite.
    """
    if message.header.frame_id != frame:
        raise MessageError(
            f"{topic} is in frame '{message.header.frame_id}', expected '{frame}' "
            "(parameter feature_frame)"
        )
    position = np.array([message.point.x, message.point.y, message.point.z], dtype=float)
    if not np.all(np.isfinite(position)):
        raise MessageError(f"{topic} is not finite: {position.tolist()}")
    return position


def to_pose(
    stamp_s: float, frame: str, position_m: np.ndarray, quaternion_xyzw: np.ndarray
) -> PoseStamped:
    """``PoseStamped`` of a position, m, shape (3,), and a unit quaternion, shape (4,)."""
    message = PoseStamped()
    message.header.stamp = to_stamp(stamp_s)
    message.header.frame_id = frame
    at, turn = message.pose.position, message.pose.orientation
    at.x, at.y, at.z = (float(value) for value in position_m)
    turn.x, turn.y, turn.z, turn.w = (float(value) for value in quaternion_xyzw)
    return message


def from_pose(message: PoseStamped, topic: str) -> tuple[np.ndarray, np.ndarray]:
    """Position and orientation of a ``PoseStamped``.

    Returns
    -------
    ndarray, shape (3,)
        Position, m.
    ndarray, shape (4,)
        Unit quaternion x, y, z, w.

    Raises
    ------
    MessageError
        If it is not finite, or its quaternion is far from a unit one.
    """
    at, turn = message.pose.position, message.pose.orientation
    position = np.array([at.x, at.y, at.z])
    quaternion = np.array([turn.x, turn.y, turn.z, turn.w])
    size = length(quaternion)
    if not (np.all(np.isfinite(position)) and abs(size - 1.0) < _QUATERNION_SLACK):
        raise MessageError(
            f"{topic} is no pose: position {position.tolist()}, quaternion {quaternion.tolist()}"
        )
    return position, quaternion / size


def to_vector(stamp_s: float, frame: str, vector: np.ndarray) -> Vector3Stamped:
    """``Vector3Stamped`` of a vector, shape (3,)."""
    message = Vector3Stamped()
    message.header.stamp = to_stamp(stamp_s)
    message.header.frame_id = frame
    x, y, z = vector
    message.vector.x, message.vector.y, message.vector.z = float(x), float(y), float(z)
    return message


def _to_matrix(matrix: np.ndarray, row: str, column: str) -> Float64MultiArray:
    """``Float64MultiArray`` of a matrix, row-major, with the names of its dimensions."""
    rows, columns = matrix.shape
    message = Float64MultiArray()
    message.layout.dim = [
        MultiArrayDimension(label=row, size=rows, stride=rows * columns),
        MultiArrayDimension(label=column, size=columns, stride=columns),
    ]
    message.data = np.asarray(matrix, dtype=float).reshape(-1).tolist()
    return message


def _from_matrix(message: Float64MultiArray, name: str, rows: int, columns: int) -> np.ndarray:
    """The matrix of a message, shape (rows, columns); a ``MessageError`` if it is none."""
    sizes = [dim.size for dim in message.layout.dim]
    if len(message.data) != rows * columns or sizes not in ([], [rows, columns]):
        raise MessageError(
            f"{name} has {len(message.data)} values and dimensions {sizes}, "
            f"expected {rows * columns} values and dimensions [{rows}, {columns}]"
        )
    matrix = np.array(message.data, dtype=float).reshape(rows, columns)
    if not np.all(np.isfinite(matrix)):
        raise MessageError(f"{name} holds a value that is not finite")
    return matrix


def to_jacobian(jacobian: np.ndarray) -> Float64MultiArray:
    """``Float64MultiArray`` of a Jacobian, m/rad, shape (3, 6), row-major."""
    return _to_matrix(jacobian, "feature", "joint")


def from_jacobian(message: Float64MultiArray) -> np.ndarray:
    """Jacobian of a ``Float64MultiArray``.

    Returns
    -------
    ndarray, shape (3, 6)
        m/rad, joints in kinematic order.

    Raises
    ------
    MessageError
        If it is not 3x6 or not finite.
    """
    return _from_matrix(message, "jacobian", 3, N_JOINTS)


def to_chain(chain: SerialChain) -> Float64MultiArray:
    """``Float64MultiArray`` of a chain, shape (15, 3), row-major.

    Rows 0 to 5 are the axes, 6 to 11 the points on them, m, 12 the ball, m, and 13 and 14 the
    reference joints, rad.
    """
    reference = chain.reference_rad.reshape(2, 3)
    rows = np.concatenate([chain.axes, chain.points_m, chain.ball_m[None], reference])
    return _to_matrix(rows, "row", "xyz")


def from_chain(message: Float64MultiArray) -> SerialChain:
    """Chain of a ``Float64MultiArray`` as :func:`to_chain` makes it.

    Raises
    ------
    MessageError
        If it is not 15x3, not finite, or no chain.
    """
    rows = _from_matrix(message, "kinematic_chain", 2 * N_JOINTS + 3, 3)
    axes, points, ball, reference = np.split(rows, [N_JOINTS, 2 * N_JOINTS, 2 * N_JOINTS + 1])
    try:
        return SerialChain(axes, points, ball[0], reference.reshape(-1))
    except ValueError as error:
        raise MessageError(f"kinematic_chain is no chain: {error}") from error


def to_command(velocity_rad_s: np.ndarray) -> Float64MultiArray:
    """``Float64MultiArray`` of joint velocities, rad/s, shape (6,), kinematic order.

    Raises
    ------
    MessageError
        If they are not six finite numbers: a velocity controller would go on with its last
        command, or be deactivated.
    """
    velocity = np.asarray(velocity_rad_s, dtype=float)
    if velocity.shape != (N_JOINTS,) or not np.all(np.isfinite(velocity)):
        raise MessageError(f"a command must be {N_JOINTS} finite numbers, got {velocity}")
    return Float64MultiArray(data=velocity.tolist())


def send_last_zeros(commands: Publisher) -> None:
    """Leave several zero commands on the wire: a velocity controller holds its last command."""
    for _ in range(_LAST_ZEROS):
        commands.publish(to_command(np.zeros(N_JOINTS)))
        time.sleep(_LAST_ZEROS_PERIOD_S)
    commands.wait_for_all_acked(Duration(seconds=_LAST_ZEROS_ACK_S))


def to_joint_state(
    stamp_s: float,
    names: Iterable[str],
    positions_rad: np.ndarray,
    velocities_rad_s: np.ndarray,
) -> JointState:
    """``JointState`` of joints in the order of ``names``."""
    message = JointState()
    message.header.stamp = to_stamp(stamp_s)
    message.name = list(names)
    message.position = np.asarray(positions_rad, dtype=float).tolist()
    message.velocity = np.asarray(velocities_rad_s, dtype=float).tolist()
    return message


def to_image(stamp_s: float, frame: str, pixels: np.ndarray, encoding: str) -> Image:
    """``Image`` of a contiguous array, shape (height, width[, channels])."""
    message = Image()
    message.header.stamp = to_stamp(stamp_s)
    message.header.frame_id = frame
    message.height, message.width = int(pixels.shape[0]), int(pixels.shape[1])
    message.encoding = encoding
    message.is_bigendian = sys.byteorder == "big"
    message.step = int(pixels.strides[0])
    # Through bytes: assigning an array goes element by element, ten thousand times slower.
    message.data = np.ascontiguousarray(pixels).tobytes()
    return message


def to_camera_info(stamp_s: float, frame: str, intrinsics: Intrinsics) -> CameraInfo:
    """``CameraInfo`` of a pinhole camera without distortion."""
    fx, fy, cx, cy = (
        float(value) for value in (intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy)
    )
    message = CameraInfo()
    message.header.stamp = to_stamp(stamp_s)
    message.header.frame_id = frame
    message.width, message.height = int(intrinsics.width), int(intrinsics.height)
    message.distortion_model = "plumb_bob"
    message.d = [0.0] * 5
    message.k = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    message.r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    message.p = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    return message


def from_color(message: Image | CompressedImage) -> np.ndarray:
    """Colours of an image, red first, uint8, shape (H, W, 3).

    Raises
    ------
    MessageError
        If it cannot be decoded.
    """
    from fvs_ros.core import images  # and so cv2, which most nodes do without

    try:
        if isinstance(message, CompressedImage):
            return images.decode_compressed_colour(message.data, message.format)
        return images.decode_colour(
            message.data, message.width, message.height, message.step, message.encoding
        )
    except images.ImageError as error:
        raise MessageError(str(error)) from error


def from_depth(message: Image | CompressedImage, unit_m: float) -> np.ndarray:
    """Depth of an image, m, 0 where there is none, float32, shape (H, W).

    Parameters
    ----------
    message : Image or CompressedImage
        16UC1 or 32FC1, raw or as ``compressedDepth``.
    unit_m : float
        Unit of whole-number depth, m.

    Raises
    ------
    MessageError
        If it cannot be decoded.
    """
    from fvs_ros.core import images  # and so cv2, which most nodes do without

    try:
        if isinstance(message, CompressedImage):
            return images.decode_compressed_depth(message.data, message.format, unit_m)
        return images.decode_depth(
            message.data,
            message.width,
            message.height,
            message.step,
            message.encoding,
            big_endian=bool(message.is_bigendian),
            unit_m=unit_m,
        )
    except images.ImageError as error:
        raise MessageError(str(error)) from error


def from_camera_info(message: CameraInfo) -> CameraModel:
    """Calibration of a camera.

    Raises
    ------
    MessageError
        If it cannot be used.
    """
    roi = message.roi
    try:
        return camera_model(
            message.width,
            message.height,
            message.k.tolist(),
            message.distortion_model,
            message.d.tolist(),
            binning=(message.binning_x, message.binning_y),
            roi=(roi.x_offset, roi.y_offset, roi.width, roi.height),
        )
    except ValueError as error:
        raise MessageError(str(error)) from error


def to_status(level: bytes, name: str, message: str, values: Mapping[str, Any]) -> DiagnosticStatus:
    """``DiagnosticStatus`` with numbers printed to five digits."""
    return DiagnosticStatus(
        level=level,
        name=name,
        message=_plain(message),
        values=[KeyValue(key=key, value=_text(value)) for key, value in values.items()],
    )


def _text(value: Any) -> str:
    if isinstance(value, (float, np.floating)):
        return f"{float(value):.5g}" if math.isfinite(value) else "unknown"
    if isinstance(value, np.ndarray):
        return " ".join(f"{float(v):.5g}" for v in value.reshape(-1))
    if value is None:
        return "unknown"
    return _plain(str(value))


def from_status(message: DiagnosticStatus) -> dict[str, str]:
    """The key numbers of a status by name."""
    return {pair.key: pair.value for pair in message.values}


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
        self._status = self.create_publisher(DiagnosticStatus, STATUS, QOS_RELIABLE)
        self._diagnostics = self.create_publisher(DiagnosticArray, DIAGNOSTICS, 10)
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
                text = _plain(f"{topic}: a message was dropped: {error}")
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
        text = _plain(text)
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
