"""Messages to numpy and back; an unusable message raises a ``MessageError``."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from fvs_ros.camera import CameraModel, Intrinsics, camera_model
from fvs_ros.chain import SerialChain
from fvs_ros.kinds import Kind
from fvs_ros.kinds.ball import Ball
from fvs_ros.kinds.kind import MOUNTS
from fvs_ros.pixel_chain import AnyChain, PixelChain, PixelChains, Webcam
from fvs_ros.topics import message_class
from fvs_ros.vectors import all_finite

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR

#: Count of the last zeros: a driver may lose one.
_LAST_ZEROS = 5
#: Time between them, s.
_LAST_ZEROS_PERIOD_S = 0.01
#: Longest wait until they have arrived, s.
_LAST_ZEROS_ACK_S = 0.5
#: Of a chain's message: axis, point and reference of a joint, whether it is prismatic, its play.
_CHAIN_COLUMNS = 9
_BALL = Ball()
#: Longest text that is logged, published or taken for a frame, characters.
MOST_TEXT = 1000


class MessageError(ValueError):
    """A message that cannot be used; the text says what was wrong and what was expected."""


def plain(text: str) -> str:
    """A text fit to log and publish: printable, and at most ``MOST_TEXT`` long."""
    return "".join(c if c.isprintable() else " " for c in text[:MOST_TEXT])


# --- messages <-> numpy. Scalars go through float(): rclpy does not check float fields. ---


def to_stamp(stamp_s: float) -> Time:
    """ROS time of seconds since the clock's epoch, within what a ``Time`` can hold."""
    nanoseconds = min(max(round(stamp_s * 1e9), -(2**31) * 10**9), 2**31 * 10**9 - 1)
    return Time(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)


def from_stamp(stamp: Time) -> float:
    """Seconds since the clock's epoch."""
    return stamp.sec + stamp.nanosec * 1e-9


def _stamped(message_type: type, stamp_s: float, frame: str) -> Any:
    """A message, with its header if its type has one."""
    message = message_type()
    if hasattr(message, "header"):
        message.header.stamp, message.header.frame_id = to_stamp(stamp_s), frame
    return message


def to_feature(stamp_s: float, frame: str, kind: Kind, z: np.ndarray) -> Any:
    """Message of a measurement or a target, (m,)."""
    message = _stamped(message_class(kind.topics.tool.type), stamp_s, frame)
    kind.write(message, z)
    return message


def from_feature(message: Any, kind: Kind, frame: str, topic: str) -> np.ndarray:
    """Measurement or target of a message, (m,).

    A ``MessageError`` names the topic if it is in another frame than this, or not usable.
    """
    if message.header.frame_id != frame and not kind.any_frame:
        raise MessageError(
            f"{topic} is in frame '{message.header.frame_id}', expected '{frame}' "
            "(parameter feature_frame)"
        )
    try:
        return kind.read(message)
    except ValueError as error:
        raise MessageError(f"{topic} {error}") from error


def to_sliding(stamp_s: float, frame: str, kind: Kind, sliding_m: np.ndarray) -> Any:
    """Message of a sliding variable, m, (d,)."""
    message = _stamped(message_class(kind.topics.sliding.type), stamp_s, frame)
    kind.write_sliding(message, sliding_m)
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
    if not all_finite(matrix):
        raise MessageError(f"{name} holds a value that is not finite")
    return matrix


def to_jacobian(jacobian: np.ndarray, kind: Kind = _BALL) -> Float64MultiArray:
    """``Float64MultiArray`` of a Jacobian, m/rad, shape (d, n), row-major."""
    return _to_matrix(jacobian / kind.unit[:, None], "feature", "joint")


def from_jacobian(message: Float64MultiArray, joints: int, kind: Kind = _BALL) -> np.ndarray:
    """Jacobian of a message, m/rad, shape (d, joints); a ``MessageError`` if it is none."""
    return _from_matrix(message, "jacobian", kind.size, joints) * kind.unit[:, None]


def to_chain(chain: AnyChain) -> Float64MultiArray:
    """``Float64MultiArray`` of a chain of n joints, shape (n + m / 3, 9), row-major.

    A row for each joint: the direction of its axis, a point on it, m, the joint's reference
    position, rad (m), 1 if it is prismatic, and its play, rad (m). Then the rows of the feature,
    the first with the two numbers of the lens, and 1 from a camera on the arm; and zeros. Before a
    webcam, its numbers in a last row. Before several, so for each.
    """
    each = chain.each if isinstance(chain, PixelChains) else (chain,)
    rows = np.concatenate([_rows_of(chain) for chain in each])
    return _to_matrix(rows, "joint", "axis_point_reference")


