"""The schemes beyond the paper through the real nodes: a turned camera, a moving target."""

import math
import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rig import Launched

from fvs_ros import ros, topics

START = np.array([0.0, 0.15, 1.45])
GOAL = np.array([-0.1, 0.05, 1.55])
TURN_DEG = 45.0
RADIUS_M, SPEED_M_S = 0.08, 0.1


def test_a_moving_target_is_followed_and_a_turned_camera_needs_no_new_training(ros_test):
    loop = Launched(ros_test, "--scheme", "best")
    learned = ros_test.collect(DiagnosticStatus, topics.ESTIMATOR_STATUS.name)
    loop.reach(START)
    began_s, errors_m = time.monotonic(), []
    while (passed_s := time.monotonic() - began_s) < 3.0:
        angle = SPEED_M_S / RADIUS_M * passed_s
        at_m = START + RADIUS_M * np.array([math.cos(angle) - 1.0, math.sin(angle), 0.0])
        loop.aim(at_m)
        loop.balls.clear()
        ros_test.spin_for(1.0 / 30.0)
        if passed_s > 1.5 and loop.balls:
            errors_m.append(loop.distance_m(at_m, count=1))
    # Seen 40 ms late at 0.1 m/s: what is heard of the ball is behind it by 4 to 9 mm.
    assert len(errors_m) > 15
    assert np.median(errors_m) < 0.015
    assert loop.reason() in ("SERVOING", "SETTLED")
    assert ros_test.output(loop.process).count("target set to") <= 4  # of a hundred

    loop.reach(START)
    ros_test.set_parameters("fvs_sim_node", camera_rotation_deg=[0.0, 0.0, TURN_DEG])
    c, s = math.cos(math.radians(TURN_DEG)), math.sin(math.radians(TURN_DEG))
    turned = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    ros_test.spin_until(lambda: loop.distance_m(turned @ START) < 0.02, 10.0, "the camera to turn")
    loop.reach(turned @ GOAL)
    loop.reach(turned @ START)
    # Frozen networks would get there as well, in the end.
    found_deg = ros.from_status(learned[-1])["camera_turned_deg"]
    assert float(found_deg) == pytest.approx(TURN_DEG, abs=3.0)
