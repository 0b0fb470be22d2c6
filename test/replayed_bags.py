"""Bags made by hand, without ROS: what a robot did in them is known exactly."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.joints import UR_JOINT_NAMES

TYPES = get_typestore(Stores.ROS2_JAZZY)
#: When every recording here begins, s.
BEGIN_S = 1_700_000_000.0


class HandmadeBag:
    """Messages of this project's topics, a scenario (node -> parameters), and remaps of topics."""

    def __init__(
        self,
        folder: Path,
        storage: StoragePlugin = StoragePlugin.MCAP,
        scenario: dict[str, Any] | None = None,
        remaps: dict[str, str] | None = None,
    ) -> None:
        self._writer = Writer(folder, version=9, storage_plugin=storage)
        if scenario is not None:
            content = {
                f"/**/{node}": {"ros__parameters": values} for node, values in scenario.items()
            }
            self._writer.set_custom_data("scenario", yaml.safe_dump(content))
            self._writer.set_custom_data("fvs_ros_version", "0.1.0")
        if remaps is not None:
            self._writer.set_custom_data("remaps", yaml.safe_dump(remaps))
        self._writer.open()
        self._connections: dict[str, Any] = {}

    def close(self) -> None:
        self._writer.close()

    def write(self, topic: str, kind: str, at_s: float, *fields: Any) -> None:
        """A message that arrives at a time, s since the beginning."""
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                f"/{topic}", kind, typestore=TYPES
            )
        raw = TYPES.serialize_cdr(TYPES.types[kind](*fields), kind)
        stamp_ns = round((BEGIN_S + at_s) * 1e9)
        self._writer.write(self._connections[topic], stamp_ns, raw)

    @staticmethod
    def header(stamp_s: float | None) -> Any:
        time_ns = 0 if stamp_s is None else round((BEGIN_S + stamp_s) * 1e9)
        stamp = TYPES.types["builtin_interfaces/msg/Time"](*divmod(time_ns, 10**9))
        return TYPES.types["std_msgs/msg/Header"](stamp, CAMERA_FRAME)

    def point(self, topic: str, at_s: float, stamp_s: float | None, position_m: Any) -> None:
        point = TYPES.types["geometry_msgs/msg/Point"](*(float(one) for one in position_m))
        kind = "geometry_msgs/msg/PointStamped"
        self.write(topic, kind, at_s, self.header(stamp_s), point)

    def pose(
        self, topic: str, at_s: float, stamp_s: float, position_m: Any, angle_rad: float
    ) -> None:
        """A pose that is turned about z."""
        place = TYPES.types["geometry_msgs/msg/Point"](*(float(one) for one in position_m))
        half = 0.5 * angle_rad
        turn = (0.0, 0.0, float(np.sin(half)), float(np.cos(half)))
        quaternion = TYPES.types["geometry_msgs/msg/Quaternion"](*turn)
        pose = TYPES.types["geometry_msgs/msg/Pose"](place, quaternion)
        self.write(topic, "geometry_msgs/msg/PoseStamped", at_s, self.header(stamp_s), pose)

    def joints(self, at_s: float, stamp_s: float, angles_rad: Any, speeds_rad_s: Any) -> None:
        """As a UR's driver does: in alphabetical order; without speeds if there are none."""
        order = [UR_JOINT_NAMES.index(name) for name in sorted(UR_JOINT_NAMES)]
        values = [
            np.asarray(one, dtype=float)[order if len(one) else []]
            for one in (angles_rad, speeds_rad_s)
        ]
        self.write(
            "joint_states",
            "sensor_msgs/msg/JointState",
            at_s,
            self.header(stamp_s),
            sorted(UR_JOINT_NAMES),
            *values,
            np.zeros(6),
        )

    def array(self, topic: str, at_s: float, values: Any) -> None:
        layout = TYPES.types["std_msgs/msg/MultiArrayLayout"]([], 0)
        kind = "std_msgs/msg/Float64MultiArray"
        self.write(topic, kind, at_s, layout, np.asarray(values, dtype=float).reshape(-1))

    def status(self, node: str, at_s: float, text: str, **values: Any) -> None:
        pair = TYPES.types["diagnostic_msgs/msg/KeyValue"]
        pairs = [pair(key, str(value)) for key, value in values.items()]
        kind = "diagnostic_msgs/msg/DiagnosticStatus"
        self.write(f"{node}/status", kind, at_s, 0, f"/{node}", text, "", pairs)

    def log(self, at_s: float, who: str, text: str, level: int = 30) -> None:
        stamp = TYPES.types["builtin_interfaces/msg/Time"](0, 0)
        kind = "rcl_interfaces/msg/Log"
        self.write("rosout", kind, at_s, stamp, level, who, text, "", "", 0)


#: Ball motion per joint motion in :func:`servo`, m/rad.
JACOBIAN = np.zeros((3, 6))
JACOBIAN[0, 0] = JACOBIAN[1, 1] = JACOBIAN[2, 2] = 0.5
START_M, TARGET_M = np.array([0.3, 0.0, 1.4]), np.array([0.0, 0.0, 1.4])
#: Rate at which the distance shrinks, 1/s, and the delays of joint states and images, s.
DECAY_1_S, JOINT_AGE_S, IMAGE_AGE_S, COMMAND_AGE_S = 4.0, 0.002, 0.045, 0.049
GIVEN_S, END_S = 1.0, 5.0


def distance_m(time_s: float) -> float:
    """Distance to the target in :func:`servo`, m."""
    return 0.3 * float(np.exp(-DECAY_1_S * max(0.0, time_s - GIVEN_S)))


def servo(
    bag: HandmadeBag,
    true: bool = True,
    gap: tuple[float, float] = (9.0, 9.0),
    target: str = "target_position",
) -> None:
    """The ball goes straight to one target, exponentially; images are missing during a gap, s."""
    for tick in range(round(END_S / 0.008) + 1):
        time_s = 0.008 * tick
        error_m = distance_m(time_s)
        speed_rad_s = -DECAY_1_S * error_m / 0.5 if time_s >= GIVEN_S else 0.0
        angles, speeds = np.zeros(6), np.zeros(6)
        angles[0], speeds[0] = (error_m - 0.3) / 0.5, speed_rad_s
        bag.joints(time_s + JOINT_AGE_S, time_s, angles, speeds)
        bag.array("forward_velocity_controller/commands", time_s + 0.004, speeds)
        bag.array("jacobian", time_s + 0.003, JACOBIAN)
        if true:
            position_m = TARGET_M + [error_m, 0.0, 0.0]
            bag.point("fvs_sim_node/true_ball_position", time_s + 0.001, time_s, position_m)
    for image in range(round(END_S * 30)):
        time_s = image / 30
        if not gap[0] <= time_s <= gap[1]:
            position_m = TARGET_M + [distance_m(time_s), 0.0, 0.0]
            bag.point("ball_position", time_s + IMAGE_AGE_S, time_s, position_m)
    bag.point(target, GIVEN_S + 0.001, GIVEN_S, TARGET_M)
    for number in range(round(END_S * 10)):
        time_s = 0.1 * number
        moving = time_s >= GIVEN_S
        bag.status(
            "fvs_controller_node",
            time_s,
            "servoing, 300.0 mm to go" if moving else "no target_position yet",
            state="SERVOING" if moving else "WAITING",
            reason="SERVOING" if moving else "NO_TARGET",
            active_limit=f"near singular ({0.07 - 0.001 * time_s:.4f} m/rad)"
            if 1.05 < time_s < 1.55
            else "",
        )
