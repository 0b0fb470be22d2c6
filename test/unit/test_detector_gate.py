"""One wrong red thing is not believed, a ball that really moved is."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fvs_detector_node.gate import Gate

DT = 1 / 30
HERE, THERE = np.array([0.0, 0.0, 1.2]), np.array([0.5, 0.0, 1.2])


def believed(gate, positions, start=0, dt=DT):
    return [gate.check((start + i) * dt, p) == "" for i, p in enumerate(positions)]


def test_one_wrong_thing_is_refused_with_the_numbers():
    gate = Gate(3.0)
    assert believed(gate, [HERE, THERE, HERE, THERE, THERE, HERE, HERE]) == [
        True, False, True, False, False, True, True,
    ]  # fmt: skip
    assert gate.refused == 3
    text = gate.check(7 * DT, THERE)
    assert "0.50 m in 0.033 s" in text
    assert "max_ball_speed_m_s (3)" in text


def test_things_here_and_there_are_no_repetition():
    places = [HERE, *[np.array([(-1) ** i * 0.6, 0.1 * i, 1.0]) for i in range(12)]]
    assert not any(believed(Gate(3.0), places)[1:])


def test_after_a_while_unseen_or_a_reset_the_ball_may_be_elsewhere():
    gate = Gate(3.0)
    assert gate.check(0.0, HERE) == gate.check(0.2, THERE) == ""
    gate.reset()
    assert gate.check(0.2 + DT, HERE) == ""


def test_noise_is_no_jump_however_slow_the_ball_must_be_and_a_decimetre_is():
    gate, rng = Gate(0.02), np.random.default_rng(0)
    assert all(believed(gate, HERE + 0.002 * rng.normal(size=(100, 3))))
    assert gate.check(100 * DT, HERE + [0.06, 0.0, 0.0])


@given(st.lists(st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(0.3, 3)), max_size=40))
@settings(max_examples=200, deadline=None)
def test_a_ball_that_stands_still_in_the_end_is_always_believed(places):
    gate = Gate(3.0)
    believed(gate, [np.array(p) for p in places])
    assert believed(gate, [HERE] * 6, start=len(places))[3:] == [True] * 3
