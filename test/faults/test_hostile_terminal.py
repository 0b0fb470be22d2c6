"""A terminal that blocks, hangs up or suspends: the arm stands, or goes on being commanded."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from held_pipe import full_pipe
from std_msgs.msg import Float64MultiArray
from test_controller_faults import Bench

from fvs_ros import topics


def starts_on(harness, monkeypatch, sink):
    """Have the harness start its processes with all their output into ``sink``."""

    def start(module, *arguments):
        process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            stdout=sink,
            stderr=sink,
            stdin=subprocess.DEVNULL,
            env=harness.environment,
            cwd=harness.folder,
        )
        process.log_path = harness.folder / "nothing.log"
        process.log_path.touch()
        harness.processes.append(process)
        return process

    monkeypatch.setattr(harness, "start", start)


@pytest.fixture
def deaf(ros_test, monkeypatch):
    """A harness whose processes write into a pipe that is full and that nobody reads."""
    source, sink = full_pipe()
    starts_on(ros_test, monkeypatch, sink)
    yield ros_test
    os.close(source)
    os.close(sink)


@pytest.fixture
def left(ros_test, monkeypatch):
    """A harness whose processes write into a pipe whose reader has gone."""
    source, sink = os.pipe()
    os.close(source)
    starts_on(ros_test, monkeypatch, sink)
    yield ros_test
    os.close(sink)


def assert_zeros_last(bench):
    bench.harness.spin_for(0.2)
    last = [m.data for _, m in bench.robot.commands[-3:]]
    assert len(last) == 3
    assert not np.any(last)


def test_a_blocked_terminal_holds_neither_the_zeros_nor_the_end(deaf):
    bench = Bench(deaf)
    bench.servo()
    for _ in range(2):  # back and forth: each change is a line in the log
        bench.robot.silent.add(topics.JACOBIAN.name)
        bench.assert_stops(time.monotonic() + 0.2)
        bench.assert_keeps_sending_zeros()
        bench.robot.silent.clear()
        bench.wait(bench.robot.moving, what="motion again")
    assert deaf.stop(bench.process) == 0
    assert_zeros_last(bench)


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGABRT])
def test_any_signal_that_ends_leaves_zeros_on_the_wire(ros_test, number):
    before = signal.signal(number, signal.SIG_DFL)  # the tests themselves may run under nohup
    try:
        bench = Bench(ros_test)
    finally:
        signal.signal(number, before)
    bench.servo()
    assert ros_test.stop(bench.process, number) == 0
    assert_zeros_last(bench)
    bench.wait(lambda: bench.reason() == "SHUT_DOWN", 2.0, "the last word")


def test_what_would_suspend_does_not(ros_test):
    bench = Bench(ros_test)
    bench.servo()
    for number in (signal.SIGTSTP, signal.SIGTTOU, signal.SIGTTIN):
        bench.process.send_signal(number)
        count = len(bench.robot.commands)
        ros_test.spin_until(lambda n=count: len(bench.robot.commands) > n + 20, 2.0, "commands")
    bench.robot.silent.add(topics.BALL_POSITION.name)
    bench.assert_stops(time.monotonic() + 0.2)


def test_a_hangup_that_is_ignored_stays_so(ros_test):
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as under nohup; children inherit it
    try:
        bench = Bench(ros_test)
    finally:
        signal.signal(signal.SIGHUP, before)
    bench.process.send_signal(signal.SIGHUP)
    bench.assert_keeps_sending_zeros()
    assert bench.process.poll() is None


@pytest.mark.parametrize("terminal", ["deaf", "left"])
def test_the_launcher_outlives_its_reader(request, terminal):
    harness = request.getfixturevalue(terminal)
    commands = harness.collect(Float64MultiArray, topics.COMMANDS.name)
    process = harness.start("fvs_tools.launcher", "servo")
    harness.spin_until(lambda: len(commands) > 100, 30.0, "commands")
    assert process.poll() is None
    assert harness.stop(process) == 0
