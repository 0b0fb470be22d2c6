"""What goes into a bag, and the bag itself, read back by another's reader."""

import importlib.util
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from fvs_tools import launcher

pytest.importorskip("rosbags")

from replayed_bags import TYPES
from scipy.spatial.transform import Rotation
from ur5_dh import flange_pose

from fvs_ros.joints import UR_JOINT_NAMES
from fvs_sim_node.robot import robot_description
from fvs_tools.bag import Bag, Message, SimulatedTime, Transforms

#: Bool(data=True) as it is on the wire, little endian.
TRUE = bytes([0, 1, 0, 0, 1])
BOOL = "std_msgs/msg/Bool"


def profile(reliability="RELIABLE", durability="TRANSIENT_LOCAL"):
    """What rclpy tells of a publisher, as far as a bag wants to know it."""
    forever = SimpleNamespace(nanoseconds=2**63 - 1)
    return SimpleNamespace(
        history=SimpleNamespace(name="UNKNOWN"),
        depth=0,
        reliability=SimpleNamespace(name=reliability),
        durability=SimpleNamespace(name=durability),
        deadline=forever,
        lifespan=forever,
        liveliness=SimpleNamespace(name="AUTOMATIC"),
        liveliness_lease_duration=forever,
        avoid_ros_namespace_conventions=False,
    )


# --- the launcher ---


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["servo", "--record", "."], "it exists already"),
        (["servo", "--record-without-images"], "needs --record"),
    ],
)
def test_a_wrong_recording_starts_nothing(capsys, arguments, words):
    assert launcher.main(arguments) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_without_rosbags_nothing_is_started(tmp_path, monkeypatch, capsys):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "rosbags" else find(name)
    )
    assert launcher.main(["servo", "--record", str(tmp_path / "bag")]) == 2
    error = capsys.readouterr().err
    assert "elsewhere, pip install rosbags" in error
    assert ".venv/bin/pip install -c constraints.txt -e '.[record,lab]'" in error


def test_a_recorder_that_cannot_begin_ends_the_launch(tmp_path, monkeypatch, capfd):
    entry = replace(launcher.NODE_TABLE[launcher.RECORDER], module="no_such_module")
    monkeypatch.setitem(launcher.NODE_TABLE, launcher.RECORDER, entry)
    monkeypatch.setattr(launcher.stop, "RECEIVED", [])
    assert launcher.main(["servo", "--record", str(tmp_path / "bag")]) == 1
    said = capfd.readouterr().out
    assert "No module named no_such_module" in said
    assert "fvs_recorder_node ended with exit code 1: stopping the rest" in said
    assert "started" not in said


# --- time ---


def clock(seconds, nanoseconds):
    kinds = TYPES.types
    time = kinds["builtin_interfaces/msg/Time"](seconds, nanoseconds)
    kind = "rosgraph_msgs/msg/Clock"
    return Message("/clock", kind, 2, bytes(TYPES.serialize_cdr(kinds[kind](time), kind)))


def at(stamp_ns, data=b""):
    return Message("/joint_states", "sensor_msgs/msg/JointState", stamp_ns, data)


def stamps(time, *messages):
    return [one.stamp_ns for message in messages for one in time.stamped(message)]


def test_simulated_time_is_that_of_the_last_clock_or_the_first():
    time = SimulatedTime()
    assert stamps(time, at(1), at(2)) == []
    assert stamps(time, clock(7, 5)) == [7_000_000_005] * 3
    assert stamps(time, at(3), clock(8, 0), at(4)) == [7_000_000_005, 8 * 10**9, 8 * 10**9]
    assert time.rest() == []


def test_without_a_clock_the_systems_time_is_kept_and_memory_is_bounded():
    time = SimulatedTime()
    assert stamps(time, at(1), at(2)) == []
    assert [one.stamp_ns for one in time.rest()] == [1, 2]
    large = bytes(10 * 2**20)
    assert len(stamps(SimulatedTime(), *(at(number, large) for number in range(20)))) >= 7


# --- the bag ---


def test_the_metadata_tells_counts_qualities_and_notes(tmp_path):
    one = Bag(tmp_path / "bag", {"scenario": "a:\n  b: 1\n"})
    both = [profile(), profile("BEST_EFFORT", "VOLATILE"), profile()]
    one.write(Message("/running", BOOL, 5, TRUE), both)
    one.close()
    text = (tmp_path / "bag" / "metadata.yaml").read_text(encoding="utf-8")
    metadata = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert metadata["custom_data"] == {"scenario": "a:\n  b: 1\n"}
    assert (metadata["version"], metadata["storage_identifier"]) == (9, "mcap")
    (topic,) = metadata["topics_with_message_count"]
    assert topic["message_count"] == 1
    offered = topic["topic_metadata"]["offered_qos_profiles"]
    assert [(qos["reliability"], qos["durability"]) for qos in offered] == [
        ("reliable", "transient_local"),
        ("best_effort", "volatile"),
    ]
    # as rosbag2 writes "for ever"
    assert offered[0]["deadline"] == {"sec": 9223372036, "nsec": 854775807}


# --- what a viewer needs ---


