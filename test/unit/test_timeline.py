import numpy as np
import pytest

from fvs_ros.timeline import History, StampGate, jump_of


def ramp(stamp_s):
    return np.arange(6.0) * stamp_s


def filled(times):
    history = History()
    for t in times:
        history.add(t, ramp(t))
    return history


def test_interpolation_is_exact_on_a_ramp():
    history = filled(np.arange(100) * 0.008)
    for t in np.random.default_rng(0).uniform(0.0, 0.79, 50):
        np.testing.assert_allclose(history.at(t), ramp(t), atol=1e-12)
    np.testing.assert_allclose(history.at(0.008 * 99), ramp(0.008 * 99))


def test_nothing_is_made_up_outside_or_in_a_gap():
    history = filled([0.0, 0.008, 0.3, 0.308])
    assert history.at(-0.001) is None
    assert history.at(0.309) is None
    assert history.at(0.1) is None
    assert history.at(0.304) is not None


def test_a_message_passes_when_it_is_newer_or_the_clock_was_set():
    gate = StampGate()
    stamps = [5.0, 5.0, 5.1, 5.04, 5.1, 5.11, 4.8, 4.8, 4.81, 99.0]
    passed = [True, False, True, False, False, True, True, False, True, True]
    assert [gate.advances(stamp_s) for stamp_s in stamps] == passed


@pytest.mark.parametrize("passed_s", [0.008, 0.1, 0.4])
def test_the_fastest_joint_makes_no_jump_and_one_three_times_as_fast_does(passed_s):
    step = np.zeros(6)
    step[3] = -np.pi * passed_s
    assert jump_of(step, passed_s) is None
    assert jump_of(3.0 * step - 0.1 * (step < 0.0), passed_s) == 3


@pytest.mark.parametrize("jump_s", [-5.0, -0.3, 10.0])
def test_a_clock_jump_starts_anew(jump_s):
    history = filled([100.0, 100.008])
    assert not history.add(100.0 + jump_s, np.ones(6))
    assert len(history) == 1
    assert history.at(100.004) is None
