"""What goes into a bag, how it is asked for, and the bag itself, read back by another's reader."""

import contextlib
import importlib.util
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from fvs_tools import launcher, markers, recording
from fvs_tools.recording import Doubles, Message, RecordingError, Request, SimulatedTime
from fvs_tools.scenario import ScenarioError, load_scenario

pytest.importorskip("rosbags")

from replayed_bags import TYPES

from fvs_ros.joints import UR_JOINT_NAMES
from fvs_sim_node.ur5_urdf import urdf_text
from fvs_tools.bag import ERRORS, NOTES, Bag, knows, to_bag_qos
from fvs_tools.viewing import Viewing

#: Bool(data=True) as it is on the wire, little endian.
TRUE = bytes([0, 1, 0, 0, 1])


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


def metadata(folder):
    text = (folder / "metadata.yaml").read_text(encoding="utf-8")
    return yaml.safe_load(text)["rosbag2_bagfile_information"]


# --- what is recorded ---


def test_a_folder_that_exists_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="it exists already; name a new folder"):
        recording.check_folder(tmp_path)
    recording.check_folder(tmp_path / "new" / "one")


def test_a_folder_below_a_file_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match="file is no folder"):
        recording.check_folder(tmp_path / "file" / "bag")


@pytest.mark.parametrize(
    ("topic", "message_type", "images", "recorded"),
    [
        ("/joint_states", "sensor_msgs/msg/JointState", False, True),
        ("/camera/color/image_raw", "sensor_msgs/msg/Image", True, True),
        ("/camera/color/image_raw", "sensor_msgs/msg/Image", False, False),
        ("/camera/color/camera_info", "sensor_msgs/msg/CameraInfo", False, True),
        ("/arm/_action/status", "action_msgs/msg/GoalStatusArray", True, False),
    ],
)
def test_which_topics_are_recorded(topic, message_type, images, recorded):
    assert recording.is_recorded(topic, message_type, images) is recorded


def test_every_kind_of_publisher_is_asked_for_once():
    latched, plain = Request(reliable=True, latched=True), Request(reliable=True, latched=False)
    lossy = Request(reliable=False, latched=False)
    assert recording.missing_requests([plain, plain], []) == [plain]
    assert recording.missing_requests([latched, lossy, plain], [plain]) == [lossy, latched]
    assert recording.missing_requests([plain], [plain, lossy]) == []


def test_a_message_over_two_subscriptions_is_known_the_second_time():
    doubles = Doubles()
    assert not doubles.again(1, b"a")
    assert not doubles.again(2, b"a")
    assert not doubles.again(1, b"b")
    assert doubles.again(1, b"a")


def test_doubles_forgets_what_is_long_gone():
    doubles = Doubles()
    for sent_ns in range(10_000):
        assert not doubles.again(sent_ns, b"")
    assert not doubles.again(0, b"")


def clock(seconds, nanoseconds):
    data = bytes([0, 1, 0, 0])
    data += seconds.to_bytes(4, "little") + nanoseconds.to_bytes(4, "little")
    return Message("/clock", "rosgraph_msgs/msg/Clock", 2, data)


def joints(received_ns, data=b""):
    return Message("/joint_states", "sensor_msgs/msg/JointState", received_ns, data)


def stamped(time, *messages):
    return [pair for message in messages for pair in time.stamped(message)]


def test_simulated_time_is_that_of_the_last_clock_before():
    time = SimulatedTime()
    stamped(time, clock(7, 5))
    assert stamped(time, joints(3), joints(4)) == [
        (7_000_000_005, joints(3)),
        (7_000_000_005, joints(4)),
    ]


def test_messages_before_the_first_clock_wait_for_it():
    time = SimulatedTime()
    assert stamped(time, joints(1), joints(2)) == []
    assert stamped(time, clock(5000, 0)) == [
        (5000 * 10**9, one) for one in (joints(1), joints(2), clock(5000, 0))
    ]
    assert list(time.rest()) == []
    assert not time.without_clock


def test_without_a_clock_the_system_s_time_is_kept():
    time = SimulatedTime()
    assert stamped(time, joints(1), joints(2)) == []
    assert list(time.rest()) == [(1, joints(1)), (2, joints(2))]
    assert time.without_clock


