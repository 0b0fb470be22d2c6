"""A terminal that blocks, hangs up or suspends: the arm stands, or goes on being commanded."""

import contextlib
import os
import signal
import time

import numpy as np
import pytest
from std_msgs.msg import Float64MultiArray
from test_controller_faults import RAMP_S, TARGETS_M, Bench

from fvs_ros import topics


@pytest.fixture
def full_pipe(ros_test):
    """A harness whose processes write into a full pipe that no process reads."""
    source, sink = os.pipe()
    os.set_blocking(sink, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(sink, b"." * 4096)
    os.set_blocking(sink, True)
    ros_test.sink = sink
    yield ros_test
    os.close(source)
    os.close(sink)


@pytest.fixture
def broken_pipe(ros_test):
    """A harness whose processes write into a pipe whose reader has gone."""
    source, ros_test.sink = os.pipe()
    os.close(source)
    yield ros_test
    os.close(ros_test.sink)


def assert_zeros_last(bench):
    bench.harness.spin_for(0.2)
    last = [m.data for _, m in bench.robot.commands[-3:]]
    assert len(last) == 3
    assert not np.any(last)


@contextlib.contextmanager
def handling(number, handler):
    """This process's own handling of a signal, which the processes that it starts inherit."""
    before = signal.signal(number, handler)
    try:
        yield
    finally:
        signal.signal(number, before)


def test_a_blocked_terminal_under_nohup_holds_neither_the_zeros_nor_the_end(full_pipe):
    with handling(signal.SIGHUP, signal.SIG_IGN):
        bench = Bench(full_pipe)
    bench.process.send_signal(signal.SIGHUP)  # ignored, and stays so
    for _ in range(2):  # back and forth: each change is a line in the log
        bench.servo()
        bench.robot.silent.add(topics.JACOBIAN.name)
        bench.assert_stops(time.time(), 0.2 + RAMP_S)
        bench.robot.silent.clear()
    bench.servo()
    assert full_pipe.stop(bench.process) == 0
    assert_zeros_last(bench)


def test_what_would_suspend_does_not_and_a_hangup_leaves_zeros_on_the_wire(ros_test):
    with handling(signal.SIGHUP, signal.SIG_DFL):  # the tests themselves may run under nohup
        bench = Bench(ros_test)
    bench.servo()
    for number in (signal.SIGTSTP, signal.SIGTTOU, signal.SIGTTIN):
        bench.process.send_signal(number)
        count = len(bench.robot.commands)
        ros_test.spin_until(lambda n=count: len(bench.robot.commands) > n + 20, 2.0, "commands")
    bench.aim(TARGETS_M[1])
    bench.wait(bench.robot.moving, what="motion")
    assert ros_test.stop(bench.process, signal.SIGHUP) == 0
    assert_zeros_last(bench)


def test_the_launcher_outlives_its_reader_also_in_a_namespace(broken_pipe):
    commands = broken_pipe.collect(Float64MultiArray, f"arm/{topics.COMMANDS.name}")
    process = broken_pipe.start("fvs_tools.launcher", "servo", "--namespace", "arm")
    broken_pipe.spin_until(lambda: len(commands) > 100, 30.0, "commands")
    assert process.poll() is None
    assert broken_pipe.stop(process) == 0