def _rows_of(chain: SerialChain | PixelChain) -> np.ndarray:
    arm, webcam = (chain, None) if isinstance(chain, SerialChain) else (chain.chain, chain.webcam)
    joint = np.column_stack([arm.reference_rad, arm.prismatic, arm.play_rad])
    joints, carried = np.hstack([arm.axes, arm.points_m, joint]), arm.feature_m.reshape(-1, 3)
    rows = np.zeros((len(carried) + (webcam is not None), _CHAIN_COLUMNS))
    rows[: len(carried), :3], rows[0, 3:6] = carried, [*arm.lens, arm.on_arm]
    if webcam is not None:
        rows[-1, : len(webcam.numbers)] = webcam.numbers
    return np.concatenate([joints, rows])


def from_chain(message: Float64MultiArray, joints: int, kind: Kind = _BALL) -> AnyChain:
    """Chain of a message as :func:`to_chain` makes it.

    A ``MessageError`` if it is none, or one of another ``camera_mount``.
    """
    parts = kind.parts
    after = joints + parts[0].numbers // (3 if kind.rigid else 2)
    rows = len(parts) * (after if kind.rigid else after + 1)
    matrix = _from_matrix(message, "kinematic_chain", rows, _CHAIN_COLUMNS)
    try:
        each = [_chain_of(block, joints, after, kind) for block in np.split(matrix, len(parts))]
        return each[0] if kind.rigid else PixelChains(tuple(each))
    except ValueError as error:
        raise MessageError(f"kinematic_chain cannot be used: {error}") from error


def _chain_of(matrix: np.ndarray, joints: int, after: int, kind: Kind) -> Any:
    joint, carried = matrix[:joints], kind.nearest(matrix[joints:after, :3].ravel())
    reference_rad, prismatic, play_rad = joint[:, 6:].T
    lens, on_arm = matrix[joints, 3:5], bool(matrix[joints, 5])
    if on_arm != kind.on_arm:
        raise ValueError(f"camera_mount {MOUNTS[on_arm]}, expected {kind.camera_mount}")
    arm = SerialChain(
        joint[:, :3], joint[:, 3:6], carried, reference_rad, prismatic, lens, on_arm, play_rad
    )
    return arm if kind.rigid else PixelChain(arm, Webcam.of_numbers(matrix[after, :6]))


def to_command(velocity_rad_s: np.ndarray) -> Float64MultiArray:
    """``Float64MultiArray`` of joint velocities, rad/s, shape (n,), kinematic order.

    A ``MessageError`` if they are not finite: a velocity controller would continue its last
    command, or be deactivated.
    """
    velocity = np.asarray(velocity_rad_s, dtype=float)
    if velocity.ndim != 1 or not all_finite(velocity):
        raise MessageError(f"a command must be finite numbers, one for each joint, got {velocity}")
    return Float64MultiArray(data=velocity.tolist())


def send_last_zeros(commands: Publisher, joints: int) -> None:
    """Send several zero commands: a velocity controller holds its last command."""
    for _ in range(_LAST_ZEROS):
        commands.publish(to_command(np.zeros(joints)))
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
    message = _stamped(Image, stamp_s, frame)
    message.height, message.width = int(pixels.shape[0]), int(pixels.shape[1])
    message.encoding = encoding
    message.is_bigendian = sys.byteorder == "big"
    message.step = int(pixels.strides[0])
    # Through bytes: assigning an array goes element by element, ten thousand times slower.
    message.data = np.ascontiguousarray(pixels).tobytes()
    return message


def to_camera_info(stamp_s: float, frame: str, intrinsics: Intrinsics) -> CameraInfo:
    """``CameraInfo`` of a pinhole camera without distortion."""
    matrix = intrinsics.matrix
    message = _stamped(CameraInfo, stamp_s, frame)
    message.width, message.height = int(intrinsics.width), int(intrinsics.height)
    message.distortion_model, message.d = "plumb_bob", [0.0] * 5
    message.k, message.r = matrix.reshape(-1), np.eye(3).reshape(-1)
    message.p = np.hstack([matrix, np.zeros((3, 1))]).reshape(-1)
    return message


def from_camera_info(message: CameraInfo) -> CameraModel:
    """Calibration of a camera; a ``MessageError`` if it cannot be used."""
    try:
        return camera_model(message)
    except ValueError as error:
        raise MessageError(str(error)) from error


def to_status(level: bytes, name: str, message: str, values: Mapping[str, Any]) -> DiagnosticStatus:
    """``DiagnosticStatus`` with numbers printed to five digits."""
    return DiagnosticStatus(
        level=level,
        name=name,
        message=plain(message),
        values=[KeyValue(key=key, value=_text(value)) for key, value in values.items()],
    )


def _text(value: Any) -> str:
    if isinstance(value, (float, np.floating)):
        return f"{float(value):.5g}" if math.isfinite(value) else "unknown"
    if isinstance(value, np.ndarray):
        return " ".join(f"{float(v):.5g}" for v in value.reshape(-1))
    if value is None:
        return "unknown"
    return plain(str(value))


def from_status(message: DiagnosticStatus) -> dict[str, str]:
    """The key numbers of a status by name."""
    return {pair.key: pair.value for pair in message.values}
