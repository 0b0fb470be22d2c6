"""A data set from a rosbag2 of an arm that was moved by any means."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from fvs_estimator_node.files import DataSet, data_set_of
from fvs_estimator_node.joint_path import LEAST_RUN, MAX_OFFSET_S
from fvs_ros.joints import ForeignJointsError, JointMap, JointStateError
from fvs_ros.kinds import KINDS, Kind
from fvs_ros.ros import from_feature, from_stamp
from fvs_ros.timeline import History, Sample, Timeline
from fvs_ros.topics import JOINT_STATES
from fvs_tools.bag_reader import open_bag

#: Kinds by the type of their message.
_KINDS = {kind.topics.tool.type: kind() for kind in KINDS.values()}
_JOINTS = "sensor_msgs/msg/JointState"
#: Joints that move by less, rad (m), stand still: some times an encoder's noise.
_REST_RAD = 1e-3


def read_data_set(
    path: Path, names: Sequence[str], joint_states: str = "", feature: str = ""
) -> DataSet:
    """Joints at the exposures of the images in which a ball or tag was seen.

    ``names`` are the arm's joints, base to tip; last ones may be missing, as a gripper's. Topics
    may be named where there are several; by default they are those that end as this package's.
    The data's provenance has, as ``left_out``, what is missing, and why. A ``ValueError`` says that
    there is no bag, it lacks one of the topics, or no image has joints.
    """
    with open_bag(path) as reader:
        types = {each.topic: each.msgtype for each in reader.connections}
        joints = _topic(types, joint_states, (_JOINTS,), (JOINT_STATES.name,))
        tools = [kind.topics.tool for kind in KINDS.values()]
        feature = _topic(types, feature, [*_KINDS], [topic.name for topic in tools])
        wanted = [each for each in reader.connections if each.topic in (joints, feature)]
        messages = [
            (connection.topic == joints, message)
            for connection, _, message in reader.decoded(wanted)
        ]
        notes = ["the bag was cut off, or a part of it is missing or damaged"] * reader.cut_off
    return _paired(messages, names, _KINDS[types[feature]], path, notes)


def _topic(types: dict[str, str], wanted: str, kinds: Sequence[str], names: Sequence[str]) -> str:
    """The topic that is meant."""
    fit = sorted(name for name, kind in types.items() if kind in kinds)
    if wanted:
        fit = [name for name in fit if name.strip("/") == wanted.strip("/")]
    elif len(fit) > 1:
        fit = [name for name in fit if name.rsplit("/", 1)[-1] in names] or fit
    if len(fit) == 1:
        return fit[0]
    what = " or ".join(kind.rsplit("/", 1)[-1] for kind in kinds)
    known = ", ".join(f"{name} ({kind.rsplit('/', 1)[-1]})" for name, kind in sorted(types.items()))
    raise ValueError(
        f"the bag has {len(fit)} topics of {what}{' called ' + wanted[:60] if wanted else ''}, "
        f"expected one: name it by --joint-states or --seen; there are {known[:600]}"
    )


def _paired(
    messages: Sequence[tuple[bool, Any]],
    arm: Sequence[str],
    kind: Kind,
    path: Path,
    notes: list[str],
) -> DataSet:
    """Pair each feature with the joints at its stamp."""
    frames = {message.header.frame_id for is_joints, message in messages if not is_joints}
    if len(frames) > 1:
        raise ValueError(
            f"{path}: ball or tag is in the frames {', '.join(sorted(frames))[:200]}, expected one"
        )
    heard = {name for is_joints, message in messages if is_joints for name in message.name}
    names = list(arm)
    while heard & {*names} and names[-1] not in heard:
        names.pop()
    joint_map, timeline = JointMap(names), Timeline()
    samples, rests, problems, foreign = list[Sample](), list[bool](), list[str](), ""
    for is_joints, message in messages:
        stamp_s, new = from_stamp(message.header.stamp), list[Sample]()
        if is_joints:
            try:
                joints = joint_map.positions(message.name, message.position, stamp_s)
                new = timeline.add_joints(stamp_s, joints)
            except ForeignJointsError as error:
                foreign = str(error)
            except JointStateError as error:
                problems.append(str(error))
        else:
            with suppress(ValueError):  # no position, or no pose
                z = from_feature(message, kind, message.header.frame_id, "ball or tag")
                new = timeline.add_image(stamp_s, z)
        samples += new
        rests += [_at_rest(timeline.joints, sample) for sample in new]
    if problems:
        notes.insert(0, f"{len(problems)} joint states cannot be used: {problems[0]}"[:400])
    if not samples:
        no_arm = foreign if timeline.joints.newest is None else ""
        why = "; ".join(notes) or no_arm or timeline.last_reason
        raise ValueError(
            f"{path}: no image has joint states at its stamp: {why or 'is there one clock?'}"
        )
    # No motion to follow.
    short = max(Counter(sample.run for sample in samples).values()) < LEAST_RUN
    still = any(rests) and (short or all(rests))
    if still and not all(rests):
        notes.insert(0, f"{rests.count(False)} images of still poses show the arm in motion")
        samples = [sample for sample, rest in zip(samples, rests, strict=True) if rest]
    return data_set_of(
        samples,
        joint_names=names,
        feature_frame=frames.pop(),
        feature=kind.name,
        provenance={"bag": path.name, "left_out": "; ".join(notes)},
        still=still,
    )


def _at_rest(joints: History, image: Sample) -> bool:
    """Whether the arm stood still before an image, which may be stamped late."""
    before = joints.at(image.stamp_s - MAX_OFFSET_S)
    return before is not None and bool(np.abs(image.joints_rad - before).max() < _REST_RAD)
