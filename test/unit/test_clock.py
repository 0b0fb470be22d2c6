import os
from pathlib import Path

import pytest

from fvs_ros import clock
from fvs_ros.clock import LoopClock


class Times:
    steady_s, simulated_s = 100.0, 0.0

    def __init__(self):
        self.clock = LoopClock(lambda: self.simulated_s, lambda: self.steady_s)

    def passed_s(self, steady_s, simulated_s=0.0):
        before_s = self.clock.now_s()
        self.steady_s += steady_s
        self.simulated_s += simulated_s
        return pytest.approx(self.clock.now_s() - before_s)


def test_simulated_time_counts_however_long_it_takes_and_jumps_do_not():
    times = Times()
    assert times.passed_s(0.1, 5000.0) == 0.0  # the first stamp
    assert times.passed_s(1.5, 0.008) == 0.008
    assert times.passed_s(0.001, 0.008) == 0.008
    assert times.passed_s(0.1, -20.0) == 0.0
    assert times.passed_s(1.9) == 0.0


def test_real_time_goes_on_where_the_simulated_one_has_ended():
    times = Times()
    times.passed_s(0.1, 1.0)
    assert times.passed_s(5.0) == 3.0
    assert times.passed_s(0.02) == 0.02
    assert times.passed_s(0.1, 0.008) == 0.008


def load(monkeypatch, running):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: {0, 1})
    monkeypatch.setattr(Path, "read_text", lambda _path: f"1.0 1.0 1.0 {running}/300 77\n")


def test_a_late_input_is_the_computers_fault_only_if_that_is_busy(monkeypatch):
    load(monkeypatch, 3)
    assert clock.blamed("joint_states is late") == "joint_states is late"
    load(monkeypatch, 6)
    assert clock.blamed("joint_states is late").startswith("this computer is too busy: joint")
