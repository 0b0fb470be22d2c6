import numpy as np
import pytest

from fvs_ros.clock import LoopClock, Pace


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
    assert times.passed_s(4.9) == 0.0


def test_real_time_goes_on_where_the_simulated_one_has_ended():
    times = Times()
    times.passed_s(0.1, 1.0)
    assert times.passed_s(8.0) == 3.0
    assert times.passed_s(0.02) == 0.02
    assert times.passed_s(0.1, 0.008) == 0.008


def test_the_period_is_learned_from_stamps_and_at_most_that_of_the_rate_that_is_given():
    stamps = 100.0 + 0.002 * np.arange(400) + np.random.default_rng(0).uniform(-3e-4, 3e-4, 400)
    learned, known = Pace(), Pace(1000.0)
    counted = [[pace.joint_state(stamp) for stamp in stamps] for pace in (learned, known)]
    assert counted[0][:4] == [0.0] * 4  # until it is known
    assert counted[0][-100:] == pytest.approx([0.002] * 100, rel=0.05)
    assert set(counted[1]) == {0.001}
    assert learned.joint_state(stamps[-1] + 3.0) == pytest.approx(0.002, rel=0.05)  # a stall
    assert learned.joint_state(stamps[-1] + 3.0) == 0.0  # a stamp that stands
    assert learned.joint_state(stamps[0]) > 0.0  # another clock
