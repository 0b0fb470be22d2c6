"""A wrong Jacobian, and targets that cannot be: held, with a sentence that helps."""

import time

import numpy as np
import pytest
from rig import RAMP_S

from fvs_ros import ros, topics


def rank_deficient(message):
    message.data[12:18] = message.data[6:12]


def flipped(message):
    message.data = [-value for value in message.data]


def test_a_singular_jacobian_is_held_with_the_number_and_released_when_good(rig):
    rig.servo()
    rig.wires[topics.JACOBIAN.name].spoil = rank_deficient
    rig.assert_stops(time.time(), 0.05 + RAMP_S)
    rig.assert_says("HOLDING", "NEAR_SINGULAR", "smallest singular value 0.0000 m/rad")
    rig.wires[topics.JACOBIAN.name].spoil = None
    rig.assert_goes_on_by_itself()
    rig.assert_settles()


def test_a_jacobian_of_the_wrong_sign_goes_the_wrong_way_for_little_and_is_held(rig):
    rig.wires[topics.JACOBIAN.name].spoil = flipped
    rig.harness.spin_for(0.2)
    start_m = rig.ball()
    rig.servo()
    rig.wait(lambda: rig.state() == "HOLDING", what="HOLDING")
    rig.assert_says("HOLDING", "PREDICTION_ERROR", "predicts motion badly", "~/start")
    rig.wait(rig.standing, what="zeros")
    rig.assert_stands()
    rig.wires[topics.JACOBIAN.name].spoil = None
    rig.assert_stands()
    gone_m = float(np.linalg.norm(rig.ball() - start_m))
    print(f"the ball went {gone_m:.3f} m")
    assert gone_m < 0.35
    rig.start()
    rig.assert_settles()


@pytest.mark.parametrize("target_m", [(0.0, 0.0, 0.5)])
def test_a_target_out_of_reach_ends_in_a_held_arm_and_a_sentence(rig, target_m):
    since_s = time.time()
    rig.servo(target_m)
    reasons = ("STALLED", "NEAR_SINGULAR", "PREDICTION_ERROR", "ERROR_GROWING")
    rig.wait(lambda: rig.state() == "HOLDING" and rig.reason() in reasons, 40.0, "HOLDING")
    print(f"{rig.reason()} after {time.time() - since_s:.1f} s")
    assert any(word in rig.text() for word in ("out of reach", "target"))
    rig.wait(rig.standing, what="zeros")
    rig.assert_stands()


@pytest.mark.parametrize(
    ("target_m", "frame", "words"),
    [
        ((5.0, 0.0, 1.5), "camera_color_optical_frame", "workspace"),
        ((-0.15, 0.1, 1.5), "base_link", "base_link"),
    ],
)
def test_a_target_that_is_refused_in_motion_leaves_the_old_one(rig, target_m, frame, words):
    rig.servo()
    rig._targets.publish(ros.to_point(time.time(), frame, np.array(target_m)))
    rig.wait(lambda: "target refused" in rig.text(), what="the refusal")
    assert words in rig.text()
    rig.assert_settles()
