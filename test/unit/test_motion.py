import numpy as np
import pytest
from cases import each

from fvs_estimator_node.motion import MotionConfig, RandomMotion

HOME = np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0])
HALF = (0.6, 0.5, 0.5, 0.5, 0.5, 0.5)
DT_S = 0.01


def motion(seed=0, start=HOME, **changes):
    config = MotionConfig(**{"duration_s": 120.0, "joint_range_rad": HALF, **changes})
    return RandomMotion(start, config, np.random.default_rng(seed))


def follow(one, duration_s=None, lag_s=0.0, start=HOME, events=()):
    """Joints and commands of an arm that follows, with a first-order lag if wanted."""
    joints, speed = np.array(start), np.zeros(6)
    share = 1.0 if lag_s == 0.0 else DT_S / (lag_s + DT_S)
    all_joints, commands = [], []
    for k in range(round((duration_s or 120.0) / DT_S)):
        for at, event in events:
            if k == round(at / DT_S):
                event(k * DT_S, joints)
        command = one.command(k * DT_S, joints)
        speed = speed + share * (command - speed)
        joints = joints + DT_S * speed
        all_joints.append(joints)
        commands.append(command)
    return np.array(all_joints), np.array(commands)


@each("half", [HALF, (0.05,) * 6])
def test_it_visits_every_part_of_every_pair_of_joints_evenly(half):
    unit = (follow(motion(joint_range_rad=half))[0] - HOME) / half
    for i in range(6):
        for j in range(i):
            counts, _, _ = np.histogram2d(unit[:, i], unit[:, j], 3, [[-1, 1], [-1, 1]])
            assert counts.min() > 0.3 * counts.mean()


def test_joint_limits_cut_the_box():
    one = motion(joint_max_rad=tuple(HOME + 0.3))
    joints, _ = follow(one, lag_s=0.03)
    assert np.all(joints <= HOME + 0.3)
    np.testing.assert_allclose(one.box_rad[1], HOME + 0.1)  # joint_limit_margin_rad below
    with pytest.raises(ValueError, match=r"wrist_2_joint starts at -1\.57 rad, closer to an"):
        motion(joint_max_rad=tuple(HOME - 1.0))
