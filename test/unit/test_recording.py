"""What goes into a bag, and the bag itself, read back by another's reader."""

import importlib.util
from dataclasses import replace

import pytest
import yaml

from fvs_tools import launcher

pytest.importorskip("rosbags")

from replayed_bags import TYPES

from fvs_ros import ros
from fvs_tools.bag import Bag, Message, SimulatedTime, camera_mount

#: Bool(data=True) as it is on the wire, little endian.
TRUE = bytes([0, 1, 0, 0, 1])
BOOL = "std_msgs/msg/Bool"


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


def message(topic, stamp_ns, kind, *fields):
    data = bytes(TYPES.serialize_cdr(TYPES.types[kind](*fields), kind))
    return Message(topic, kind, stamp_ns, data)


def time_of(seconds, nanoseconds=0):
    return TYPES.types["builtin_interfaces/msg/Time"](seconds, nanoseconds)


def clock(seconds, nanoseconds):
    return message("/clock", 2, "rosgraph_msgs/msg/Clock", time_of(seconds, nanoseconds))


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
    profiles = [ros.QOS_LATCHED, ros.QOS_NEWEST, ros.QOS_LATCHED]
    one.write(Message("/running", BOOL, 5, TRUE), profiles)
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


def test_a_viewer_finds_the_cameras_frame_where_the_camera_is():
    kinds = TYPES.types
    header = kinds["std_msgs/msg/Header"](time_of(1), "base_link")
    pose = kinds["geometry_msgs/msg/Pose"](
        kinds["geometry_msgs/msg/Point"](1.0, 2.0, 3.0),
        kinds["geometry_msgs/msg/Quaternion"](0.0, 1.0, 0.0, 0.0),
    )
    kind = "geometry_msgs/msg/PoseStamped"
    mount = camera_mount(message("/camera_pose", 1, kind, header, pose), "eye")
    (one,) = TYPES.deserialize_cdr(mount.data, mount.message_type).transforms
    assert (mount.topic, mount.stamp_ns) == ("/tf_static", 1)
    assert (one.header.frame_id, one.child_frame_id) == ("base_link", "eye")
    place = one.transform.translation
    assert (place.x, place.y, place.z, one.transform.rotation.y) == (1.0, 2.0, 3.0, 1.0)
    with pytest.raises(ValueError, match="/camera_pose is malformed"):
        camera_mount(Message("/camera_pose", kind, 0, b"\0\1\0\0"), "eye")
