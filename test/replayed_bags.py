"""Bags made by hand, without ROS: what a robot did in them is known exactly."""

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer

from fvs_ros.joints import UR_JOINT_NAMES
from fvs_tools.bag import TYPES, Message

#: When every recording here begins, s.
BEGIN_S = 1_700_000_000.0
T = TYPES.types


def write_bag(folder, messages, storage=StoragePlugin.MCAP):
    """Write messages; returns the folder."""
    writer = Writer(folder, version=9, storage_plugin=storage)
    writer.open()
    connections = {}
    for sent in messages:
        key = sent.topic, sent.message_type
        if key not in connections:
            connections[key] = writer.add_connection(*key, typestore=TYPES)
        writer.write(connections[key], sent.stamp_ns, sent.data)
    writer.close()
    return folder


def file_in(folder):
    """The one file with messages."""
    (file,) = (path for path in folder.iterdir() if path.suffix in (".mcap", ".db3"))
    return file


def message(topic, kind, at_s, *fields):
    """A message that arrives at a time, s since the beginning."""
    data = bytes(TYPES.serialize_cdr(T[kind](*fields), kind))
    return Message(f"/{topic}", kind, round((BEGIN_S + at_s) * 1e9), data)


def header(stamp_s):
    """Of a message in the camera's frame; without a stamp if it is None."""
    time_ns = 0 if stamp_s is None else round((BEGIN_S + stamp_s) * 1e9)
    stamp = T["builtin_interfaces/msg/Time"](*divmod(time_ns, 10**9))
    return T["std_msgs/msg/Header"](stamp, "camera")


def point(topic, at_s, stamp_s, position_m):
    position = T["geometry_msgs/msg/Point"](*map(float, position_m))
    return message(topic, "geometry_msgs/msg/PointStamped", at_s, header(stamp_s), position)


def pose(topic, at_s, stamp_s, position_m, angle_rad):
    """A pose that is rotated about z."""
    half_rad = 0.5 * angle_rad
    quaternion = T["geometry_msgs/msg/Quaternion"](0.0, 0.0, np.sin(half_rad), np.cos(half_rad))
    fields = T["geometry_msgs/msg/Point"](*position_m), quaternion
    fields = header(stamp_s), T["geometry_msgs/msg/Pose"](*fields)
    return message(topic, "geometry_msgs/msg/PoseStamped", at_s, *fields)


def joint_states(at_s, stamp_s, names, positions_rad, speeds_rad_s=(), topic="joint_states"):
    arrays = (np.array(values, float) for values in (positions_rad, speeds_rad_s, ()))
    kind = "sensor_msgs/msg/JointState"
    return message(topic, kind, at_s, header(stamp_s), list(names), *arrays)


def joints(at_s, stamp_s, speeds_rad_s):
    """As a UR's driver does: in alphabetical order."""
    names = sorted(UR_JOINT_NAMES)
    speeds = speeds_rad_s[[UR_JOINT_NAMES.index(name) for name in names]]
    return joint_states(at_s, stamp_s, names, np.zeros(6), speeds)


def array(topic, at_s, values):
    layout = T["std_msgs/msg/MultiArrayLayout"]([], 0)
    return message(topic, "std_msgs/msg/Float64MultiArray", at_s, layout, np.array(values, float))


def status(at_s, state, reason, target_m=()):
    values = {"state": state, "reason": reason}
    values |= {f"target_{axis}_m": f"{x:.3f}" for axis, x in zip("xyz", target_m, strict=False)}
    pairs = [T["diagnostic_msgs/msg/KeyValue"](*pair) for pair in values.items()]
    name, kind = "fvs_controller_node", "diagnostic_msgs/msg/DiagnosticStatus"
    return message(f"{name}/status", kind, at_s, 0, name, "", "", pairs)


START_M, TARGET_M = np.array([0.3, 0.0, 1.4]), np.array([0.0, 0.0, 1.4])
#: Rate at which the distance shrinks, 1/s, and when the target is given, and the end, s.
DECAY_1_S, GIVEN_S, END_S = 4.0, 1.0, 5.0


def distance_m(time_s):
    """Distance to the target in :func:`servo`, m."""
    return 0.3 * float(np.exp(-DECAY_1_S * max(0.0, time_s - GIVEN_S)))


def servo(target="target_position"):
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