def test_no_more_than_some_memory_waits_for_a_clock():
    time = SimulatedTime()
    large = bytes(10 * 2**20)
    found = stamped(time, *(joints(number, large) for number in range(20)))
    assert len(found) == 20
    assert [stamp_ns for stamp_ns, _ in found] == list(range(20))
    assert stamped(time, clock(7, 5), joints(30)) == [(2, clock(7, 5)), (30, joints(30))]


def test_the_notes_tell_what_was_remapped_only():
    names = {"/left/target_position": "/goal", "/left/joint_states": "/left/joint_states"}
    told = recording.notes("a: 1", "1.2.3", names)
    assert yaml.safe_load(told["remaps"]) == {"/left/target_position": "/goal"}
    plain = recording.notes("a: 1", "1.2.3", {"/left/joint_states": "/left/joint_states"})
    assert plain == {"fvs_ros_version": "1.2.3", "scenario": "a: 1"}


# --- the launcher ---


def test_a_recorder_comes_first_and_knows_what_it_records(tmp_path):
    scenario = load_scenario("demo").with_overrides(["use_sim_time:=true", "law:=arrive"])
    recorded = scenario.with_recording(str(tmp_path / "bag"), images=False)
    assert recorded.nodes == [recording.NODE, *scenario.nodes, markers.NODE]
    values = recorded.parameters[recording.NODE]
    assert values["use_sim_time"] is True
    assert values["images"] is False
    started = yaml.safe_load(values["scenario"])
    assert started["/**/fvs_controller_node"]["ros__parameters"]["law"] == "arrive"
    assert yaml.safe_load(recorded.to_params_yaml())  # text within text


def test_who_looks_on_shares_frame_and_time_with_the_loop(tmp_path):
    scenario = load_scenario("demo").with_overrides(["use_sim_time:=true", "feature_frame:=eye"])
    recorded = scenario.with_recording(str(tmp_path / "bag"), images=False)
    for name in (recording.NODE, markers.NODE):
        assert recorded.parameters[name]["feature_frame"] == "eye"
        assert recorded.parameters[name]["use_sim_time"] is True
    assert markers.NODE not in recorded.parameters[recording.NODE]["scenario"]


def test_parameters_of_what_is_added_can_be_given(tmp_path, monkeypatch):
    started = []
    monkeypatch.setattr(
        launcher.Launcher, "run", lambda self: started.append(self._scenario.parameters) or 0
    )
    given = ["-p", "fvs_markers_node:trail_s:=3.0", "-p", "fvs_recorder_node:smallest_free_mb:=5.0"]
    assert launcher.main(["servo", "--record", str(tmp_path / "bag"), *given]) == 0
    assert started[0][markers.NODE]["trail_s"] == 3.0
    assert started[0][recording.NODE]["smallest_free_mb"] == 5.0


def test_a_recording_into_a_folder_that_exists_is_no_scenario(tmp_path):
    with pytest.raises(ScenarioError, match="exists already"):
        load_scenario("demo").with_recording(str(tmp_path), images=True)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["servo", "--record", "."], "it exists already"),
        (["servo", "--record-without-images"], "needs --record"),
        (
            ["servo", "-p", "fvs_recorder_node:images:=false"],
            "unknown node of servo.yaml 'fvs_recorder_node'",
        ),
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
    monkeypatch.setattr(launcher.Launcher, "run", lambda _: pytest.fail("it was started"))
    assert launcher.main(["servo", "--record", str(tmp_path / "bag")]) == 2
    error = capsys.readouterr().err
    assert "elsewhere, pip install rosbags" in error
    assert ".venv/bin/pip install -c constraints.txt -e '.[record,lab]'" in error
    assert error.count("\n") == 1


def test_a_recorder_that_cannot_begin_ends_the_launch(tmp_path, monkeypatch, capfd):
    """Whatever stopped it: here its module is not to be found."""
    table = dict(launcher.NODE_TABLE)
    table[recording.NODE] = replace(table[recording.NODE], module="no_such_module")
    monkeypatch.setattr(launcher, "NODE_TABLE", table)
    recorded = load_scenario("servo").with_recording(str(tmp_path / "bag"), images=False)
    one = launcher.Launcher(recorded)
    assert one.run() == 1
    said = capfd.readouterr().out
    assert "No module named no_such_module" in said
    assert "fvs_recorder_node ended with exit code 1: not started without it" in said
    assert len(one._processes) == 1