def message(topic, stamp_ns, kind, *fields):
    data = bytes(TYPES.serialize_cdr(TYPES.types[kind](*fields), kind))
    return Message(topic, kind, stamp_ns, data)


def header(second, frame=""):
    return TYPES.types["std_msgs/msg/Header"](
        TYPES.types["builtin_interfaces/msg/Time"](second, 0), frame
    )


def joint_state(stamp_ns, joints_rad=(0.1,) * 6, names=UR_JOINT_NAMES):
    none, kind = np.zeros(0), "sensor_msgs/msg/JointState"
    joints = np.array(joints_rad)
    return message("/joint_states", stamp_ns, kind, header(7), list(names), joints, none, none)


def description(text):
    return message("/robot_description", 0, "std_msgs/msg/String", text)


def camera_pose():
    kinds = TYPES.types
    pose = kinds["geometry_msgs/msg/Pose"](
        kinds["geometry_msgs/msg/Point"](1.0, 2.0, 3.0),
        kinds["geometry_msgs/msg/Quaternion"](0.0, 1.0, 0.0, 0.0),
    )
    return message("/camera_pose", 1, "geometry_msgs/msg/PoseStamped", header(1, "base_link"), pose)


def transforms(answer):
    """Of a ``TFMessage``: child -> parent and matrix, shape (4, 4)."""
    found = {}
    for one in TYPES.deserialize_cdr(answer.data, "tf2_msgs/msg/TFMessage").transforms:
        at, turn = one.transform.translation, one.transform.rotation
        matrix = np.eye(4)
        matrix[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
        matrix[:3, 3] = at.x, at.y, at.z
        found[one.child_frame_id] = (one.header.frame_id, matrix)
    return found


@pytest.fixture
def viewing():
    return Transforms("/robot_description", "/joint_states", "/camera_pose", "eye")


def test_the_last_static_transforms_hold_all_of_them(viewing):
    answer = viewing.of(camera_pose())
    assert answer.topic == "/tf_static"
    ((child, (parent, matrix)),) = transforms(answer).items()
    assert (parent, child) == ("base_link", "eye")
    np.testing.assert_allclose(matrix[:3, 3], [1.0, 2.0, 3.0])
    np.testing.assert_allclose(np.diag(matrix)[:3], [-1.0, 1.0, -1.0])
    assert list(transforms(viewing.of(description(robot_description())))) == ["tool0", "eye"]


@pytest.mark.parametrize("prefix", ["", "left_"])
def test_the_flange_is_where_the_closed_form_says(viewing, prefix):
    joints_rad = np.random.default_rng(1).uniform(-3.0, 3.0, 6)
    found = transforms(viewing.of(description(robot_description(tf_prefix=prefix))))
    names = [prefix + name for name in UR_JOINT_NAMES]
    found |= transforms(viewing.of(joint_state(10**9, joints_rad, names)))
    frame, place = f"{prefix}tool0", np.eye(4)
    while frame != f"{prefix}base_link":
        frame, matrix = found[frame]
        place = matrix @ place
    # ``base_link`` is the closed form's base, turned by half a turn.
    np.testing.assert_allclose(
        place, np.diag([-1.0, -1.0, 1.0, 1.0]) @ flange_pose(joints_rad), atol=1e-6
    )


def test_links_that_move_are_told_30_times_a_second(viewing):
    assert viewing.of(joint_state(0)) is None  # the robot is not known yet
    viewing.of(description(robot_description()))
    answers = [viewing.of(joint_state(10**9 + 2_000_000 * step)) for step in range(501)]
    found = [one for one in answers if one is not None]
    assert 28 <= len(found) <= 31
    assert found[0].topic == "/tf"
    assert len(transforms(found[0])) == 6
    assert viewing.of(joint_state(5)) is not None  # time was set back


def test_a_robot_whose_links_another_node_publishes_is_left_out(viewing):
    assert viewing.of(description(robot_description()), robot=False) is None
    assert viewing.of(joint_state(10**9), robot=False) is None
    assert list(transforms(viewing.of(camera_pose(), robot=False))) == ["eye"]


URDF = (
    '<robot name="r"><joint name="j" type="fixed"><origin xyz="1 2 3"/><parent link="a"/>'
    '<child link="b"/></joint></robot>'
)


@pytest.mark.parametrize(
    "text",
    [
        "no xml",
        URDF.replace("1 2 3", "1 2"),
        URDF.replace("1 2 3", "1 2 nan"),
        URDF.replace("1 2 3", "1 2 x"),
        URDF.replace('<child link="b"/>', ""),
    ],
)
def test_what_is_no_robot_is_refused_in_words(viewing, text):
    with pytest.raises(ValueError, match="robot_description cannot be read"):
        viewing.of(description(text))
    assert viewing.of(joint_state(10**9)) is None


def test_a_malformed_message_is_refused_and_other_topics_have_no_frames(viewing):
    with pytest.raises(ValueError, match="/camera_pose"):
        viewing.of(Message("/camera_pose", "geometry_msgs/msg/PoseStamped", 0, b"\0\1\0\0"))
    assert viewing.of(Message("/running", BOOL, 0, TRUE)) is None
