import numpy as np
import pytest

from fvs_ros.core.history import JointHistory


def ramp(stamp_s):
    return np.arange(6.0) * stamp_s


def filled(times):
    history = JointHistory()
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


def test_duplicates_and_reordered_samples_are_passed_over():
    history = filled([0.0, 0.008, 0.016])
    assert history.add(0.016, np.ones(6))
    assert history.add(0.008, np.ones(6))
    assert len(history) == 3
    np.testing.assert_allclose(history.newest, ramp(0.016))


@pytest.mark.parametrize("jump_s", [-5.0, 10.0])
def test_a_clock_jump_starts_anew(jump_s):
    history = filled([100.0, 100.008])
    assert not history.add(100.0 + jump_s, np.ones(6))
    assert len(history) == 1
    assert history.at(100.004) is None


def test_it_forgets_what_is_too_old():
    history = filled(np.arange(1000) * 0.008)
    assert len(history) <= 252
    assert history.at(1.0) is None
