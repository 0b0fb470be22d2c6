"""What is said of an input that does not come as it should."""

from __future__ import annotations

import numpy as np

from fvs_controller_node.config import SupervisorConfig
from fvs_controller_node.inbox import InputMonitor


def heard(times_s):
    monitor = InputMonitor(
        SupervisorConfig(), "ball_position", "is the ball in view?", "ball_max_age_s"
    )
    for time_s in times_s:
        monitor.good(float(time_s))
    return monitor


def test_the_sources_own_words_are_the_hint_while_they_are_new():
    monitor = heard(np.arange(0.0, 1.0, 0.1))
    monitor.set_source_status(1.5, "waiting for ball_position")
    for now_s in (1.6, 3.2):
        assert "the estimator says: waiting for ball_position" in monitor.find(now_s).text
    assert "is the ball in view?" in monitor.find(4.0).text
    monitor.set_source_status(4.0, "")
    assert "is the ball in view?" in monitor.find(4.1).text


def test_stamps_that_stand_still_are_the_hint_while_such_messages_come():
    monitor = heard(np.arange(0.0, 1.0, 0.1))
    monitor.stuck(1.5)
    assert "stamps do not advance" in monitor.find(1.6).text
    assert "is the ball in view?" in monitor.find(2.0).text
