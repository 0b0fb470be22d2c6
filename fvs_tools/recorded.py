"""A data set from a rosbag2 of an arm that was moved by any means; no ROS."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fvs_estimator_node.files import DataSet, data_set_of
from fvs_ros.arguments import how_to_install
from fvs_ros.feature import Feature, PoseFeature, ServoedConfig, from_quaternion
from fvs_ros.timeline import Sample, Timeline
from fvs_ros.topics import BALL, BALL_POSITION, JOINT_STATES, POSE, TOOL_POSE

_POINT, _POSE = "geometry_msgs/msg/PointStamped", "geometry_msgs/msg/PoseStamped"
_JOINTS = "sensor_msgs/msg/JointState"


def read_data_set(path: Path, joint_states: str = "", seen: str = "") -> DataSet:
    """Joints at the exposures of the images in which a ball or tag was seen.

    Parameters
    ----------
    path : Path
        Folder of a rosbag2, or its one file.
    joint_states, seen : str
        Topics, where there are several; by default those that end as this package's.

    Raises
    ------
    ValueError
        If there is no bag, or it lacks one of the topics.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise ValueError(f"a bag needs rosbags: {how_to_install('record', ['rosbags'])}") from None
    if not path.exists():
        raise ValueError(f"there is no file or folder {path}")
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            types = {one.topic: one.msgtype or "" for one in reader.connections}
            joints = _topic(types, joint_states, (_JOINTS,), (JOINT_STATES.name,))
            feature = _topic(types, seen, (_POINT, _POSE), (BALL_POSITION.name, TOOL_POSE.name))
            wanted = [one for one in reader.connections if one.topic in (joints, feature)]
            messages = [
                (connection.topic == joints, reader.deserialize(raw, connection.msgtype))
                for connection, _, raw in reader.messages(wanted)
            ]
    except ValueError:
        raise
    except Exception as error:  # a damaged file shows anywhere in the reader
        words = " ".join(str(error).split())[:200]
        raise ValueError(f"cannot read {path} ({type(error).__name__}: {words})") from error
    return _paired(messages, types[feature] == _POSE, path)


def _topic(types: dict[str, str], given: str, kinds: Sequence[str], names: Sequence[str]) -> str:
    """The topic that is meant."""
    fit = sorted(name for name, kind in types.items() if kind in kinds)
    if given:
        fit = [name for name in fit if name.strip("/") == given.strip("/")]
    elif len(fit) > 1:
        fit = [one for one in fit if one.rsplit("/", 1)[-1] in names] or fit
    if len(fit) == 1:
        return fit[0]
    what = " or ".join(kind.rsplit("/", 1)[-1] for kind in kinds)
    known = ", ".join(f"{name} ({kind.rsplit('/', 1)[-1]})" for name, kind in sorted(types.items()))
    raise ValueError(
        f"the bag has {len(fit)} topics of {what}{' called ' + given[:60] if given else ''}, "
        f"expected one: name it by --joint-states or --seen; there are {known[:600]}"
    )


def _paired(messages: Sequence[tuple[bool, Any]], is_pose: bool, path: Path) -> DataSet:
    """Pair each feature with the joints at its stamp."""
    feature = PoseFeature(ServoedConfig.lever_arm_m) if is_pose else Feature()
    timeline, samples = Timeline(), list[Sample]()
    # The arm's: a gripper's may come on the same topic.
    given_names = (tuple(message.name) for is_joints, message in messages if is_joints)
    names = max(given_names, key=len, default=())
    frame = ""
    for is_joints, message in messages:
        stamp = message.header.stamp
        stamp_s = stamp.sec + 1e-9 * stamp.nanosec
        if is_joints:
            given = dict(zip(message.name, message.position, strict=False))
            joints = np.array([given.get(name, np.nan) for name in names])
            if np.isfinite(joints).all():
                samples += timeline.add_joints(stamp_s, joints)
            continue
        frame = frame or message.header.frame_id
        position = message.pose.position if is_pose else message.point
        vector_m = np.array([position.x, position.y, position.z])
        if isinstance(feature, PoseFeature):
            turn = message.pose.orientation
            quaternion = np.array([turn.x, turn.y, turn.z, turn.w])
            length = np.linalg.norm(quaternion)
            if not 0.9 < length < 1.1:
                continue
            vector_m = feature.of(vector_m, from_quaternion(quaternion / length))
        if np.isfinite(vector_m).all():
            samples += timeline.add_feature(stamp_s, vector_m)
    if not samples:
        raise ValueError(f"{path}: no image has joint states at its stamp: is there one clock?")
    return data_set_of(
        samples,
        joint_names=names,
        feature_frame=frame,
        feature=POSE if is_pose else BALL,
        lever_arm_m=ServoedConfig.lever_arm_m,
        provenance={"bag": path.name},
    )
