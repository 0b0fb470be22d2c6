"""Whatever a recorder left of a bag is read, by the reader of every program."""

import shutil
import sqlite3
from dataclasses import replace

import pytest

pytest.importorskip("rosbags")

pytest.importorskip("mcap")

from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from replayed_bags import T, file_in, message, servo, write_bag
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2.storage_mcap import zstd

from fvs_tools import launcher
from fvs_tools.bag import Message, SimulatedTime
from fvs_tools.bag_reader import BagError, open_bag


def made(folder, storage=StoragePlugin.MCAP):
    return write_bag(folder, servo(), storage)


def content(path, cut_off=None):
    """Topic, time and bytes of each message."""
    with open_bag(path) as reader:
        assert cut_off in (None, reader.cut_off)
        return [
            (connection.topic, time_ns, bytes(raw))
            for connection, time_ns, raw in reader.messages()
        ]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return content(made(tmp_path_factory.mktemp("bags") / "whole"))


def packed(folder, storage=StoragePlugin.MCAP):
    file = file_in(made(folder, storage))
    file.with_name(f"{file.name}.zstd").write_bytes(zstd.compress(file.read_bytes()))
    file.unlink()
    return folder


def cut_metadata(folder):
    path = folder / "metadata.yaml"
    path.write_bytes(path.read_bytes()[:300])
    return folder


def without_metadata(folder):
    (folder / "metadata.yaml").unlink()
    return folder


def by_another(folder, whole, others=False, **options):
    """The messages as another recorder writes them, with channels that no ROS type describes."""
    folder.mkdir()
    with (folder / "bag.mcap").open("wb") as file:
        writer = McapWriter(file, chunk_size=20_000, **options)
        writer.start(profile="")
        channels = {}
        with open_bag(made(folder / "whole")) as reader:
            for known in reader.connections:
                text = known.msgdef.data.encode()
                schema = writer.register_schema(known.msgtype, "ros2msg", text)
                channels[known.topic] = writer.register_channel(known.topic, "cdr", schema)
        if others:
            schema = writer.register_schema("Any", "jsonschema", b"{}")
            json = writer.register_channel("/any", "json", schema)
            text = b"Nonsense[<=1] request\n"
            schema = writer.register_schema("std_srvs/srv/Trigger_Event", "ros2msg", text)
            event = writer.register_channel("/any/_service_event", "cdr", schema)
            writer.add_message(json, 0, b"{}", 0)
            writer.add_message(event, 0, b"\0\1\0\0", 0)
        for topic, time_ns, raw in whole:
            writer.add_message(channels[topic], time_ns, raw, time_ns)
        writer.finish()
    shutil.rmtree(folder / "whole")
    return folder / "bag.mcap"


def packed_by_message(folder, whole):
    """SQLite, each message compressed, and nothing says so."""
    path = without_metadata(made(folder, StoragePlugin.SQLITE3)) / "bag.db3"
    with sqlite3.connect(path) as database:
        rows = database.execute("SELECT id, data FROM messages").fetchall()
        pairs = [(zstd.compress(data), number) for number, data in rows]
        database.executemany("UPDATE messages SET data = ? WHERE id = ?", pairs)
    return path


KINDS = {
    "a file packed": lambda folder, whole: packed(folder),
    "a file packed, no metadata": lambda folder, whole: without_metadata(packed(folder)),
    "a database packed": lambda folder, whole: packed(folder, StoragePlugin.SQLITE3),
    "messages packed": packed_by_message,
    "no metadata": lambda folder, whole: without_metadata(made(folder)),
    "metadata cut off": lambda folder, whole: cut_metadata(made(folder)),
    "named by its metadata": lambda folder, whole: made(folder) / "metadata.yaml",
    "no chunks": lambda folder, whole: by_another(folder, whole, use_chunking=False),
    "lz4": lambda folder, whole: by_another(folder, whole, compression=CompressionType.LZ4),
    "JSON and service events": lambda folder, whole: by_another(folder, whole, others=True),
}


@pytest.mark.parametrize("kind", KINDS)
def test_whatever_a_recorder_left_is_read(tmp_path, whole, kind):
    path = KINDS[kind](tmp_path / "bag", whole)
    messages = [sent for sent in content(path) if not sent[0].startswith("/any")]
    assert sorted(messages) == sorted(whole)


def test_a_file_that_is_broken_within_is_said_to_be_cut_off(tmp_path, whole):
    path = by_another(tmp_path / "bag", whole, index_types=IndexType.NONE)
    assert content(path, cut_off=False)
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2 : len(raw) // 2 + 64] = b"\xff" * 64
    path.write_bytes(raw)
    assert 0 < len(content(path, cut_off=True)) < len(whole)


def test_a_message_whose_bytes_are_damaged_is_passed_over(tmp_path, whole):
    path = by_another(tmp_path / "bag", whole, use_chunking=False)
    raw = path.read_bytes()
    _, _, message = whole[len(whole) // 2]
    path.write_bytes(raw.replace(message, message[:12] + b"\xff\xff\xff\x7f" + message[16:], 1))
    with open_bag(path) as reader:
        assert len(list(reader.decoded())) == len(whole) - 1
        assert reader.cut_off


def test_a_database_without_metadata_is_cut_off_packed_or_not(tmp_path, whole):
    (path,) = without_metadata(packed(tmp_path / "bag", StoragePlugin.SQLITE3)).iterdir()
    assert content(path, cut_off=True) == whole


def test_a_lost_part_is_said_and_the_rest_is_read(tmp_path, whole):
    folder = made(tmp_path / "bag")
    text = (folder / "metadata.yaml").read_text()
    lost = text.replace("  - bag.mcap\n", "  - bag.mcap\n  - bag_1.mcap\n")
    assert lost != text
    (folder / "metadata.yaml").write_text(lost)
    assert content(folder, cut_off=True) == whole
    (folder / "bag.mcap").unlink()
    with pytest.raises(BagError, match="neither metadata"):
        content(folder)


# --- what goes into a bag ---


def test_a_recorder_that_cannot_begin_ends_the_launch(tmp_path, monkeypatch, capfd):
    entry = replace(launcher.NODE_TABLE[launcher.topics.RECORDER], module="no_such_module")
    monkeypatch.setitem(launcher.NODE_TABLE, launcher.topics.RECORDER, entry)
    monkeypatch.setattr(launcher.stop, "RECEIVED", [])
    assert launcher.main(["servo", "--record", str(tmp_path / "bag")]) == 1
    printed = capfd.readouterr().out
    assert "No module named no_such_module" in printed
    assert "fvs_recorder_node ended with exit code 1: stopping the rest" in printed
    assert "started" not in printed


def clock(seconds, nanoseconds):
    time = T["builtin_interfaces/msg/Time"](seconds, nanoseconds)
    return message("clock", "rosgraph_msgs/msg/Clock", 0.0, time)


def at(stamp_ns):
    return Message("/joint_states", "sensor_msgs/msg/JointState", stamp_ns, b"")


def stamps(time, *messages):
    return [sent.stamp_ns for message in messages for sent in time.stamped(message)]


def test_simulated_time_is_that_of_the_last_clock_or_the_first():
    time = SimulatedTime()
    assert stamps(time, at(1), at(2)) == []
    assert stamps(time, clock(7, 5)) == [7_000_000_005] * 3
    assert stamps(time, at(3), clock(8, 0), at(4)) == [7_000_000_005, 8 * 10**9, 8 * 10**9]
    assert time.rest() == []
