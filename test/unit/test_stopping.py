"""A collection ends early when a fit in another process knows the chain well enough."""

import sys
import time

import numpy as np
import pytest
import ur5_dh
from recordings import Recording

from fvs_estimator_node.stopping import StopCriterion
from fvs_ros.timeline import Sample

BOX = ur5_dh.HOME_RAD + np.array([-1.0, 1.0])[:, None] * ur5_dh.BOX_M_RAD
GOOD = '{"jacobian_deviation": 0.001, "misfit": 1.0, "image_offset_s": 0.0, "is_chain": true}'


def samples_of(data):
    columns = (data.stamps_s, data.joints_rad, data.ball_m, data.segment.tolist())
    return [Sample(float(t), *rest) for t, *rest in zip(*columns, strict=True)]


@pytest.fixture(scope="module")
def samples():
    return samples_of(Recording(seed=2, seconds=20.0).data())


def answered(stop, time_s, samples):
    """Ask at a time, and wait for the answer."""
    stop.look(time_s, samples, BOX)
    until_s = time.monotonic() + 60.0
    while stop._fit is not None and time.monotonic() < until_s:
        time.sleep(0.01)
        stop.look(time_s, samples, BOX)
    return stop


def saying(*words):
    """A program that prints lines whatever it is asked, and reads all of it before."""
    lines = "; ".join(f"print({word!r})" for word in words)
    return (sys.executable, "-c", f"import sys; sys.stdin.buffer.read(); {lines}")


def test_two_fits_in_a_row_that_know_the_chain_are_enough(samples):
    stop = StopCriterion(0.002)
    stop.look(11.9, samples, BOX)
    assert stop._fit is None  # too early
    answered(stop, 12.0, samples)
    assert stop.found["is_chain"]
    assert stop.found["image_offset_s"] == pytest.approx(0.08, abs=0.002)
    assert stop.words() == f"Jacobian known to {100 * stop.found['jacobian_deviation']:.2g} %"
    assert not stop.enough
    stop.look(15.9, samples, BOX)
    assert stop._fit is None  # not yet again
    assert answered(stop, 16.0, samples).enough


@pytest.mark.parametrize(
    ("answer", "counts"),
    [
        (GOOD, True),
        (GOOD.replace("0.001", "0.02"), False),
        (GOOD.replace("1.0", "NaN").replace("true", "false"), False),
        ("{}", False),
    ],
    ids=["good", "not known", "cannot be told", "no fit yet"],
)
def test_only_good_answers_count(samples, answer, counts):
    stop = StopCriterion(0.01, command=saying("a library's remark", answer))
    assert not answered(stop, 12.0, samples).enough
    assert answered(stop, 16.0, samples).enough == counts
    assert stop.trouble == ""


def test_a_fit_that_hangs_holds_nothing_up(samples):
    stop = StopCriterion(0.01, command=("sleep", "100"))
    began_s = time.monotonic()
    stop.look(12.0, samples, BOX)
    stop.look(16.0, samples, BOX)
    assert time.monotonic() - began_s < 1.0
    assert not stop.trouble
    stop._fit.kill()
    assert "exit code -9" in answered(stop, 17.0, samples).trouble
