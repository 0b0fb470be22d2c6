"""A data set, and a photograph, from a rosbag2 of an arm that was moved by any means."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fvs_estimator_node.files import DataSet, data_set_of
from fvs_ros.arguments import how_to_install
from fvs_ros.feature import Feature, PoseFeature, ServoedConfig, from_quaternion
from fvs_ros.ros import from_camera_info, from_stamp
from fvs_ros.ros.images import from_color
from fvs_ros.timeline import Sample, Timeline
from fvs_ros.topics import BALL, BALL_POSITION, JOINT_STATES, POSE, TOOL_POSE
from fvs_tools.overlay import Photograph

_POINT, _POSE = "geometry_msgs/msg/PointStamped", "geometry_msgs/msg/PoseStamped"
_JOINTS, _IMAGE = "sensor_msgs/msg/JointState", "sensor_msgs/msg/Image"


def read_data_set(
    path: Path, names: tuple[str, ...], joint_states: str = "", seen: str = ""
) -> DataSet:
    """Joints at the exposures of the images in which a ball or tag was seen.

    Parameters
    ----------
    path : Path
        Folder of a rosbag2, or its one file.
    names : tuple of str
        The arm's joints; others are kept, too, where they come with these.
    joint_states, seen : str
        Topics, where there are several; by default those that end as this package's.

    Raises
    ------
    ValueError
        If there is no bag, or it lacks one of the topics.
    """
    with _reading(path) as reader:
        types = {one.topic: one.msgtype or "" for one in reader.connections}
        joints = _topic(types, joint_states, (_JOINTS,), (JOINT_STATES.name,))
        feature = _topic(types, seen, (_POINT, _POSE), (BALL_POSITION.name, TOOL_POSE.name))
        wanted = [one for one in reader.connections if one.topic in (joints, feature)]
        messages = [
            (connection.topic == joints, reader.deserialize(raw, connection.msgtype))
            for connection, _, raw in reader.messages(wanted)
        ]
    return _paired(messages, names, types[feature] == _POSE, path)


def read_photograph(path: Path, frame: str) -> Photograph | None:
    """A colour image of the camera with this frame, from the middle of a rosbag2, if it has one."""
    with _reading(path) as reader:
        of = {one.topic: one for one in reader.connections}
        for image in reader.connections:
            info = of.get(image.topic.rsplit("/", 1)[0] + "/camera_info")
            if image.msgtype != _IMAGE or info is None:
                continue
            middle_ns = (reader.start_time + reader.end_time) // 2
            first = partial(_first, reader, start=middle_ns)
            photo, camera = first(image), first(info)
            if photo is None or camera is None or photo.header.frame_id != frame:
                continue
            with suppress(ValueError):  # a depth image, or a lens that is not known
                return Photograph.of(
                    from_color(photo), from_camera_info(camera), from_stamp(photo.header.stamp)
                )
    return None


def _first(reader: Any, connection: Any, start: int) -> Any:
    """The first message of a topic after a time, ns; None if there is none."""
    for _, _, raw in reader.messages([connection], start=start):
        return reader.deserialize(raw, connection.msgtype)
    return None


@contextmanager
def _reading(path: Path) -> Iterator[Any]:
    """A reader of a bag; a ``ValueError`` for whatever is wrong with that."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise ValueError(f"a bag needs rosbags: {how_to_install('record', ['rosbags'])}") from None
    if not path.exists():
        raise ValueError(f"there is no file or folder {path}")
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            yield reader
    except ValueError:
        raise
    except Exception as error:  # a damaged file shows anywhere in the reader
        words = " ".join(str(error).split())[:200]
        raise ValueError(f"cannot read {path} ({type(error).__name__}: {words})") from error


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


def _paired(
    messages: Sequence[tuple[bool, Any]], arm: tuple[str, ...], is_pose: bool, path: Path
) -> DataSet:
    """Pair each feature with the joints at its stamp."""
    feature = PoseFeature(ServoedConfig.lever_arm_m) if is_pose else Feature()
    timeline, samples = Timeline(), list[Sample]()
    # The arm's: a gripper's may come on the same topic.
    given_names = {tuple(message.name) for is_joints, message in messages if is_joints}
    names = max(given_names, key=lambda given: len({*given} & {*arm}), default=())
    frames = {message.header.frame_id for is_joints, message in messages if not is_joints}
    if len(frames) > 1:
        raise ValueError(
            f"{path}: ball or tag is in the frames {', '.join(sorted(frames))[:200]}, expected one"
        )
    for is_joints, message in messages:
        stamp_s = from_stamp(message.header.stamp)
        if is_joints:
            given = dict(zip(message.name, message.position, strict=False))
            joints = np.array([given.get(name, np.nan) for name in names])
            if np.isfinite(joints).all():
                samples += timeline.add_joints(stamp_s, joints)
            continue
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
        feature_frame=frames.pop(),
        feature=POSE if is_pose else BALL,
        lever_arm_m=ServoedConfig.lever_arm_m,
        provenance={"bag": path.name},
    )
