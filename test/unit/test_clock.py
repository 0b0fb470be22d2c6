import pytest

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
    assert times.passed_s(4.9) == 0.0


def test_real_time_goes_on_where_the_simulated_one_has_ended():
    times = Times()
    times.passed_s(0.1, 1.0)
    assert times.passed_s(8.0) == 3.0
    assert times.passed_s(0.02) == 0.02
    assert times.passed_s(0.1, 0.008) == 0.008