# --- the bag ---


def test_another_reader_reads_the_bag(tmp_path):
    mcap = pytest.importorskip("mcap_ros2.reader")
    bag = Bag(tmp_path / "bag", {"fvs_ros_version": "1.2.3"})
    for number in range(50):
        bag.write("/running", "std_msgs/msg/Bool", [profile()], 10**9 * number, TRUE)
    bag.write("/other", "std_msgs/msg/Bool", [], 10**9, TRUE)
    bag.close()
    messages = list(mcap.read_ros2_messages(str(tmp_path / "bag" / "bag.mcap")))
    assert sum(m.channel.topic == "/running" for m in messages) == 50
    assert len(messages) == 51
    assert all(m.ros_msg.data is True for m in messages)
    assert [m.log_time_ns for m in messages] == sorted(m.log_time_ns for m in messages)


def test_what_was_written_is_in_the_file_before_it_is_finished(tmp_path):
    mcap = pytest.importorskip("mcap.stream_reader")
    ended = pytest.importorskip("mcap.exceptions").EndOfFile
    bag = Bag(tmp_path / "bag", {"fvs_ros_version": "1.2.3"})
    for number in range(100):
        bag.write("/running", "std_msgs/msg/Bool", [profile()], 10**8 * number, TRUE)
    found = []
    with (tmp_path / "bag" / "bag.mcap").open("rb") as file, contextlib.suppress(ended):
        for record in mcap.StreamReader(file).records:
            found.append(record)
    assert sum(hasattr(one, "log_time") for one in found) >= 88  # all but the last second
    notes = tmp_path / "bag" / NOTES
    assert yaml.safe_load(notes.read_text(encoding="utf-8")) == {"fvs_ros_version": "1.2.3"}
    bag.close()
    assert not notes.exists()


def test_the_metadata_tells_counts_qualities_and_notes(tmp_path):
    bag = Bag(tmp_path / "bag", {"fvs_ros_version": "1.2.3", "scenario": "a:\n  b: 1\n"})
    both = [profile(), profile("BEST_EFFORT", "VOLATILE"), profile()]
    bag.write("/running", "std_msgs/msg/Bool", both, 5, TRUE)
    bag.close()
    told = metadata(tmp_path / "bag")
    assert told["custom_data"] == {"fvs_ros_version": "1.2.3", "scenario": "a:\n  b: 1\n"}
    assert (told["version"], told["storage_identifier"]) == (9, "mcap")
    (topic,) = told["topics_with_message_count"]
    assert topic["message_count"] == 1
    offered = topic["topic_metadata"]["offered_qos_profiles"]
    assert [(one["reliability"], one["durability"]) for one in offered] == [
        ("reliable", "transient_local"),
        ("best_effort", "volatile"),
    ]
    # as rosbag2 writes "for ever"
    assert offered[0]["deadline"] == {"sec": 9223372036, "nsec": 854775807}


def test_a_full_disk_is_an_error_that_says_so(tmp_path):
    bag = Bag(tmp_path / "bag", {})
    long = bytes([0, 1, 0, 0]) + (2**21).to_bytes(4, "little") + bytes(2**21)
    with Path("/dev/full").open("wb", buffering=0) as full:
        bag._writer.storage.bio = full
        with pytest.raises(OSError, match="No space left"):
            bag.write("/text", "std_msgs/msg/String", [], 1, long)
        bag.abandon()


def test_a_folder_that_was_removed_is_one_of_the_errors(tmp_path):
    bag = Bag(tmp_path / "bag", {})
    bag.write("/running", "std_msgs/msg/Bool", [profile()], 1, TRUE)
    shutil.rmtree(tmp_path / "bag")
    with pytest.raises(ERRORS):
        bag.close()
    bag.abandon()


def test_a_bag_that_was_closed_refuses_in_its_own_way(tmp_path):
    bag = Bag(tmp_path / "bag", {})
    bag.close()
    with pytest.raises(ERRORS, match="not open"):
        bag.write("/running", "std_msgs/msg/Bool", [], 1, TRUE)
    bag.abandon()


