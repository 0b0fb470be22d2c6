import os
from pathlib import Path

import numpy as np
import pytest

from bench.dry_node import DryController
from fvs_ros import clock, ros
from fvs_ros.clock import LoopClock
from fvs_ros.joints import HOME_JOINTS_RAD, UR_JOINT_NAMES

FRAME = "camera_color_optical_frame"
JACOBIAN = np.array([[0.5, 0.1, 0.1, 0, 0, 0], [0.1, 0.5, -0.3, 0, 0, 0], [0.1, 0, 0.4, 0, 0, 0]])
BALL_M = np.array([0.0, 0.1, 1.4])


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


@pytest.mark.parametrize("state", ["HOLDING", "WAITING"])
def test_late_inputs_that_come_again_and_again_are_logged_once(monkeypatch, state):
    load(monkeypatch, 6)
    now_s, told = 10.0, []
    monkeypatch.setattr(DryController, "tell", lambda _self, _level, text: told.append(text))
    given = {"autostart": state == "HOLDING", "joint_state_rate_hz": 125.0}
    node = DryController(given, lambda: now_s)
    node._on_target(ros.to_point(1.0, FRAME, BALL_M))
    holds = 0
    for tick in range(1250):
        now_s += 0.008
        if tick % 50 > 20 or tick < 100:  # else the driver's turn does not come
            joints = ros.to_joint_state(now_s, UR_JOINT_NAMES, HOME_JOINTS_RAD, np.zeros(6))
            node._on_ball(ros.to_point(now_s, FRAME, BALL_M))
            node._on_jacobian(ros.to_jacobian(JACOBIAN))
            node._on_joint_states(joints)
        node._watchdog()
        holds += node._command.state.value == state
    assert holds > 100
    held = [text for text in told if text.startswith(f"{state}: this")]
    assert len(held) == 1, held
    assert held[0].startswith(f"{state}: this computer is too busy: joint_states is 0.1")
    assert len(told) < 10, told
