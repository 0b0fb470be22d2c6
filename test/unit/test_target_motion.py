"""A target that moves: where it is now, how fast, and when it is another one."""

import numpy as np
from cases import each

from fvs_controller_node.target_motion import TargetMotion, Update
from fvs_ros.kinds.ball import Ball
from fvs_ros.kinds.pose import Pose

START = np.array([0.1, -0.1, 1.2])
VELOCITY = np.array([0.2, 0.0, -0.1])


def line(time_s):
    return START + VELOCITY * time_s


@each("age_s", [0.0, 0.05, 0.1, 0.15])
@each("rate_hz", [30.0, 60.0, 100.0])
def test_updates_that_are_told_late_are_those_of_a_moving_target_all_the_same(age_s, rate_hz):
    motion, told_s = TargetMotion(Ball()), 0.0
    for now_s in np.arange(0.0, 1.0, 0.008):
        if now_s >= told_s:
            told_s += 1.0 / rate_hz
            motion.add(line(now_s - age_s), now_s - age_s, age_s)
        if now_s > 0.3:
            z, _, velocity_m_s = motion.at(now_s)
            np.testing.assert_allclose(z, line(now_s), atol=1e-6)
            np.testing.assert_allclose(velocity_m_s, VELOCITY, atol=1e-5)
    # Silence counts from when it was told last, not from where the target was then.
    assert motion.at(now_s + 3.5 / rate_hz + 1.0 / rate_hz)[2] is None


@each(
    ("position", "after_s"),
    [
        (START + [0.3, 0.0, 0.0], 1 / 30),
        (START + [0.07, 0.0, 0.0], 1 / 30),
        (START, 0.5),
        (START, -1.0),
    ],
)
def test_what_no_motion_goes_on_to_is_a_new_target(position, after_s):
    motion, last_s = TargetMotion(Ball()), 0.5
    for time_s in np.arange(0.0, last_s + 0.01, 1.0 / 30.0):
        motion.add(START, float(time_s))
    assert motion.add(position, last_s + after_s) is Update.NEW
    assert motion.at(last_s + after_s + 0.01)[2] is None


def test_a_target_at_rest_is_none_that_moves_although_its_noise_is_correlated():
    """As beside a tag: what the tag's turning adds to a place at a distance, and its arc."""
    kind = Pose()
    begin = kind.of_body(START, np.eye(3))
    motion, generator = TargetMotion(kind), np.random.default_rng(0)
    turns_rad = 1e-3 * generator.standard_normal((600, 3)) * [0.5, 0.7, 0.2]
    path_m = np.hstack([np.cross(turns_rad, [0.2, 0.16, -0.06]), 0.3 * turns_rad])
    path_m += 1e-5 * generator.standard_normal(path_m.shape)
    targets = []
    for count, position_m in enumerate(path_m):
        motion.add(kind.retract(begin, position_m), count / 30)
        targets.append(motion.at(count / 30 + 0.01))
    assert sum(velocity_m_s.any() for _, _, velocity_m_s in targets[5:]) < 3
    errors_m = np.array([position_m for _, position_m, _ in targets[60:]])
    assert np.all(errors_m.std(axis=0) < 0.25 * path_m.std(axis=0))