# --- what a viewer needs ---


def message(kind, *fields):
    return bytes(TYPES.serialize_cdr(TYPES.types[kind](*fields), kind))


def header(second, frame=""):
    return TYPES.types["std_msgs/msg/Header"](
        TYPES.types["builtin_interfaces/msg/Time"](second, 0), frame
    )


def joint_state(second):
    none = np.zeros(0)
    kind = "sensor_msgs/msg/JointState"
    return message(kind, header(second), list(UR_JOINT_NAMES), np.full(6, 0.1), none, none)


def description(text):
    return message("std_msgs/msg/String", text)


def camera_pose():
    kinds = TYPES.types
    pose = kinds["geometry_msgs/msg/Pose"](
        kinds["geometry_msgs/msg/Point"](1.0, 2.0, 3.0),
        kinds["geometry_msgs/msg/Quaternion"](0.0, 1.0, 0.0, 0.0),
    )
    return message("geometry_msgs/msg/PoseStamped", header(1, "base_link"), pose)


def told(answer):
    """Topic and transforms, read back."""
    topic, data = answer
    return topic, TYPES.deserialize_cdr(data, "tf2_msgs/msg/TFMessage").transforms


@pytest.fixture
def viewing():
    return Viewing("/robot_description", "/joint_states", "/sim/true_camera_pose", "eye")


def test_the_last_static_transforms_hold_all_of_them(viewing):
    topic, camera = told(viewing.of("/sim/true_camera_pose", 1, camera_pose()))
    assert topic == "/tf_static"
    assert [(one.header.frame_id, one.child_frame_id) for one in camera] == [("base_link", "eye")]
    at, turned = camera[0].transform.translation, camera[0].transform.rotation
    assert (at.x, at.y, at.z) == (1.0, 2.0, 3.0)
    assert (turned.x, turned.y, turned.z, turned.w) == (0.0, 1.0, 0.0, 0.0)
    _, both = told(viewing.of("/robot_description", 2, description(urdf_text())))
    assert [one.child_frame_id for one in both] == ["tool0", "eye"]


def test_links_that_move_are_told_as_often_as_a_viewer_wants(viewing):
    assert viewing.of("/joint_states", 0, joint_state(0)) is None  # of which robot?
    viewing.of("/robot_description", 0, description(urdf_text()))
    assert viewing.of("/joint_states", 0, joint_state(0), robot=False) is None
    answers = [
        viewing.of("/joint_states", 10**9 + 2_000_000 * step, joint_state(7)) for step in range(501)
    ]
    found = [told(one) for one in answers if one is not None]
    assert 28 <= len(found) <= 31
    topic, moved = found[0]
    assert topic == "/tf"
    assert [one.child_frame_id for one in moved] == [
        "shoulder_link",
        "upper_arm_link",
        "forearm_link",
        "wrist_1_link",
        "wrist_2_link",
        "wrist_3_link",
    ]
    assert {one.header.stamp.sec for one in moved} == {7}
    assert viewing.of("/joint_states", 5, joint_state(7)) is not None  # time was set back


def test_a_robot_that_is_told_of_by_another_is_not_told_twice(viewing):
    assert viewing.of("/robot_description", 0, description(urdf_text()), robot=False) is None
    _, camera = told(viewing.of("/sim/true_camera_pose", 1, camera_pose(), robot=False))
    assert [one.child_frame_id for one in camera] == ["eye"]


def test_a_description_that_is_none_is_named(viewing):
    assert viewing.of("/robot_description", 0, description("no urdf")) is None
    assert "cannot be read" in viewing.wrong
    assert viewing.of("/joint_states", 0, joint_state(0)) is None


def test_other_topics_say_nothing_of_frames(viewing):
    assert viewing.of("/running", 0, TRUE) is None


def test_only_types_that_can_be_described_are_known():
    assert knows("visualization_msgs/msg/MarkerArray")
    assert not knows("stranger_msgs/msg/Thing")


def test_names_of_qualities_are_those_of_rosbags():
    qos = to_bag_qos(profile("BEST_EFFORT", "VOLATILE"))
    assert (qos.reliability.name, qos.durability.name) == ("BEST_EFFORT", "VOLATILE")
