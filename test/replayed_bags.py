"""Bags made by hand, without ROS: what a robot did in them is known exactly."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rosbags.rosbag2 import StoragePlugin, Writer

from fvs_ros.joints import UR_JOINT_NAMES
from fvs_tools.bag import TYPES, Message

#: When every recording here begins, s.
BEGIN_S = 1_700_000_000.0
T = TYPES.types


def write_bag(
    folder: Path,
    messages: Iterable[Message],
    storage: StoragePlugin = StoragePlugin.MCAP,
    **notes: Any,
) -> Path:
    """Write messages, and notes as YAML; returns the folder."""
    writer = Writer(folder, version=9, storage_plugin=storage)
    for name, content in notes.items():
        writer.set_custom_data(name, yaml.safe_dump(content))
    writer.open()
    connections: dict[tuple[str, str], Any] = {}
    for one in messages:
        key = one.topic, one.message_type
        if key not in connections:
            connections[key] = writer.add_connection(*key, typestore=TYPES)
        writer.write(connections[key], one.stamp_ns, one.data)
    writer.close()
    return folder


def file_in(folder: Path) -> Path:
    """The one file with messages."""
    (file,) = (one for one in folder.iterdir() if one.suffix in (".mcap", ".db3"))
    return file


def message(topic: str, kind: str, at_s: float, *fields: Any) -> Message:
    """A message that arrives at a time, s since the beginning."""
    data = bytes(TYPES.serialize_cdr(T[kind](*fields), kind))
    return Message(f"/{topic}", kind, round((BEGIN_S + at_s) * 1e9), data)


def header(stamp_s: float | None) -> Any:
    time_ns = 0 if stamp_s is None else round((BEGIN_S + stamp_s) * 1e9)
    stamp = T["builtin_interfaces/msg/Time"](*divmod(time_ns, 10**9))
    return T["std_msgs/msg/Header"](stamp, "camera")


def point(topic: str, at_s: float, stamp_s: float | None, position_m: Any) -> Message:
    place = T["geometry_msgs/msg/Point"](*map(float, position_m))
    return message(topic, "geometry_msgs/msg/PointStamped", at_s, header(stamp_s), place)


def pose(topic: str, at_s: float, stamp_s: float, position_m: Any, angle_rad: float) -> Message:
    """A pose that is turned about z."""
    half_rad = 0.5 * angle_rad
    turn = T["geometry_msgs/msg/Quaternion"](0.0, 0.0, np.sin(half_rad), np.cos(half_rad))
    place = T["geometry_msgs/msg/Pose"](T["geometry_msgs/msg/Point"](*position_m), turn)
    return message(topic, "geometry_msgs/msg/PoseStamped", at_s, header(stamp_s), place)


def joints(at_s: float, stamp_s: float, speeds_rad_s: np.ndarray) -> Message:
    """As a UR's driver does: in alphabetical order."""
    names = sorted(UR_JOINT_NAMES)
    speeds = speeds_rad_s[[UR_JOINT_NAMES.index(name) for name in names]]
    fields = (header(stamp_s), names, np.zeros(6), speeds, np.zeros(6))
    return message("joint_states", "sensor_msgs/msg/JointState", at_s, *fields)


def array(topic: str, at_s: float, values: Any) -> Message:
    layout = T["std_msgs/msg/MultiArrayLayout"]([], 0)
    return message(topic, "std_msgs/msg/Float64MultiArray", at_s, layout, np.array(values, float))


def status(at_s: float, state: str, reason: str, target_m: Any = ()) -> Message:
    values = {"state": state, "reason": reason}
    values |= {f"target_{axis}_m": f"{one:.3f}" for axis, one in zip("xyz", target_m, strict=False)}
    pairs = [T["diagnostic_msgs/msg/KeyValue"](*pair) for pair in values.items()]
    name, kind = "fvs_controller_node", "diagnostic_msgs/msg/DiagnosticStatus"
    return message(f"{name}/status", kind, at_s, 0, name, "", "", pairs)


START_M, TARGET_M = np.array([0.3, 0.0, 1.4]), np.array([0.0, 0.0, 1.4])
#: Rate at which the distance shrinks, 1/s, and when the target is given, and the end, s.
DECAY_1_S, GIVEN_S, END_S = 4.0, 1.0, 5.0


def distance_m(time_s: float) -> float:
    """Distance to the target in :func:`servo`, m."""
    return 0.3 * float(np.exp(-DECAY_1_S * max(0.0, time_s - GIVEN_S)))


def servo(target: str = "target_position") -> Iterator[Message]:
    """The ball goes straight to one target, exponentially."""
    for time_s in np.arange(0.0, END_S, 0.008):
        speeds = np.zeros(6)
        speeds[0] = -DECAY_1_S * distance_m(time_s) / 0.5 if time_s >= GIVEN_S else 0.0
        yield joints(time_s + 0.002, time_s, speeds)
        yield array("forward_velocity_controller/commands", time_s + 0.004, speeds)
        at_m = TARGET_M + [distance_m(time_s), 0.0, 0.0]
        yield point("fvs_sim_node/true_ball_position", time_s + 0.001, time_s, at_m)
    for time_s in np.arange(0.0, END_S, 1 / 30):
        at_m = TARGET_M + [distance_m(time_s), 0.001, 0.0]
        yield point("ball_position", time_s + 0.045, time_s, at_m)
    yield point(target, GIVEN_S + 0.001, GIVEN_S, TARGET_M)
    for time_s in np.arange(0.0, END_S, 0.1):
        if time_s < GIVEN_S:
            yield status(time_s, "WAITING", "NO_TARGET")
        else:
            yield status(time_s, "SERVOING", "SERVOING" if time_s < 3.0 else "SETTLED", TARGET_M)
