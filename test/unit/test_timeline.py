import numpy as np
import pytest

from fvs_ros.timeline import StampGate, jump_of


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
