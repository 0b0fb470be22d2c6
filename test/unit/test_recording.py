"""What goes into a bag, and the bag itself, read back by another's reader."""

from dataclasses import replace

import pytest

from fvs_tools import launcher

pytest.importorskip("rosbags")

from replayed_bags import message

from fvs_tools.bag import TYPES, Message, SimulatedTime

# --- the launcher ---


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
    time = TYPES.types["builtin_interfaces/msg/Time"](seconds, nanoseconds)
    return message("clock", "rosgraph_msgs/msg/Clock", 0.0, time)


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
