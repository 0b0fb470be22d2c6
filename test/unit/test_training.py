import sys
from dataclasses import replace

import numpy as np
import pytest
from cases import each
from ur5_dh import (
    BOX_M_RAD,
    HOME_RAD,
    ball_and_jacobian,
    jacobian_error,
    uniform_in_box,
)

from fvs_estimator_node.files import DataSet
from fvs_estimator_node.motion import MotionConfig, RandomMotion
from fvs_estimator_node.pairs import TrainingError
from fvs_estimator_node.training import TrainingOptions, train

NOISE_M = 1e-3
RIDGE = TrainingOptions(method="ridge")
SHORT = TrainingOptions(iterations=40)


def measured(rng, joints):
    return ball_and_jacobian(joints)[0] + NOISE_M * rng.standard_normal((len(joints), 3))


def probes(count, seed=0, size_rad=0.2):
    """Pairs of images, size_rad apart at most, anywhere in box M."""
    rng = np.random.default_rng(seed)
    middle = uniform_in_box(rng, count)
    half = 0.5 * rng.uniform(-size_rad, size_rad, (count, 6))
    joints = np.stack([middle - half, middle + half], axis=1).reshape(-1, 6)
    stamps = np.arange(2 * count) / 30.0
    return DataSet(stamps, joints, measured(rng, joints), np.repeat(np.arange(count), 2))


def smooth(duration_s, seed=0):
    """What the collector would record at 30 Hz."""
    rng = np.random.default_rng(seed)
    motion = RandomMotion(
        HOME_RAD, MotionConfig(duration_s=duration_s, joint_range_rad=tuple(BOX_M_RAD)), rng
    )
    stamps = np.arange(0.0, duration_s, 1.0 / 30.0)
    joints, now = [], HOME_RAD.copy()
    for t in stamps:
        joints.append(now)
        now = now + motion.command(t, now) / 30.0
    joints = np.array(joints)
    return DataSet(stamps, joints, measured(rng, joints), np.zeros(len(stamps), dtype=int))


@pytest.mark.torch
def test_two_minutes_of_the_collectors_motion_suffice():
    told = []
    result = train(smooth(120.0), SHORT, lambda *one: told.append(one) or False)
    assert [one[:2] for one in told] == [(i, 40) for i in range(1, 41)]
    assert jacobian_error(result.model.jacobian) < 0.02


def test_outliers_are_left_out():
    data = smooth(90.0)
    ball, rng = data.z.copy(), np.random.default_rng(5)
    bad = rng.random(len(data)) < 0.02
    ball[bad] += 0.1 * rng.standard_normal((bad.sum(), 3))
    spoilt = train(replace(data, z=ball), RIDGE)
    assert 0.7 * bad.sum() <= spoilt.errors["outliers"] <= bad.sum() + 5
    assert any("left out" in note for note in spoilt.notes)
    chain = train(replace(data, z=ball), TrainingOptions(method="poe"))
    far = ball[np.linalg.norm(ball - data.z, axis=1) > 0.05]
    assert not np.isin(chain.z_samples, far).any()  # targets are drawn from them


def test_data_that_cannot_teach_is_refused():
    data = probes(400)
    n = len(data)
    with pytest.raises(TrainingError, match="expected at least"):
        train(probes(20), RIDGE)
    with pytest.raises(TrainingError, match="joints hardly move"):
        train(replace(data, joints_rad=np.zeros((n, 6))), RIDGE)
    with pytest.raises(TrainingError, match="does not move"):
        train(replace(data, z=np.ones((n, 3))), RIDGE)
    with pytest.raises(TrainingError, match="unknown training method"):
        TrainingOptions(method="magic")


@each("late_s", [0.04, -0.02])
def test_a_time_offset_of_the_images_is_found_and_corrected(late_s):
    data, rng = smooth(90.0), np.random.default_rng(0)
    t = data.stamps_s
    seen = np.stack([np.interp(t - late_s, t, joint) for joint in data.joints_rad.T], axis=1)
    punctual, late = train(data, RIDGE), train(replace(data, z=measured(rng, seen)), RIDGE)
    assert punctual.errors["time_offset_s"] == pytest.approx(0.0, abs=1e-3)
    assert late.errors["time_offset_s"] == pytest.approx(late_s, abs=1e-3)
    assert any("ms" in note for note in late.notes)
    assert not any("ms" in note for note in punctual.notes)
    wrong = jacobian_error(late.model.jacobian)
    assert wrong < 1.3 * jacobian_error(punctual.model.jacobian)


def test_without_torch_the_way_out_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "fvs_estimator_node.varpro", raising=False)
    with pytest.raises(TrainingError, match="needs torch: pip install torch, or use the method ri"):
        train(smooth(20.0), TrainingOptions(method="varpro"))
