"""What is said of an input that does not come as it should."""

from __future__ import annotations

import numpy as np
import pytest

from fvs_controller_node.inputs import InputMonitor, InputSpec

SPEC = InputSpec("ball_position", "is the ball in view?", 0.2, "ball_max_age_s")


def heard(times_s):
    monitor = InputMonitor(SPEC, 5)
    for time_s in times_s:
        monitor.good(float(time_s))
    return monitor


@pytest.mark.parametrize("after_s", [0.01, 0.15, 0.24])
def test_who_comes_more_slowly_than_the_limit_is_told_so(after_s):
    times_s = np.arange(0.0, 5.0, 0.25)
    finding = heard(times_s).find(times_s[-1] + after_s)
    assert "messages come, but every 0.25 s only (ball_max_age_s is 0.20 s)" in finding.text
    assert "in view" not in finding.text


@pytest.mark.parametrize(
    ("times_s", "now_s"),
    [
        ([], 1.0),
        ([0.0], 0.3),
        ([0.0, 0.5], 0.6),
        (np.arange(0.0, 5.0, 0.25), 6.0),
        ([0.0, 10.0, 20.0], 20.1),
        ([0.0, 0.25, 0.5, 0.6], 0.9),
    ],
    ids=["never", "once", "one gap", "gone", "seldom", "quick again, then gone"],
)
def test_an_input_that_does_not_come_is_not_called_slow(times_s, now_s):
    assert "is the ball in view?" in heard(times_s).find(now_s).text


def test_who_comes_now_just_in_time_and_now_just_too_late_is_slow_too():
    times_s = np.cumsum(np.tile([0.19, 0.21], 10))
    assert "messages come, but every 0.21 s only" in heard(times_s).find(times_s[-1] + 0.1).text


def test_one_long_gap_says_nothing_of_how_rarely_messages_come():
    times_s = np.cumsum([0.0, 0.21, 0.21, 0.21, 4.0])
    assert "messages come, but every 0.21 s only" in heard(times_s).find(times_s[-1] + 0.1).text


def test_who_comes_in_time_of_late_is_not_called_slow():
    times_s = np.cumsum([0.0, 0.25, 0.25, 0.19, 0.19, 0.19])
    text = heard(times_s[:-2]).find(times_s[-3] + 0.1).text
    assert "messages come, but every 0.25 s only" in text
    monitor = heard(times_s)
    assert "messages come" not in str(monitor.find(times_s[-1] + 0.1))


def test_who_comes_at_the_very_limit_is_slow_in_every_sentence():
    times_s = np.arange(0.0, 5.0, 0.2)
    monitor = InputMonitor(SPEC, 5)
    for time_s in times_s:
        monitor.find(time_s - 1e-3)
        monitor.good(float(time_s))
        monitor.find(time_s + 0.2 + 1e-3)  # a tick that came just before the next one
    for after_s in (0.01, 0.19, 0.21):
        text = monitor.find(times_s[-1] + after_s).text
        assert "messages come, but every 0.20 s only (ball_max_age_s is 0.20 s)" in text


def test_who_comes_just_in_time_is_not_called_slow():
    assert "messages come" not in heard([0.0, 0.185, 0.37, 0.555]).find(0.6).text


def test_what_comes_in_time_is_fine_again():
    monitor = heard([0.0, 0.25, 0.5])
    for time_s in (0.53, 0.56, 0.59):
        monitor.good(time_s)
        assert "messages come" not in monitor.find(time_s + 0.01).text
    times_s = [0.0, 0.25, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]
    assert heard(times_s).find(1.05) is None


def test_what_the_source_says_of_itself_is_the_hint_while_it_is_new():
    monitor = heard(np.arange(0.0, 1.0, 0.1))
    monitor.source_says(1.5, "the estimator says: waiting for ball_position")
    assert "the estimator says: waiting for ball_position" in monitor.find(1.6).text
    assert "is the ball in view?" in monitor.find(4.0).text
    monitor.source_says(4.0, "")
    assert "is the ball in view?" in monitor.find(4.1).text
